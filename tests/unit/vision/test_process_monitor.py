"""When the vision process is started and ended, and what is reported: with plain numbers instead of processes."""

import random
from dataclasses import replace

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from msgspec import structs

from gateway.config import CameraConfig, Reconnect, VisionConfig
from gateway.core.detection import Circle, Detection
from gateway.core.readings import AgeProof, PictureFault, PictureHealth, Quality, VisionReading
from gateway.vision.process.monitor import Action, Emit, GiveUp, Kill, ProcessMonitor, Start
from gateway.vision.transport.messages import FrameResult
from gateway.vision.transport.progress import FrameProgress
from tests.examples import examples

MS = 1_000_000
SEEN = Detection(Circle(10.0, 20.0, 30.0), x_n=0.1, y_n=0.2, stage_ns=(("hsv", 7), ("circle", 3)))
EMPTY = Detection(None, stage_ns=(("hsv", 5),))
KILLED = "was killed by SIGKILL"


class Bench:
    """A monitor whose process is played by the test; time is `ms`. The process notes its progress in `notes`."""

    def __init__(self, *, lossless: bool = False, finite: bool = False, first_ms: int = 1000) -> None:
        self.ms = first_ms
        self.monitor = ProcessMonitor(
            "cam",
            CameraConfig(deadline_s=1.0, open_deadline_s=10.0, reconnect=Reconnect(min_s=0.25, max_s=5.0)),
            VisionConfig(deadline_s=0.5),
            rng=random.Random(1),
        )
        self.lossless, self.finite = lossless, finite
        self.starts: list[Start] = []
        self.alive: list[int] = []  # tokens of processes that exist
        self.seq = 0
        self.notes = FrameProgress()
        self.readings: list[VisionReading] = []
        self.killed: dict[int, str] = {}
        self.given_up: list[str] = []
        self.settle()

    @property
    def ns(self) -> int:
        return self.ms * MS

    @property
    def token(self) -> int:
        return self.starts[-1].token

    def settle(self, after_ms: int = 0) -> list[Action]:
        self.ms += after_ms
        self.monitor.progress(self.notes, self.ns)
        actions = self.monitor.settle(self.ns)
        for action in actions:
            match action:
                case Start(token, first_seq):
                    assert self.alive == [], "two processes at once"
                    assert token not in {start.token for start in self.starts}
                    self.starts.append(action)
                    self.alive.append(token)
                    self.seq, self.notes = first_seq - 1, FrameProgress(token, detector_ns=self.ns)
                case Kill(token, why):
                    self.killed[token] = why
                case Emit(reading):
                    self.readings.append(reading)
                case GiveUp(why):
                    self.given_up.append(why)
        return actions

    def ready(self) -> None:
        self.monitor.ready(self.token, self.ns)
        self.settle()

    def open(self) -> None:
        self.monitor.opened(self.token, self.ns, lossless=self.lossless, finite=self.finite)
        self.settle()

    def capture(self) -> None:
        """A frame is captured; the detector has not begun it."""
        self.seq += 1
        self.notes = replace(self.notes, captured_seq=self.seq, captured_ns=self.ns, detector_ns=self.ns)

    def begin(self) -> None:
        """The detector begins the newest frame, captured 2 ms ago."""
        self.notes = replace(self.notes, work_seq=self.seq, work_t_capture_ns=self.ns - 2 * MS, work_began_ns=self.ns)

    def frame(self) -> None:
        self.capture()
        self.begin()
        self.settle()

    def result(
        self, detection: Detection = SEEN, since_ns: int | None = None, picture: PictureHealth | None = None
    ) -> VisionReading:
        seq, t_ns = self.notes.work_seq, self.notes.work_t_capture_ns
        message = FrameResult(seq, t_ns, detection, t_ns if since_ns is None else since_ns, picture)
        self.monitor.result(self.token, message, self.ns)
        self.notes = replace(self.notes, work_began_ns=0, detector_ns=self.ns)
        self.settle()
        return self.readings[-1]

    def look(self, detection: Detection = SEEN, picture: PictureHealth | None = None) -> VisionReading:
        self.frame()
        return self.result(detection, picture=picture)

    def lose(self, why: str = "cam: lost", *, config: bool = False) -> None:
        self.monitor.source_lost(self.token, why, self.ns, config=config)
        self.settle()

    def fail(self, why: str) -> None:
        self.monitor.progress(self.notes, self.ns)
        self.monitor.failed(self.token, why, self.ns)
        self.settle()

    def die(self, how: str = KILLED, *, crashed: bool = False) -> None:
        """It is gone; the next is running, once it is due."""
        self.alive.remove(self.token)
        self.monitor.progress(self.notes, self.ns)
        self.monitor.gone(self.token, how, self.ns, crashed=crashed)
        self.settle()

    def until_started(self, *, run: bool = True) -> int:
        """How many ms until the next process is started; with `run` it is at work afterwards."""
        begun_ms = self.ms
        while not self.alive:
            self.settle(after_ms=1)
        waited_ms = self.ms - begun_ms
        if run:
            self.ready()
            self.open()
        return waited_ms

    def seqs(self) -> list[int]:
        return [reading.frame_id for reading in self.readings]

    def qualities(self) -> list[Quality]:
        return [reading.quality for reading in self.readings]


