"""A frame that was held back on its way is as old as it is, not as old as its arrival."""

import math
import random
from collections.abc import Iterable

import pytest

from gateway.core.readings import AgeProof
from gateway.errors import LinkError
from gateway.vision.source.frame_time import (
    ArrivalTime,
    BufferTime,
    LatchedTime,
    PresentationTime,
    SynchronisedTime,
)
from tests.virtual_time import LoopClock

MS = 1_000_000
S = 1000 * MS
FRAME = 40 * MS
ZERO = 77 * S  # of the source's clock, in the gateway's time: nobody knows it


def delays(delays_ns: Iterable[int], *, drift: float = 0.0, first: int = 0) -> list[tuple[int, float]]:
    """(arrival, stamp in ms) of one frame every 40 ms, taken when the source says, and this long on its way."""
    frames, last = [], 0
    for n, delay_ns in enumerate(delays_ns, first):
        taken = n * FRAME
        last = max(last, ZERO + taken + delay_ns)  # frames do not overtake each other
        frames.append((last, taken * (1 - drift) / MS))
    return frames


def ages_ns(time: PresentationTime, frames: list[tuple[int, float]]) -> list[int]:
    return [arrival - time.taken_ns(arrival, stamp) for arrival, stamp in frames]


def test_by_arrival_a_frame_is_as_new_as_it_arrives() -> None:
    assert ArrivalTime().taken_ns(5 * S, 1234.5) == 5 * S


def test_on_a_steady_way_a_frame_is_new_when_it_arrives() -> None:
    assert ages_ns(PresentationTime(), delays([30 * MS] * 500)) == [0] * 500


@pytest.mark.failure_mode("C8")
def test_a_burst_after_a_stall_has_the_age_that_it_has() -> None:
    """1 s without a frame, then 25 at once: each as old as it was held back, and afterwards all is as before."""
    frames = delays([0] * 50 + [S - n * FRAME for n in range(25)] + [0] * 50)
    assert [arrival for arrival, _ in frames[50:75]] == [frames[50][0]] * 25
    assert ages_ns(PresentationTime(), frames) == [0] * 50 + [S - n * FRAME for n in range(25)] + [0] * 50


