"""Who looks at which frame, who has failed, what is told: with plain numbers instead of processes and clocks."""

import random
from collections.abc import Sequence
from dataclasses import replace

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from gateway.config import CameraConfig, Reconnect, VisionConfig
from gateway.core.model import Circle, Detection, PictureFault, PictureHealth, Quality, VisionReading
from gateway.vision.process.actions import Action, Assign, Emit, GiveUp, Kill, Offer, Return, StartCamera, StartWorker
from gateway.vision.process.dispatcher import Dispatcher
from gateway.vision.process.process_slot import Phase
from gateway.vision.transport.messages import FrameRef

MS = 1_000_000
SEEN = Detection(Circle(10.0, 20.0, 30.0), x_n=0.1, y_n=0.2, stage_ns=(("hsv", 7), ("circle", 3)))
EMPTY = Detection(None, stage_ns=(("hsv", 5),))


class Bench:
    """A dispatcher whose processes are played by the test. `do` keeps what is to be done; time is `self.ms`."""

    def __init__(self, workers: int = 1, *, lossless: bool = False, first_ms: int = 1000) -> None:
        self.ms = first_ms
        self.dispatcher = Dispatcher(
            "cam",
            CameraConfig(deadline_s=1.0, open_deadline_s=10.0, reconnect=Reconnect(min_s=0.25, max_s=5.0)),
            VisionConfig(workers=workers, deadline_s=0.5),
            slots=workers + 2,
            rng=random.Random(1),
        )
        self.lossless = lossless
        self.camera = 0
        self.free: set[int] = set()
        self.seq = 0
        self.generation = 0
        self.workers: list[int] = []  # tokens running
        self.work: dict[int, FrameRef] = {}
        self.offers: list[int] = []  # workers that the camera may hand its next frame to
        self.notes: list[tuple[int, FrameRef, int, int]] = []  # of the camera, not reported yet
        self.inbox: dict[int, list[FrameRef]] = {}  # handed over straight
        self.told: list[VisionReading] = []
        self.killed: dict[int, str] = {}
        self.given_up: list[str] = []
        self.settle()

    @property
    def ns(self) -> int:
        return self.ms * MS

    def settle(self, after_ms: int = 0) -> list[Action]:
        self.ms += after_ms
        actions = self.dispatcher.settle(self.ns)
        for action in actions:
            self.carry_out(action)
        return actions

    def carry_out(self, action: Action) -> None:
        match action:
            case StartCamera(token, first_seq, slots):
                self.camera, self.free, self.seq, self.offers = token, set(slots), first_seq, []
            case StartWorker(token):
                self.workers.append(token)
            case Assign(token, frame):
                assert token not in self.work, "given a second frame while it has one"
                self.work[token] = frame
            case Return(token, slot):
                if token == self.camera:
                    assert slot not in self.free, "given back twice"
                    self.free.add(slot)
            case Offer(token, worker):
                assert token == self.camera, "offered to a camera that is no more"
                assert worker not in self.offers, "offered twice"
                assert worker not in self.work, "offered while it has a frame"
                self.offers.append(worker)
            case Kill(token, why):
                self.killed[token] = why
                self.work.pop(token, None)
                self.inbox.pop(token, None)
            case Emit(reading):
                self.told.append(reading)
            case GiveUp(why):
                self.given_up.append(why)

    def open(self) -> None:
        self.dispatcher.opened(self.camera, self.lossless)

    def ready(self, *tokens: int) -> None:
        for token in tokens or tuple(self.workers):
            self.dispatcher.ready(token)
        self.settle()

    def capture(self, *, skipped: int = 0) -> FrameRef:
        """A frame comes, captured 2 ms ago; nothing is settled yet."""
        frame = self._new_frame()
        self.dispatcher.captured(self.camera, frame, skipped, self.ns)
        return frame

    def _new_frame(self) -> FrameRef:
        slot = min(self.free)
        self.free.remove(slot)
        self.generation += 2
        frame = FrameRef(slot, self.generation, self.seq, self.ns - 2 * MS)
        self.seq += 1
        return frame

    def frame(self) -> FrameRef:
        frame = self.capture()
        self.settle()
        return frame

    def hand(self, *, to: int | None = None) -> FrameRef:
        """A frame comes and goes straight to a worker; the camera notes it, and nobody has read the note yet."""
        worker = self.offers[0] if to is None else to
        self.offers.remove(worker)
        frame = self._new_frame()
        self.notes.append((self.camera, frame, worker, self.ns))
        self.inbox.setdefault(worker, []).append(frame)
        return frame

    def hear(self) -> None:
        """The camera's notes are reported; nothing is settled yet."""
        for camera, frame, worker, then_ns in self.notes:
            self.dispatcher.handed(camera, frame, 0, worker, then_ns, self.ns)
        self.notes.clear()

    def look(self, token: int, detection: Detection | None = SEEN) -> None:
        frame = self.work.pop(token) if token in self.work else self.inbox[token].pop(0)
        self.hear()
        self.dispatcher.looked(token, frame.seq, detection, self.ns)
        self.settle()

    def die(self, token: int, how: str = "was killed by SIGKILL") -> None:
        self.work.pop(token, None)
        self.inbox.pop(token, None)
        self.hear()
        self.killed.setdefault(token, how)
        if token in self.workers:
            self.workers.remove(token)
        self.dispatcher.gone(token, how, self.ns)
        self.settle()

    def seqs(self) -> list[int]:
        return [reading.frame_id for reading in self.told]

    def qualities(self) -> list[Quality]:
        return [reading.quality for reading in self.told]