def running(*, lossless: bool = False, finite: bool = False) -> Bench:
    bench = Bench(lossless=lossless, finite=finite)
    bench.ready()
    bench.open()
    return bench


def counts(bench: Bench) -> tuple[int, int, int, int, int]:
    stats = bench.monitor.stats
    return stats.frames, stats.skipped, stats.lost, stats.restarts, stats.reopens


# Frames and readings.


def test_one_process_is_started_and_nothing_is_reported_yet() -> None:
    bench = Bench(first_ms=0)
    assert (len(bench.starts), bench.readings) == (1, [])
    assert (bench.starts[0].first_seq, bench.starts[0].discard) == (1, 0)


def test_a_frame_becomes_a_reading_with_its_capture_time_and_age() -> None:
    bench = running()
    bench.frame()
    t_capture_ns = bench.ns - 2 * MS
    bench.ms += 5

    reading = bench.result()

    assert len(bench.readings) == 1
    assert (t_capture_ns, Quality.GOOD, 1) == (reading.t_ns, reading.quality, reading.frame_id)
    assert (Circle(10.0, 20.0, 30.0), 0.1, 0.2) == (reading.circle, reading.x_n, reading.y_n)
    assert reading.stage_ns == (("hsv", 7), ("circle", 3))
    assert counts(bench) == (1, 0, 0, 0, 0)
    assert (reading.stats.latency_ms, reading.stats.rate_hz) == (7.0, 1.0)


def test_what_has_been_in_the_picture_unchanged_is_as_old_as_its_first_sight() -> None:
    bench = running()
    bench.frame()
    first_ns = bench.ns - 2 * MS
    assert bench.result(since_ns=first_ns).t_ns == first_ns
    bench.ms += 40
    bench.frame()
    assert bench.result(since_ns=first_ns).t_ns == first_ns
    bench.frame()
    assert bench.result(since_ns=bench.ns + 99 * MS).t_ns == bench.ns - 2 * MS  # never newer than its frame
    assert bench.qualities() == [Quality.GOOD] * 3


def test_the_health_of_the_picture_is_judged_here_and_reported_with_every_result_while_it_is_new() -> None:
    bench = running()
    dark = PictureHealth(0.01, 0.0, 0.0, None, None, None)

    def look(picture: PictureHealth | None, after_ms: int) -> VisionReading:
        bench.ms += after_ms
        bench.frame()
        return bench.result(EMPTY, picture=picture)

    assert look(None, 0).picture is None
    for _ in range(11):
        seen = look(dark, 500)
        assert seen.picture is not None
    assert seen.picture == replace(dark, status=1 << PictureFault.DARK)  # for 5 s
    assert look(None, 900).picture == seen.picture
    assert look(None, 2100).picture == seen.picture
    assert look(None, 100).picture is None
    assert look(dark, 100).picture is not None
    bench.lose()
    assert (bench.readings[-1].quality, bench.readings[-1].picture) == (Quality.LINK_DOWN, None)


@pytest.mark.parametrize(
    ("found", "quality"),
    [
        (EMPTY, Quality.NO_TARGET),
        (replace(EMPTY, predicted=Circle(1.0, 2.0, 3.0)), Quality.COASTED),
        (replace(EMPTY, wrong_size=Circle(10.0, 20.0, 30.0)), Quality.NO_TARGET),
    ],
    ids=["nothing", "a prediction", "a disc of the wrong size"],
)
def test_a_frame_without_a_measured_marker_is_no_fault(found: Detection, quality: Quality) -> None:
    reading = running().look(found)
    assert (reading.quality, reading.circle, reading.stage_ns) == (quality, None, found.stage_ns)
    assert (reading.predicted, reading.wrong_size) == (found.predicted, found.wrong_size)


def test_the_rate_is_the_number_of_results_of_the_last_second() -> None:
    bench = running()
    for _ in range(40):
        bench.ms += 50
        bench.look()
    assert bench.readings[-1].stats.rate_hz == 20.0
    bench.ms += 600
    bench.lose()
    assert bench.readings[-1].stats.rate_hz == 8.0


def test_the_newest_frame_wins_and_every_other_is_counted() -> None:
    bench = running()
    bench.frame()
    for _ in range(4):  # 2, 3 and 4 are replaced while 1 is worked on
        bench.capture()
    bench.result()
    bench.begin()
    bench.result()
    assert bench.seqs() == [1, 5]
    assert counts(bench) == (2, 3, 0, 0, 0)


