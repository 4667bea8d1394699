"""What root takes of a request of the pages, and what it refuses: whoever has the gateway's user can write anything."""

import json
import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from gateway import config
from gateway.cli import update as cli
from gateway.update import recordings, requested
from gateway.update import state as states
from gateway.update.finish import log_to
from gateway.update.machine import ProgramResult, UpdateError
from gateway.update.recordings import Replayed
from gateway.update_request import MAX_SIGNATURE_BYTES, ShownUpdate, shown_now
from tests.unit.update.test_cli import WatchedMachine
from tests.update_machine import NEW, OLD, Version, installed, package

GOOD = "[GNUPG:] GOODSIG 99 plant\n[GNUPG:] VALIDSIG 99\n"


class ServedMachine(WatchedMachine):
    """The service's user is that of the tests; gpgv believes what is signed `good`."""

    def service_user(self) -> str:
        return ""

    def command(self, *words: str | Path, user: str = "", timeout_s: float = 1.0) -> ProgramResult:
        if words[0] == "gpgv":
            good = Path(words[-2]).read_text() == "good"
            return ProgramResult(0 if good else 1, GOOD if good else "[GNUPG:] BADSIG 99\n")
        if words[1] == "--compare-versions":
            return ProgramResult(int(float(str(words[2])) <= float(str(words[4]))))
        return super().command(*words, user=user, timeout_s=timeout_s)


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ServedMachine:
    """Nothing was recorded."""
    monkeypatch.setattr(config, "load", lambda _: SimpleNamespace(bays=[SimpleNamespace(name="bay1")]))
    monkeypatch.setattr(recordings, "segments", lambda *_: ({}, {}))
    made = ServedMachine(installed(tmp_path, Version(name=OLD)).paths)
    made.paths.spool.mkdir(parents=True, mode=0o700)
    keyring = made.paths.keyrings[1]
    keyring.parent.mkdir(parents=True, exist_ok=True)
    keyring.write_bytes(b"key")
    keyring.chmod(0o644)
    return made


def ask(machine: ServedMachine, action: str = "install", signature: str = "good", **more: object) -> None:
    """As the page's helper leaves it."""
    spool = machine.paths.spool
    package(machine, Version(name=NEW)).replace(spool / "package.deb")
    (spool / "package.deb.asc").write_text(signature)
    (spool / "request.json").write_text(json.dumps({"action": action, **more}))


def run(machine: ServedMachine) -> tuple[int, ShownUpdate]:
    code = cli._requested(machine, log_to(machine, lambda _: None))
    return code, shown_now(machine.paths.shown)


def left(machine: ServedMachine) -> list[str]:
    return sorted(path.name for path in machine.paths.spool.iterdir())


def test_a_signed_package_is_taken_through_to_its_proof_and_back(machine: ServedMachine) -> None:
    ask(machine)
    code, shown = run(machine)
    assert (code, machine.version(), left(machine)) == (0, NEW, [])
    assert (shown.version, shown.previous, shown.stage, shown.outcome) == (NEW, OLD, "ended", "updated")
    assert any("signature: good, by plant" in line for line in shown.log)
    assert machine.paths.shown.stat().st_mode & 0o777 == 0o644
    (machine.paths.spool / "request.json").write_text('{"action": "back"}')
    assert run(machine)[0] == 0
    assert machine.version() == OLD


def test_a_check_ends_before_the_switch_and_keeps_the_package_for_the_installation(machine: ServedMachine) -> None:
    ask(machine, "check")
    code, shown = run(machine)
    assert (code, machine.version(), left(machine)) == (0, OLD, ["package.deb", "package.deb.asc"])
    assert (shown.outcome, shown.new) == ("abandoned", NEW)


def test_a_package_without_a_good_signature_is_not_installed(machine: ServedMachine) -> None:
    ask(machine, signature="bad")
    code, shown = run(machine)
    assert (code, machine.version(), machine.world.unpacked) == (1, OLD, "")
    assert "changed or damaged after it was signed" in shown.why


