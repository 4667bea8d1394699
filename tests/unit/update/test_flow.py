"""An update from its package to its end, on a played machine, in its own time."""

from pathlib import Path
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from gateway.modbus.registers.register_map import MAP_VERSION
from gateway.update import prepare, watcher
from gateway.update import state as states
from gateway.update.machine import ProgramResult, UpdateError
from gateway.update.prepare import UpdateOptions
from gateway.update.state import Outcome, Stage, UpdateState
from tests.update_machine import CONFIG, NEW, OLD, PlayedMachine, Version, installed, package

NEW_CONFIG = CONFIG.replace("old_key", "new_key")


class Update:
    """From `OLD` to `version` with these options, to its end; `lines`: what was reported."""

    def __init__(self, machine: PlayedMachine, version: Version | None, **options: Any) -> None:
        self.machine = machine
        self.lines: list[str] = []
        named = None if version is None else package(machine, version)
        self.options = UpdateOptions(package=named, **{"unsigned": True, "hours": 0.0} | options)

    def prepare(self) -> UpdateState:
        with self.machine.lock() as ours:
            assert ours
            return prepare.prepare(self.machine, self.options, lambda _: False, self.lines.append)

    def run(self) -> UpdateState:
        state = self.prepare()
        if state.stage is Stage.ENDED:
            return state
        return self.watch()

    def watch(self) -> UpdateState:
        state = watcher.resume(self.machine, self.lines.append)
        assert state is not None
        return state

    @property
    def text(self) -> str:
        return "\n".join(self.lines)


def is_tidy(machine: PlayedMachine) -> None:
    """Nothing of an update is left but its state and its log."""
    paths = machine.paths
    left = {path.name for path in paths.folder.iterdir()} - {"state.json", "lock", "log.txt"}
    kept = {path for path in left if path.startswith("gateway.toml.")}
    assert left == kept
    assert [path.name for path in paths.config.parent.iterdir()] == ["gateway.toml"]


def test_a_good_version_is_taken_and_the_one_before_stays(tmp_path: Path) -> None:
    machine = installed(tmp_path, Version(name=OLD), Version(name="0.8"), Version(name="0.9"))
    update = Update(machine, Version(name=NEW))
    state = update.run()
    assert (state.outcome, state.previous, machine.version()) == (Outcome.UPDATED, OLD, NEW)
    assert machine.installed() == [OLD, NEW], "exactly one version before it stays"
    assert (machine.world.runs, machine.world.starts) == (NEW, 2)
    assert "deleted: version 0.8" in update.text
    assert machine.paths.config.read_text() == CONFIG
    is_tidy(machine)


@pytest.mark.long
@pytest.mark.one_interpreter
def test_the_configuration_is_migrated_in_a_copy_and_back_by_hand_uses_the_original(tmp_path: Path) -> None:
    machine = installed(tmp_path, Version(name=OLD, wants="old_key"))
    update = Update(machine, Version(name=NEW, wants="new_key", migrates={"old_key": "new_key"}))
    assert update.prepare().stage is Stage.WAITING
    assert machine.paths.config.read_text() == CONFIG, "the running version's is untouched before the switch"
    assert update.watch().outcome is Outcome.UPDATED
    assert machine.paths.config.read_text() == NEW_CONFIG
    machine.paths.config.write_text(NEW_CONFIG + "later = 1\n")
    back = Update(machine, None).run()
    assert (back.outcome, back.previous, machine.version()) == (Outcome.UPDATED, NEW, OLD)
    assert machine.paths.config.read_text() == CONFIG
    forth = Update(machine, None).run()
    assert (forth.outcome, machine.version()) == (Outcome.UPDATED, NEW)
    assert machine.paths.config.read_text() == NEW_CONFIG + "later = 1\n"
    is_tidy(machine)


