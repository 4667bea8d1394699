"""A power cut, or a kill, before each single action of an update: afterwards one of the two versions runs, with the
configuration that fits it, and nothing is half done. The process really ends (os._exit), in its own child."""

import multiprocessing
import os
import shutil
from pathlib import Path

import msgspec
import pytest

from gateway import config
from gateway.records.names import SEGMENT, FileName
from gateway.update import prepare, watcher
from gateway.update import state as states
from gateway.update.machine import InstallPaths
from gateway.update.prepare import UpdateOptions
from gateway.update.state import Outcome, Stage
from tests.long import mostly_long
from tests.unit.update.test_flow import is_tidy
from tests.unit.update.test_recordings import row
from tests.update_machine import KILLED, NEW, OLD, PlayedMachine, Version, installed, package

OTHER = "0.9"  # lies there before
GOOD = Version(name=NEW, wants="new_key", migrates={"old_key": "new_key"})
WORSE = Version(name=NEW, wants="new_key", migrates={"old_key": "new_key"}, vision="link_down")
DIFFERENCE = row("08:00:01")
pytestmark = pytest.mark.one_interpreter
CONTEXT = multiprocessing.get_context("fork")


def _quiet(_: str) -> None:
    pass


def _update(root: Path, cut: int) -> None:
    """In a child: all of an update, to its end or to its cut."""
    machine = PlayedMachine(InstallPaths(root), cut=cut)
    with machine.lock():
        options = UpdateOptions(package=root / f"loading-gateway_{NEW}.deb", unsigned=True)
        state = prepare.prepare(machine, options, lambda _: True, _quiet)
    if state.stage is not Stage.ENDED:
        _resume(root, machine.cut - machine.count if machine.cut else 0)


def _resume(root: Path, cut: int) -> None:
    machine = PlayedMachine(InstallPaths(root), cut=max(cut, 0))
    with machine.lock() as ours:
        assert ours
        watcher.resume(machine, _quiet, machine.ready)


def _with_a_recording(machine: PlayedMachine, kept: Path) -> None:
    """Of an hour ago, outside the machine's root: it is not copied, and the gateway only reads it."""
    text = f'# old_key\nstate_dir = "{kept}"\n'
    machine.paths.config.write_text(text)
    machine.change(config=text)
    settings = config.load(machine.paths.config)
    bay = kept / "records" / f"{settings.site}.{settings.instance}" / "bay1"
    bay.mkdir(parents=True)
    segment = bay / str(FileName(1, machine.unix_s() - 3600, SEGMENT))
    segment.write_bytes(b"")
    os.utime(segment, (machine.unix_s(), machine.unix_s()))


def _ended(target: object, root: Path, cut: int) -> bool:
    """False: it was cut."""
    child = CONTEXT.Process(target=target, args=(root, cut))  # type: ignore[arg-type]
    child.start()
    child.join(60)
    code = child.exitcode
    child.close()
    assert code in (0, KILLED)
    return code == 0


def _booted(root: Path) -> PlayedMachine:
    """As systemd does: the unit where its condition holds, and the gateway."""
    machine = PlayedMachine(InstallPaths(root))
    if machine.paths.watcher.is_symlink():
        with machine.lock() as ours:
            assert ours, "the kernel has dropped the lock of the dead"
            watcher.resume(machine, _quiet, machine.ready)
    machine.ready()
    return machine


def _is_sound(machine: PlayedMachine, version: Version, where: str) -> Outcome | None:
    world, paths = machine.world, machine.paths
    runs = machine.version()
    assert runs in (OLD, NEW), where
    assert world.runs == runs, where
    assert world.config == paths.config.read_text(), where
    assert machine.played(runs).wants in world.config, where
    assert not world.half_installed, where
    state = states.read(machine)
    assert state is None or state.stage is Stage.ENDED, where
    outcome = None if state is None else state.outcome
    machine.python_replaced()
    there = {OLD, NEW} if outcome is Outcome.UPDATED else {OLD, OTHER}
    assert set(machine.installed()) == there, f"{where}: {outcome}"
    assert (runs == NEW) == (outcome is Outcome.UPDATED), where
    assert not (runs == NEW and version is WORSE), where
    is_tidy(machine)
    return outcome


@pytest.mark.parametrize("version", [GOOD, WORSE], ids=["good", "worse"])
@pytest.mark.parametrize("power", mostly_long([True, False]), ids=["power", "killed"])
def test_a_cut_before_each_action(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, version: Version, power: bool
) -> None:
    monkeypatch.setattr(watcher, "LOOK_S", 10.0)  # a tenth of the looks, for speed
    begun = tmp_path / "begun"
    at_first = installed(begun, Version(name=OLD, wants="old_key", otherwise=[DIFFERENCE]), Version(name=OTHER))
    package(at_first, msgspec.structs.replace(version, otherwise=[DIFFERENCE]))  # so the old one is asked, too
    _with_a_recording(at_first, tmp_path / "kept")
    outcomes: list[Outcome | None] = []
    stages: set[Stage] = set()
    cut = 0
    while True:
        cut += 1
        root = tmp_path / "cut"
        shutil.copytree(begun, root, symlinks=True)
        if _ended(_update, root, cut):
            break
        machine = PlayedMachine(InstallPaths(root))
        if (state := states.read(machine)) is not None:
            stages.add(state.stage)
        if power:
            machine.power_cut()
        # What goes on is cut, too, at another place each time; then it may end.
        if machine.paths.watcher.is_symlink() and not _ended(_resume, root, 1 + cut * 5 % 17) and power:
            machine.power_cut()
        outcomes.append(_is_sound(_booted(root), version, f"cut before action {cut}"))
        shutil.rmtree(root)
    assert _is_sound(PlayedMachine(InstallPaths(root)), version, "not cut") is not None
    assert stages == set(Stage) - {Stage.RETURNING if version is GOOD else Stage.CLEANING}, "it was cut in each step"
    good = Outcome.UPDATED if version is GOOD else Outcome.RETURNED
    assert {Outcome.ABANDONED, good} <= set(outcomes) <= {None, Outcome.ABANDONED, Outcome.RETURNED, good}


def test_the_version_that_goes_on_is_the_old_one_at_every_moment(tmp_path: Path) -> None:
    """The unit starts what the link `watcher` names."""
    begun = tmp_path / "begun"
    package(installed(begun, Version(name=OLD, wants="old_key"), Version(name=OTHER)), GOOD)
    machine = PlayedMachine(InstallPaths(begun))
    targets = set()
    real = machine.act

    def act(what: str) -> None:
        if machine.paths.watcher.is_symlink():
            targets.add(machine.paths.watcher.resolve().name)
        real(what)

    machine.act = act  # type: ignore[method-assign]
    with machine.lock():
        options = UpdateOptions(package=begun / f"loading-gateway_{NEW}.deb", unsigned=True, hours=0)
        prepare.prepare(machine, options, lambda _: True, _quiet)
        assert machine.paths.watcher.is_symlink()
        watcher.resume(machine, _quiet)
    assert targets == {OLD}
    assert not machine.paths.watcher.is_symlink()