def test_messages_that_can_wait_are_sent_only_to_a_process_that_reads_them() -> None:
    """One that reads none for long would be killed for a full inbox, before its deadline."""
    bench = Bench()
    assert not bench.monitor.reads_messages(bench.ns)
    bench.ready()
    assert not bench.monitor.reads_messages(bench.ns)
    bench.open()
    assert bench.monitor.reads_messages(bench.ns)
    bench.look()
    assert bench.monitor.reads_messages(bench.ns + 999 * MS)
    assert not bench.monitor.reads_messages(bench.ns + 1000 * MS)
    bench.fail("no")
    assert not bench.monitor.reads_messages(bench.ns)


# A detector or a process that fails.


def test_a_process_that_dies_loses_its_frame_and_the_state_is_bad_at_once() -> None:
    bench = running()
    bench.frame()
    t_capture_ns = bench.ns - 2 * MS
    bench.die()

    (reading,) = bench.readings
    assert (reading.quality, reading.t_ns, reading.frame_id) == (Quality.PROCESS_FAULT, t_capture_ns, 1)
    assert (reading.detail, reading.stage_ns) == ("vision process was killed by SIGKILL", ())
    assert counts(bench) == (0, 0, 1, 1, 0)
    assert bench.starts[-1].first_seq == 2


def test_a_process_that_dies_while_it_waits_for_a_frame_is_a_fault_without_a_lost_frame() -> None:
    bench = running()
    bench.look()
    bench.capture()  # and the detector has not begun it
    bench.die()
    assert (bench.qualities(), bench.readings[-1].t_ns) == ([Quality.GOOD, Quality.PROCESS_FAULT], bench.ns)
    assert counts(bench) == (1, 1, 0, 1, 0)


def test_a_detector_that_throws_is_reported_at_once_and_its_process_is_ended() -> None:
    bench = running()
    bench.frame()
    old = bench.token
    bench.fail("ValueError: poison")
    assert [(r.quality, r.detail) for r in bench.readings] == [
        (Quality.PROCESS_FAULT, "vision process: ValueError: poison")
    ]
    assert old in bench.killed
    bench.settle(after_ms=300)
    assert bench.token == old  # not replaced while it may still exist
    bench.die()
    assert bench.token != old
    assert counts(bench) == (0, 0, 1, 1, 0)
    assert len(bench.readings) == 1


@pytest.mark.failure_mode("V4")
def test_a_detector_hangs_exactly_at_its_deadline() -> None:
    bench = running()
    bench.look()
    bench.frame()
    assert bench.ns + 500 * MS == bench.monitor.next_deadline_ns()
    bench.capture()  # the source goes on
    bench.settle(after_ms=499)
    assert bench.killed == {}
    bench.settle(after_ms=1)
    assert bench.killed == {bench.token: "vision process gave no result within 0.5 s"}
    assert bench.qualities() == [Quality.GOOD, Quality.PROCESS_FAULT]
    assert counts(bench) == (1, 1, 1, 0, 0)


def test_work_that_no_message_reported_is_noticed_in_time() -> None:
    """A note wakes nobody: the main process looks in good time."""
    bench = running()
    bench.look()
    bench.ms += 300
    bench.capture()
    bench.begin()
    hangs_ms = bench.ms
    while not bench.killed:
        deadline_ns = bench.monitor.next_deadline_ns()
        assert deadline_ns is not None
        bench.ms = deadline_ns // MS
        bench.settle()
    assert bench.ms == hangs_ms + 500
    assert bench.qualities()[-1] is Quality.PROCESS_FAULT


def test_a_result_that_was_not_read_yet_is_not_late() -> None:
    bench = running()
    bench.frame()
    bench.ms += 5000  # the main process was held up; the result came in time
    bench.capture()
    bench.result()
    assert (bench.qualities(), bench.killed) == ([Quality.GOOD], {})


def test_a_result_after_the_deadline_is_ignored() -> None:
    bench = running()
    bench.look()
    bench.frame()
    bench.settle(after_ms=500)
    bench.result()
    assert bench.qualities() == [Quality.GOOD, Quality.PROCESS_FAULT]


@pytest.mark.parametrize("results", [0, 1])
def test_the_first_failure_is_replaced_at_once_later_ones_with_a_delay_until_a_second_result(results: int) -> None:
    """What is done after a result, as the picture's measurement, may fail, too."""
    bench = running()
    delays_ms = []
    for _ in range(4):
        for _ in range(results):
            bench.look()
        bench.frame()
        bench.die()
        delays_ms.append(bench.until_started())
    assert delays_ms[0] == 0
    for waited, ceiling in zip(delays_ms[1:], (201, 401, 801), strict=True):
        assert 100 <= waited <= ceiling

    bench.look()
    bench.look()
    bench.frame()
    bench.die()
    assert bench.alive != []  # at once again


def test_a_detector_that_cannot_be_built_is_reported() -> None:
    bench = Bench()
    bench.fail("ImportError: no")
    assert [(r.quality, r.detail) for r in bench.readings] == [
        (Quality.PROCESS_FAULT, "vision process: ImportError: no")
    ]