def running(workers: int = 1, *, lossless: bool = False) -> Bench:
    bench = Bench(workers, lossless=lossless)
    bench.open()
    bench.ready()
    return bench


def kinds(actions: Sequence[Action]) -> list[str]:
    return [type(action).__name__ for action in actions]


# The straight road.


def test_starts_one_camera_and_all_workers_with_every_slot_free() -> None:
    bench = Bench(workers=3, first_ms=0)

    assert (0, {0, 1, 2, 3, 4}) == (len(bench.told), bench.free)
    assert (len(bench.workers), bench.seq) == (3, 1)
    assert len({bench.camera, *bench.workers}) == 4


def test_a_frame_becomes_a_reading_with_its_capture_time_and_age() -> None:
    bench = running()
    frame = bench.frame()
    (worker,) = bench.workers
    assert frame == bench.work[worker]
    bench.ms += 5

    bench.look(worker)

    (reading,) = bench.told
    assert (frame.t_capture_ns, Quality.GOOD, 1) == (reading.t_ns, reading.quality, reading.frame_id)
    assert (Circle(10.0, 20.0, 30.0), 0.1, 0.2) == (reading.circle, reading.x_n, reading.y_n)
    assert reading.stage_ns == (("hsv", 7), ("circle", 3))
    assert (
        reading.stats.frames,
        reading.stats.skipped,
        reading.stats.lost,
        reading.stats.latency_ms,
        reading.stats.rate_hz,
    ) == (1, 0, 0, 7.0, 1.0)
    assert {0, 1, 2} == bench.free


def test_what_has_stood_in_the_picture_unchanged_is_as_old_as_its_first_sight() -> None:
    bench = running()
    first = bench.frame()
    bench.ms += 40
    for seen_ns in (first.t_capture_ns, bench.ns + 99 * MS):  # never newer than its frame
        frame = bench.frame() if bench.told else first
        del bench.work[bench.workers[0]]
        bench.dispatcher.looked(bench.workers[0], frame.seq, SEEN, bench.ns, seen_ns)
        bench.settle()
        assert bench.told[-1].t_ns == min(seen_ns, frame.t_capture_ns)
    assert bench.qualities() == [Quality.GOOD] * 2


def test_the_health_of_the_picture_is_judged_here_and_told_with_every_result_while_it_is_new() -> None:
    bench = running()
    dark = PictureHealth(0.01, 0.0, 0.0, None, None, None)

    def look(picture: PictureHealth | None, after_ms: int) -> VisionReading:
        bench.ms += after_ms
        worker = bench.workers[0]
        frame = bench.frame() if not bench.work else bench.work[worker]
        bench.work.pop(worker)
        bench.dispatcher.looked(worker, frame.seq, EMPTY, bench.ns, frame.t_capture_ns, picture)
        bench.settle()
        return bench.told[-1]

    assert look(None, 0).picture is None
    for _ in range(11):
        seen = look(dark, 500)
        assert seen.picture is not None
    assert seen.picture == replace(dark, status=1 << PictureFault.DARK)  # for 5 s
    assert look(None, 900).picture == seen.picture
    assert look(None, 2100).picture == seen.picture
    assert look(None, 100).picture is None
    assert look(dark, 100).picture is not None
    bench.dispatcher.failed(bench.camera, "lost", bench.ns)
    bench.settle()
    assert (bench.told[-1].quality, bench.told[-1].picture) == (Quality.LINK_DOWN, None)


def test_a_frame_without_a_marker_is_no_target_not_a_fault() -> None:
    bench = running()
    bench.frame()
    bench.look(bench.workers[0], EMPTY)

    assert bench.qualities() == [Quality.NO_TARGET]
    assert bench.told[0].circle is None
    assert bench.told[0].stage_ns == (("hsv", 5),)


def test_a_disc_of_the_wrong_size_is_told_with_the_frame() -> None:
    bench = Bench()
    bench.open()
    bench.ready()
    bench.frame()
    bench.look(bench.workers[0], Detection(None, wrong_size=Circle(10.0, 20.0, 30.0)))
    assert bench.told[-1].quality is Quality.NO_TARGET
    assert bench.told[-1].wrong_size == Circle(10.0, 20.0, 30.0)


