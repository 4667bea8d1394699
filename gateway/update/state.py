"""The state of an update on disk: each step is written before it begins, so that a power cut finds its place."""

from collections.abc import Callable
from contextlib import suppress
from enum import StrEnum

import msgspec

from gateway.explained import ExplainedStr
from gateway.files import plain_bytes, replacing
from gateway.status_file import Status
from gateway.update.machine import Machine, UpdateError, scratch
from gateway.update_request import ShownUpdate

FORMAT = 1
SHOWN_LOG_BYTES, SHOWN_LOG_LINES = 30_000, 200


class Stage(ExplainedStr):
    """The step that has begun. The names are on disk."""

    VERIFYING = "verifying", "the package is copied, and its signature verified"
    INSTALLING = "installing", "dpkg installs the new version beside the running one"
    CHECKING = "checking", "the new version examines the configuration, and migrates a copy where it must"
    REPLAYING = "replaying", "the new version takes the recorded decisions of the last day again"
    WAITING = "waiting", "no truck may be in any bay at the switch"
    SWITCHING = "switching", "configuration and link are changed to the new version"
    PROVING = "proving", "the new version runs, and must prove itself in operation"
    RETURNING = "returning", "it could not, or was told to: back to the old version, which is proven, too"
    CLEANING = "cleaning", "versions that are older than the two are deleted"
    ENDED = "ended", "nothing is under way"


BEFORE_SWITCH = (Stage.VERIFYING, Stage.INSTALLING, Stage.CHECKING, Stage.REPLAYING, Stage.WAITING, Stage.SWITCHING)
"""A power cut in one of these ends the update; the old version runs on."""


class Outcome(StrEnum):
    """How an update has ended. The names are on disk."""

    UPDATED = "updated"
    ABANDONED = "abandoned"  # before the switch: nothing has changed
    RETURNED = "returned"  # to the old version, which is proven
    NOT_PROVEN = "not_proven"  # returned, but the old version could not be proven either


class UpdateState(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that must be known to go on. Replaced with every step."""

    format: int = FORMAT
    stage: Stage
    old: str  # the version that ran when the update began, and watches
    new: str = ""  # "": not known yet
    boot: str  # of the machine, when `stage` was written
    began_unix_s: int
    by_hand: bool = False  # `--back`: without a package
    was_there: bool = False  # `new` was installed before: never deleted
    wait_s: float = 3600.0
    within_s: float = 120.0
    steady_s: float = 45.0
    at_once: bool = False  # do not wait until the bays are free
    accepted: tuple[str, ...] = ()  # ids of alarms that may be new
    config_digest: str = ""  # of the configuration that the new version has examined
    new_config: bool = False  # the switch replaces the configuration
    before: Status | None = None  # of the old version, at the switch; None: it did not run
    registers: bool = False  # the registers could be read at the switch
    known: tuple[int, ...] = ()  # their words that show the word order (images.KNOWN)
    invocation: str = ""  # of the service, at the last restart
    undone: bool = False  # the configuration is again as before the switch
    resumed: int = 0  # times that the proof was begun again
    previous: str = ""  # to which `--back` returns
    outcome: Outcome | None = None
    why: str = ""
    differing: tuple[str, ...] = ()  # bays in which `new` decides otherwise, or could not be tried


_DECODER = msgspec.json.Decoder(UpdateState)


def read(machine: Machine) -> UpdateState | None:
    """None: there was no update yet. Raises UpdateError for a file that this version does not understand."""
    path = machine.paths.state
    try:
        state = _DECODER.decode(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, msgspec.MsgspecError) as error:
        raise UpdateError(f"{path}: {error}; if no update is under way, delete this file") from error
    if state.format != FORMAT:
        raise UpdateError(f"{path}: format {state.format}, and this version reads {FORMAT}")
    return state


def write(machine: Machine, state: UpdateState) -> UpdateState:
    """On disk when it returns."""
    state = msgspec.structs.replace(state, boot=machine.boot())
    machine.write(machine.paths.state, msgspec.json.format(msgspec.json.encode(state), indent=1))
    show(machine, state)
    return state


def show(machine: Machine, state: UpdateState | None) -> None:
    """For the pages, which may not read this folder. That it fails ends nothing."""
    with suppress(OSError, UpdateError):
        log = plain_bytes(machine.paths.log) if machine.paths.log.is_file() else b""
        lines = log[-SHOWN_LOG_BYTES:].decode(errors="replace").splitlines()
        shown = ShownUpdate(version=machine.version(), log=tuple(lines[-SHOWN_LOG_LINES:]))
        if state is not None:
            outcome = "" if state.outcome is None else state.outcome.value
            names = ("previous", "old", "new", "why", "differing")
            of_state = {name: getattr(state, name) for name in names}
            shown = msgspec.structs.replace(shown, stage=state.stage.value, outcome=outcome, **of_state)
        path = machine.paths.shown
        with replacing(path, 0o644, fresh=scratch(path)) as file:
            file.write(msgspec.json.encode(shown))


Report = Callable[[str], None]
"""Reports one line: to the log of the update, and to whoever looks on."""