@pytest.mark.parametrize(
    ("steps", "first_s", "quality", "why"),
    [
        (0, 10.0, Quality.PROCESS_FAULT, "vision process not ready within 10 s"),
        (1, 10.0, Quality.LINK_DOWN, "cam: no first frame within 10 s"),
        (2, 0.5, Quality.PROCESS_FAULT, "vision process gave no result within 0.5 s"),
    ],
)
def test_a_start_that_was_late_may_take_twice_as_long_the_next_time(
    steps: int, first_s: float, quality: Quality, why: str
) -> None:
    """On a loaded machine, where each would be ended shortly before its first result."""
    bench = Bench()

    def late_s() -> float:
        """How long the next step of a start may take; the next process is started afterwards."""
        for step in (bench.ready, bench.open, bench.frame)[: steps + steps // 2]:
            step()
        begun_ms = bench.ms
        while bench.token not in bench.killed:
            bench.settle(after_ms=100)
        took_ms = bench.ms - begun_ms
        bench.die()
        bench.until_started(run=False)
        return took_ms / 1000

    first = bench.token
    starts_s = [late_s() for _ in range(7)]
    assert (bench.readings[0].quality, bench.killed[first]) == (quality, why)
    assert starts_s == pytest.approx([factor * first_s for factor in (1, 2, 4, 8, 16, 24, 24)], abs=0.2)

    def run_for(ms: int) -> None:
        bench.ready()
        bench.open()
        for _ in range(ms // 500):
            bench.settle(after_ms=500)
            bench.look()
        bench.fail("no")
        bench.die()
        bench.until_started(run=False)

    run_for(240_000)
    bench.monitor = bench.monitor.successor(VisionConfig(deadline_s=0.5))  # other settings make no machine faster
    bench.alive.clear()
    bench.until_started(run=False)
    assert late_s() == pytest.approx(24 * first_s, abs=0.2)
    run_for(240_500)
    assert late_s() == pytest.approx(first_s, abs=0.2)


# A source that fails.


@pytest.mark.parametrize("frames", [0, 1])
def test_a_silent_source_is_bad_at_its_deadline(frames: int) -> None:
    bench = Bench()
    bench.ready()
    if frames:
        bench.open()
        bench.look()
    allowed_ms, words = (1000, "cam: no frame within 1 s") if frames else (10_000, "cam: no first frame within 10 s")
    for _ in range(allowed_ms // 100):
        assert Quality.LINK_DOWN not in bench.qualities()
        bench.notes = replace(bench.notes, detector_ns=bench.ns)  # which waits for a frame
        bench.settle(after_ms=100)
    reading = bench.readings[-1]
    assert (Quality.LINK_DOWN, words, bench.ns) == (reading.quality, reading.detail, reading.t_ns)
    assert {bench.token: words} == bench.killed


def test_a_source_is_not_judged_while_the_detector_works() -> None:
    bench = running()
    bench.monitor.vision = VisionConfig(deadline_s=3.0)
    bench.frame()
    bench.settle(after_ms=2500)
    assert bench.killed == {}
    bench.result()
    bench.settle(after_ms=249)  # a moment for the capture thread
    assert bench.qualities() == [Quality.GOOD]
    bench.settle(after_ms=1)
    assert bench.qualities() == [Quality.GOOD, Quality.LINK_DOWN]
    assert bench.readings[-1].detail == "cam: no frame within 1 s"


def test_a_process_of_which_neither_thread_runs_is_a_fault_of_the_process() -> None:
    """It was stopped, or native code hangs with the interpreter's lock held."""
    bench = running()
    bench.look()
    bench.settle(after_ms=999)
    assert bench.killed == {}
    bench.settle(after_ms=1)
    assert bench.killed == {bench.token: "vision process has stopped: no sign of life for 1 s"}
    assert bench.qualities()[-1] is Quality.PROCESS_FAULT


@pytest.mark.parametrize(
    ("moment", "crashed", "quality"),
    [
        ("builds", True, Quality.PROCESS_FAULT),
        ("opens", False, Quality.LINK_DOWN),
        ("waits for a frame", True, Quality.LINK_DOWN),
        ("waits for a frame", False, Quality.PROCESS_FAULT),
        ("works on a frame", True, Quality.PROCESS_FAULT),
    ],
)
def test_a_process_that_ends_ends_by_its_driver_or_by_itself(moment: str, crashed: bool, quality: Quality) -> None:
    bench = Bench()
    if moment != "builds":
        bench.ready()
    if moment not in ("builds", "opens"):
        bench.open()
        bench.look()
    if moment == "works on a frame":
        bench.frame()
    bench.die("was killed by SIGSEGV", crashed=crashed)
    assert bench.qualities()[-1] is quality
    assert "vision process was killed by SIGSEGV" in bench.readings[-1].detail
    bench.until_started()
    assert counts(bench)[3:] == ((0, 1) if quality is Quality.LINK_DOWN else (1, 0))


def test_a_source_is_opened_again_with_a_delay_and_only_when_the_old_process_is_gone() -> None:
    bench = Bench()
    bench.ready()
    old = bench.token
    bench.settle(after_ms=10_000)
    bench.settle(after_ms=4000)
    assert old == bench.token  # it can't be killed: there is no second one
    bench.die()
    assert old != bench.token
    assert counts(bench) == (0, 0, 0, 0, 1)


def test_the_delay_grows_for_a_camera_that_cannot_be_opened() -> None:
    bench = Bench(first_ms=100_000)  # the machine has been up for longer than any delay
    delays = []
    for _ in range(5):
        bench.ready()
        bench.lose()
        bench.die()
        delays.append(bench.until_started(run=False))
    assert delays[4] > delays[2] > delays[0]


def test_the_counters_distinguish_failed_processes_from_lost_sources() -> None:
    bench = running()
    bench.lose()
    bench.die()
    bench.until_started()
    bench.look()
    bench.fail("no")
    bench.die()
    bench.until_started()
    assert counts(bench)[3:] == (1, 1)


def test_the_delay_grows_and_is_forgotten_after_a_good_while() -> None:
    bench = running()

    def lose() -> int:
        bench.lose()
        bench.die()
        return bench.until_started()

    delays = [lose() for _ in range(7)]
    for waited, ceiling in zip(delays, (500, 1000, 2000, 4000, 5000, 5000, 5000), strict=True):
        assert 250 <= waited <= ceiling + 1
    assert len(set(delays)) > 4  # jitter
    for _ in range(11):  # well for more than five seconds
        bench.look()
        bench.settle(after_ms=500)
    assert 250 <= lose() <= 501


def test_nothing_captured_before_the_loss_is_reported_after_it() -> None:
    bench = running()
    bench.frame()
    bench.capture()
    bench.capture()
    bench.settle()
    bench.lose()
    bench.result()
    assert [(r.quality, r.detail, r.frame_id) for r in bench.readings] == [(Quality.LINK_DOWN, "cam: lost", 3)]
    assert counts(bench) == (0, 3, 0, 0, 0)


def test_frame_numbers_continue_in_the_next_process() -> None:
    bench = running()
    bench.look()
    bench.frame()
    bench.capture()
    bench.die()
    bench.until_started()
    assert bench.starts[-1].first_seq == 4
    bench.look()
    bench.lose()
    bench.die()
    bench.until_started()
    bench.look()
    assert bench.seqs() == [1, 2, 4, 4, 5]
    assert counts(bench) == (3, 1, 1, 1, 1)


def test_late_messages_of_a_process_given_up_are_ignored() -> None:
    bench = running()
    bench.look()
    old = bench.token
    bench.lose()
    bench.die()
    bench.until_started()
    known = len(bench.readings)
    deadline_ns = bench.monitor.next_deadline_ns()

    bench.monitor.result(old, FrameResult(9, bench.ns, SEEN, bench.ns), bench.ns)
    bench.monitor.opened(old, bench.ns, lossless=True, finite=True)
    bench.monitor.ready(old, bench.ns)
    bench.monitor.progress(FrameProgress(old, 99, bench.ns, 99, bench.ns, 1), bench.ns)
    assert bench.monitor.next_deadline_ns() == deadline_ns
    bench.monitor.source_lost(old, "too late", bench.ns)
    bench.monitor.failed(old, "too late", bench.ns)
    bench.monitor.gone(old, "too late", bench.ns)
    bench.settle()

    assert (known, bench.killed) == (len(bench.readings), {old: "cam: lost"})
    bench.look()
    assert bench.readings[-1].frame_id == 2


def test_a_configuration_error_gives_up_after_the_fault_was_reported() -> None:
    bench = Bench()
    bench.ready()
    bench.monitor.source_lost(bench.token, "camera.url: nonsense", bench.ns, config=True)
    actions = bench.settle()
    assert bench.given_up == ["camera.url: nonsense"]
    assert [type(action) for action in actions] == [Emit, Kill, GiveUp]
    bench.lose("again", config=True)
    assert len(bench.given_up) == 1


def test_there_is_nothing_to_do_until_the_next_deadline() -> None:
    bench = running()
    bench.look()
    for _ in range(5):
        assert bench.monitor.next_deadline_ns() == bench.ns + 500 * MS  # to look for work that has begun
        bench.capture()
        assert bench.settle(after_ms=500) == []


# What the process notes or sends may be nonsense: it is damaged, or somebody has taken it over.

NEVER_NS = 1 << 62


@pytest.mark.parametrize(
    "nonsense",
    [
        {"captured_ns": NEVER_NS},
        {"captured_ns": -NEVER_NS},
        {"detector_ns": NEVER_NS},
        {"work_began_ns": NEVER_NS, "work_seq": 2},
        {"work_began_ns": -NEVER_NS, "work_seq": 2},
        {"work_t_capture_ns": NEVER_NS},
        {"work_seq": NEVER_NS},
        {"captured_seq": NEVER_NS},
        {"captured_seq": -1},
        dict.fromkeys(("captured_seq", "captured_ns", "work_seq", "work_t_capture_ns", "work_began_ns"), NEVER_NS),
    ],
)
@pytest.mark.failure_mode("V5")
def test_notes_that_cannot_be_are_no_notes(nonsense: dict[str, int]) -> None:
    """The process is not silent for ever, and the numbers of the frames stay what they are."""
    bench = running()
    bench.look()
    bench.notes = replace(bench.notes, **nonsense)
    for _ in range(21):
        bench.settle(after_ms=100)
        deadline_ns = bench.monitor.next_deadline_ns()
        if not bench.killed:
            bench.notes = replace(bench.notes, detector_ns=nonsense.get("detector_ns", bench.ns))
            assert deadline_ns is not None
            assert deadline_ns <= bench.ns + 1000 * MS
    assert bench.killed == {bench.token: "vision process has stopped: no sign of life for 1 s"}
    assert bench.readings[-1].quality is Quality.PROCESS_FAULT
    bench.die()
    bench.until_started()
    assert bench.starts[-1].first_seq == 2
    assert counts(bench) == (1, 0, 0, 1, 0)


@pytest.mark.parametrize("settings_change", [False, True])
def test_a_fault_is_never_older_than_the_reading_before_it(*, settings_change: bool) -> None:
    """Whoever keeps the newest reading would go on with the good one."""
    bench = running()
    good = bench.look()
    if settings_change:
        bench.monitor = bench.monitor.successor(VisionConfig(deadline_s=0.5))
        bench.alive.clear()
        bench.settle()
        bench.ready()
        bench.open()
    bench.ms += 33
    bench.frame()
    bench.notes = replace(bench.notes, work_t_capture_ns=5)
    bench.die()
    assert bench.readings[-1].quality is Quality.PROCESS_FAULT
    assert bench.readings[-1].t_ns == good.t_ns


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"seq": 1}, "result of frame 1 after that of frame 1"),
        ({"seq": 0}, "result of frame 0 after that of frame 1"),
        ({"seq": -5}, "result of frame -5 after that of frame 1"),
        ({"seq": 1 << 63}, f"result of frame {1 << 63} after that of frame 1"),
        ({"seq": 2, "t_capture_ns": 1 << 63}, "result of a frame of another time"),
        ({"seq": 2, "t_capture_ns": -1}, "result of a frame of another time"),
    ],
)
@pytest.mark.failure_mode("V5")
def test_a_result_that_cannot_be_is_a_fault_of_the_process(changes: dict[str, int], why: str) -> None:
    bench = running()
    bench.look()
    bench.ms += 33
    bench.frame()
    message = structs.replace(FrameResult(2, bench.ns - 2 * MS, SEEN, bench.ns - 2 * MS), **changes)
    bench.monitor.result(bench.token, message, bench.ns)
    bench.settle()
    assert bench.qualities() == [Quality.GOOD, Quality.PROCESS_FAULT]
    assert bench.killed == {bench.token: f"vision process: {why}"}
    assert counts(bench)[:3] == (1, 0, 1)


