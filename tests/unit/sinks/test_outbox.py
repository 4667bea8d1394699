"""The outbox against a plain list that does the same slowly."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.sinks.outbox.outbox import MemoryOutbox, OutboxEntry, OutboxLimits


def entry(number: int, *, drop_last: bool = False) -> OutboxEntry:
    return OutboxEntry(f"b-{number}", "loading/s/bay1/event", str(number).encode(), drop_last)


def ids(outbox: MemoryOutbox) -> list[str]:
    """Delivers everything."""
    found = []
    while oldest := next(iter(outbox.batch(1)), None):
        found.append(oldest.id)
        outbox.acknowledge(oldest.id)
    return found


def test_an_entry_stays_until_it_is_acknowledged() -> None:
    outbox = MemoryOutbox(OutboxLimits(10))
    outbox.put(entry(1))
    assert outbox.batch(1) == outbox.batch(1) == [entry(1)]
    assert len(outbox) == 1
    outbox.acknowledge("b-1")
    assert outbox.batch(1) == []
    assert len(outbox) == 0


@pytest.mark.parametrize(
    ("limit", "drop_last", "kept"),
    [
        (10, (2, 3, 6), [1, 2, 3, 4, 5, 6, 7]),  # in order across kinds
        (3, (1, 3, 5, 6, 7), [5, 6, 7]),  # the oldest common entries go first, then the oldest of all
        (4, (1, 3, 5, 7), [1, 3, 5, 7]),
        (2, (1, 2), [1, 2]),  # full of others, a common one is not taken
    ],
)
def test_when_full_common_entries_are_dropped_before_the_others(
    limit: int, drop_last: tuple[int, ...], kept: list[int]
) -> None:
    outbox = MemoryOutbox(OutboxLimits(limit))
    for number in range(1, 8):
        outbox.put(entry(number, drop_last=number in drop_last))
    outbox.acknowledge("b-0")  # of one that was dropped on its way
    assert outbox.dropped == 7 - len(kept)
    assert ids(outbox) == [f"b-{number}" for number in kept]


def test_room_for_nothing_is_no_outbox() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        MemoryOutbox(OutboxLimits(0))


MOVES = st.sampled_from(["common", "drop_last", "acknowledge", "acknowledge another", "late", "unused", "used"])


@given(
    limit=st.integers(1, 6),
    moves=st.lists(st.tuples(MOVES, st.integers(0, 2), st.integers(0, 5)), max_size=60),
    without=st.sets(st.sampled_from(["t0", "t1", "t2"])),
)
def test_it_behaves_like_a_slow_list(limit: int, moves: list[tuple[str, int, int]], without: set[str]) -> None:
    outbox = MemoryOutbox(OutboxLimits(limit))
    model: list[OutboxEntry] = []
    unused: set[str] = set()
    dropped = [0, 0]
    for number, (move, topic, place) in enumerate(moves):
        if move == "acknowledge" and model:
            outbox.acknowledge(model.pop(0).id)
        elif move == "acknowledge another" and model:
            outbox.acknowledge(model.pop(place % len(model)).id)
        elif move == "late":
            outbox.acknowledge("b-none")
        elif move in ("unused", "used"):
            outbox.set_unused(f"t{topic}", move == "unused")
            (unused.add if move == "unused" else unused.discard)(f"t{topic}")
        elif move in ("common", "drop_last"):
            new = replace(entry(number, drop_last=move == "drop_last"), topic=f"t{topic}")
            outbox.put(new)
            model.append(new)
            if len(model) > limit:
                choices = [[e for e in model if e.topic in unused], [e for e in model if not e.drop_last], model]
                gone = next(found for found in choices if found)[0]
                model.remove(gone)
                dropped[gone.topic in unused] += 1
        assert outbox.batch(1) == model[:1]
        assert (len(outbox), outbox.dropped, outbox.unused_dropped) == (len(model), *dropped)
        assert outbox.batch(3, without) == [e for e in model if e.topic not in without][:3]
        assert outbox.count(without) == sum(e.topic in without for e in model)
    assert outbox.waiting() == model
    assert ids(outbox) == [e.id for e in model]


def test_size_and_age_drop_the_oldest_common_entries_first() -> None:
    day_ms = 86_400_000
    outbox = MemoryOutbox(OutboxLimits(100, size_bytes=4 * entry(1).size, age_ms=2 * day_ms))
    now_ms = 1_795_000_000_000
    for number in range(1, 6):
        gone = outbox.put(replace(entry(number, drop_last=number == 1), unix_ms=now_ms))
    assert [e.id for e in gone] == ["b-2"]
    assert outbox.dropped == 1
    gone = outbox.put(replace(entry(6), unix_ms=now_ms + 2 * day_ms + 1))
    assert sorted(e.id for e in gone) == ["b-1", "b-3", "b-4", "b-5"]
    assert ids(outbox) == ["b-6"]


def test_a_clock_that_was_not_set_makes_nothing_old() -> None:
    outbox = MemoryOutbox(OutboxLimits(100, age_ms=1000))
    outbox.put(replace(entry(1), unix_ms=5000))  # 1970
    outbox.put(replace(entry(2), unix_ms=1_795_000_000_000))
    assert ids(outbox) == ["b-1", "b-2"]


def test_one_entry_larger_than_all_room_is_kept() -> None:
    outbox = MemoryOutbox(OutboxLimits(100, size_bytes=1))
    outbox.put(entry(1))
    assert [e.id for e in outbox.put(entry(2))] == ["b-1"]
    assert ids(outbox) == ["b-2"]


def test_one_outbox_after_another_keeps_order_limit_and_counts() -> None:
    first, second = MemoryOutbox(OutboxLimits(3)), MemoryOutbox(OutboxLimits(3))
    for number in (1, 2, 3, 4):
        first.put(entry(number))
    for number in (5, 6, 7, 8):
        second.put(entry(number))

    lost = first.append(second)

    assert [e.id for e in lost] == ["b-2", "b-3", "b-4"]
    assert [e.id for e in first.waiting()] == ["b-6", "b-7", "b-8"]
    assert first.dropped == 1 + 1 + 3
    third = MemoryOutbox(OutboxLimits(3))
    first.set_unused("loading/s/bay1/event", True)
    third.append(first)
    assert [e.id for e in third.put(replace(entry(9), topic="used"))] == ["b-6"]
    assert (third.dropped, third.unused_dropped) == (5, 1)  # unused there, unused here


def test_what_nobody_has_a_use_for_expires_a_topic_at_a_time() -> None:
    outbox = MemoryOutbox(OutboxLimits(100))
    now_ms = 1_795_000_000_000
    outbox.set_unused("t0", True)
    for number in range(6):
        outbox.put(replace(entry(number), topic=f"t{number % 2}", unix_ms=now_ms + 1000 * number))
    outbox.put(replace(entry(6), topic="t0", unix_ms=5000))  # of a clock that was not set

    assert outbox.expire("t0", 1000, now_ms + 3001, limit=1) == [replace(entry(0), topic="t0", unix_ms=now_ms)]
    assert [e.id for e in outbox.expire("t0", 1000, now_ms + 3001, limit=10)] == ["b-2"]
    assert outbox.expire("t0", 1000, now_ms + 3001, limit=10) == []
    assert outbox.expire("t2", 1000, now_ms + 3001, limit=10) == []
    assert (outbox.dropped, outbox.unused_dropped) == (0, 2)
    assert ids(outbox) == ["b-1", "b-3", "b-4", "b-5", "b-6"]
