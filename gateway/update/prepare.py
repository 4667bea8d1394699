"""Everything up to the switch: signature, installation beside, configuration, recordings; at a terminal."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from msgspec.structs import replace

from gateway import config
from gateway.errors import ConfigError, LinkError
from gateway.files import plain_bytes
from gateway.update import package, proof, recordings
from gateway.update import state as states
from gateway.update.finish import abandon, content, digest
from gateway.update.machine import Machine, UpdateError
from gateway.update.recordings import Replayed
from gateway.update.state import Report, Stage, UpdateState

CHECK_S = 120.0
LOG_BYTES = 1_000_000  # more than a hundred updates; half of it is kept
DRY = "a dry run ends here"


@dataclass(frozen=True, slots=True)
class UpdateOptions:
    """What was asked for. `package` None: back to the version before. Times in s; `hours`: of recordings, 0: none."""

    package: Path | None = None
    signature: Path | None = None
    unsigned: bool = False
    dry: bool = False
    hours: float = 24.0
    wait_s: float = 3600.0
    within_s: float = 120.0
    steady_s: float = 45.0
    at_once: bool = False
    accepted: tuple[str, ...] = ()
    accepted_bays: tuple[str, ...] = ()  # where the new version may decide otherwise
    newer: bool = False  # an older version is refused: what it lacks is known to whoever has taken over the pages


def prepare(machine: Machine, options: UpdateOptions, confirm: Callable[[str], bool], report: Report) -> UpdateState:
    """The state that the watcher goes on from: WAITING. ENDED: a dry run, or it was abandoned. The caller holds the
    lock. Raises UpdateError where nothing was begun."""
    state = _begun(machine, options, report)
    try:
        if options.package is None:
            state = replace(state, new=_previous(machine, state), was_there=True)
            state = _kept_config(machine, state, report)
        else:
            state = _verified(machine, state, options.package, options, report)
            state = _installed(machine, state, report)
            state = _examined(machine, state, report)
            state = _replayed(machine, state, options, confirm, report)
        _report_bays(machine, report)
        if options.dry:
            return abandon(machine, state, DRY, report)
        return states.write(machine, replace(state, stage=Stage.WAITING))
    except (UpdateError, ConfigError, OSError) as error:
        return abandon(machine, states.read(machine) or state, str(error), report)
    except KeyboardInterrupt:
        return abandon(machine, states.read(machine) or state, "interrupted at the terminal", report, cut_off=True)


def _begun(machine: Machine, options: UpdateOptions, report: Report) -> UpdateState:
    known = states.read(machine)
    if known is not None and known.stage is not Stage.ENDED:
        if known.stage not in states.BEFORE_SWITCH:
            raise UpdateError(f"an update to {known.new} is {known.stage.value}: gateway update --status")
        abandon(machine, known, "its process has ended", report, cut_off=True)
    old = machine.version()
    if not machine.paths.executable(old).exists():
        raise UpdateError(f"{machine.paths.executable(old)}: is not there: install the running version's package anew")
    _shorten_log(machine)
    machine.link(machine.paths.watcher, machine.paths.versions / old)
    begun = UpdateState(
        stage=Stage.VERIFYING,
        old=old,
        boot=machine.boot(),
        began_unix_s=machine.unix_s(),
        by_hand=options.package is None,
        wait_s=options.wait_s,
        within_s=options.within_s,
        steady_s=options.steady_s,
        at_once=options.at_once,
        accepted=options.accepted,
        previous="" if known is None else known.previous,
    )
    report(f"{old} runs; {'back by hand' if options.package is None else f'update with {options.package}'}")
    return states.write(machine, begun)


def _shorten_log(machine: Machine) -> None:
    log = machine.paths.log
    if log.is_file() and log.stat().st_size > LOG_BYTES:
        machine.write(log, log.read_bytes()[-LOG_BYTES // 2 :].partition(b"\n")[2])


def _previous(machine: Machine, state: UpdateState) -> str:
    if not state.previous or not machine.paths.executable(state.previous).exists():
        raise UpdateError("there is no previous version on this machine")
    return state.previous


def _checking(machine: Machine, state: UpdateState) -> UpdateState:
    """What is saved from now on was not examined."""
    examined = digest(content(machine.paths.config))
    return states.write(machine, replace(state, stage=Stage.CHECKING, config_digest=examined))


def _kept_config(machine: Machine, state: UpdateState, report: Report) -> UpdateState:
    """Back by hand: where the update has changed the configuration, the one of before is used again."""
    paths = machine.paths
    state = _checking(machine, state)
    kept = paths.kept_config(state.new)
    if kept.is_file():
        report(f"configuration: that of {state.new} is used again, with what it set then")
        machine.write(paths.new_config, kept.read_bytes(), like=paths.config)
    return _checked(machine, state, report, new_config=kept.is_file())


def _verified(machine: Machine, state: UpdateState, named: Path, options: UpdateOptions, report: Report) -> UpdateState:
    if not named.is_file():
        raise UpdateError(f"{named}: no such file")
    package.need_space(machine, named, state.old)
    machine.copy(named, machine.paths.package)
    signature = options.signature or named.with_name(f"{named.name}.asc")
    package.verify(machine, machine.paths.package, report, signature=signature, unsigned=options.unsigned)
    new = package.version_of(machine, machine.paths.package)
    if new == state.old:
        raise UpdateError(f"{named.name} is version {new}, which runs already")
    if options.newer and machine.command("dpkg", "--compare-versions", new, "gt", state.old).code != 0:
        raise UpdateError(f"{named.name} is version {new}, older than {state.old}: that can be installed at a terminal")
    report(f"package: {named.name} is version {new}")
    return replace(state, new=new, was_there=new in machine.installed())


def _installed(machine: Machine, state: UpdateState, report: Report) -> UpdateState:
    state = states.write(machine, replace(state, stage=Stage.INSTALLING))
    report(f"install {state.new} beside {state.old}, which runs on")
    package.install(machine, state.new, report)
    if machine.version() != state.old:
        raise UpdateError(f"the package has changed {machine.paths.current}, which it must not")
    return state


def _examined(machine: Machine, state: UpdateState, report: Report) -> UpdateState:
    """The new version migrates a copy of the configuration where it must, and checks what it will run with."""
    paths = machine.paths
    state = _checking(machine, state)
    machine.remove(paths.new_config)
    copy = paths.folder / "migrated.toml"
    machine.remove(copy)
    answer = machine.command(paths.executable(state.new), "update", "--migrate", paths.config, copy)
    if answer.code != 0:
        raise UpdateError(f"configuration: {state.new} can't migrate it: {answer.last_lines}")
    for line in answer.out.splitlines():
        report(f"configuration: {line}")
    changed = copy.is_file() and copy.read_bytes() != plain_bytes(paths.config)
    if changed:
        machine.write(paths.new_config, copy.read_bytes(), like=paths.config)
    machine.remove(copy)
    return _checked(machine, state, report, new_config=changed)


def _checked(machine: Machine, state: UpdateState, report: Report, *, new_config: bool) -> UpdateState:
    paths = machine.paths
    path = paths.new_config if new_config else paths.config
    command = (paths.executable(state.new), "check", path)
    answer = machine.command(*command, user=machine.service_user(), timeout_s=CHECK_S)
    if answer.code != 0:
        raise UpdateError(f"configuration: {state.new} refuses it: {answer.last_lines}")
    for line in answer.out.splitlines():
        report(f"configuration: {line.strip()}")
    return states.write(machine, replace(state, new_config=new_config))


def _replayed(
    machine: Machine, state: UpdateState, options: UpdateOptions, confirm: Callable[[str], bool], report: Report
) -> UpdateState:
    state = states.write(machine, replace(state, stage=Stage.REPLAYING))
    paths = machine.paths
    if options.hours == 0:
        report("recordings: not replayed, as --replay 0 asks")
        return state
    day = recordings.day_of(options.hours)
    settings = config.load(paths.config)
    found, faults = recordings.segments(settings, options.hours, machine.unix_s())
    if not found and not faults:
        report(f"recordings: there are none of the {day}: what {state.new} would decide otherwise is not known")
        return state
    old = state.old, paths.config
    new = state.new, paths.new_config if state.new_config else paths.config
    results = []
    for bay in (bay.name for bay in settings.bays):
        if bay in found:
            report(f"recordings of {bay}: {len(found[bay])} files of the {day}, replayed by {state.new}")
            results.append(recordings.replay(machine, bay, found[bay], old, new, machine.service_user()))
        elif bay in faults:
            results.append(Replayed(bay, fault=f"cannot be listed, and so not replayed: {faults[bay]}"))
        else:
            report(f"recordings of {bay}: there are none of the {day}")
            continue
        for line in results[-1].lines:
            report(line)
    if differing := tuple(one.bay for one in results if one.rows or one.fault):
        state = states.write(machine, replace(state, differing=differing))
        question = f"{state.new} decides otherwise, or could not be tried: use it all the same?"
        if set(differing) - set(options.accepted_bays) and not confirm(question):
            raise UpdateError("the differences were not accepted; --yes accepts them")
        report("recordings: the differences were accepted")
    return state


def _report_bays(machine: Machine, report: Report) -> None:
    try:
        status = machine.status()
    except LinkError as error:
        report(f"bays: not known: {error}")
        return
    report(f"bays: {proof.phases_in_words(status)}")