def test_a_result_before_the_source_is_open_is_a_fault_of_the_process() -> None:
    bench = Bench()
    bench.ready()
    bench.monitor.result(bench.token, FrameResult(1, bench.ns, SEEN, bench.ns), bench.ns)
    bench.settle()
    assert bench.qualities() == [Quality.PROCESS_FAULT]


def test_a_source_is_opened_once() -> None:
    """A process that says again and again that it has a frame is silent all the same."""
    bench = running()
    bench.look()
    for _ in range(10):
        bench.ms += 100
        bench.notes = replace(bench.notes, detector_ns=bench.ns)
        bench.monitor.opened(bench.token, bench.ns, lossless=True, finite=True)
        bench.settle()
    assert bench.qualities() == [Quality.GOOD, Quality.LINK_DOWN]
    assert bench.readings[-1].detail == "cam: no frame within 1 s"


@pytest.mark.parametrize(("deadline_s", "allowed_s"), [(0.5, 1), (2.0, 2)])
def test_a_detector_that_hangs_between_two_frames_is_noticed_though_the_camera_goes_on(
    deadline_s: float, allowed_s: int
) -> None:
    bench = running()
    bench.monitor.vision = VisionConfig(deadline_s=deadline_s)
    bench.look()
    hangs_ms = bench.ms
    hangs_ns = bench.ns
    while not bench.killed:
        assert bench.ms < hangs_ms + 5000
        bench.ms += 33
        bench.capture()
        bench.notes = replace(bench.notes, detector_ns=hangs_ns)
        bench.settle()
    assert 0 <= bench.ms - hangs_ms - 1000 * allowed_s <= 33
    assert bench.killed == {bench.token: f"vision process has stopped: no sign of its detector for {allowed_s} s"}
    assert bench.qualities()[-1] is Quality.PROCESS_FAULT
    assert not bench.monitor.reads_messages(bench.ns)