def test_only_those_that_read_their_messages_are_sent_any_that_can_wait() -> None:
    """One that reads none for long would be killed for a full inbox, before its deadline."""
    bench = Bench(workers=2)
    first, second = bench.workers
    bench.open()
    assert bench.dispatcher.readers(bench.ns) == []
    bench.ready(first)
    assert bench.dispatcher.readers(bench.ns) == [first]
    bench.ready(second)
    bench.frame()
    assert bench.dispatcher.readers(bench.ns) == [first, second]
    assert bench.dispatcher.readers(bench.ns + 1000 * MS) == [second]
    bench.die(second)
    assert bench.dispatcher.readers(bench.ns) == [first]


def test_nothing_is_assigned_before_the_detector_is_ready() -> None:
    bench = Bench()
    bench.open()
    bench.frame()
    assert bench.work == {}

    bench.ready()

    assert [frame.seq for frame in bench.work.values()] == [1]


def test_the_rate_is_the_number_of_results_of_the_last_second() -> None:
    bench = running()
    for _ in range(40):
        bench.ms += 50
        bench.frame()
        bench.look(bench.workers[0])

    assert bench.told[-1].stats.rate_hz == 20.0


# Newest wins.


def test_the_newest_frame_wins_and_every_other_is_counted() -> None:
    bench = running()
    (worker,) = bench.workers
    for _ in range(5):  # 1 is looked at; 2, 3, 4 are replaced; 5 waits
        bench.frame()

    assert bench.work[worker].seq == 1
    bench.look(worker)

    assert bench.work[worker].seq == 5
    assert (bench.told[-1].stats.frames, bench.told[-1].stats.skipped) == (1, 3)
    assert len(bench.free) == 2  # all but the one under work


def test_of_a_burst_that_arrived_together_only_the_newest_is_looked_at() -> None:
    bench = running()
    bench.capture()
    bench.capture()
    bench.settle()

    assert [frame.seq for frame in bench.work.values()] == [2]
    assert bench.dispatcher.stats.skipped == 1


def test_what_the_camera_itself_skipped_is_counted_once() -> None:
    bench = running()
    for total in (0, 4, 4, 6):
        bench.capture(skipped=total)
        bench.settle()
        bench.look(bench.workers[0])

    assert bench.told[-1].stats.skipped == 6


def test_no_older_result_follows_a_newer_one() -> None:
    bench = running(workers=2)
    first, second = bench.workers
    bench.frame()
    bench.frame()
    assert (bench.work[first].seq, bench.work[second].seq) == (1, 2)

    bench.look(second)
    bench.look(first)

    assert bench.seqs() == [2]
    assert (bench.dispatcher.stats.frames, bench.dispatcher.stats.skipped) == (1, 1)


# Lossless.


def test_lossless_every_frame_is_told_in_order() -> None:
    bench = running(workers=2, lossless=True)
    first, second = bench.workers
    for _ in range(4):
        bench.frame()
    assert set() == bench.free  # the camera waits now

    bench.look(second)  # frame 2: 1 is still under work
    assert bench.seqs() == []
    bench.look(first)
    assert bench.seqs() == [1, 2]
    assert sorted(frame.seq for frame in bench.work.values()) == [3, 4]
    bench.look(first)
    bench.look(second)

    assert bench.seqs() == [1, 2, 3, 4]
    assert bench.dispatcher.stats.skipped == 0


def test_lossless_the_end_is_told_after_the_last_frame() -> None:
    bench = running(lossless=True)
    (worker,) = bench.workers
    for _ in range(3):
        bench.frame()
    camera = bench.camera

    bench.dispatcher.failed(camera, "film: ended", bench.ns)
    bench.die(camera, "ended with exit code 1")
    for _ in range(3):
        bench.look(worker)

    assert bench.qualities() == [Quality.GOOD] * 3 + [Quality.LINK_DOWN]
    assert bench.told[-1].detail == "film: ended"
    bench.settle(after_ms=501)
    assert bench.camera != camera  # although it was gone long before it was given up


def test_lossless_a_camera_that_waits_for_us_has_not_stalled() -> None:
    bench = running(lossless=True)
    (worker,) = bench.workers
    for _ in range(3):
        bench.frame()
    bench.settle(after_ms=400)
    bench.look(worker)
    bench.frame()
    assert set() == bench.free
    bench.settle(after_ms=450)
    bench.look(worker)  # from here the camera's time runs

    bench.settle(after_ms=480)
    bench.look(worker)
    bench.settle(after_ms=480)
    bench.look(worker)
    assert Quality.LINK_DOWN not in bench.qualities()
    bench.settle(after_ms=40)

    assert Quality.LINK_DOWN is bench.qualities()[-1]


def test_lossless_a_lost_frame_is_told_in_its_turn() -> None:
    bench = running(workers=2, lossless=True)
    first, second = bench.workers
    bench.frame()
    bench.frame()

    bench.die(second)
    assert bench.seqs() == []
    bench.look(first)

    assert [(r.frame_id, r.quality) for r in bench.told] == [(1, Quality.GOOD), (2, Quality.PROCESS_FAULT)]


# Workers that fail.


