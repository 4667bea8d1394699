"""A teach-in in the running gateway: a bay's newest states are collected while its truck stands right. asyncio.

It changes nothing: it reads what the pages are sent anyway, ten times a second. One for each bay at a time; kept in
memory only, and its result for KEPT_S.
"""

from contextlib import ExitStack
from dataclasses import dataclass, field
from enum import StrEnum

from gateway.config import BayConfig
from gateway.core import teach_in
from gateway.core.interlock import Recipe
from gateway.core.readings import Quality
from gateway.core.state import StateVector
from gateway.core.teach_in import Spreads, Suggestion, TeachSample
from gateway.durations import NS_PER_S
from gateway.errors import GatewayError
from gateway.web.server.gateway_client import BayReport, GatewayClient
from gateway.web.tuning import marker_pick

KEPT_S = 900.0
NEWER_S = 3.0  # the main process reports the bay within this
UNKNOWN_S = 5.0  # without R or Z for this time, it has failed
LATE_S = 10.0  # so much later than planned it is given up, whatever has arrived
MAX_SAMPLES = 4000
HALF_WAY = 0.5  # from the marker's colour to the gate: farther, another light may reach it


class TeachInError(GatewayError):
    """It can't begin now, and why."""


class Phase(StrEnum):
    MEASURING = "measuring"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class TaughtColour:
    """Of `vision.marker_colour`; None: absent."""

    value: str | None
    old: str | None
    why: str


@dataclass(slots=True)
class TeachInSession:
    """One teach-in. Times of the gateway's clock, ns. `why`: it has failed; `suggestion`: it is done.

    `bay`: with what the recipe in force makes of it; `recipe` 0: nothing.
    """

    bay: BayConfig
    recipe: int
    who: str
    seconds: float
    began_ns: int
    phase: Phase = Phase.MEASURING
    samples: list[TeachSample] = field(default_factory=list)
    size_px: tuple[int, int] | None = None  # of the pictures
    known_ns: int = 0  # when R and Z were good last
    ended_ns: int = 0
    why: str = ""
    suggestion: Suggestion | None = None
    colour: TaughtColour | None = None

    @property
    def end_ns(self) -> int:
        return self.began_ns + round(self.seconds * NS_PER_S)


