"""Reports of alarms and actions on them, as records: they cross a process boundary. Pure."""

import re
from dataclasses import dataclass
from enum import StrEnum

from gateway.alarms.states import AlarmEvent, AlarmState
from gateway.core import details
from gateway.processes.codec import Message

MAX_SHELVE_MIN = 12 * 60  # one shift
MAX_NOTE = 120
OPERATOR_EVENTS = (
    AlarmEvent.ACKNOWLEDGE,
    AlarmEvent.RESET,
    AlarmEvent.SHELVE,
    AlarmEvent.UNSHELVE,
    AlarmEvent.REMOVE,
    AlarmEvent.RESTORE,
)
"""What a person may do."""
_LOGGED = re.compile(r"([^\s:]+): (\w+), now (\w+)")


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm now. Times are the gateway's clock."""

    id: str
    kind: str  # row of the table
    bay: str | None  # None: of the gateway itself
    state: AlarmState = AlarmState.NORMAL
    active: bool = False  # does its cause hold, delays counted? Always false while suppressed
    since_ns: int = 0  # in this state
    raised_ns: int | None = None  # last announced; None: never
    occurrences: int = 0  # times announced since the start of the gateway
    detail: str = ""  # in words, when it was last announced
    who: str = ""  # who acted on it last since it was announced
    note: str = ""  # and why
    shelved_until_ns: int | None = None


@dataclass(frozen=True, slots=True)
class AlarmChange:
    """One step of one alarm, numbered from 1 over all alarms since the start of the gateway."""

    number: int
    t_ns: int
    id: str
    kind: str
    bay: str | None
    event: AlarmEvent
    before: AlarmState
    after: AlarmState
    detail: str = ""
    who: str = ""
    note: str = ""

    @property
    def by_design(self) -> bool:
        """Suppressed or unsuppressed by design while no action was needed: for debugging only."""
        return {self.before, self.after} == {AlarmState.SUPPRESSED, AlarmState.NORMAL}

    def __str__(self) -> str:
        detail = f": {self.detail}" if self.detail and self.after is AlarmState.UNACKNOWLEDGED else ""
        step = self.id, self.event.value, self.after.value
        if not self.who:
            return details.ALARM_STEP(*step) + detail
        return details.ALARM_STEP_BY(*step, f"{self.who} ({self.note})" if self.note else self.who) + detail


@dataclass(frozen=True, slots=True)
class LoggedChange:
    """What is known of a change whose text was kept, in a recording or a log."""

    id: str
    event: AlarmEvent
    after: AlarmState

    @property
    def kind(self) -> str:
        """Row of the table, of a later version maybe."""
        return self.id.rpartition(".")[2]

    @property
    def bay(self) -> str | None:
        """None: of the gateway itself."""
        return self.id.rpartition(".")[0] or None

    @staticmethod
    def of(text: str) -> "LoggedChange | None":
        """`str` of an AlarmChange, read again; None: another text, or the change of a later version."""
        found = _LOGGED.match(text)
        try:
            return None if found is None else LoggedChange(found[1], AlarmEvent(found[2]), AlarmState(found[3]))
        except ValueError:
            return None


class OperatorAction(Message, frozen=True):
    """An operator's action. `occurrence`: the one that was shown (Alarm.occurrences); None: any."""

    id: str
    event: AlarmEvent
    who: str
    note: str = ""
    minutes: float | None = None  # of SHELVE
    occurrence: int | None = None


class ActionOutcome(StrEnum):
    DONE = "done"
    UNKNOWN = "unknown"  # no such alarm
    REFUSED = "refused"  # not in this state
    INVALID = "invalid"  # the action is never possible


@dataclass(frozen=True, slots=True)
class ActionReply:
    """To an action. `why`: what is wrong with it, for people; empty: it was done."""

    outcome: ActionOutcome = ActionOutcome.DONE
    why: str = ""


@dataclass(frozen=True, slots=True)
class AlarmSummary:
    """All alarms, as one record. Those in NORMAL are left out; `omitted` more had no room here."""

    alarms: tuple[Alarm, ...] = ()  # the most important first
    omitted: int = 0
    counts: tuple[tuple[AlarmState, int], ...] = ()  # of all alarms, in the order of AlarmState
    announced: tuple[tuple[str, int], ...] = ()  # kind -> times announced since the start; those never announced not
    newest_change: int = 0