def test_a_worker_that_dies_loses_its_frame_and_the_state_goes_bad_at_once() -> None:
    bench = running()
    frame = bench.frame()
    (old,) = bench.workers

    bench.die(old)

    (reading,) = bench.told
    assert (Quality.PROCESS_FAULT, frame.t_capture_ns) == (reading.quality, reading.t_ns)
    assert reading.detail == "vision process was killed by SIGKILL"
    assert reading.stage_ns == ()
    assert (bench.dispatcher.stats.lost, bench.dispatcher.stats.restarts) == (1, 1)
    assert [old] != bench.workers
    assert {0, 1, 2} == bench.free


def test_a_worker_is_hung_exactly_at_its_deadline_and_replaced_when_it_is_gone() -> None:
    bench = running()
    bench.frame()
    (old,) = bench.workers
    assert bench.ns + 500 * MS == bench.dispatcher.next_deadline_ns()

    bench.settle(after_ms=499)
    assert bench.killed == {}
    bench.settle(after_ms=1)

    assert {old: "vision process gave no result within 0.5 s"} == bench.killed
    assert bench.qualities() == [Quality.PROCESS_FAULT]
    bench.settle(after_ms=300)
    assert [old] == bench.workers  # not replaced while it may still be there
    bench.die(old, "was killed by SIGKILL")
    assert len(bench.workers) == 1
    assert [old] != bench.workers
    assert bench.dispatcher.stats.lost == 1


def test_a_result_that_lay_waiting_is_not_late() -> None:
    bench = running()
    bench.frame()
    bench.ms += 5000  # the main process was held up; the result came in time

    bench.look(bench.workers[0])

    assert Quality.GOOD is bench.qualities()[0]
    assert bench.workers[0] not in bench.killed


def test_a_result_after_the_deadline_is_ignored() -> None:
    bench = running()
    frame = bench.frame()
    (old,) = bench.workers
    bench.settle(after_ms=500)

    bench.dispatcher.looked(old, frame.seq, SEEN, bench.ns)
    bench.settle()

    assert bench.qualities() == [Quality.PROCESS_FAULT]


def test_the_first_failure_is_replaced_at_once_later_ones_with_backoff_until_a_result() -> None:
    bench = running()
    delays_ms = []
    for _ in range(4):
        bench.ready()
        bench.frame()
        (old,) = bench.workers
        bench.die(old)
        waited = 0
        while not bench.workers:
            bench.settle(after_ms=1)
            waited += 1
        delays_ms.append(waited)
    assert delays_ms[0] == 0
    for waited, ceiling in zip(delays_ms[1:], (201, 401, 801), strict=True):
        assert 100 <= waited <= ceiling

    bench.ready()
    bench.frame()
    bench.look(bench.workers[0])
    bench.frame()
    bench.die(bench.workers[0])
    assert len(bench.workers) == 1  # at once again


def test_a_failure_is_not_told_while_a_newer_frame_is_under_work() -> None:
    bench = running(workers=2)
    first, second = bench.workers
    bench.frame()
    bench.frame()

    bench.die(first)
    assert bench.told == []
    bench.look(second)

    assert [(r.frame_id, r.quality) for r in bench.told] == [(2, Quality.GOOD)]
    assert (bench.told[0].stats.lost, bench.told[0].stats.restarts) == (1, 1)


def test_a_failure_is_not_told_while_a_newer_frame_is_about_to_be_looked_at() -> None:
    bench = running(workers=2)
    first, second = bench.workers
    bench.frame()
    bench.frame()
    bench.frame()  # waits
    done = bench.work.pop(first)
    bench.work.pop(second)

    bench.dispatcher.looked(first, done.seq, SEEN, bench.ns)  # both are found in one look at the news
    bench.dispatcher.gone(second, "was killed by SIGKILL", bench.ns)
    bench.settle()

    assert bench.qualities() == [Quality.GOOD]
    assert bench.work[first].seq == 3


def test_if_the_newer_frame_is_lost_too_it_is_told_once() -> None:
    bench = running(workers=2)
    first, second = bench.workers
    bench.frame()
    bench.frame()

    bench.die(first)
    bench.die(second)

    assert [(r.frame_id, r.quality) for r in bench.told] == [(2, Quality.PROCESS_FAULT)]
    assert bench.dispatcher.stats.lost == 2


def test_an_older_result_does_not_hide_the_loss_of_a_newer_frame() -> None:
    bench = running(workers=2)
    first, second = bench.workers
    bench.frame()
    bench.frame()

    bench.die(second)
    bench.look(first)

    assert [(r.frame_id, r.quality) for r in bench.told] == [(2, Quality.PROCESS_FAULT)]


def test_a_worker_that_cannot_start_is_told_but_only_if_no_other_can_look() -> None:
    bench = Bench(workers=2)
    first, second = bench.workers
    bench.ready(first)
    bench.dispatcher.failed(second, "ImportError: no", bench.ns)
    bench.settle()
    assert bench.told == []

    bench.die(first)

    assert bench.qualities() == [Quality.PROCESS_FAULT]


def test_a_worker_that_never_becomes_ready_is_replaced() -> None:
    bench = Bench()
    bench.open()
    for _ in range(10):
        bench.frame()
        bench.settle(after_ms=999)
    bench.frame()
    assert bench.killed == {}
    bench.settle(after_ms=10)

    assert list(bench.killed.values()) == ["vision process not ready within 10 s"]
    assert bench.qualities() == [Quality.PROCESS_FAULT]