@pytest.mark.mostly_long
@pytest.mark.one_interpreter
@pytest.mark.parametrize("migrates", [{}, {"old_key": "new_key"}])
def test_what_is_saved_while_a_worse_version_is_tried_is_put_aside(tmp_path: Path, migrates: dict[str, str]) -> None:
    """A technician, on its pages, with a key that the old version does not know."""
    machine = installed(tmp_path, Version(name=OLD, wants="old_key", refuses="later"))
    update = Update(machine, Version(name=NEW, migrates=migrates, vision="link_down"))
    update.prepare()
    saved = "# the new version's\nnew_key = 1\nlater = 1\n"

    def report(line: str) -> None:
        update.lines.append(line)
        if line.startswith("  bay1: no frames"):
            machine.paths.config.write_text(saved)

    state = watcher.resume(machine, report)
    assert state is not None
    assert state.outcome is Outcome.RETURNED, update.text
    assert machine.paths.config.read_text() == machine.world.config == CONFIG
    kept = machine.paths.saved_config(NEW)
    assert kept.read_text() == saved
    assert f"configuration: it was changed after the switch. What it was then is kept as {kept}; 1.0 gets its own" in (
        update.lines
    )
    is_tidy(machine)
    assert Update(machine, Version(name="3.0")).run().outcome is Outcome.UPDATED
    assert kept.read_text() == saved, "the next update leaves it"


@pytest.mark.long
@pytest.mark.one_interpreter
def test_what_is_saved_on_the_old_version_after_the_return_stays(tmp_path: Path) -> None:
    """Also where the return is begun again after a power cut."""
    machine = installed(tmp_path)
    update = Update(machine, Version(name=NEW, vision="link_down"))
    update.prepare()

    class Cut(BaseException):
        pass

    def report(line: str) -> None:
        update.lines.append(line)
        if line.startswith("  everything is there again") and machine.world.runs == OLD:
            raise Cut

    with pytest.raises(Cut):
        watcher.resume(machine, report)
    machine.paths.config.write_text(CONFIG + "later = 1\n")
    machine.power_cut()
    state = watcher.resume(machine, update.lines.append, machine.ready)
    assert state is not None
    assert state.outcome is Outcome.RETURNED
    assert machine.world.config == CONFIG + "later = 1\n"
    assert not machine.paths.saved_config(NEW).exists()


@pytest.mark.one_interpreter
def test_back_by_hand_uses_what_was_saved_since_where_nothing_was_migrated(tmp_path: Path) -> None:
    machine = installed(tmp_path)
    assert Update(machine, Version(name=NEW)).run().outcome is Outcome.UPDATED
    machine.paths.config.write_text(CONFIG + "later = 1\n")
    assert Update(machine, None).run().outcome is Outcome.UPDATED
    assert machine.world.config == CONFIG + "later = 1\n"


