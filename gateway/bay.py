"""One bay's control task: a thin shell that feeds fusion, publishes each state whole, and never waits for anyone."""

import logging
from collections.abc import Callable

from gateway import events, fusion
from gateway.clock import NS_PER_S, Clock
from gateway.config import BayConfig
from gateway.hub import Hub
from gateway.model import Event, EventKind, RangeReading, Reason, StateVector, Tick, VisionReading

log = logging.getLogger(__name__)

DEAD_AFTER_PERIODS = 2  # fewer than the usual ten: this is the last line, and slow ticks must not stretch it
DEAD_AFTER_MIN_S = 0.25  # a busy machine may hold the event loop for a moment


class BayControl:
    """Observations in, states out. All methods run on the event loop and return at once."""

    def __init__(
        self, config: BayConfig, hub: Hub, clock: Clock, mirrors: tuple[Callable[[StateVector], None], ...] = ()
    ) -> None:
        self.name = config.name
        self._config = config.fusion
        self._hub = hub
        self._clock = clock
        self._mirrors = mirrors
        self._over = False
        self._dead_after_ns = int(max(DEAD_AFTER_MIN_S, DEAD_AFTER_PERIODS * config.fusion.period_s) * NS_PER_S)
        state = fusion.initial(self.name, clock.now_ns())
        self._publish(state, [Event(EventKind.START, self.name, state.t_ns, state)])

    def on_vision(self, reading: VisionReading) -> None:
        self._step(reading)

    def on_range(self, reading: RangeReading) -> None:
        self._step(reading)

    async def run(self) -> None:
        """Tick for ever: ages grow, the heartbeat counts."""
        period_ns = round(self._config.period_s * NS_PER_S)
        due_ns = self._clock.now_ns()
        while True:
            self._step(Tick())
            now_ns = self._clock.now_ns()
            due_ns = max(due_ns + period_ns, now_ns - period_ns)  # keeps its pace; what was missed is not made up for
            await self._clock.sleep(max(0, due_ns - now_ns) / NS_PER_S)

    def state(self) -> StateVector:
        """The state as it may be shown to a PLC now: if fusion has stopped running, stop is on and no value stands."""
        state = self._hub.state(self.name)
        now_ns = self._clock.now_ns()
        if self._over or now_ns - state.t_ns <= self._dead_after_ns:
            return state
        return fusion.forced_stop(state, Reason.GATEWAY_FAULT, now_ns)

    def shut_down(self) -> None:
        """The last word: stop on, no values, and no observation changes it any more."""
        if self._over:
            return
        self._over = True
        old = self._hub.state(self.name)
        new = fusion.forced_stop(old, Reason.SHUTDOWN, self._clock.now_ns())
        stop_raised = [event for event in events.diff(old, new) if event.kind is EventKind.STOP_RAISED]
        self._publish(new, [*stop_raised, Event(EventKind.SHUTDOWN, self.name, new.t_ns, new)])

    def _step(self, observation: fusion.Observation) -> None:
        if self._over:
            return
        old = self._hub.state(self.name)
        new = fusion.step(old, observation, self._clock.now_ns(), self._config)
        self._publish(new, events.diff(old, new))

    def _publish(self, state: StateVector, happened: list[Event]) -> None:
        self._hub.publish(state, happened)
        for mirror in self._mirrors:
            mirror(state)
        for event in happened:
            log.info(
                "%s: %s%s%s",
                self.name,
                event.kind.value.replace("_", " "),
                f" ({event.sensor} {event.quality.name.lower()})" if event.sensor else "",
                f": {event.detail}" if event.detail else f", reason {state.reason.name.lower()}",
            )
