"""What the main process keeps of events for the pages."""

from dataclasses import replace

from gateway.core.events import Event, EventKind
from gateway.core.fusion import initial
from gateway.core.scale import ScaleSample
from gateway.core.state import FusionMemory
from gateway.hub import Hub
from gateway.processes.codec import record_packed
from gateway.web.host.request_handler import KEPT_EVENTS, EventHistory

STATE = initial("bay1", 0)
SAMPLES = tuple(ScaleSample(0, 193.25 + n, 280.5 + n, n) for n in range(20))
PAIRS = tuple((150.25 + n, 350.5 - n) for n in range(20))
REMEMBERED = FusionMemory(
    d=True, latched=True, disagree=True, restarts=3, scale_samples=SAMPLES, pairs=PAIRS, others=PAIRS, track=((1, 2.5),)
)


def test_an_event_keeps_its_state_but_not_what_grows_with_every_visit() -> None:
    hub = Hub(["bay1"])
    history = EventHistory(hub)
    event = Event(EventKind.STOP_RAISED, "bay1", 5, replace(STATE, stop=True, memory=REMEMBERED), detail="D = 1")
    hub.publish(event.state, [event])
    (kept,) = history.after(0)
    assert kept.number == 1
    assert kept.event.detail == "D = 1"
    memory = kept.event.state.memory
    assert (memory.d, memory.latched, memory.disagree, memory.restarts) == (True, True, True, 3)
    assert kept.event == replace(event, state=replace(event.state, memory=memory))
    plain = replace(
        event, state=replace(event.state, memory=replace(REMEMBERED, scale_samples=(), pairs=(), others=(), track=()))
    )
    assert len(record_packed(kept.event)) == len(record_packed(plain)) < len(record_packed(event)) - 1000


def test_the_newest_events_are_kept() -> None:
    hub = Hub(["bay1"])
    history = EventHistory(hub)
    for n in range(KEPT_EVENTS + 7):
        hub.publish(STATE, [Event(EventKind.STOP_RAISED, "bay1", n, STATE)])
    assert history.newest == KEPT_EVENTS + 7
    numbers = [kept.number for kept in history.after(KEPT_EVENTS + 5)]
    assert numbers == [KEPT_EVENTS + 6, KEPT_EVENTS + 7]
    assert history.after(0)[0].number == 8