class TeachInSessions:
    """One for the web process."""

    def __init__(self, client: GatewayClient) -> None:
        self._client = client
        self._sessions: dict[str, TeachInSession] = {}
        self._watching: dict[str, ExitStack] = {}
        client.listeners.append(self._on_report)

    def of(self, bay: str) -> TeachInSession | None:
        """The bay's newest; None: there is none, or it is too old."""
        session = self._sessions.get(bay)
        if session is None:
            return None
        now_ns = self._client.clock.now_ns()
        if session.phase is Phase.MEASURING:
            if now_ns > session.end_ns + LATE_S * NS_PER_S:
                self._end(session, now_ns, "the gateway has reported nothing for too long")
        elif now_ns - session.ended_ns > KEPT_S * NS_PER_S:
            del self._sessions[bay]
            return None
        return session

    async def start(self, bay: BayConfig, seconds: float, who: str) -> TeachInSession:
        """Judged by the state as it is now. Raises TeachInError."""
        known = self._client.report(bay.name)
        with self._client.watching(bay.name):
            report = await self._client.newer(bay.name, 0 if known is None else known.number, NEWER_S)
        before = self.of(bay.name)
        if before is not None and before.phase is Phase.MEASURING:
            raise TeachInError(f"this bay is being taught already, wait or cancel that: {before.who}")
        if report is None:
            raise TeachInError("the gateway has not reported this bay")
        number = report.now.state.plc.recipe
        bay = self._with_recipe(bay, number)
        if why := why_not(report.now.state, bay):
            raise TeachInError(why)
        now_ns = self._client.clock.now_ns()
        session = TeachInSession(bay, number, who, seconds, now_ns, known_ns=now_ns)
        self._sessions[bay.name] = session
        self._watching[bay.name] = stack = ExitStack()
        stack.enter_context(self._client.watching(bay.name))
        return session

    def _with_recipe(self, bay: BayConfig, number: int) -> BayConfig:
        for recipe in self._client.about.config.recipes:
            if recipe.id == number:
                made = Recipe.of(bay, recipe)
                return bay.model_copy(update={"fusion": made.fusion, "guidance": made.guidance})
        return bay

    def cancel(self, bay: str) -> None:
        """Forget the bay's teach-in, whatever its phase."""
        if (session := self._sessions.pop(bay, None)) is not None:
            self._unwatch(session)

    def _on_report(self, bay: str, report: BayReport) -> None:
        session = self._sessions.get(bay)
        if session is None or session.phase is not Phase.MEASURING:
            return
        state, now_ns = report.now.state, report.now_ns
        if now_ns < session.began_ns:
            return
        if session.size_px is None and (frame := self._client.snapshot(bay)) is not None:
            session.size_px = frame.image.shape[1], frame.image.shape[0]
        circle, distance_mm = state.vision.circle, state.range.distance_mm
        session.samples.append(
            TeachSample(now_ns, state.vision.t_ns, circle, state.range.t_ns, distance_mm, state.memory.disagree)
        )
        if circle is not None and distance_mm is not None:
            session.known_ns = now_ns
        if state.plc.recipe != session.recipe:
            self._end(session, now_ns, "the PLC has selected another recipe")
        elif now_ns - session.known_ns > UNKNOWN_S * NS_PER_S:
            self._end(session, now_ns, f"no R or Z for {UNKNOWN_S:g} s: {_not_good(state)}")
        elif now_ns >= session.end_ns or len(session.samples) >= MAX_SAMPLES:
            session.suggestion = teach_in.suggest(session.samples, session.bay, session.size_px, state.memory.scale)
            if session.suggestion.values:
                session.colour = self._colour(session.bay.name, session.suggestion.spreads, report)
            self._end(session, now_ns)

    def _colour(self, bay: str, spreads: Spreads, report: BayReport) -> TaughtColour | None:
        """What is seen of the marker's inner half, where it is far from the configured colour. A marker that was found
        lies within the gate: what does not is something else in its place.
        """
        if report.now.state.vision.quality is not Quality.GOOD:
            return None
        vision, frame = report.now.vision, self._client.snapshot(bay)
        u, v, radius = spreads.u_px, spreads.v_px, spreads.radius_px
        if vision.method != "robust" or frame is None or u is None or v is None or radius is None:
            return None
        seen = marker_pick.pick(frame.image, u.median, v.median, round(radius.median), vision.marker_colour)
        if not seen.keys or not HALF_WAY < seen.distance < 1:
            return None
        way = f"seen here {100 * seen.distance:.0f} % of the way from the marker's colour to the limit"
        return TaughtColour(seen.keys["marker_colour"], vision.marker_colour, way)

    def _end(self, session: TeachInSession, now_ns: int, why: str = "") -> None:
        session.phase = Phase.FAILED if why else Phase.DONE
        session.why, session.ended_ns = why, now_ns
        self._unwatch(session)

    def _unwatch(self, session: TeachInSession) -> None:
        if (stack := self._watching.pop(session.bay.name, None)) is not None:
            stack.close()


def why_not(state: StateVector, bay: BayConfig) -> str:
    """Why a teach-in can't begin in this state; empty: it can."""
    if why := _not_good(state):
        return why
    speed = state.guidance.closing_mm_s
    if speed is not None and abs(speed) >= bay.guidance.still_mm_s:
        return f"the truck is moving, {abs(speed):.0f} mm/s: wait until it stands"
    return ""


def _not_good(state: StateVector) -> str:
    """What is wrong with the sensors; empty: both are good and agree."""
    if state.vision.quality is not Quality.GOOD:
        return f"camera: {state.vision.quality.meaning}"
    if state.range.quality is not Quality.GOOD:
        return f"ranger: {state.range.quality.meaning}"
    if state.memory.disagree:
        return "camera and ranger contradict each other: R and Z do not fit"
    return ""