def test_frames_that_waited_through_a_failed_start_are_still_looked_at() -> None:
    bench = Bench(lossless=True)
    bench.open()
    bench.frame()
    bench.frame()
    bench.die(bench.workers[0])
    bench.ready()
    bench.look(bench.workers[0])
    bench.look(bench.workers[0])

    assert bench.qualities() == [Quality.PROCESS_FAULT, Quality.GOOD, Quality.GOOD]
    assert bench.seqs() == [0, 1, 2]


def test_a_frame_that_changed_under_the_work_is_lost_and_has_no_reading() -> None:
    bench = running()
    bench.frame()
    bench.look(bench.workers[0], None)

    assert bench.told == []
    assert (bench.dispatcher.stats.lost, bench.dispatcher.stats.restarts) == (1, 0)
    bench.frame()
    bench.look(bench.workers[0])
    assert bench.seqs() == [2]


# Cameras that fail.


@pytest.mark.parametrize("frames", [0, 1])
def test_a_silent_camera_is_bad_at_its_deadline(frames: int) -> None:
    bench = running()
    for _ in range(frames):
        bench.frame()
        bench.look(bench.workers[0])
    allowed_ms, words = (1000, "cam: no frame within 1 s") if frames else (10_000, "cam: no first frame within 10 s")

    bench.settle(after_ms=allowed_ms - 1)
    assert Quality.LINK_DOWN not in bench.qualities()
    bench.settle(after_ms=1)

    reading = bench.told[-1]
    assert (Quality.LINK_DOWN, words, bench.ns) == (reading.quality, reading.detail, reading.t_ns)
    assert {bench.camera: words} == bench.killed


def test_a_camera_is_opened_again_with_backoff_and_only_when_the_old_one_is_gone() -> None:
    bench = running()
    old = bench.camera
    bench.settle(after_ms=10_000)
    bench.settle(after_ms=4000)
    assert old == bench.camera  # cannot be killed: there is no second one

    bench.die(old)

    assert old != bench.camera
    assert bench.dispatcher.stats.reopens == 1


def test_backoff_grows_and_is_forgotten_after_a_good_while() -> None:
    bench = running()

    def lose() -> int:
        old = bench.camera
        bench.dispatcher.failed(old, "lost", bench.ns)
        bench.die(old)
        waited = 0
        while bench.camera == old:
            bench.settle(after_ms=1)
            waited += 1
        return waited

    delays = [lose() for _ in range(7)]
    for waited, ceiling in zip(delays, (500, 1000, 2000, 4000, 5000, 5000, 5000), strict=True):
        assert 250 <= waited <= ceiling + 1
    assert len(set(delays)) > 4  # jitter
    for _ in range(11):  # well for more than five seconds
        bench.frame()
        bench.look(bench.workers[0])
        bench.settle(after_ms=500)
    assert 250 <= lose() <= 501


def test_nothing_captured_before_the_loss_is_told_after_it() -> None:
    bench = running(workers=2)
    first, second = bench.workers
    for _ in range(3):
        bench.frame()

    bench.dispatcher.failed(bench.camera, "cam: lost", bench.ns)
    bench.settle()
    bench.look(first)
    bench.look(second)

    assert bench.qualities() == [Quality.LINK_DOWN]
    assert bench.told[0].detail == "cam: lost"
    assert bench.dispatcher.stats.skipped == 3


@pytest.mark.parametrize("lossless", [False, True])
@pytest.mark.parametrize("how", ["ended", "killed", "silent"])
def test_a_film_that_was_lost_after_its_first_frame_is_not_begun_again(lossless: bool, how: str) -> None:
    bench = Bench(lossless=lossless)
    bench.dispatcher.opened(bench.camera, lossless, finite=True)
    bench.ready()
    bench.frame()
    bench.look(bench.workers[0])
    film = bench.camera
    match how:
        case "ended":
            bench.dispatcher.failed(film, "film.avi: ended", bench.ns)
            why = "film.avi: ended"
        case "killed":
            bench.dispatcher.gone(film, "was killed by SIGKILL", bench.ns)
            why = "cam: camera process was killed by SIGKILL"
        case _:
            bench.ms += 1000
            why = "cam: no frame within 1 s"
    bench.settle()
    bench.die(film)
    assert bench.qualities() == [Quality.GOOD, Quality.LINK_DOWN]
    assert bench.told[-1].detail == f"{why}; it is not begun again (camera.loop)"
    assert bench.dispatcher.next_deadline_ns() is None
    for _ in range(100):
        assert bench.settle(60_000) == []
    anew = bench.dispatcher.anew(VisionConfig(coast_s=0.1))  # nor with other settings
    assert [type(action) for action in anew.settle(bench.ns)] == [StartWorker]
    assert anew.next_deadline_ns() == bench.ns + 10_000 * MS  # of the worker's start


