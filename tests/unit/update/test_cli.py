"""The command line of `gateway update`: what it starts, ends and shows, on a played machine."""

import argparse
import os
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from gateway.cli import update as cli
from gateway.update import prepare, watcher
from gateway.update import state as states
from gateway.update.machine import ProgramResult, UpdateError
from gateway.update.prepare import UpdateOptions
from gateway.update.state import Outcome, Stage, UpdateState
from tests.update_machine import NEW, OLD, PlayedMachine, Version, installed, package


@dataclass
class WatchedMachine(PlayedMachine):
    """Its watcher does all its work at once when it is started; `stops`: how often it was ended."""

    stops: int = 0

    def start_watcher(self) -> None:
        super().start_watcher()
        with self.lock() as ours:
            assert ours, "whoever starts it has dropped the lock"
            watcher.resume(self, self.log)

    def stop_watcher(self) -> None:
        self.stops += 1

    def log(self, line: str) -> None:
        with suppress(OSError), self.paths.log.open("a") as file:
            file.write(f"{line}\n")


@pytest.fixture
def machine(tmp_path: Path) -> WatchedMachine:
    return WatchedMachine(installed(tmp_path, Version(name=OLD)).paths)


def run(machine: PlayedMachine, *words: str | Path) -> int:
    parser = argparse.ArgumentParser()
    cli.configure(parser)
    return cli.run(parser.parse_args([str(word) for word in words]), machine)


def prepared(machine: PlayedMachine, version: Version) -> UpdateState:
    options = UpdateOptions(package=package(machine, version), unsigned=True, hours=0)
    with machine.lock():
        return prepare.prepare(machine, options, lambda _: False, lambda _: None)


def proving(machine: PlayedMachine) -> None:
    """As if the watcher worked: after the switch."""
    state = prepared(machine, Version(name=NEW))
    before, invocation = machine.status(), machine.service().invocation
    machine.link(machine.paths.current, machine.paths.versions / NEW)
    states.write(machine, replace(state, stage=Stage.PROVING, before=before, invocation=invocation))
    machine.restart()


@pytest.mark.one_interpreter
def test_an_update_to_its_end(machine: WatchedMachine, capsys: pytest.CaptureFixture[str]) -> None:
    path = package(machine, Version(name=NEW))
    assert run(machine, path, "--unsigned", "--replay", "0") == 0
    assert (machine.world.runs, machine.world.watcher_starts) == (NEW, 1)
    out = capsys.readouterr().out
    assert "1.0 runs; update with" in out
    assert "updated: 2.0 runs and is proven" in out, "what the watcher logs is shown"
    assert run(machine, "--back") == 0
    assert machine.world.runs == OLD


def test_a_worse_version_is_an_error(machine: WatchedMachine) -> None:
    assert run(machine, package(machine, Version(name=NEW, starts=False)), "--unsigned", "--replay", "0") == 1
    assert machine.world.runs == OLD


def test_back_before_the_switch_abandons(machine: WatchedMachine, capsys: pytest.CaptureFixture[str]) -> None:
    prepared(machine, Version(name=NEW))
    assert run(machine, "--back") == 0
    state = states.read(machine)
    assert state is not None
    assert (state.outcome, state.why, machine.version()) == (Outcome.ABANDONED, "ended by hand", OLD)
    assert (machine.stops, machine.world.watcher_starts, machine.world.starts) == (1, 0, 1)
    assert "ended before the switch, while it was waiting: ended by hand" in capsys.readouterr().out


def test_back_during_the_proof_returns(machine: WatchedMachine, capsys: pytest.CaptureFixture[str]) -> None:
    proving(machine)
    assert run(machine, "--back") == 0
    state = states.read(machine)
    assert state is not None
    assert (state.outcome, state.why, machine.world.runs) == (Outcome.RETURNED, "ended by hand", OLD)
    assert (machine.stops, machine.world.watcher_starts) == (1, 1)
    assert "returned to 1.0, which is proven. 2.0 was not taken: ended by hand" in capsys.readouterr().out


def test_a_log_that_is_gone_does_not_keep_from_returning(machine: WatchedMachine) -> None:
    proving(machine)
    machine.paths.log.mkdir()
    assert run(machine, "--back") == 0
    assert machine.world.runs == OLD


@pytest.mark.one_interpreter
def test_back_where_the_old_version_cannot_be_proven_is_an_error(machine: WatchedMachine) -> None:
    proving(machine)
    machine.remove(machine.paths.versions / OLD)
    machine.put(Version(name=OLD, vision="link_down"))
    assert run(machine, "--back") == 1
    state = states.read(machine)
    assert state is not None
    assert state.outcome is Outcome.NOT_PROVEN