@pytest.mark.failure_mode("C8")
def test_a_growing_backlog_is_seen_to_the_millisecond_and_never_forgiven() -> None:
    """A link that carries nine tenths of the stream: 5.4 s late after 54 s; then it stays so for an hour."""
    growing = [n * FRAME // 10 for n in range(1350)]
    frames = delays(growing + [growing[-1]] * 90_000)
    ages = ages_ns(PresentationTime(), frames)
    assert ages[:1350] == growing
    assert ages[1349] == pytest.approx(5.4 * S, rel=0.01)
    assert min(ages[1350:]) == growing[-1]


def test_a_start_in_the_middle_of_a_backlog_is_measured_from_its_fastest_frame() -> None:
    frames = delays([2 * S - n * FRAME for n in range(50)] + [0] * 50 + [500 * MS] * 50)
    ages = ages_ns(PresentationTime(), frames)
    assert ages[50:] == [0] * 50 + [500 * MS] * 50


@pytest.mark.parametrize("drift", [-300e-6, -50e-6, 50e-6, 300e-6])
def test_clocks_that_drift_make_no_frame_old(drift: float) -> None:
    chance = random.Random(3)
    frames = delays([int(chance.expovariate(1 / (4 * MS))) for _ in range(90_000)], drift=drift)  # an hour
    ages = ages_ns(PresentationTime(), frames)
    assert max(ages) < 100 * MS


@pytest.mark.parametrize("late_ns", [200 * MS, 900 * MS])
def test_a_standing_delay_is_not_taken_for_drift_whatever_the_jitter(late_ns: int) -> None:
    chance = random.Random(4)
    jitter = [int(chance.expovariate(1 / (10 * MS))) for _ in range(90_000)]
    frames = delays([*jitter[:1000], *(late_ns + more for more in jitter[1000:])])
    ages = ages_ns(PresentationTime(), frames)
    assert min(ages[1000:]) > late_ns - 30 * MS


@pytest.mark.parametrize("jump_ns", [-70 * S, -5 * S, 30 * S, 10_000 * S])
@pytest.mark.parametrize("late_ns", [0, 300 * MS])
def test_a_clock_that_is_set_or_a_film_that_begins_again_keeps_the_delay(jump_ns: int, late_ns: int) -> None:
    frames = delays([0] * 100 + [late_ns] * 100)
    after = [(arrival, stamp + jump_ns / MS) for arrival, stamp in delays([late_ns] * 100, first=200)]
    time = PresentationTime()
    assert ages_ns(time, frames) == [0] * 100 + [late_ns] * 100
    assert ages_ns(time, after) == [late_ns] * 100
    more = [(arrival, stamp + jump_ns / MS) for arrival, stamp in delays([late_ns + 200 * MS] * 10, first=300)]
    assert ages_ns(time, more) == [late_ns + 200 * MS] * 10


@pytest.mark.parametrize("stamp", [0.0, 5.0, math.nan, math.inf])
def test_a_source_without_usable_stamps_is_timed_by_arrival(stamp: float) -> None:
    time = PresentationTime()
    assert [time.taken_ns(n * S, stamp) for n in range(100)] == [n * S for n in range(100)]


def test_no_frame_is_from_the_future() -> None:
    chance, time, arrival = random.Random(9), PresentationTime(), 0
    for _ in range(5000):
        arrival += chance.randrange(100 * MS)
        assert time.taken_ns(arrival, chance.uniform(-1e5, 1e5)) <= arrival


def test_a_buffer_stamped_with_our_own_clock_is_that_old() -> None:
    time = BufferTime(lambda: 0)
    for n, held_ns in enumerate([4 * MS, 4 * MS, 700 * MS, 660 * MS, 2 * S]):
        arrival = 1000 * S + n * FRAME
        assert time.taken_ns(arrival, (arrival - held_ns) / MS) == pytest.approx(arrival - held_ns, abs=1000)


def test_a_buffer_s_stamp_leaves_out_the_time_that_the_machine_was_suspended() -> None:
    behind_ns = 0
    time = BufferTime(lambda: behind_ns)
    for behind_ns in (0, 3 * S, 7000 * S):
        arrival = 1000 * S + behind_ns
        assert time.taken_ns(arrival, (arrival - behind_ns - 4 * MS) / MS) == pytest.approx(arrival - 4 * MS, abs=1000)


@pytest.mark.parametrize("epoch_ns", [-1_700_000_000 * S, 500 * S])
def test_a_buffer_stamped_with_another_clock_is_timed_by_its_fastest(epoch_ns: int) -> None:
    time = BufferTime(lambda: 0)
    frames = delays([0] * 50 + [S - n * FRAME for n in range(25)])
    ages = [arrival - time.taken_ns(arrival, stamp - epoch_ns / MS) for arrival, stamp in frames]
    assert ages == pytest.approx([0] * 50 + [S - n * FRAME for n in range(25)], abs=2000)


def test_a_driver_without_stamps_is_timed_by_arrival() -> None:
    time = BufferTime(lambda: 0)
    assert [time.taken_ns(n * S, 0.0) for n in range(1, 9)] == [n * S for n in range(1, 9)]


def proofs(time: PresentationTime, frames: list[tuple[int, float]]) -> list[bool]:
    """Of each frame: is its age proven?"""
    return [(time.taken_ns(arrival, stamp), time.proof is not AgeProof.UNPROVEN)[1] for arrival, stamp in frames]


@pytest.mark.failure_mode("C11")
def test_an_age_is_proven_once_no_frame_has_been_faster_for_five_seconds() -> None:
    """A backlog that waited for the opening is sent in half the time: until it is gone, each frame is the fastest."""
    at_once = proofs(PresentationTime(), delays([30 * MS] * 160))
    assert at_once == [False] * 125 + [True] * 35
    drained = proofs(PresentationTime(), delays([2 * S - n * FRAME // 2 for n in range(100)] + [0] * 160))
    assert drained == [False] * 225 + [True] * 35


@pytest.mark.failure_mode("C11")
@pytest.mark.parametrize("rate", [0.01, 0.002])
def test_a_backlog_that_drains_slowly_is_never_proven(rate: float) -> None:
    assert not any(proofs(PresentationTime(), delays([3 * S - int(n * FRAME * rate) for n in range(3000)])))


@pytest.mark.failure_mode("C11")
@pytest.mark.parametrize("later_ns", [-3000 * MS, -900 * MS, -25 * MS])
def test_a_proof_is_withdrawn_by_a_frame_that_shows_those_before_it_to_have_been_older(later_ns: int) -> None:
    """A full link drains at last, or a server drops its queue. 3 s at once looks like a clock that was set."""
    found = proofs(PresentationTime(), delays([3 * S] * 200 + [3 * S + later_ns] * 200))
    newest = 200 - later_ns // FRAME  # what the server dropped does not arrive: the rest come at once
    assert found[:200] == [False] * 125 + [True] * 75
    assert not any(found[201 : newest + 120])
    assert found[-1]


@pytest.mark.failure_mode("C11")
@pytest.mark.parametrize("again_ns", [0, -15 * MS])
def test_a_stamp_that_comes_twice_forgives_no_backlog(again_ns: int) -> None:
    """Each is sent again, a little later: of a link that is too slow from the tenth second on."""
    time = PresentationTime()
    worst_ns = 0
    for n in range(1000):
        stamp_ns = 40 * MS * n
        late_ns = 50 * MS + max(0, stamp_ns - 10_000 * MS) // 4
        for sent_ns, behind_ns in ((stamp_ns, 0), (stamp_ns + again_ns, 20 * MS)):
            arrival_ns = ZERO + stamp_ns + late_ns + behind_ns
            found_ns = time.taken_ns(arrival_ns, (50_000 * MS + sent_ns) / MS)
            if time.proof is AgeProof.PRESENTATION_TIME:
                worst_ns = max(worst_ns, found_ns - (ZERO + stamp_ns))
    assert worst_ns <= 70 * MS


@pytest.mark.failure_mode("C11")
def test_a_clock_that_is_set_withdraws_the_proof() -> None:
    for jump_ms in (-70_000, 3000, 30_000):
        time = PresentationTime()
        assert proofs(time, delays([0] * 130))[-1]
        after = [(arrival, stamp + jump_ms) for arrival, stamp in delays([0] * 130, first=130)]
        assert proofs(time, after) == [False] * 125 + [True] * 5


@pytest.mark.parametrize("jitter_ms", [5, 30])
@pytest.mark.parametrize("fps", [10, 25, 60])
def test_jitter_neither_hinders_the_proof_nor_withdraws_it(fps: int, jitter_ms: int) -> None:
    chance, time, last = random.Random(fps), PresentationTime(), 0
    found = []
    for n in range(120 * fps):
        taken = n * S // fps
        last = max(last, ZERO + taken + int(chance.expovariate(1 / (jitter_ms * MS))))
        found.append((time.taken_ns(last, taken / MS), time.proof)[1])
    assert set(found[15 * fps :]) == {AgeProof.PRESENTATION_TIME}


@pytest.mark.failure_mode("C11")
def test_stamps_that_stand_still_prove_nothing() -> None:
    time = PresentationTime()
    assert not any(proofs(time, [(ZERO + n * FRAME, 40.0) for n in range(100)]))
    time = PresentationTime()
    assert proofs(time, delays([0] * 160))[-1]
    stuck = [(ZERO + n * FRAME, 159 * 40.0) for n in range(160, 220)]
    assert proofs(time, stuck).index(False) == 24  # 1 s after they last went on


def test_a_buffer_proves_its_age_and_a_driver_without_stamps_does_not() -> None:
    time = BufferTime(lambda: 0)
    stamps = [(100 * S, 99_990.0), *((200 * S + n * FRAME, 0.0) for n in range(100))]
    found = [(time.taken_ns(arrival, stamp), time.proof)[1] for arrival, stamp in stamps]
    assert found == [AgeProof.BUFFER_TIME] + [AgeProof.UNPROVEN] * 100
    assert ArrivalTime.proof is AgeProof.UNPROVEN


class CameraClock:
    """250 s ahead of ours. A call takes 2 ms; the second one 40 ms, of which 39 are on the way back."""

    def __init__(self) -> None:
        self.now_ns = 10 * S
        self.calls = 0
        self.readable = True

    def now(self) -> int:
        return self.now_ns

    def latch(self) -> int | None:
        self.calls += 1
        self.now_ns += 1 * MS
        value_ns = self.now_ns + 250 * S
        self.now_ns += 39 * MS if self.calls == 2 else 1 * MS
        return value_ns if self.readable else None


def test_a_delay_from_the_opening_on_is_seen_where_the_cameras_clock_can_be_read() -> None:
    camera = CameraClock()
    stamps = LatchedTime(camera.latch, camera.now)
    for n in range(30):
        arrival_ns = 20 * S + n * S
        camera.now_ns = arrival_ns
        taken_ns = arrival_ns - (80 + 5 * (n % 2)) * MS
        assert stamps.taken_ns(arrival_ns, (taken_ns + 250 * S) / MS) == pytest.approx(taken_ns, abs=1000)
        assert stamps.proof is AgeProof.DEVICE_TIME
    assert camera.calls == 9  # three at the first frame, and every 10 s


def test_a_camera_without_stamps_proves_nothing_even_while_its_clock_is_near_zero() -> None:
    camera = CameraClock()
    stamps = LatchedTime(lambda: camera.now_ns - 20 * S, camera.now)
    for n in range(200):
        arrival_ns = camera.now_ns = 20 * S + n * FRAME
        assert stamps.taken_ns(arrival_ns, 0.0) == arrival_ns
        assert stamps.proof is AgeProof.UNPROVEN


def test_a_clock_that_cant_be_read_or_is_not_that_of_the_stamps_changes_nothing() -> None:
    for readable, ahead_s in ((False, 250), (True, 3), (True, 300)):
        camera = CameraClock()
        camera.readable = readable
        stamps, plain = LatchedTime(camera.latch, camera.now), PresentationTime()
        for n in range(40):
            arrival_ns = 20 * S + 100 * MS * n
            stamp_ms = (arrival_ns + ahead_s * S - 7 * (n % 3) * MS) / MS
            assert stamps.taken_ns(arrival_ns, stamp_ms) == plain.taken_ns(arrival_ns, stamp_ms)
            assert stamps.proof is plain.proof


class WallClock(LoopClock):
    """At the arrival of a frame: the gateway's clock, and its wall clock, which is `ahead_ns` of it."""

    def __init__(self) -> None:
        self.now = 0
        self.ahead_ns = 1_700_000_000 * S

    def now_ns(self) -> int:
        return self.now

    def wall_ns(self) -> int:
        return self.now + self.ahead_ns


def synchronised(
    frames: list[tuple[int, float]], clock: WallClock, camera_ahead_ns: int = 0, known_from: int = 75
) -> Iterable[tuple[int, AgeProof]]:
    """Age and proof of each frame. The camera states its clock from the 75th frame on, as it was then."""
    unix_ms = math.nan
    time = SynchronisedTime(lambda: unix_ms, clock, "rtsp://cam/1")
    for n, (clock.now, stamp) in enumerate(frames):
        if n == known_from:
            unix_ms = (ZERO + n * FRAME + clock.ahead_ns + camera_ahead_ns) / MS - stamp
        yield clock.now - time.taken_ns(clock.now, stamp), time.proof


@pytest.mark.failure_mode("C8")
@pytest.mark.parametrize("drift", [-300e-6, -50e-6, 0.0, 50e-6, 300e-6])
def test_two_clocks_set_by_ntp_show_a_constant_delay_however_the_stamps_drift(drift: float) -> None:
    """An hour at 300 ms, then 200 ms more. Before it is known, the delay is not seen, and nothing proven."""
    told = list(synchronised(delays([300 * MS] * 90_000 + [500 * MS] * 100, drift=drift), WallClock()))
    assert {proof for _, proof in told[:125]} == {AgeProof.UNPROVEN}
    assert {proof for _, proof in told[130:]} == {AgeProof.DEVICE_TIME}
    assert min(age for age, _ in told[75:]) + MS >= 300 * MS
    assert max(age for age, _ in told[75:90_000]) < 330 * MS
    assert min(age for age, _ in told[90_000:]) + MS >= 500 * MS


@pytest.mark.parametrize(
    ("camera_ahead_ns", "known_from", "words"),
    [
        (400 * MS, 75, "its clock is 0.1 s ahead of the gateway's"),
        (-11 * S, 75, "its clock is 11.3 s behind the gateway's"),
        (3600 * S, 130, "its clock is 3599.7 s ahead of the gateway's"),
        (0, 10_000, "it does not state its clock: no RTCP sender report, no Unix time"),
    ],
)
def test_a_wrong_clock_proves_nothing_and_is_told_once(
    camera_ahead_ns: int, known_from: int, words: str, caplog: pytest.LogCaptureFixture
) -> None:
    told: list[tuple[int, AgeProof]] = []
    frames = delays([300 * MS] * 2000)
    if known_from < 2000:
        with pytest.raises(LinkError, match=f"^rtsp://cam/1: {words}$"):
            told.extend(synchronised(frames, WallClock(), camera_ahead_ns, known_from))
    else:
        told.extend(synchronised(frames, WallClock(), camera_ahead_ns, known_from))
    assert {proof for _, proof in told} <= {AgeProof.UNPROVEN}
    assert [words in record.getMessage() for record in caplog.records] == [True]


def test_a_gateway_s_wall_clock_that_is_set_is_followed() -> None:
    """2 s ahead until the 500th frame."""
    clock = WallClock()
    true_ns, clock.ahead_ns = clock.ahead_ns, clock.ahead_ns + 2 * S
    ages = []
    for n, (age, _) in enumerate(synchronised(delays([300 * MS] * 1000), clock, -2 * S)):
        ages.append(age)
        clock.ahead_ns = true_ns if n >= 500 else clock.ahead_ns
    assert ages[499] == pytest.approx(2300 * MS, abs=2 * MS)
    assert ages[999] == pytest.approx(300 * MS, abs=2 * MS)
