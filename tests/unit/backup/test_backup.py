"""A gateway's files in one archive and back again: whole, or not at all, and never anywhere else."""

import gzip
import io
import os
import stat
import subprocess
import sys
import tarfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec
import pytest

from gateway.backup import archive, contents, restore
from gateway.backup.manifest import NAME, BackupError, Entry, Kind, Manifest, Owned, decoded
from gateway.cli.main import main
from gateway.config import GatewayConfig, load, reference
from gateway.files import write_file
from gateway.sinks import registry
from tests.plant_certs import Plant
from tests.recorded_bay import Recorded

HASH = "$argon2id$v=19$m=19456,t=2,p=1$c2FsdHNhbHQ$q6urq6urq6urq6urq6urq6urq6urq6urq6urq6urq6s"
SECRETS = (b"Broker-Pw", b"c2FsdHNhbHQ", b"Camera-Pw", b"PRIVATE KEY")


def no_check(_config: GatewayConfig, _name: str, _text: str) -> None:
    """Every configuration is good."""


@dataclass
class Machine:
    """The folders of an installed gateway below `root`."""

    root: Path

    def __post_init__(self) -> None:
        self.etc, self.state = self.root / "etc", self.root / "state"
        self.config = self.etc / "gateway.toml"
        self.archive = self.root / "north.tar.gz"
        self.bay_file = self.state / f"bay.site1.{self.root.name}.bay1.json"

    def install(self) -> None:
        self.etc.mkdir()
        self.state.mkdir(mode=0o700)
        Plant(self.etc / "certs")
        (self.etc / "broker.pw").write_text("Broker-Pw\n")
        (self.etc / "broker.pw").chmod(0o640)
        certs = self.etc / "certs"
        self.config.write_text(f"""
# the north bay
instance = "{self.root.name}"
[camera]
url = "rtsp://u:Camera-Pw@127.0.0.1/live"
[modbus]
port = 0
[modbus.tls]
cert = "{certs}/gateway.pem"
key = "{certs}/gateway.key"
ca = "{certs}/ca.pem"
crl = "{certs}/crl.pem"
[mqtt]
url = "mqtt://127.0.0.1:1"
username = "u"
password_file = "{self.etc}/broker.pw"
[hmi]
users = [{{ name = "ann", password_hash = "{HASH}" }}]
""")
        self.config.chmod(0o640)
        write_file(self.bay_file, b'{"a": 1}')

    def files(self) -> dict[str, bytes]:
        """All below its two folders."""
        found = [path for folder in (self.etc, self.state) for path in folder.rglob("*") if path.is_file()]
        return {str(path.relative_to(self.root)): path.read_bytes() for path in found}

    def empty(self) -> None:
        """Another machine, on which nothing is yet."""
        self.etc.rename(self.root / "old-etc")
        self.state.rename(self.root / "old-state")


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    made = Machine(tmp_path)
    monkeypatch.setenv("STATE_DIRECTORY", str(made.state))
    monkeypatch.setattr(restore, "SYSTEM_FOLDER", made.etc)
    made.install()
    return made


def kept(machine: Machine, *options: str) -> Manifest:
    assert main(["backup", str(machine.archive), "--config", str(machine.config), "--overwrite", *options]) == 0
    return archive.verify(machine.archive)


def restored(machine: Machine, *options: str) -> int:
    return main(["restore", str(machine.archive), *options])


HOLDS_THE_LOCK = """
import sys
from gateway.shared_state import SharedStateWriter
with SharedStateWriter(sys.argv[1], "bay1"):
    print("held", flush=True)
    sys.stdin.read()
"""
AUTHORITY = ("etc/certs/ca.key",)  # which the gateway does not need, and should not have