@pytest.mark.parametrize("noted", [False, True])
def test_after_a_long_detection_the_next_frame_has_its_moment(*, noted: bool) -> None:
    """Its capture thread waited for the detector to take the frame before, or for the interpreter's lock; and the
    result may be here before the end of the work is noted."""
    bench = running(lossless=True)
    bench.monitor.vision = VisionConfig(deadline_s=3.0)
    bench.frame()
    bench.capture()  # waits to be looked at
    waiting = bench.notes
    bench.settle(after_ms=2990)
    bench.monitor.result(bench.token, FrameResult(1, waiting.work_t_capture_ns, SEEN, 0), bench.ns)
    bench.notes = replace(waiting, work_began_ns=0, detector_ns=bench.ns) if noted else waiting
    bench.settle()
    bench.settle(after_ms=20)
    bench.begin()
    bench.settle(after_ms=2000)
    bench.result()
    assert (bench.qualities(), bench.killed) == ([Quality.GOOD] * 2, {})


# Films.


def test_the_end_of_a_film_is_reported_after_its_last_frame() -> None:
    bench = running(lossless=True)
    old = bench.token
    for _ in range(3):
        bench.look()
    bench.lose("film: ended")
    bench.die("ended with exit code 1")
    assert bench.qualities() == [Quality.GOOD] * 3 + [Quality.LINK_DOWN]
    assert bench.readings[-1].detail == "film: ended"
    bench.settle(after_ms=501)
    assert bench.token != old
    assert bench.starts[-1].discard == 0  # it is a film to be repeated