def test_a_film_that_cannot_be_opened_yet_is_tried_again() -> None:
    bench = Bench()
    bench.dispatcher.opened(bench.camera, False, finite=True)
    film = bench.camera
    bench.dispatcher.failed(film, "film.avi: no such file or folder", bench.ns)
    bench.die(film)
    bench.settle(6000)
    assert bench.told[-1].detail == "film.avi: no such file or folder"
    assert bench.camera != film


def test_frame_numbers_and_slots_go_on_after_a_reopening() -> None:
    bench = running(workers=2)
    for _ in range(3):
        bench.frame()
    old, (first, second) = bench.camera, bench.workers
    bench.die(old)
    while bench.camera == old:
        bench.settle(after_ms=1)
    assert {2, 3} == bench.free  # 0 and 1 are still under the workers' eyes
    assert bench.seq == 4

    bench.look(first)
    assert {0, 2, 3} == bench.free
    bench.open()
    bench.frame()
    bench.look(first)

    assert bench.seqs() == [3, 4]
    assert bench.qualities() == [Quality.LINK_DOWN, Quality.GOOD]
    bench.look(second)
    assert bench.seqs() == [3, 4]


def test_late_words_of_a_camera_given_up_are_ignored() -> None:
    bench = running()
    old = bench.camera
    bench.settle(after_ms=10_000)
    bench.die(old)
    bench.settle(after_ms=501)
    told = len(bench.told)

    bench.dispatcher.captured(old, FrameRef(0, 2, 1, bench.ns), 0, bench.ns)
    bench.dispatcher.failed(old, "too late", bench.ns)
    bench.dispatcher.gone(old, "too late", bench.ns)
    bench.settle()

    assert (told, {}) == (len(bench.told), bench.work)


def test_a_configuration_error_gives_up_after_telling() -> None:
    bench = running()
    bench.dispatcher.failed(bench.camera, "camera.url: nonsense", bench.ns, config=True)
    actions = bench.settle()

    assert bench.given_up == ["camera.url: nonsense"]
    assert kinds(actions) == ["Emit", "Kill", "GiveUp"]
    bench.dispatcher.failed(bench.camera, "again", bench.ns, config=True)
    bench.settle()
    assert len(bench.given_up) == 1


def test_nothing_to_do_means_nothing_to_do_until_the_next_deadline() -> None:
    bench = running()
    bench.frame()
    bench.look(bench.workers[0])

    assert bench.ns + 500 * MS == bench.dispatcher.next_deadline_ns()  # the notes are read, for a frame handed over
    assert bench.settle(after_ms=500) == []
    assert bench.ns + 500 * MS == bench.dispatcher.next_deadline_ns()
    assert bench.settle(after_ms=499) == []


# Straight from the camera to a worker.


def test_an_idle_worker_is_offered_to_a_live_camera_once() -> None:
    bench = Bench()
    bench.ready()
    assert bench.offers == []  # a film must be looked at in order, and nobody knows yet whether it is one
    bench.open()
    bench.settle()

    assert bench.offers == bench.workers
    bench.settle()
    assert bench.offers == bench.workers


def test_no_offers_for_a_film() -> None:
    assert running(lossless=True).offers == []


def test_a_frame_handed_over_becomes_a_reading_and_the_next_offer_follows() -> None:
    bench = running()
    (worker,) = bench.workers
    frame = bench.hand()
    bench.ms += 3

    bench.look(worker)

    assert [(r.t_ns, r.frame_id, r.quality) for r in bench.told] == [(frame.t_capture_ns, 1, Quality.GOOD)]
    assert (bench.told[0].stats.latency_ms, bench.free, bench.offers) == (5.0, {0, 1, 2}, [worker])


def test_a_frame_that_comes_without_an_offer_is_assigned_at_once_and_the_offer_stands() -> None:
    bench = running()
    (worker,) = bench.workers
    bench.frame()  # it came before the camera had read of the offer
    assert bench.work[worker].seq == 1

    bench.hand()  # while the first is under work
    bench.look(worker)
    bench.look(worker)

    assert (bench.seqs(), bench.free) == ([1, 2], {0, 1, 2})
    assert bench.offers == [worker]


def test_a_frame_behind_one_handed_over_later_waits_for_nobody() -> None:
    bench = running(workers=2)
    bench.hand()
    late = bench.capture()  # both are heard of together, the note first or last
    bench.hear()
    bench.settle()
    assert list(bench.work.values()) == [late]

    bench = running(workers=1)
    bench.frame()
    waiting = bench.frame()
    bench.hand()
    bench.hear()
    bench.settle()
    assert bench.dispatcher.stats.skipped == 1
    assert waiting.slot in bench.free


def test_a_frame_older_than_one_handed_over_is_skipped() -> None:
    bench = running()
    (worker,) = bench.workers
    older = bench._new_frame()
    bench.hand()
    bench.hear()

    bench.dispatcher.captured(bench.camera, older, 0, bench.ns)
    bench.settle()

    assert (bench.work, bench.dispatcher.stats.skipped, older.slot in bench.free) == ({}, 1, True)
    bench.look(worker)
    assert bench.seqs() == [2]


