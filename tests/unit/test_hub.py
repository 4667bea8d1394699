"""States conflate, events do not, and nothing grows."""

import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.core.events import Event, EventKind
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import StateVector
from gateway.hub import EventQueue, Hub
from tests import virtual_time
from tests.virtual_time import in_virtual_time


def state(seq: int, bay: str = "a") -> StateVector:
    return StateVector(bay=bay, seq=seq)


def event(n: int, bay: str = "a") -> Event:
    return Event(EventKind.STOP_RAISED, bay, n, state(n, bay))


def stamps(queue: EventQueue) -> list[int]:
    return [e.t_ns for e in queue.drain()]


# Readings.


def test_a_reading_reaches_the_listeners_of_its_bay_at_once_in_the_order_in_which_they_began_to_listen() -> None:
    """The control task is the first: what the pages do with a reading does not delay the decision."""
    hub, heard = Hub(["a", "b"]), list[tuple[str, object]]()
    hub.listen_to_readings("a", lambda reading: heard.append(("control", reading)))
    hub.listen_to_readings("a", lambda reading: heard.append(("pages", reading)))
    hub.listen_to_readings("b", lambda reading: heard.append(("other bay", reading)))
    distance, frame = RangeReading(1, Quality.GOOD, 900.0), VisionReading(2, Quality.NO_TARGET)
    hub.offer("a", distance)
    hub.offer("a", frame)
    assert heard == [("control", distance), ("pages", distance), ("control", frame), ("pages", frame)]


# Events.


@given(st.integers(1, 5), st.lists(st.booleans(), max_size=40))
def test_a_queue_is_bounded_and_counts_what_it_drops(limit: int, puts: list[bool]) -> None:
    """True: an event comes; False: everything is taken away. Against a plain list."""
    queue, model, dropped = EventQueue(limit), list[int](), 0
    for n, put in enumerate(puts):
        if put:
            queue.put(event(n))
            model.append(n)
            if len(model) > limit:
                model.pop(0)  # the oldest goes
                dropped += 1
        else:
            assert stamps(queue) == model
            model.clear()
        assert (len(queue), queue.dropped) == (len(model), dropped)
    assert stamps(queue) == model


def test_a_queue_of_no_room_drops_and_counts_everything() -> None:
    queue = EventQueue(0)
    for n in range(3):
        queue.put(event(n))

    assert (len(queue), queue.dropped, queue.drain()) == (0, 3, [])


@in_virtual_time
async def test_get_takes_the_oldest_and_waits_for_the_next() -> None:
    queue = EventQueue(10)
    queue.put(event(1))
    queue.put(event(2))
    found = [(await queue.get()).t_ns, (await queue.get()).t_ns]
    asyncio.get_running_loop().call_later(5.0, queue.put, event(3))
    found.append((await queue.get()).t_ns)
    assert asyncio.get_running_loop().time() == pytest.approx(1005.0)
    queue.put(event(4))
    assert stamps(queue) == [4]
    with pytest.raises(TimeoutError):  # drained: what was announced is gone again
        async with asyncio.timeout(1.0):
            await queue.get()
    assert found == [1, 2, 3]


@in_virtual_time
async def test_two_that_wait_get_one_event_each() -> None:
    queue = EventQueue(10)
    async with asyncio.TaskGroup() as group:
        waiting = [group.create_task(queue.get()) for _ in range(2)]
        await asyncio.sleep(1.0)
        queue.put(event(1))
        await asyncio.sleep(1.0)
        assert sum(task.done() for task in waiting) == 1
        queue.put(event(2))
    assert sorted(task.result().t_ns for task in waiting) == [1, 2]


@in_virtual_time
async def test_a_cancelled_wait_loses_no_event() -> None:
    queue = EventQueue(10)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(1.0):
            await queue.get()
    queue.put(event(7))
    assert (await queue.get()).t_ns == 7


def test_every_subscriber_gets_every_event_and_its_own_bound() -> None:
    hub = Hub(["a", "b"])
    roomy, tight = hub.subscribe(), hub.subscribe(limit=2)
    hub.publish(state(1), [event(1), event(2)])
    late = hub.subscribe()
    hub.publish(state(1, "b"), [event(3, "b")])
    hub.publish(state(2))

    assert (stamps(roomy), roomy.dropped) == ([1, 2, 3], 0)
    assert (stamps(tight), tight.dropped) == ([2, 3], 1)
    assert hub.dropped == 1
    assert stamps(late) == [3]


def test_a_default_queue_holds_a_thousand() -> None:
    hub = Hub(["a"])
    queue = hub.subscribe()
    hub.publish(state(1), [event(n) for n in range(1001)])

    assert (len(queue), queue.dropped) == (1000, 1)


# States.


def test_before_the_first_publish_every_bay_is_at_stop() -> None:
    hub = Hub(["a", "b"])

    assert hub.bays == ("a", "b")
    for bay in hub.bays:
        first = hub.state(bay)
        assert (first.bay, first.seq, first.stop, first.may_move, first.d) == (bay, 0, True, False, None)
        assert (first.vision.quality, first.range.quality) == (Quality.WAITING, Quality.WAITING)


def test_the_latest_state_wins_and_bays_do_not_mix() -> None:
    hub = Hub(["a", "b"])
    newest = state(2)
    hub.publish(state(1))
    hub.publish(newest)

    assert hub.state("a") is newest
    assert hub.state("b").seq == 0


def test_an_unknown_bay_is_an_error() -> None:
    hub = Hub(["a"])
    with pytest.raises(KeyError):
        hub.publish(state(1, "z"))
    with pytest.raises(KeyError):
        hub.state("z")
    assert hub.bays == ("a",)


@in_virtual_time
async def test_newer_gives_a_newer_state_at_once() -> None:
    hub = Hub(["a"])
    hub.publish(state(5))
    assert await hub.newer("a", 4) == 5


def test_newer_waits_and_skips_what_came_in_between() -> None:
    async def main() -> list[tuple[float, int]]:
        hub = Hub(["a", "b"])
        loop = asyncio.get_running_loop()

        def burst() -> None:
            for seq in (1, 2, 3):
                hub.publish(state(seq))

        loop.call_later(1.0, hub.publish, state(9, "b"))  # not our bay
        loop.call_later(2.0, hub.publish, state(0))  # not newer
        loop.call_later(3.0, burst)
        loop.call_later(4.0, hub.publish, state(4))
        found: list[tuple[float, int]] = []
        seq = 0
        while seq < 4:
            seq = await hub.newer("a", seq)
            found.append((loop.time() - 1000, seq))
        return found

    found = virtual_time.run(main())
    assert [seq for _, seq in found] == [3, 4]
    assert [at_s for at_s, _ in found] == pytest.approx([3.0, 4.0])


@in_virtual_time
async def test_all_that_wait_are_woken() -> None:
    hub = Hub(["a"])
    async with asyncio.TaskGroup() as group:
        waiting = [group.create_task(hub.newer("a", seq)) for seq in (0, 1, 0)]
        await asyncio.sleep(1.0)
        hub.publish(state(1))
        await asyncio.sleep(1.0)
        assert [task.done() for task in waiting] == [True, False, True]
        hub.publish(state(2))
    assert [task.result() for task in waiting] == [1, 2, 1]


@in_virtual_time
async def test_publishing_runs_nobody_and_waits_for_nobody() -> None:
    hub = Hub(["a"])
    async with asyncio.TaskGroup() as group:
        waiting = group.create_task(hub.newer("a", 0))
        await asyncio.sleep(0)
        hub.publish(state(1))
        assert not waiting.done()