def test_a_film_in_which_no_frame_may_be_skipped_continues_after_the_frame_that_a_detector_failed_on() -> None:
    bench = running(lossless=True, finite=True)
    bench.look()
    bench.frame()
    bench.capture()  # waits for the detector, and is read again
    bench.die()
    assert bench.starts[-1] == Start(bench.token, first_seq=3, discard=2)
    bench.die()  # while its detector is built
    bench.until_started()
    assert bench.starts[-1] == Start(bench.token, first_seq=3, discard=2)
    bench.look()
    assert [(r.frame_id, r.quality) for r in bench.readings] == [
        (1, Quality.GOOD),
        (2, Quality.PROCESS_FAULT),
        (2, Quality.PROCESS_FAULT),
        (3, Quality.GOOD),
    ]
    assert counts(bench) == (2, 0, 1, 2, 0)


@pytest.mark.parametrize("lossless", [False, True])
@pytest.mark.parametrize("how", ["ended", "silent", "killed"])
@pytest.mark.failure_mode("C9")
def test_a_film_that_was_lost_after_its_first_frame_is_not_begun_again(lossless: bool, how: str) -> None:
    bench = running(lossless=lossless, finite=True)
    bench.look()
    match how:
        case "ended":
            bench.lose("film.avi: ended")
            why = "film.avi: ended"
        case "silent":
            bench.settle(after_ms=600)
            bench.notes = replace(bench.notes, detector_ns=bench.ns)
            bench.settle(after_ms=400)
            why = "cam: no frame within 1 s"
        case _ if lossless:
            bench.die()
            assert bench.starts[-1].discard == 1
            bench.ready()
            bench.lose("film.avi: no such file")  # nor when it was to be continued
            why = "film.avi: no such file"
        case _:
            bench.die()
            why = "vision process was killed by SIGKILL"
    if bench.alive:
        bench.die()
    assert [quality for quality in bench.qualities() if quality is not Quality.PROCESS_FAULT] == [
        Quality.GOOD,
        Quality.LINK_DOWN,
    ]
    assert bench.readings[-1].detail == f"{why}; it begins again only with camera.loop = true"
    assert bench.monitor.next_deadline_ns() is None
    for _ in range(100):
        assert bench.settle(60_000) == []
    successor = bench.monitor.successor(VisionConfig(coast_s=0.1))  # nor with other settings
    assert (successor.settle(bench.ns), successor.next_deadline_ns()) == ([], None)


def test_a_film_that_cannot_be_opened_yet_is_tried_again() -> None:
    bench = Bench(finite=True)
    bench.ready()
    old = bench.token
    bench.lose("film.avi: no such file or folder")
    bench.die()
    bench.until_started()
    assert bench.readings[-1].detail == "film.avi: no such file or folder"
    assert bench.token != old


# Other settings.