def test_what_a_backup_has_kept_comes_back_on_an_empty_machine(
    machine: Machine, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {name: data for name, data in machine.files().items() if name not in AUTHORITY}
    modes = {name: stat.S_IMODE((machine.root / name).stat().st_mode) for name in before}
    manifest = kept(machine)
    assert stat.S_IMODE(machine.archive.stat().st_mode) == 0o600
    assert [entry.kind for entry in manifest.files] == [
        Kind.CONFIGURATION,
        Kind.CERTIFICATE,
        Kind.SECRET,
        Kind.CERTIFICATE,
        Kind.CERTIFICATE,
        Kind.SECRET,
        Kind.STATE,
    ]
    machine.empty()

    assert restored(machine, "--dry-run") == 0
    assert not machine.etc.exists()
    assert restored(machine) == 0
    assert machine.files() == before
    assert {name: stat.S_IMODE((machine.root / name).stat().st_mode) for name in before} == modes
    assert stat.S_IMODE(machine.state.stat().st_mode) == 0o700
    assert main(["check", str(machine.config)]) == 0
    assert f"7 files written. Now: gateway check {machine.config}" in capsys.readouterr().out
    assert restored(machine) == 0  # once more changes nothing
    assert "0 files written" in capsys.readouterr().out


def test_what_exists_stays_unless_told_and_then_beside(machine: Machine, capsys: pytest.CaptureFixture[str]) -> None:
    kept(machine)
    newer = machine.config.read_text() + "log_level = 1\n"
    machine.config.write_text(newer)
    (machine.etc / "broker.pw").write_text("another\n")
    machine.bay_file.write_bytes(b'{"function_check": "of now"}')
    before = machine.files()

    assert restored(machine) == 2
    assert "exists, with other contents; --force replaces it" in capsys.readouterr().err
    assert machine.files() == before
    assert restored(machine, "--force") == 0
    assert "# the north bay" in machine.config.read_text()
    (aside,) = machine.etc.glob("gateway.toml.before-*")
    assert aside.read_text() == newer
    assert len(list(machine.etc.glob("broker.pw.before-*"))) == 1
    assert machine.bay_file.read_bytes() == b'{"function_check": "of now"}'
    assert "the state of a bay is that of now" in capsys.readouterr().out


def test_all_or_nothing(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    kept(machine)
    for name in ("gateway.toml", "broker.pw", "certs/ca.pem"):
        (machine.etc / name).write_text("newer")
    before = machine.files()
    replace, done = Path.replace, []

    def fails_at_the_third(self: Path, target: Path) -> Path:
        done.append(self.name)
        if len(done) == 3:
            raise OSError(5, "Input/output error", str(target))
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", fails_at_the_third)
    assert restored(machine, "--force") == 1
    monkeypatch.undo()
    assert machine.files() == before


@pytest.mark.long
@pytest.mark.one_interpreter
def test_while_a_gateway_of_this_name_runs_nothing_is_written(
    machine: Machine, capsys: pytest.CaptureFixture[str]
) -> None:
    kept(machine)
    (machine.etc / "broker.pw").unlink()
    line = [sys.executable, "-c", HOLDS_THE_LOCK, machine.root.name]
    with subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == b"held\n"
        assert restored(machine) == 2
        running.communicate()
    assert "is already running" in capsys.readouterr().err
    assert not (machine.etc / "broker.pw").exists()
    assert restored(machine) == 0


def test_without_secrets_no_byte_of_one_is_there(machine: Machine, capsys: pytest.CaptureFixture[str]) -> None:
    kept(machine)
    with tarfile.open(machine.archive) as whole:
        everything = b"".join(data.read() for member in whole if (data := whole.extractfile(member)) is not None)
    assert all(secret in everything for secret in SECRETS)

    manifest = kept(machine, "--no-secrets")
    with tarfile.open(machine.archive) as whole:
        everything = b"".join(data.read() for member in whole if (data := whole.extractfile(member)) is not None)
    assert not [secret for secret in SECRETS if secret in everything]
    assert b"# the north bay" in everything
    assert manifest.left_out == [
        f"{machine.etc}/certs/gateway.key (modbus.tls.key)",
        f"{machine.etc}/broker.pw (mqtt.password_file)",
    ]
    assert restored(machine, "--force") == 2
    assert "an archive without secrets replaces nothing" in capsys.readouterr().err
    machine.empty()
    assert restored(machine) == 0
    assert 'password_hash = "***"' in machine.config.read_text()
    assert "set them before the gateway is started" in capsys.readouterr().out


@pytest.mark.parametrize("contents_of", ["a certificate with its key", "no certificate"])
def test_without_secrets_a_file_that_is_named_as_a_certificate_is_one(machine: Machine, contents_of: str) -> None:
    certs = machine.etc / "certs"
    certificate = certs / "gateway.pem"
    if contents_of == "a certificate with its key":
        certificate.write_bytes(certificate.read_bytes() + (certs / "gateway.key").read_bytes())
    else:
        certificate.write_text("root:PRIVATE KEY of somebody")
    machine.config.write_text(machine.config.read_text().replace("gateway.key", "gateway.pem"))
    manifest = kept(machine, "--no-secrets")
    with tarfile.open(machine.archive) as whole:
        everything = b"".join(data.read() for member in whole if (data := whole.extractfile(member)) is not None)
    assert b"PRIVATE KEY" not in everything
    assert f"{certificate} (modbus.tls.cert)" in manifest.left_out
    assert [entry.path for entry in manifest.files if entry.kind is Kind.CERTIFICATE] == [
        f"{certs}/ca.pem",
        f"{certs}/crl.pem",
    ]


@pytest.mark.one_interpreter
def test_it_is_whole_while_everything_is_written(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Configuration and bay file are one of the two that there were at any moment; a recording grows meanwhile."""
    recorded = Recorded(machine.state / "records", f"site1.{machine.root.name}")
    recorded.write(0)
    (segment,) = recorded.path.rglob("*.seg")
    texts = [machine.config.read_bytes(), machine.config.read_bytes() + b"# " + b"x" * 100_000 + b"\n"]
    states = [b'{"a": 1}', b'{"a": ' + b"1" * 50_000 + b"}"]
    done = threading.Event()

    def write() -> None:
        n = 0
        while not done.is_set():
            n += 1
            write_file(machine.config, texts[n % 2])
            write_file(machine.bay_file, states[n % 2])
            with segment.open("ab") as file:
                file.write(os.urandom(3000))

    writer = threading.Thread(target=write)
    writer.start()
    try:
        found = [kept(machine, "--records") for _ in range(10)]
    finally:
        done.set()
        writer.join()
    sizes = [entry.bytes for manifest in found for entry in manifest.files if entry.kind is Kind.RECORD]
    assert sizes == sorted(sizes)
    assert sizes[-1] > sizes[0]
    for path, data in archive.files(machine.archive, found[-1]):
        if path.kind in (Kind.CONFIGURATION, Kind.STATE):
            assert data.read() in (texts if path.kind is Kind.CONFIGURATION else states)


def test_recordings_come_back_into_an_empty_folder_only(machine: Machine, capsys: pytest.CaptureFixture[str]) -> None:
    folder = machine.state / "records" / f"site1.{machine.root.name}"
    recorded = Recorded(folder.parent, folder.name)
    for n in range(3):
        recorded.write(n * 10**9)
    before = {path.name: path.read_bytes() for path in folder.rglob("*.seg")}
    kept(machine, "--records")
    (folder / "bay1" / max(before)).unlink()
    assert restored(machine) == 2
    assert "has recordings of its own" in capsys.readouterr().err
    machine.empty()
    assert restored(machine) == 0
    assert {path.name: path.read_bytes() for path in folder.rglob("*.seg")} == before


def test_test_sets_come_back_as_a_whole(machine: Machine, capsys: pytest.CaptureFixture[str]) -> None:
    folder = machine.state / "test-sets" / f"site1.{machine.root.name}" / "bay1" / "Low sun"
    folder.mkdir(parents=True)
    (folder / "labels.jsonl").write_text('{"file": "0001-a.png", "found": false}\n')
    (folder / "0001-a.png").write_bytes(b"picture")
    (folder / "notes.txt").write_text("not a part of it")
    (folder / "0002-b.png").symlink_to("/etc/hostname")
    manifest = kept(machine)
    assert [Path(entry.path).name for entry in manifest.files if entry.kind is Kind.TEST_SET] == [
        "0001-a.png",
        "labels.jsonl",
    ]
    machine.empty()
    assert restored(machine) == 0
    assert sorted(path.name for path in folder.iterdir()) == ["0001-a.png", "labels.jsonl"]
    (folder / "labels.jsonl").write_text('{"file": "0001-a.png", "found": true, "u": 1, "v": 1, "r": 1}\n')
    (folder / "0001-a.png").unlink()
    assert restored(machine, "--force") == 0
    assert [path.name for path in folder.iterdir()] == ["labels.jsonl"]
    assert "stays as it is: pictures and labels of two test sets are not mixed" in "".join(capsys.readouterr())
    assert Kind.TEST_SET not in {entry.kind for entry in kept(machine, "--no-secrets").files}


DUTCH = '{"name": "Nederlands", "texts": {"driver|STOP": "STOP"}}'


def speak(machine: Machine, text: str = DUTCH) -> Path:
    """The plant's own language."""
    folder = machine.etc / "languages"
    folder.mkdir()
    (folder / "nl.json").write_text(text)
    (folder / "notes.txt").write_text("not a part of it")
    machine.config.write_text(machine.config.read_text().replace("[hmi]\n", f'[hmi]\nlanguages_folder = "{folder}"\n'))
    return folder


def test_the_plants_own_languages_come_back(machine: Machine, capsys: pytest.CaptureFixture[str]) -> None:
    folder = speak(machine)
    manifest = kept(machine)
    assert [entry.path for entry in manifest.files if entry.kind is Kind.LANGUAGE] == [f"{folder}/nl.json"]
    machine.empty()
    assert restored(machine) == 0
    assert [path.name for path in folder.iterdir()] == ["nl.json"]
    assert (folder / "nl.json").read_text() == DUTCH
    assert main(["check", str(machine.config)]) == 0
    assert Kind.LANGUAGE in {entry.kind for entry in kept(machine, "--no-secrets").files}


def test_a_languages_folder_that_is_missing_is_an_error(machine: Machine, capsys: pytest.CaptureFixture[str]) -> None:
    speak(machine).rename(machine.etc / "elsewhere")
    assert main(["backup", str(machine.archive), "--config", str(machine.config)]) == 1
    assert f"hmi.languages_folder: {machine.etc}/languages: No such file or directory" in capsys.readouterr().err


def test_of_a_strangers_archive_no_other_file_is_written_as_a_language(machine: Machine) -> None:
    folder = machine.etc / "languages"
    config = f'instance = "{machine.root.name}"\n[hmi]\nlanguages_folder = "{folder}"\n'.encode()
    names = [
        f"{folder}/nl.json",
        f"{folder}/nl.sh",
        f"{folder}/x/nl.json",
        f"{folder}/Evil.json",
        f"{machine.etc}/nl.json",
    ]
    files = [(entry(name, DUTCH.encode(), Kind.LANGUAGE), DUTCH.encode()) for name in names]
    files.insert(0, (entry(str(machine.config), config, Kind.CONFIGURATION), config))
    machine.empty()
    plan = restore.plan(made(machine.archive, files, str(machine.config)), no_check, force=True, outside=True)
    assert [entry.path for entry in plan.new] == [str(machine.config), names[0]]
    assert len(plan.faults) == 4


def test_the_plants_own_keyring_comes_back_and_is_pointed_out(
    machine: Machine, capsys: pytest.CaptureFixture[str]
) -> None:
    keyring = machine.etc / "release.gpg"
    keyring.write_bytes(b"public keys")
    keyring.chmod(0o644)
    assert [entry.path for entry in kept(machine).files if entry.kind is Kind.KEYRING] == [str(keyring)]
    machine.empty()
    assert restored(machine) == 0
    assert (keyring.read_bytes(), stat.S_IMODE(keyring.stat().st_mode)) == (b"public keys", 0o644)
    assert f"{keyring}: packages that are signed with these keys can be installed by root" in capsys.readouterr().out
    other = (entry(str(machine.etc / "other.gpg"), b"1", Kind.KEYRING), b"1")
    config = machine.config.read_bytes()
    files = [(entry(str(machine.config), config, Kind.CONFIGURATION), config), other]
    plan = restore.plan(made(machine.archive, files, str(machine.config)), no_check, force=True, outside=True)
    assert [fault.partition(": ")[0] for fault in plan.faults] == [f"{machine.etc}/other.gpg"]


@pytest.mark.parametrize("options", [[], ["--no-secrets"]])
@pytest.mark.parametrize("what", ["bay file", "keyring", "language"])
def test_a_link_where_the_service_can_write_is_not_followed(
    machine: Machine, capsys: pytest.CaptureFixture[str], what: str, options: list[str]
) -> None:
    """It is root that makes the backup."""
    place = {
        "bay file": machine.bay_file,
        "keyring": machine.etc / "release.gpg",
        "language": speak(machine) / "nl.json",
    }[what]
    place.unlink(missing_ok=True)
    (machine.root / "shadow").write_text("of root alone")
    place.symlink_to(machine.root / "shadow")
    assert main(["backup", str(machine.archive), "--config", str(machine.config), *options]) == 1
    assert f"{place}: cannot be read: Too many levels of symbolic links" in capsys.readouterr().err
    assert not machine.archive.exists()


@pytest.mark.parametrize("kind", [Kind.RECORD, Kind.TEST_SET])
def test_a_file_that_becomes_a_link_after_it_was_listed_is_not_followed(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, kind: Kind
) -> None:
    (machine.root / "shadow").write_text("of root alone")
    link = machine.state / "link"
    link.symlink_to(machine.root / "shadow")
    monkeypatch.setattr(contents, "record_files" if kind is Kind.RECORD else "test_set_files", lambda _: iter([link]))
    assert main(["backup", str(machine.archive), "--config", str(machine.config), "--records"]) == 1
    assert not machine.archive.exists()


def test_more_files_than_an_archive_can_list_are_refused_before_anything_is_written(
    machine: Machine, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archive, "MAX_FILES", 7)
    kept(machine)
    machine.archive.unlink()
    (machine.etc / "release.gpg").write_bytes(b"one more")
    monkeypatch.setattr(archive, "_added", lambda *_: pytest.fail("it has begun to write"))
    assert main(["backup", str(machine.archive), "--config", str(machine.config)]) == 1
    assert "8 files, and an archive lists at most 7" in capsys.readouterr().err
    assert not list(machine.root.glob("north.tar.gz*"))


def test_a_configuration_that_this_gateway_refuses_is_not_restored(
    machine: Machine, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (machine.etc / "certs" / "gateway.pem").write_text("no certificate")
    kept(machine)
    machine.empty()
    assert restored(machine) == 2
    assert f"{machine.config}:8: modbus.tls: " in capsys.readouterr().err
    assert not machine.etc.exists()


def test_a_file_that_the_configuration_names_must_be_there(
    machine: Machine, capsys: pytest.CaptureFixture[str]
) -> None:
    (machine.etc / "broker.pw").unlink()
    assert main(["backup", str(machine.archive), "--config", str(machine.config)]) == 1
    assert f"mqtt.password_file: {machine.etc}/broker.pw: No such file" in capsys.readouterr().err
    assert not list(machine.root.glob("north.tar.gz*"))


# Archives that were damaged, or made by somebody else.


def test_a_truncated_or_damaged_archive_is_refused_wherever_it_ends(machine: Machine) -> None:
    manifest = kept(machine)
    data = machine.archive.read_bytes()
    broken = machine.root / "broken.tar.gz"
    for length in (0, 1, 100, len(data) // 3, len(data) // 2, len(data) - 1000, len(data) - 20):
        broken.write_bytes(data[:length])
        with pytest.raises(BackupError):
            archive.verify(broken)
    broken.write_bytes(data + gzip.compress(b"more"))
    with pytest.raises(BackupError, match="behind its end"):
        archive.verify(broken)
    refused = 0
    for place in range(64, len(data) - 20, len(data) // 40):
        broken.write_bytes(data[:place] + bytes([data[place] ^ 0x10]) + data[place + 1 :])
        try:  # in a run of zeros another bit may be the same file, compressed otherwise
            assert archive.verify(broken) == manifest
        except BackupError:
            refused += 1
    assert refused >= 35


OWNED = Owned(0o600, "root", "root")


def entry(path: str, data: bytes, kind: Kind = Kind.STATE) -> Entry:
    import hashlib

    return Entry(path, kind, len(data), hashlib.sha256(data).hexdigest(), OWNED, OWNED)


def made(path: Path, files: list[tuple[Entry, bytes]], config: str, more: list[tarfile.TarInfo] | None = None) -> Path:
    """An archive as somebody else could make it, its digests right."""
    manifest = Manifest(1, "0", "3", "now", "there", "site1", "x", config, True, [e for e, _ in files])
    text = msgspec.json.encode(manifest)
    with tarfile.open(path, "w:gz") as out:
        for one, data in files:
            info = tarfile.TarInfo(one.member)
            info.size = len(data)
            out.addfile(info, io.BytesIO(data))
        for info in more or []:
            out.addfile(info)
        info = tarfile.TarInfo(NAME)
        info.size = len(text)
        out.addfile(info, io.BytesIO(text))
    return path


@pytest.mark.parametrize(
    "path", ["/etc/../root/x", "etc/x", "//etc/x", "/etc//x", "/etc/x/", "/etc/./x", "/etc/x\n", "../x", "/", ""]
)
def test_paths_that_lead_elsewhere_are_refused(tmp_path: Path, path: str) -> None:
    good = (entry("/etc/g.toml", b"", Kind.CONFIGURATION), b"")
    with pytest.raises(BackupError):
        archive.verify(made(tmp_path / "a", [good, (entry(path, b"x"), b"x")], "/etc/g.toml"))


def test_an_archive_with_more_than_its_manifest_or_other_things_than_files_is_refused(tmp_path: Path) -> None:
    good = (entry("/etc/g.toml", b"", Kind.CONFIGURATION), b"")
    archive.verify(made(tmp_path / "a", [good], "/etc/g.toml"))
    link = tarfile.TarInfo("files/etc/x")
    link.type, link.linkname = tarfile.SYMTYPE, "/etc/passwd"
    hard = tarfile.TarInfo("files/etc/x")
    hard.type, hard.linkname = tarfile.LNKTYPE, "files/etc/g.toml"
    device = tarfile.TarInfo("files/etc/x")
    device.type = tarfile.FIFOTYPE
    for more in ([tarfile.TarInfo("files/etc/y")], [link], [hard], [device], [tarfile.TarInfo("files/etc/g.toml")]):
        with pytest.raises(BackupError):
            archive.verify(made(tmp_path / "a", [good], "/etc/g.toml", more))
    wrong = entry("/etc/g.toml", b"a = 1", Kind.CONFIGURATION)
    with pytest.raises(BackupError, match="size or digest"):
        archive.verify(made(tmp_path / "a", [(wrong, b"a = 2")], "/etc/g.toml"))
    with pytest.raises(BackupError, match="one configuration"):
        archive.verify(made(tmp_path / "a", [(entry("/etc/g.toml", b""), b"")], "/etc/g.toml"))
    with pytest.raises(BackupError, match="not a manifest"):
        decoded(b'{"format": 1}')


def test_nothing_is_written_that_the_configuration_does_not_name_or_outside_its_folders(machine: Machine) -> None:
    config = (
        f'instance = "{machine.root.name}"\n[hmi]\ntls_cert = "/opt/other.pem"\ntls_key = "/opt/other.key"\n'.encode()
    )
    files = [
        (entry(str(machine.config), config, Kind.CONFIGURATION), config),
        (entry("/opt/other.pem", b"1", Kind.CERTIFICATE), b"1"),
        (entry(f"{machine.etc}/cron", b"2", Kind.CERTIFICATE), b"2"),
        (entry(f"{machine.state}/records/site1.{machine.root.name}/bay1/evil.sh", b"3", Kind.RECORD), b"3"),
        (entry("/opt/other.key", b"4", Kind.RECORD), b"4"),  # it names one, and no recording
    ]
    machine.empty()
    evil = made(machine.archive, files, str(machine.config))
    plan = restore.plan(evil, no_check, force=True, outside=False)
    assert [entry.path for entry in plan.new] == [str(machine.config)]
    assert [fault.partition(": ")[0] for fault in plan.faults] == [entry.path for entry, _ in files[1:]]
    assert len(restore.plan(evil, no_check, force=True, outside=True).faults) == 3
    machine.etc.mkdir()
    machine.config.symlink_to("/etc/passwd")
    assert "is a link" in restore.plan(evil, no_check, force=True, outside=True).faults[0]


@pytest.mark.parametrize(("user", "refused"), [(0, True), (1000, False)])
def test_root_does_not_let_the_archive_choose_the_folder(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, user: int, refused: bool
) -> None:
    config = machine.root / "cron.d" / "gateway.toml"
    data = b'instance = "cron"\n[modbus]\nport = 0\n'
    evil = machine.root / "evil.tar.gz"
    made(evil, [(entry(str(config), data, Kind.CONFIGURATION), data)], str(config))
    monkeypatch.setattr(os, "geteuid", lambda: user)
    faults = restore.plan(evil, no_check, force=True, outside=False).faults
    assert [str(machine.etc) in fault and "--outside" in fault for fault in faults] == [True] * refused
    assert restore.plan(evil, no_check, force=True, outside=True).faults == []


def described() -> Iterator[str]:
    """Every key of the documentation that names a certificate, a key or a file with a password."""
    title = ""
    for line in reference.markdown(registry.sections()).splitlines():
        if line.startswith("### "):
            title = line.split("`")[1].strip("[]")
        elif "| PEM" in line or "whose one line" in line:
            yield f"{title}.{line.split('`')[1]}"


def test_no_file_is_overwritten_unless_that_is_wanted(machine: Machine, capsys: pytest.CaptureFixture[str]) -> None:
    """It may be the configuration itself, named in the wrong place."""
    before = machine.config.read_text()
    assert main(["backup", str(machine.config), "--config", str(machine.config)]) == 2
    assert f"{machine.config}: exists, and was left as it is" in capsys.readouterr().err
    assert machine.config.read_text() == before
    kept(machine)
    first = machine.archive.stat().st_ino
    kept(machine)
    assert machine.archive.stat().st_ino != first


def test_every_folder_that_a_configuration_can_name_is_known() -> None:
    """A new one needs a place in contents.py."""
    text = reference.markdown(registry.sections())
    keys = {line.split("`")[1] for line in text.splitlines() if line.startswith("| `")}
    folders = {key for key in keys if key.endswith(("folder", "_dir"))}
    assert folders == {"state_dir", "folder", "languages_folder"}


def test_every_file_that_a_configuration_can_name_is_taken(tmp_path: Path) -> None:
    keys = list(described())
    tables: dict[str, list[str]] = {"mqtt": ['url = "mqtt://b"']}
    for key in keys:
        table, _, name = key.rpartition(".")
        tables.setdefault(table, []).append(f'{name} = "/{key}"')
    text = "".join(f"[{table}]\n" + "\n".join(lines) + "\n" for table, lines in tables.items())
    (tmp_path / "g.toml").write_text(text)
    found = {key: kind for key, _, kind in contents.named_files(load(tmp_path / "g.toml"))}
    assert set(found) == set(keys)
    assert len(keys) == 22
    secret = {key for key in keys if key.endswith((".key", "tls_key", "key_file", "password_file"))}
    assert {key for key, kind in found.items() if kind is Kind.SECRET} == secret