def test_an_older_version_is_not_installed_whoever_has_signed_it(machine: ServedMachine) -> None:
    ask(machine)
    package(machine, Version(name="0.9")).replace(machine.paths.spool / "package.deb")
    code, shown = run(machine)
    assert (code, machine.version(), machine.world.unpacked) == (1, OLD, "")
    assert "is version 0.9, older than 1.0" in shown.why


def spoil(machine: ServedMachine, how: str) -> None:
    spool, elsewhere = machine.paths.spool, machine.paths.root / "elsewhere"
    request, signature = spool / "request.json", spool / "package.deb.asc"
    match how:
        case "a link for the package":
            (spool / "package.deb").rename(elsewhere)
            (spool / "package.deb").symlink_to(elsewhere)
        case "a second name of a file":
            os.link(spool / "package.deb", elsewhere)
        case "a pipe for the signature":
            signature.unlink()
            os.mkfifo(signature)
        case "a signature as large as a package":
            signature.write_bytes(bytes(MAX_SIGNATURE_BYTES + 1))
        case "no signature":
            signature.unlink()
        case "a folder that others may write":
            spool.chmod(0o770)
        case "a link for the folder":
            spool.rename(elsewhere)
            spool.symlink_to(elsewhere)
        case text:
            request.write_text(text)


@pytest.mark.parametrize(
    "how",
    [
        "a link for the package", "a second name of a file", "a pipe for the signature",
        "a signature as large as a package", "no signature", "a folder that others may write", "a link for the folder",
        '{"action": "install", "unsigned": true}', '{"action": "install", "package": "/tmp/other.deb"}',
        '{"action": "migrate"}', '{"action": "install", "alarms": ["--now"], "bays": ["a b"]}', "",
        json.dumps({"action": "install", "bays": ["x" * 60] * 64, "alarms": ["y" * 60] * 64}),
    ],
)  # fmt: skip
def test_refused(machine: ServedMachine, how: str) -> None:
    ask(machine)
    spoil(machine, how)
    code, shown = run(machine)
    assert (code, machine.version(), states.read(machine)) == (1, OLD, None)
    assert "the page's request is refused" in shown.log[-1]
    if "folder" not in how:
        assert "request.json" not in left(machine), "or its unit would be started for ever"


def test_a_file_of_another_user_is_refused(machine: ServedMachine, monkeypatch: pytest.MonkeyPatch) -> None:
    ask(machine)
    own, spool = os.fstat, machine.paths.spool.stat().st_ino

    def of_another(fd: int) -> os.stat_result:
        found = own(fd)
        return found if found.st_ino == spool else os.stat_result((*found[:4], 12345, *found[5:10]))

    monkeypatch.setattr(os, "fstat", of_another)
    with pytest.raises(UpdateError, match="not a plain file of the gateway's user"):
        requested.taken(machine)


def test_a_request_while_an_update_is_under_way_is_refused(machine: ServedMachine) -> None:
    ask(machine)
    with machine.lock() as ours:
        assert ours
        code, shown = run(machine)
    assert code == 1
    assert "an update is under way" in shown.log[-1]


def test_differences_are_accepted_by_the_name_of_their_bay(
    machine: ServedMachine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recordings, "segments", lambda *_: ({"bay1": ["x"]}, {}))
    monkeypatch.setattr(recordings, "replay", lambda *_: Replayed("bay1", fault="decides otherwise"))
    ask(machine)
    code, shown = run(machine)
    assert (code, shown.differing, shown.outcome) == (1, ("bay1",), "abandoned")
    assert "package.deb" in left(machine), "it need not be uploaded again"
    ask(machine, bays=["bay2"])
    assert run(machine)[0] == 1
    ask(machine, bays=["bay1"])
    code, shown = run(machine)
    assert (code, machine.version(), shown.stage) == (0, NEW, "ended")