@pytest.mark.parametrize("moment", ["update --migrate", "check"])
def test_what_is_saved_while_the_configuration_is_examined_was_not_examined(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    machine = installed(tmp_path)
    update = Update(machine, Version(name=NEW))
    real = PlayedMachine.command

    def command(self: PlayedMachine, *words: str | Path, **options: Any) -> ProgramResult:
        answer = real(self, *words, **options)
        if " ".join(map(str, words[1:])).startswith(moment):
            self.paths.config.write_text(CONFIG + "later = 1\n")
        return answer

    monkeypatch.setattr(PlayedMachine, "command", command)
    state = update.run()
    assert (state.outcome, machine.version()) == (Outcome.ABANDONED, OLD)
    assert "was changed after 2.0 had examined it" in state.why


@pytest.mark.mostly_long(short=3)
@pytest.mark.one_interpreter
@pytest.mark.parametrize(
    ("worse", "why"),
    [
        ({"starts": False}, "started again by itself"),
        ({"vision": "link_down"}, "bay1: no frames of its camera: link_down"),
        ({"vision": "waiting"}, "bay1: no frames of its camera: waiting"),
        ({"range": "stale"}, "bay1: no distances of its ranger: stale"),
        ({"ticks": False}, "bay1: its control has not ticked"),
        ({"alarms": {"bay1.camera_down": "no frames"}}, "new alarm bay1.camera_down (no frames)"),
        ({"alarms": {"sink_lost": ""}, "alarm_after_s": 40.0}, "new alarm sink_lost"),
        ({"reads": False}, "10.0.0.7 does not read registers"),
        ({"answers": False}, "no answer"),
        ({"serves": {"stop": 0, "may_move": 1, "in_place": 1}}, "the image contradicts itself: "),
        ({"serves": {"reason": 22}}, "its registers are not what is decided: reason is 22, decided 10"),
        ({"serves": {"vision_quality": 0}, "serves_after_s": 40.0}, "vision_quality is 0, decided 1"),
        ({"serves": {"heartbeat": 7}}, "their heartbeat does not move"),
        ({"serves": {"seq_begin": 7, "seq_end": 7}}, "image 7 is not of state"),
        ({"serves": {"seq_end": 7}}, "torn image"),
        ({"serves": {"visit_phase": 3}}, "visit_phase is approaching, and the status says empty"),
        ({"serves": {"known_u32": 0x5678}}, "another word order?"),
        ({"serves": {"map_version": MAP_VERSION - 1}}, f"lacks registers of version {MAP_VERSION}"),
        ({"serves": {"ne107_active": 0}}, "a function check is on, and ne107_active does not say so"),
        ({"function_check": "off"}, "its function check has ended"),
        ({"shares": False}, "its registers can't be compared: no shared state that this version can read"),
    ],
)
def test_a_worse_version_goes_back_by_itself(tmp_path: Path, worse: dict[str, Any], why: str) -> None:
    worse = {"function_check": "may_move_off"} | worse
    old = Version(name=OLD, wants="old_key", function_check="may_move_off")
    machine = installed(tmp_path, old)
    update = Update(machine, Version(name=NEW, wants="new_key", migrates={"old_key": "new_key"}, **worse))
    state = update.run()
    assert state.outcome is Outcome.RETURNED, update.text
    assert why in state.why
    assert (machine.version(), machine.world.runs, machine.installed()) == (OLD, OLD, [OLD])
    assert machine.paths.config.read_text() == machine.world.config == CONFIG
    assert machine.world.now_s < 1100 + 120 + 60 + 60, "within the limit, and the proof of the old one"
    is_tidy(machine)


def test_an_alarm_that_was_there_before_or_is_accepted_is_no_reason(tmp_path: Path) -> None:
    alarms = {"bay1.disagree": "x", "sink_lost": "y"}
    machine = installed(tmp_path, Version(name=OLD, alarms={"bay1.disagree": "z"}))
    state = Update(machine, Version(name=NEW, alarms=alarms), accepted=("sink_lost",)).run()
    assert state.outcome is Outcome.UPDATED


def test_what_did_not_work_before_need_not_work_after(tmp_path: Path) -> None:
    broken: dict[str, Any] = {"vision": "link_down", "range": "wrong_version", "reads": False, "answers": False}
    machine = installed(tmp_path, Version(name=OLD, **broken))
    assert Update(machine, Version(name=NEW, **broken), at_once=True).run().outcome is Outcome.UPDATED


def test_what_certainly_contradicts_what_is_decided_is_not_waited_for(tmp_path: Path) -> None:
    machine = installed(tmp_path)
    Update(machine, Version(name=NEW, serves={"stop": 0, "may_move": 1, "in_place": 1})).run()
    assert machine.world.began_s < 1100 + 15, "when the old version was started again"


@pytest.mark.one_interpreter
def test_a_version_with_a_newer_map_is_taken_and_back_by_hand_takes_the_older_one(tmp_path: Path) -> None:
    machine = installed(tmp_path)
    assert Update(machine, Version(name=NEW, serves={"map_version": MAP_VERSION + 1})).run().outcome is Outcome.UPDATED
    (machine.paths.versions / OLD / "version.json").write_bytes(
        msgspec.json.encode(Version(name=OLD, serves={"map_version": MAP_VERSION - 1}))
    )
    assert Update(machine, None).run().outcome is Outcome.UPDATED


def test_without_room_nothing_is_begun(tmp_path: Path) -> None:
    machine = installed(tmp_path)
    machine.change(free_mb=99.0)
    state = Update(machine, Version(name=NEW)).run()
    assert (state.outcome, state.stage) == (Outcome.ABANDONED, Stage.ENDED)
    assert "100 MB needed, 99 MB free; nothing was begun" in state.why
    for path in (machine.paths.folder, machine.paths.versions):
        assert str(path) in state.why
    assert "dpkg begins" not in machine.actions
    assert not any(one.startswith("copy") for one in machine.actions)
    is_tidy(machine)


@pytest.mark.long
@pytest.mark.one_interpreter
def test_an_old_version_that_cannot_be_proven_either_is_told(tmp_path: Path) -> None:
    """Somebody has pulled the camera's cable meanwhile."""
    machine = installed(tmp_path)
    update = Update(machine, Version(name=NEW, vision="link_down"))
    update.prepare()
    state = None

    def report(line: str) -> None:
        update.lines.append(line)
        if line.startswith(f"back to {OLD}: not proven within 120 s: bay1: no frames"):
            (machine.paths.versions / OLD / "version.json").unlink()
            (machine.paths.versions / OLD / "bin/gateway").unlink()
            (machine.paths.versions / OLD / "bin").rmdir()
            (machine.paths.versions / OLD).rmdir()
            machine.put(Version(name=OLD, vision="link_down"))

    state = watcher.resume(machine, report)
    assert state is not None
    assert (state.outcome, machine.world.runs) == (Outcome.NOT_PROVEN, OLD)
    assert "1.0 not proven: not proven within 120 s: bay1: no frames" in state.why


@pytest.mark.one_interpreter
def test_it_waits_for_free_bays(tmp_path: Path) -> None:
    machine = installed(tmp_path)
    machine.change(phases={"1000": "in_place", "1400": "leaving", "1500": "empty"})
    update = Update(machine, Version(name=NEW))
    assert update.run().outcome is Outcome.UPDATED
    assert "bays: waiting until no truck is there (bay1: in_place), 3600 s more" in update.lines
    assert machine.world.began_s >= 1500 + 2


def test_a_bay_that_is_never_free_ends_it_before_the_switch(tmp_path: Path) -> None:
    machine = installed(tmp_path)
    machine.change(phase="unknown")
    state = Update(machine, Version(name=NEW), wait_s=600.0).run()
    assert (state.outcome, machine.world.starts) == (Outcome.ABANDONED, 1)
    assert state.why == "no moment without a truck within 600 s (bay1: unknown)"
    assert machine.installed() == [OLD]
    is_tidy(machine)


def test_a_truck_at_the_last_moment_stops_the_switch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = installed(tmp_path)
    update = Update(machine, Version(name=NEW))
    update.prepare()
    real = PlayedMachine.write

    def write(self: PlayedMachine, path: Path, data: bytes, like: Path | None = None) -> None:
        if b'"switching"' in data:
            self.change(phase="arriving")
        real(self, path, data, like)

    monkeypatch.setattr(PlayedMachine, "write", write)
    state = update.watch()
    assert (state.outcome, machine.world.starts, machine.version()) == (Outcome.ABANDONED, 1, OLD)
    assert "a truck has arrived at the last moment (bay1: arriving)" in state.why


def test_a_configuration_edited_meanwhile_stops_the_switch(tmp_path: Path) -> None:
    machine = installed(tmp_path)
    update = Update(machine, Version(name=NEW))
    update.prepare()
    machine.paths.config.write_text(CONFIG + "old_key_2 = 2\n")
    state = update.watch()
    assert (state.outcome, machine.version()) == (Outcome.ABANDONED, OLD)
    assert "was changed after 2.0 had examined it" in state.why


@pytest.mark.parametrize(
    ("version", "options", "why"),
    [
        (Version(name=OLD), {}, "is version 1.0, which runs already"),
        (Version(name=NEW, install="no space left on device"), {}, "dpkg --install: no space left on device"),
        (Version(name=NEW, wants="other_key"), {}, "2.0 refuses it: unknown key"),
        (Version(name=NEW), {"unsigned": False}, "the package has no signature beside it"),
    ],
)
def test_what_fails_before_the_switch_leaves_everything(
    tmp_path: Path, version: Version, options: dict[str, Any], why: str
) -> None:
    machine = installed(tmp_path)
    state = Update(machine, version, **options).run()
    assert state.outcome is Outcome.ABANDONED
    assert why in state.why
    assert (machine.installed(), machine.version(), machine.world.starts) == ([OLD], OLD, 1)
    assert not machine.world.half_installed
    is_tidy(machine)


def test_a_package_that_stays_half_installed_is_told_with_what_to_do(tmp_path: Path) -> None:
    machine = installed(tmp_path)
    update = Update(machine, Version(name=NEW, install="no space left on device", configures=False))
    state = update.run()
    assert (state.outcome, machine.installed(), machine.version()) == (Outcome.ABANDONED, [OLD], OLD)
    assert machine.world.half_installed
    assert state.why == (
        "dpkg --install: no space left on device; dpkg has the package half installed, and refuses other packages: no "
        "space left on device. Mend that, then dpkg --configure -a; or dpkg --install the package of 1.0"
    )


def test_a_dpkg_that_does_not_end_is_told_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = installed(tmp_path)
    real = PlayedMachine._dpkg

    def dpkg(self: PlayedMachine, package: Path) -> ProgramResult:
        real(self, package)
        self.change(half_installed=True)
        raise UpdateError("dpkg: has not ended within 1800 s")

    monkeypatch.setattr(PlayedMachine, "_dpkg", dpkg)
    state = Update(machine, Version(name=NEW, install="interrupted", configures=False)).run()
    assert state.why.startswith("dpkg: has not ended within 1800 s; dpkg has the package half installed")


def test_an_installation_that_changes_the_version_in_use_is_undone(tmp_path: Path) -> None:
    machine = installed(tmp_path)
    state = Update(machine, Version(name=NEW, switches=True)).run()
    assert (state.outcome, machine.version(), machine.installed()) == (Outcome.ABANDONED, OLD, [OLD])
    assert "the package has changed" in state.why
    is_tidy(machine)


@pytest.mark.one_interpreter
@pytest.mark.parametrize("how", ["dry", "worse", "refused"])
def test_a_version_that_was_not_taken_does_not_come_back_with_another_python(tmp_path: Path, how: str) -> None:
    machine = installed(tmp_path)
    version = Version(name=NEW, starts=how != "worse", wants="other_key" if how == "refused" else "")
    update = Update(machine, version, dry=how == "dry")
    update.run()
    machine.python_replaced()
    assert machine.installed() == [OLD]
    assert f"dpkg lists the package of {NEW}: units, device rules and /usr/share/loading-gateway are its" in update.text
    assert Update(machine, Version(name=NEW)).run().outcome is Outcome.UPDATED, "it may be tried again"
    assert not machine.paths.rejected.exists()
    machine.remove(machine.paths.versions / NEW)
    machine.python_replaced()
    assert machine.installed() == [OLD, NEW]


@pytest.mark.one_interpreter
def test_back_by_hand_rejects_no_package(tmp_path: Path) -> None:
    """dpkg lists that of the version that runs."""
    machine = installed(tmp_path)
    assert Update(machine, Version(name=NEW)).run().outcome is Outcome.UPDATED
    (machine.paths.versions / OLD / "version.json").write_bytes(msgspec.json.encode(Version(name=OLD, starts=False)))
    assert Update(machine, None).run().outcome is Outcome.RETURNED
    assert not machine.paths.rejected.exists()


def test_a_dry_run_does_all_but_the_switch(tmp_path: Path) -> None:
    machine = installed(tmp_path)
    update = Update(machine, Version(name=NEW), dry=True)
    state = update.run()
    assert (state.outcome, state.why) == (Outcome.ABANDONED, prepare.DRY)
    assert (machine.installed(), machine.world.starts) == ([OLD], 1)
    assert "configuration: good" in update.lines
    assert "bays: bay1: empty" in update.lines
    is_tidy(machine)


def test_back_without_a_previous_version(tmp_path: Path) -> None:
    machine = installed(tmp_path)
    assert Update(machine, None).run().why == "there is no previous version on this machine"


@pytest.mark.one_interpreter
def test_a_failed_update_keeps_the_version_before(tmp_path: Path) -> None:
    machine = installed(tmp_path)
    assert Update(machine, Version(name=NEW)).run().outcome is Outcome.UPDATED
    failed = Update(machine, Version(name="3.0", starts=False)).run()
    assert (failed.outcome, failed.previous, machine.installed()) == (Outcome.RETURNED, OLD, [OLD, NEW])
    assert Update(machine, None).run().outcome is Outcome.UPDATED
    assert machine.world.runs == OLD


def test_ended_by_hand_while_it_is_proven_it_returns(tmp_path: Path) -> None:
    machine = installed(tmp_path)
    update = Update(machine, Version(name=NEW))
    state = update.prepare()
    machine.link(machine.paths.current, machine.paths.versions / NEW)
    states.write(machine, replace(state, stage=Stage.PROVING, invocation="start 0", before=machine.status()))
    machine.restart()
    cancelled = watcher.cancel(machine, update.lines.append, "ended by hand")
    assert cancelled is not None
    assert cancelled.stage is Stage.RETURNING
    ended = update.watch()
    assert (ended.outcome, ended.why, machine.world.runs) == (Outcome.RETURNED, "ended by hand", OLD)


def test_a_second_update_begins_only_where_none_is_under_way(tmp_path: Path) -> None:
    machine = installed(tmp_path)
    first = Update(machine, Version(name=NEW))
    first.prepare()
    second = Update(machine, Version(name="3.0"))
    assert second.run().outcome is Outcome.UPDATED, "the first had not switched, and nobody worked on it"
    assert machine.installed() == [OLD, "3.0"]
    with machine.lock() as ours, machine.lock() as theirs:
        assert (ours, theirs) == (True, False)


def test_the_log_of_many_updates_is_shortened(tmp_path: Path) -> None:
    machine = installed(tmp_path)
    machine.paths.log.write_text("an old line\n" * 100_000)
    Update(machine, Version(name=NEW)).prepare()
    text = machine.paths.log.read_text()
    assert 490_000 < len(text) <= 500_000
    assert set(text.splitlines()) == {"an old line"}


def proving(machine: PlayedMachine, update: Update, **fields: Any) -> None:
    """As if the watcher had been ended after the switch, before the restart."""
    state = update.prepare()
    before = machine.status()
    machine.link(machine.paths.current, machine.paths.versions / NEW)
    now = machine.service().invocation
    states.write(machine, replace(state, stage=Stage.PROVING, before=before, **{"invocation": now} | fields))


def test_ended_between_switch_and_restart_it_restarts_and_proves(tmp_path: Path) -> None:
    machine = installed(tmp_path)
    update = Update(machine, Version(name=NEW))
    proving(machine, update)
    assert update.watch().outcome is Outcome.UPDATED
    assert machine.world.starts == 2


def test_a_proof_that_is_cut_off_twice_has_failed(tmp_path: Path) -> None:
    """A version that brings the machine down."""
    machine = installed(tmp_path)
    update = Update(machine, Version(name=NEW))
    proving(machine, update, resumed=watcher.MAX_RESUMED)
    machine.power_cut()
    state = watcher.resume(machine, update.lines.append, machine.ready)
    assert state is not None
    assert (state.outcome, state.why, machine.world.runs) == (Outcome.RETURNED, "its proof was cut off twice", OLD)