def test_a_worker_that_hangs_on_a_frame_handed_over_is_hung_at_its_deadline() -> None:
    bench = running()
    (worker,) = bench.workers
    bench.settle(after_ms=100)
    bench.hand()  # nobody hears of it
    bench.settle(after_ms=399)
    assert bench.dispatcher.next_deadline_ns() == bench.ns + 1 * MS
    bench.ms += 1
    bench.hear()  # what is past its deadline is judged after everything was heard
    bench.settle()
    assert bench.killed == {}

    bench.settle(after_ms=99)
    assert bench.killed == {}
    bench.settle(after_ms=1)

    assert bench.killed == {worker: "vision process gave no result within 0.5 s"}
    assert bench.qualities() == [Quality.PROCESS_FAULT]
    assert bench.dispatcher.stats.lost == 1


def test_a_worker_that_dies_of_a_frame_handed_over_loses_it_and_is_told_at_once() -> None:
    bench = running()
    frame = bench.hand()

    bench.die(bench.workers[0])

    assert [(r.frame_id, r.quality, r.t_ns) for r in bench.told] == [(1, Quality.PROCESS_FAULT, frame.t_capture_ns)]
    assert (bench.dispatcher.stats.lost, bench.free) == (1, {0, 1, 2})


def test_a_worker_that_dies_with_two_frames_loses_both() -> None:
    bench = running()
    bench.frame()
    bench.hand()
    bench.die(bench.workers[0])

    assert [(r.frame_id, r.quality) for r in bench.told] == [(2, Quality.PROCESS_FAULT)]
    assert (bench.dispatcher.stats.lost, bench.free) == (2, {0, 1, 2})


def test_a_frame_handed_to_a_worker_that_was_gone_already_waits_for_the_next_one() -> None:
    bench = running()
    (old,) = bench.workers
    offers = list(bench.offers)
    bench.die(old)
    bench.offers = offers  # the camera has not heard of it
    frame = bench.hand()
    bench.hear()
    bench.settle()
    assert bench.work == {}

    bench.ready()

    assert bench.work == {bench.workers[0]: frame}


def test_a_frame_handed_over_by_a_camera_given_up_is_not_told_and_keeps_its_slot_till_then() -> None:
    bench = running()
    (worker,) = bench.workers
    old = bench.camera
    bench.settle(after_ms=10_000)
    assert bench.qualities() == [Quality.LINK_DOWN]
    frame = bench.hand()  # at the very moment
    bench.die(old)
    while bench.camera == old:
        bench.settle(after_ms=1)

    assert frame.slot not in bench.free
    assert bench.seq == frame.seq + 1
    bench.look(worker)
    assert bench.qualities() == [Quality.LINK_DOWN]
    assert (frame.slot in bench.free, bench.dispatcher.stats.skipped) == (True, 1)


def test_a_vision_process_that_was_not_ready_in_time_gets_more_time_the_next_time() -> None:
    bench = Bench()
    starts: list[int] = []
    begun_ms = bench.ms
    while len(starts) < 4:
        (worker,) = bench.workers
        bench.settle(after_ms=100)
        if worker in bench.killed:
            starts.append(round((bench.ms - begun_ms) / 1000))
            bench.die(worker)
            while worker in bench.workers or not bench.workers:
                bench.settle(after_ms=100)
            begun_ms = bench.ms

    assert starts == [10, 20, 40, 40]


def test_what_a_camera_given_up_had_skipped_before_its_last_frame_is_counted() -> None:
    bench = running()
    (worker,) = bench.workers
    bench.settle(after_ms=10_000)
    frame = FrameRef(min(bench.free), 2, 3, bench.ns)
    bench.dispatcher.handed(bench.camera, frame, 2, worker, bench.ns, bench.ns)
    bench.dispatcher.looked(worker, 3, SEEN, bench.ns)

    assert bench.dispatcher.stats.skipped == 3  # the first two, and this one, which came too late


def test_with_other_settings_numbers_go_on_and_what_was_under_work_is_counted() -> None:
    bench = running(workers=2)
    for _ in range(4):
        bench.frame()  # two looked at, one replaced by the last
    after = bench.dispatcher.anew(VisionConfig(workers=2, deadline_s=0.25))

    assert (after.stats.skipped, after.stats.lost) == (2, 2)
    (camera,) = (action for action in after.settle(bench.ns) if isinstance(action, StartCamera))
    assert (camera.first_seq, sorted(camera.slots)) == (5, [0, 1, 2, 3])


def test_with_other_settings_a_film_s_readings_before_their_turn_are_counted() -> None:
    bench = running(workers=2, lossless=True)
    bench.frame()
    bench.frame()
    bench.look(bench.workers[1])

    after = bench.dispatcher.anew(VisionConfig(workers=2))

    assert (bench.told, after.stats.frames, after.stats.skipped, after.stats.lost) == ([], 0, 1, 1)


def test_a_camera_that_has_gone_takes_its_offers_with_it() -> None:
    bench = running()
    old = bench.camera
    bench.die(old)
    while bench.camera == old:
        bench.settle(after_ms=1)
    assert bench.offers == []
    bench.open()
    bench.settle()

    assert bench.offers == bench.workers