def test_back_ends_the_update_only_where_its_process_has_ended(machine: WatchedMachine) -> None:
    prepared(machine, Version(name=NEW))
    with machine.lock() as ours:
        assert ours
        with pytest.raises(UpdateError, match="another process works on an update"):
            run(machine, "--back")
        with pytest.raises(UpdateError, match="an update is under way"):
            run(machine, package(machine, Version(name="3.0")), "--unsigned")
    state = states.read(machine)
    assert state is not None
    assert state.stage is Stage.WAITING


def test_a_watcher_that_does_not_work_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine = installed(tmp_path)  # its watcher does nothing
    began_s = machine.now_s()
    assert run(machine, package(machine, Version(name=NEW)), "--unsigned", "--replay", "0") == 1
    assert "nothing works on the update: look at systemctl status loading-gateway-update" in capsys.readouterr().err
    assert cli.LOST_S < machine.now_s() - began_s < cli.LOST_S + 5
    assert run(machine, "--status") == 0
    shown = capsys.readouterr().out
    assert "update:    from 1.0 to 2.0: waiting: no truck may be in any bay at the switch" in shown
    assert "no process works on it: systemctl start loading-gateway-update" in shown
    with machine.lock():
        run(machine, "--status")
        assert "no process works on it" not in capsys.readouterr().out


def test_the_terminal_may_be_left_while_it_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    machine = installed(tmp_path)

    def left(_: PlayedMachine, _seconds: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(PlayedMachine, "sleep", left)
    assert run(machine, package(machine, Version(name=NEW)), "--unsigned", "--replay", "0") == 1
    assert "it goes on without you: gateway update --status shows it" in capsys.readouterr().out
    state = states.read(machine)
    assert state is not None
    assert state.stage is Stage.WAITING


@pytest.mark.parametrize("where", ["dpkg", "check"])
def test_ctrl_c_while_it_is_prepared_leaves_nothing_behind(
    machine: WatchedMachine, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    real, left = PlayedMachine.command, list[str]()

    def command(self: PlayedMachine, *words: str | Path, **options: Any) -> ProgramResult:
        if where in map(str, words[:2]) and not left:
            left.append(where)
            if where == "dpkg":
                self.change(half_installed=True)
            raise KeyboardInterrupt
        return real(self, *words, **options)

    monkeypatch.setattr(PlayedMachine, "command", command)
    assert run(machine, package(machine, Version(name=NEW)), "--unsigned", "--replay", "0") == 1
    state = states.read(machine)
    assert state is not None
    assert (state.outcome, state.why) == (Outcome.ABANDONED, "interrupted at the terminal")
    assert (machine.installed(), machine.version(), machine.world.half_installed) == ([OLD], OLD, False)
    assert not machine.paths.watcher.is_symlink()


@pytest.mark.parametrize(("typed", "taken"), [("y\n", True), ("\n", False), ("", False)])
def test_the_question_about_differences(
    machine: WatchedMachine, monkeypatch: pytest.MonkeyPatch, typed: str, taken: bool
) -> None:
    """Empty: Ctrl-D, or a terminal that is gone."""

    class Terminal:
        def isatty(self) -> bool:
            return True

        def readline(self) -> str:
            return typed

    asked = []

    def replayed(_machine: object, state: UpdateState, _options: object, confirm: Any, _say: object) -> UpdateState:
        asked.append(confirm("2.0 decides otherwise: use it all the same?"))
        if not asked[-1]:
            raise UpdateError("the differences were not accepted; --yes accepts them")
        return state

    monkeypatch.setattr(prepare, "_replayed", replayed)
    monkeypatch.setattr(sys, "stdin", Terminal())
    assert run(machine, package(machine, Version(name=NEW)), "--unsigned") == (0 if taken else 1)
    assert (asked, machine.world.runs) == ([taken], NEW if taken else OLD)
    assert not machine.paths.watcher.is_symlink()


@pytest.mark.one_interpreter
def test_status_shows_when_and_how_it_was_begun(machine: WatchedMachine, capsys: pytest.CaptureFixture[str]) -> None:
    run(machine, "--status")
    assert "update:    none so far" in capsys.readouterr().out
    run(machine, package(machine, Version(name=NEW)), "--unsigned", "--replay", "0")
    capsys.readouterr()
    run(machine, "--status")
    shown = capsys.readouterr().out
    begun = "           begun 2026-11-23 02:31:40 UTC, with a package\n"
    assert f"update:    from 1.0 to 2.0: updated\n{begun}" in shown
    run(machine, "--back")
    capsys.readouterr()
    run(machine, "--status")
    assert " UTC, back by hand\n" in capsys.readouterr().out


def test_who_resumes_waits_for_the_lock(machine: WatchedMachine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    prepared(machine, Version(name=NEW))
    assert os.path.islink(machine.paths.watcher)
    with machine.lock(), pytest.raises(UpdateError, match="another process works on the update"):
        run(machine, "--resume")
    assert run(machine, "--resume") == 0
    assert machine.world.runs == NEW
