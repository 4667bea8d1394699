"""Signatures, by the real gpgv, with keys that are made here; and what else a package may be."""

import os
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.update import package
from gateway.update.machine import ProgramResult, UpdateError
from tests.update_machine import NEW, PlayedMachine, Version, installed
from tests.update_machine import package as package_of


class Keys:
    """Keys of a maker, of a plant, and one that has expired. `public`: by name."""

    def __init__(self, home: str) -> None:
        self._home = home
        at = ("--faked-system-time", "20250101T000000")
        for name, when, life in (("maker", (), "never"), ("plant", (), "never"), ("late", at, "1d")):
            self.gpg("--passphrase", "", *when, "--quick-gen-key", name, "ed25519", "sign", life)
        self.public = {name: self.gpg("--export", name) for name in ("maker", "plant", "late")}

    def gpg(self, *words: str | Path) -> bytes:
        command = ["gpg", "--homedir", self._home, "--batch", "--quiet", *words]
        return subprocess.run(command, check=True, capture_output=True, timeout=60).stdout

    def sign(self, name: str, path: Path, *, armor: bool = True) -> Path:
        signature = path.with_name(f"{path.name}.{'asc' if armor else 'sig'}")
        signature.unlink(missing_ok=True)
        at = ("--faked-system-time", "20250101T010000") if name == "late" else ()
        self.gpg(
            *at, "--local-user", name, "--output", signature, *(["--armor"] if armor else []), "--detach-sign", path
        )
        return signature


@pytest.fixture(scope="module")
def keys() -> Iterator[Keys]:
    with tempfile.TemporaryDirectory(prefix="lgk") as home:  # short: the agent's socket is in it
        yield Keys(home)
        subprocess.run(["gpgconf", "--homedir", home, "--kill", "all"], check=True, timeout=60)


@pytest.fixture
def machine(tmp_path: Path) -> PlayedMachine:
    made = installed(tmp_path)
    for path in made.paths.keyrings:
        path.parent.mkdir(parents=True, exist_ok=True)
    return made


def test_dpkgs_own_error_is_quoted() -> None:
    out = "(Reading database ... 9 files)\nPreparing to unpack ...\nUnpacking loading-gateway ...\n"
    failed = "dpkg: error processing archive p.deb (--install):\n cannot copy extracted data: No space left on device\n"
    err = f"{failed}Errors were encountered while processing:\n p.deb\n"
    assert package.dpkg_fault(ProgramResult(1, out, err)) == (
        "dpkg: error processing archive p.deb (--install):; cannot copy extracted data: No space left on device"
    )
    assert package.dpkg_fault(ProgramResult(1, "only this\n")) == "only this"


def verified(machine: PlayedMachine, path: Path, *, unsigned: bool = False) -> str:
    lines: list[str] = []
    signature = path.with_name(f"{path.name}.asc")
    package.verify(machine, path, lines.append, signature=signature, unsigned=unsigned)
    return "\n".join(lines)


def test_a_good_signature_by_a_key_of_either_keyring(machine: PlayedMachine, keys: Keys) -> None:
    path = package_of(machine, Version(name=NEW))
    keys.sign("maker", path)
    own, shipped = machine.paths.keyrings
    shipped.write_bytes(keys.public["maker"])
    assert verified(machine, path).startswith("signature: good, by maker, key ")
    own.write_bytes(keys.public["plant"])
    assert "good, by maker" in verified(machine, path), "the plant's own keyring does not replace the maker's"
    shipped.unlink()
    with pytest.raises(UpdateError, match="which is in none of the keyrings"):
        verified(machine, path)


def test_what_is_refused_says_why(machine: PlayedMachine, keys: Keys) -> None:
    path = package_of(machine, Version(name=NEW))
    shipped = machine.paths.keyrings[1]
    with pytest.raises(UpdateError, match=r"deb\.asc: no such file: the package has no signature beside it"):
        verified(machine, path)
    signature = keys.sign("plant", path)
    with pytest.raises(UpdateError, match="no keyring: put the public keys that you trust into"):
        verified(machine, path)
    shipped.write_bytes(keys.public["maker"])
    with pytest.raises(UpdateError, match=r"signed with key [0-9A-F]{16}, which is in none of the keyrings"):
        verified(machine, path)
    shipped.write_bytes(keys.public["plant"])
    assert "good, by plant" in verified(machine, path)
    text = path.read_bytes()
    path.write_bytes(text + b" ")
    with pytest.raises(UpdateError, match="was changed or damaged after it was signed"):
        verified(machine, path)
    path.write_bytes(text)
    signature.write_text("-----BEGIN PGP SIGNATURE-----\nnone\n")
    with pytest.raises(UpdateError, match="no signature that can be verified"):
        verified(machine, path)
    shipped.write_text("no keys")
    keys.sign("maker", path.rename(path.with_name("other.deb")))
    with pytest.raises(UpdateError, match=r"none of the keyrings|can be verified"):
        verified(machine, path.with_name("other.deb"))