def test_a_frame_not_looked_at_because_a_newer_one_came_first_is_skipped_not_lost() -> None:
    bench = running()
    (worker,) = bench.workers
    bench.frame()
    bench.hand()
    first, second = bench.work.pop(worker), bench.inbox[worker].pop()
    bench.hear()

    bench.dispatcher.looked(worker, second.seq, SEEN, bench.ns)  # they reached it in this order
    bench.dispatcher.looked(worker, first.seq, None, bench.ns)
    bench.settle()

    assert bench.seqs() == [2]
    assert (bench.dispatcher.stats.skipped, bench.dispatcher.stats.lost) == (1, 0)


# Everything at once.


class Chaos(RuleBasedStateMachine):
    """Any order of frames, results, deaths, hangs and silence, with one to three workers, live or lossless."""

    @initialize(workers=st.integers(1, 3), lossless=st.booleans())
    def begin(self, workers: int, lossless: bool) -> None:
        self.bench = running(workers, lossless=lossless)
        self.captured = 0

    @rule(n=st.integers(1, 4))
    def frames(self, n: int) -> None:
        for _ in range(n):
            if self.bench.free and self.bench.camera not in self.bench.killed:
                self.bench.capture()
                self.captured += 1
        self.bench.settle()

    @rule(pick=st.integers(0, 99))
    def frame_handed_over(self, pick: int) -> None:
        bench = self.bench
        if bench.free and bench.offers and bench.camera not in bench.killed:
            bench.hand(to=bench.offers[pick % len(bench.offers)])
            self.captured += 1

    @rule()
    def notes_are_read(self) -> None:
        self.bench.hear()
        self.bench.settle()

    @rule(pick=st.integers(0, 99), detection=st.sampled_from((SEEN, EMPTY, None)))
    def look(self, pick: int, detection: Detection | None) -> None:
        busy = sorted({*self.bench.work, *(token for token, frames in self.bench.inbox.items() if frames)})
        if busy:
            self.bench.look(busy[pick % len(busy)], detection)

    @rule(pick=st.integers(0, 99))
    def worker_dies(self, pick: int) -> None:
        if self.bench.workers:
            self.bench.die(self.bench.workers[pick % len(self.bench.workers)])

    @rule()
    def worker_ready(self) -> None:
        self.bench.ready()

    @rule()
    def camera_dies(self) -> None:
        self.bench.die(self.bench.camera)

    @rule()
    def camera_ends(self) -> None:
        self.bench.dispatcher.failed(self.bench.camera, "ended", self.bench.ns)
        self.bench.killed.setdefault(self.bench.camera, "ended")
        self.bench.settle()

    @rule()
    def camera_opens(self) -> None:
        self.bench.open()

    @rule(ms=st.sampled_from((1, 20, 300, 1100, 11_000)))
    def time_passes(self, ms: int) -> None:
        self.bench.ms += ms
        self.bench.hear()  # what is past its deadline is judged after everything was heard
        self.bench.settle()

    @rule()
    def the_killed_are_reaped(self) -> None:
        for token in list(self.bench.killed):
            self.bench.die(token)

    @invariant()
    def every_slot_is_in_one_place(self) -> None:
        d = self.bench.dispatcher
        at_work = [frame.slot for seat in d._workers for frame in seat.frames]
        waiting = [frame.slot for frame in d._waiting]
        assert sorted([*d._free, *at_work, *waiting]) == list(range(d.slots))
        unread = {note[1].slot for note in self.bench.notes}
        assert self.bench.free.isdisjoint(unread | set(at_work)) or self.bench.camera in self.bench.killed

    @invariant()
    def live_frames_never_queue_up(self) -> None:
        d = self.bench.dispatcher
        assert len(d._waiting) <= (d.slots if d._lossless else 1)

    @invariant()
    def readings_never_go_back(self) -> None:
        seqs = [r.frame_id for r in self.bench.told if r.quality in (Quality.GOOD, Quality.NO_TARGET)]
        assert seqs == sorted(set(seqs))

    @invariant()
    def every_frame_is_accounted_for(self) -> None:
        d = self.bench.dispatcher
        held = sum(r.quality is not Quality.PROCESS_FAULT for r in d._held.values())
        at_work = sum(len(seat.frames) for seat in d._workers) + len(self.bench.notes)
        assert self.captured == d.stats.frames + d.stats.skipped + d.stats.lost + held + at_work + len(d._waiting)

    @invariant()
    def a_worker_has_a_frame_if_and_only_if_it_is_busy_and_none_idles_while_one_waits(self) -> None:
        d = self.bench.dispatcher
        assert all((seat.phase is Phase.BUSY) is bool(seat.frames) for seat in d._workers)
        assert all(len(seat.frames) <= 2 for seat in d._workers)
        assert not (d._waiting and any(seat.phase is Phase.IDLE for seat in d._workers))


TestChaos = Chaos.TestCase
TestChaos.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)
