"""The ends of an update: abandoned before the switch, or cleaned up after it. Each may be begun again after a cut."""

import hashlib
import os
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from msgspec.structs import replace

from gateway.files import plain_bytes
from gateway.update import state as states
from gateway.update.machine import SAVED, Machine, UpdateError, scratch
from gateway.update.package import configure, dpkg_fault, is_installed, run_dpkg
from gateway.update.state import Outcome, Report, Stage, UpdateState


def log_to(machine: Machine, shown: Callable[[str], None]) -> Report:
    """Appends each line to the log of the update with its time (UTC), and shows it. A terminal or a journal that is
    gone ends nothing."""

    def report(text: str) -> None:
        moment = datetime.fromtimestamp(machine.unix_s(), UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        with suppress(OSError), machine.paths.log.open("a", encoding="utf-8") as file:
            file.write(f"{moment} {text}\n")
        with suppress(UpdateError):
            states.show(machine, states.read(machine))
        with suppress(OSError, ValueError):
            shown(text)

    return report


def content(path: Path) -> bytes | None:
    """None: it can't be read."""
    try:
        return plain_bytes(path)
    except OSError:
        return None


def digest(data: bytes | None) -> str:
    """Empty: of nothing."""
    return "" if data is None else hashlib.sha256(data).hexdigest()


def undo_files(machine: Machine, state: UpdateState, report: Report) -> None:
    """Configuration and link as before the switch. Also where only one of the two was changed, or none."""
    if not state.undone and (state.new_config or state.stage is not Stage.SWITCHING):
        _undo_config(machine, state, report)
    machine.link(machine.paths.current, machine.paths.versions / state.old)


def _undo_config(machine: Machine, state: UpdateState, report: Report) -> None:
    """Somebody may have saved what only the new version understands: that is put aside, whatever it is."""
    paths = machine.paths
    kept = paths.kept_config(state.old)
    former, now = content(kept), content(paths.config)
    if former is None or now == former:
        return
    if now is not None and now != (content(paths.new_config) if state.new_config else former):
        saved = paths.saved_config(state.new)
        machine.write(saved, now)
        report(
            f"configuration: it was changed after the switch. What it was then is kept as {saved}; "
            f"{state.old} gets its own"
        )
    # Where there is none any more, or no plain file, it must become one that the service may read.
    machine.write(paths.config, former, like=kept if now is None else paths.config)


def abandon(machine: Machine, state: UpdateState, why: str, report: Report, *, cut_off: bool = False) -> UpdateState:
    """Before the switch: the machine is as it was, but for what dpkg lists as installed. `cut_off`: the step may have
    been ended in its midst."""
    if state.stage is Stage.SWITCHING:
        undo_files(machine, state, report)
    if state.stage is Stage.INSTALLING:
        if fault := _complete_installation(machine, state, cut_off=cut_off):
            why = f"{why}; {fault}"
        machine.link(machine.paths.current, machine.paths.versions / state.old)  # the installation may have set it
    if state.stage is not Stage.VERIFYING:
        _reject(machine, state, report)
    _remove_new(machine, state)
    report(f"ended before the switch, while it was {state.stage.value}: {why}. {state.old} runs as before")
    return _end(machine, state, Outcome.ABANDONED, why)


def _complete_installation(machine: Machine, state: UpdateState, *, cut_off: bool) -> str:
    """dpkg has failed or was interrupted: until its package is installed, dpkg and apt refuse to do anything else.
    Empty: it is; else what is to be done."""
    try:
        # Interrupted, it may be unpacked in parts; to configure it is not enough then.
        again = run_dpkg(machine) if cut_off and machine.paths.package.is_file() else configure(machine)
        if is_installed(machine):
            return ""
        fault = dpkg_fault(again)
    except UpdateError as error:
        fault = str(error)
    return (
        f"dpkg has the package half installed, and refuses other packages: {fault}. Mend that, then "
        f"dpkg --configure -a; or dpkg --install the package of {state.old}"
    )


def _reject(machine: Machine, state: UpdateState, report: Report) -> None:
    """The version that was not taken, where dpkg lists its package."""
    if state.by_hand or not state.new:
        return
    machine.write(machine.paths.rejected, f"{state.new}\n".encode())
    report(
        f"dpkg lists the package of {state.new}: units, device rules and /usr/share/loading-gateway are its; "
        f"dpkg --install the package of {state.old} brings back those that it had"
    )


def returned(machine: Machine, state: UpdateState, fault: str, report: Report) -> UpdateState:
    """After the old version was restarted. `fault`: why it could not be proven; empty: it was."""
    _reject(machine, state, report)
    _remove_new(machine, state)
    if fault:
        report(
            f"{state.old} was started again, and could not be proven: {fault}. Observation at it now: gateway doctor"
        )
        return _end(machine, state, Outcome.NOT_PROVEN, f"{state.why}; {state.old} not proven: {fault}")
    report(f"returned to {state.old}, which is proven. {state.new} was not taken: {state.why}")
    return _end(machine, state, Outcome.RETURNED, state.why)


def clean(machine: Machine, state: UpdateState, report: Report) -> UpdateState:
    """After the proof: the two versions stay, and nothing older."""
    paths = machine.paths
    for version in machine.installed():
        if version not in (state.old, state.new):
            machine.remove(paths.versions / version)
            report(f"deleted: version {version}")
    if not state.new_config:  # back by hand, the one in force is used
        machine.remove(paths.kept_config(state.old))
    report(f"updated: {state.new} runs and is proven; {state.old} stays beside it: gateway update --back returns to it")
    return _end(machine, replace(state, previous=state.old), Outcome.UPDATED, "")


def _remove_new(machine: Machine, state: UpdateState) -> None:
    """The new version's folder, where this update has made it."""
    paths = machine.paths
    running = {state.old, state.previous, Path(os.readlink(paths.current)).name}
    if state.new and not state.was_there and state.new not in running:
        machine.remove(paths.versions / state.new)
        machine.remove(scratch(paths.versions / state.new))  # of an installation that has failed


def _end(machine: Machine, state: UpdateState, outcome: Outcome, why: str) -> UpdateState:
    state = states.write(machine, replace(state, stage=Stage.ENDED, outcome=outcome, why=why))
    tidy(machine, state)
    return state


def tidy(machine: Machine, state: UpdateState | None) -> None:
    """Remove what is of no use once an update has ended. The link goes last: it has the unit started at boot."""
    paths = machine.paths
    previous = "" if state is None else state.previous
    stays = {paths.state, paths.log, paths.lock, paths.watcher, paths.kept_config(previous)}
    for path in sorted(set(paths.folder.iterdir()) - stays):  # the package, copies, what was being written
        if not path.name.startswith(SAVED):
            machine.remove(path)
    machine.remove(paths.new_config)
    machine.remove(scratch(paths.new_config))
    machine.remove(scratch(paths.config))
    machine.remove(paths.watcher)