def test_a_good_signature_beside_a_bad_one_is_refused(machine: PlayedMachine, keys: Keys) -> None:
    """gpgv prints GOODSIG and VALIDSIG for the good one, and ends with another code than 0."""
    path = package_of(machine, Version(name=NEW))
    shipped = machine.paths.keyrings[1]
    shipped.write_bytes(keys.public["maker"] + keys.public["plant"])
    good = keys.sign("maker", path, armor=False).read_bytes()
    signature = path.with_name(f"{path.name}.asc")
    text = path.read_bytes()
    path.write_bytes(text + b" ")
    bad = keys.sign("plant", path, armor=False).read_bytes()
    unknown = keys.sign("late", path, armor=False).read_bytes()
    path.write_bytes(text)
    for other, why in ((bad, "was changed or damaged"), (unknown, "none of the keyrings")):
        for both in (good + other, other + good):
            signature.write_bytes(both)
            with pytest.raises(UpdateError, match=why):
                verified(machine, path)
    signature.write_bytes(good)
    assert "good, by maker" in verified(machine, path)


def test_a_keyring_that_others_than_root_can_write_is_not_trusted(machine: PlayedMachine, keys: Keys) -> None:
    path = package_of(machine, Version(name=NEW))
    keys.sign("plant", path)
    own, shipped = machine.paths.keyrings
    shipped.write_bytes(keys.public["maker"])
    own.write_bytes(keys.public["plant"])
    for mode in (0o664, 0o646):
        own.chmod(mode)
        with pytest.raises(UpdateError, match=r"etc/loading-gateway/release\.gpg: others than root can write it"):
            verified(machine, path)
    own.chmod(0o644)
    assert "good, by plant" in verified(machine, path)
    elsewhere = own.rename(own.with_name("elsewhere.gpg"))
    own.symlink_to(elsewhere)
    with pytest.raises(UpdateError, match="is a link"):
        verified(machine, path)


def test_a_keyring_of_another_user_is_not_trusted(
    machine: PlayedMachine, keys: Keys, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = package_of(machine, Version(name=NEW))
    keys.sign("maker", path)
    keyring = machine.paths.keyrings[1]
    keyring.write_bytes(keys.public["maker"])
    keyring.chmod(0o644)
    if os.geteuid() == 0:
        os.chown(keyring, 4711, 4711)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: 0)
    with pytest.raises(UpdateError, match="others than root can write it"):
        verified(machine, path)


def test_an_expired_key_is_refused_which_gpgv_itself_takes(machine: PlayedMachine, keys: Keys) -> None:
    path = package_of(machine, Version(name=NEW))
    signature = keys.sign("late", path)
    keyring = machine.paths.keyrings[1]
    keyring.write_bytes(keys.public["late"])
    assert (
        subprocess.run(["gpgv", "--keyring", keyring, signature, path], check=False, capture_output=True).returncode
        == 0
    )
    with pytest.raises(UpdateError, match="the key that signed it has expired"):
        verified(machine, path)


def test_unsigned_is_told(machine: PlayedMachine) -> None:
    path = package_of(machine, Version(name=NEW))
    assert "not verified, as --unsigned asks" in verified(machine, path, unsigned=True)


@pytest.mark.parametrize(
    ("fields", "version"),
    [
        ("Package: loading-gateway\nVersion: 0.2.0\n", "0.2.0"),
        ("Package: loading-gateway\nVersion: 1:0.2.0~rc1-3\n", "0.2.0~rc1"),
        ("Package: other\nVersion: 0.2.0\n", "the package of other, and not of loading-gateway"),
        ("Package: loading-gateway\nVersion: ../../etc\n", "is none"),
        ("", "not a Debian package"),
    ],
)
def test_the_version_of_a_package(
    machine: PlayedMachine, monkeypatch: pytest.MonkeyPatch, fields: str, version: str
) -> None:
    monkeypatch.setattr(
        PlayedMachine, "command", lambda *_, **__: ProgramResult(0 if fields else 2, fields, "no ar archive")
    )
    path = machine.paths.root / "x.deb"
    if version[0].isdigit():
        assert package.version_of(machine, path) == version
    else:
        with pytest.raises(UpdateError, match=version):
            package.version_of(machine, path)