def test_with_other_settings_numbers_continue_and_what_was_worked_on_is_counted() -> None:
    bench = running()
    bench.look()
    bench.frame()
    bench.capture()
    bench.settle()
    successor = bench.monitor.successor(VisionConfig(deadline_s=0.25))
    (start,) = successor.settle(bench.ns)
    assert isinstance(start, Start)
    assert (start.first_seq, start.discard, start.token > bench.token) == (4, 0, True)
    stats = successor.stats
    assert (stats.frames, stats.skipped, stats.lost, stats.restarts, stats.reopens) == (1, 1, 1, 0, 0)


# Everything at once.


class Chaos(RuleBasedStateMachine):
    """Any order of frames, results, deaths, hangs and silence, live or lossless, endless or finite."""

    @initialize(lossless=st.booleans(), finite=st.booleans())
    def begin(self, lossless: bool, finite: bool) -> None:
        self.bench = Bench(lossless=lossless, finite=finite)

    @property
    def at_work(self) -> bool:
        return self.bench.notes.work_began_ns > 0

    @property
    def opened(self) -> bool:
        return bool(self.bench.alive) and self.bench.monitor._opened_ns > 0

    @rule()
    def ready(self) -> None:
        self.bench.ready()

    @rule()
    def opens(self) -> None:
        if self.bench.alive and self.bench.seq == self.bench.starts[-1].first_seq - 1:
            self.bench.open()

    @rule(n=st.integers(1, 4))
    def frames(self, n: int) -> None:
        for _ in range(n if self.opened and not self.bench.lossless else 0):
            self.bench.capture()
        if self.opened and self.bench.lossless and self.bench.seq == self.bench.notes.work_seq:
            self.bench.capture()
        self.bench.settle()

    @rule()
    def work_begins(self) -> None:
        if self.opened and not self.at_work and self.bench.seq > max(self.bench.notes.work_seq, 0):
            self.bench.begin()

    @rule(detection=st.sampled_from((SEEN, EMPTY)))
    def result(self, detection: Detection) -> None:
        if self.bench.alive and self.at_work:
            self.bench.result(detection)

    @rule(crashed=st.booleans())
    def dies(self, crashed: bool) -> None:
        if self.bench.alive:
            self.bench.die(crashed=crashed)

    @rule(source=st.booleans())
    def fails(self, source: bool) -> None:
        if source:
            self.bench.lose()
        else:
            self.bench.fail("no")

    @rule(ms=st.sampled_from((1, 20, 300, 1100, 11_000)))
    def time_passes(self, ms: int) -> None:
        self.bench.settle(after_ms=ms)

    @invariant()
    def readings_never_go_back(self) -> None:
        seqs = [r.frame_id for r in self.bench.readings if r.quality in (Quality.GOOD, Quality.NO_TARGET)]
        assert seqs == sorted(set(seqs))
        assert self.bench.seqs() == sorted(self.bench.seqs())

    @invariant()
    def every_frame_is_accounted_for(self) -> None:
        frames, skipped, lost, *_ = counts(self.bench)
        assert min(frames, skipped, lost) >= 0
        assert frames + skipped + lost == max(self.bench.seqs(), default=0)

    @invariant()
    def a_process_that_has_failed_is_ended_and_one_that_hangs_is_noticed(self) -> None:
        deadline_ns = self.bench.monitor.next_deadline_ns()
        if self.bench.alive and self.bench.token not in self.bench.killed:
            assert deadline_ns is not None
            assert deadline_ns <= self.bench.ns + 40_000 * MS


TestChaos = Chaos.TestCase
TestChaos.settings = settings(max_examples=examples(60), stateful_step_count=40, deadline=None)


@pytest.mark.failure_mode("C11")
@pytest.mark.parametrize(
    ("camera", "quality"),
    [
        (CameraConfig(url="rtsp://h/"), Quality.STALE),
        (CameraConfig(url="HTTP://h/"), Quality.STALE),
        (CameraConfig(url="/dev/video0"), Quality.GOOD),
        (CameraConfig(url="pattern://"), Quality.GOOD),
        (CameraConfig(url="rtsp://h/", unproven_age="accept"), Quality.GOOD),
        (CameraConfig(url="/dev/video0", unproven_age="refuse"), Quality.STALE),
    ],
)
def test_frames_whose_age_nothing_proves_are_refused_or_accepted(camera: CameraConfig, quality: Quality) -> None:
    """A stream's are refused unless told otherwise; of proven ones nothing changes."""
    for proof, expected in ((AgeProof.UNPROVEN, quality), (AgeProof.PRESENTATION_TIME, Quality.GOOD)):
        bench = Bench()
        bench.monitor.camera = camera
        bench.ready()
        bench.open()
        bench.frame()
        message = FrameResult(1, bench.ns - 2 * MS, SEEN, bench.ns - 2 * MS, age_proof=proof)
        bench.monitor.result(bench.token, message, bench.ns)
        bench.settle()
        reading = bench.readings[-1]
        assert (reading.quality, reading.age_proof) == (expected, proof)
        assert (reading.detail == "") == (expected is Quality.GOOD)
