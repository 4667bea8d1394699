"""How often a line may be written: a fault that comes and goes must not fill the disk; no line is lost uncounted."""

import asyncio
import io
import logging
import random
import re
from functools import partial

import pytest

from gateway.alarms.definition import GatewayConditions
from gateway.alarms.monitor import AlarmMonitor
from gateway.alarms.records import AlarmChange
from gateway.bay import BayControl
from gateway.config import BayConfig, FusionConfig, Reconnect
from gateway.core.detection import Circle
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.errors import LinkError
from gateway.hub import Hub
from gateway.logs.folding import Folding, LogCounts, kind_of
from gateway.logs.lines import formatter
from gateway.logs.setup import FoldingHandler
from gateway.supervisor import Supervisor, Task
from tests.virtual_time import LoopClock, run

S = 1_000_000_000
FAILED = "camera /dev/video0: read failed"
REPEATED = re.compile(r" \(repeated (once|(\d+) times)\)$")


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("bay1: frame 17 lost, age 0.25 s", "bay1: frame 9 lost, age 12 s", True),
        ("bay1: start", "bay2: start", False),
        ("10.0.0.7:502: refused", "10.0.0.8:1502: refused", True),
        ("/dev/ttyACM0: no such device", "/dev/ttyACM1: no such device", False),
        ("moved -3 mm", "moved 4 mm", True),
    ],
)
def test_lines_that_differ_in_numbers_alone_are_of_one_kind(one: str, other: str, same: bool) -> None:
    assert (kind_of(one) == kind_of(other)) is same


class TestFolding:
    def test_twenty_of_a_kind_then_one_in_two_minutes_with_the_number_of_the_others(self) -> None:
        folding: Folding[int] = Folding()
        written: list[int | tuple[int, int]] = []
        for second in range(600):
            written += [(one.line, one.times) for one in folding.due(second * S)]
            if folding.admits("a", second, second * S):
                written.append(second)
        assert written == [*range(20), (119, 100), (239, 120), (359, 120), (479, 120)]
        assert [(one.line, one.times) for one in folding.due(599 * S, all_of_them=True)] == [(599, 120)]

    def test_kinds_do_not_share(self) -> None:
        folding: Folding[int] = Folding()
        assert sum(folding.admits("a", 0, 0) for _ in range(50)) == 20
        assert folding.admits("b", 0, 0)

    @pytest.mark.long
    @pytest.mark.one_interpreter
    def test_all_together_have_a_limit_whatever_their_kinds(self) -> None:
        """A peer may choose the text."""
        folding: Folding[int] = Folding()
        admitted, reported, told = 0, 0, 0
        for n in range(20_000):
            due = folding.due(n * S // 10)
            reported, told = reported + len(due), told + sum(one.times for one in due)
            admitted += folding.admits(f"kind {n}", n, n * S // 10)
        assert admitted + reported <= 1000 + 2000 / 4
        told += sum(one.times for one in folding.due(2000 * S, all_of_them=True))
        assert admitted + told == 20_000


class TestHandler:
    def lines(self, texts: list[tuple[int, str]], *, folded: bool = True) -> list[str]:
        """What is written of these, each logged at a second."""
        out, now_s = io.StringIO(), 0
        handler = FoldingHandler(out, Folding() if folded else None, lambda: now_s * S)
        for second, text in texts:
            now_s = second
            handler.handle(logging.LogRecord("gateway.x", logging.INFO, "x.py", 1, text, (), None))
        handler.report(all_of_them=True)
        return out.getvalue().splitlines()

    def test_no_line_is_lost_uncounted(self) -> None:
        rng = random.Random(1)
        texts = [(n // 3, rng.choice(["up 1", "down 2", "up 3", "seldom"])) for n in range(5000)]
        lines = self.lines(texts)
        counted = sum(1 if (m := REPEATED.search(line)) is None else int(m[2] or 1) for line in lines)
        assert counted == 5000
        assert len(lines) < 120
        assert len(self.lines(texts, folded=False)) == 5000

    def test_at_debug_every_line_is_written_and_the_level_can_change(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(logging, "root", logging.RootLogger(logging.INFO))
        out = io.StringIO()
        handler = FoldingHandler(out, Folding(), lambda: 0)

        def log_fifty() -> list[str]:
            out.truncate(out.seek(0))
            for n in range(50):
                handler.handle(logging.LogRecord("gateway.x", logging.INFO, "x.py", 1, f"line {n}", (), None))
            return out.getvalue().splitlines()

        assert len(log_fifty()) == 20
        out.truncate(out.seek(0))
        handler.set_level("debug")
        assert (out.getvalue(), logging.getLogger().level) == ("line 49 (repeated 30 times)\n", logging.DEBUG)
        assert len(log_fifty()) == 50
        handler.set_level("warning")
        assert (len(log_fifty()), logging.getLogger().level) == (20, logging.WARNING)
        assert handler.counts() == LogCounts(folded=60, lost=0)

    def test_arguments_that_do_not_fit_do_not_end_what_is_logged(self, capsys: pytest.CaptureFixture[str]) -> None:
        handler = FoldingHandler(io.StringIO(), Folding(), lambda: 0)
        handler.handle(logging.LogRecord("gateway.x", logging.INFO, "x.py", 1, "%d", ("x",), None))
        assert "--- Logging error ---" in capsys.readouterr().err


@pytest.mark.one_interpreter
@pytest.mark.long
def test_a_camera_that_comes_and_goes_writes_less_than_half_a_megabyte_a_day() -> None:
    """A marginal cable: half a second of frames, then none until it is opened again, and so on; all that logs it takes
    part: bay, alarms, supervisor. The second quarter of an hour is that of every later one."""
    quarter_s = 900.0
    folded, plain = io.StringIO(), io.StringIO()
    sizes: list[tuple[int, int]] = []

    async def main() -> None:
        clock = LoopClock()
        handlers = [
            FoldingHandler(folded, Folding(), clock.now_ns),
            FoldingHandler(plain, None, clock.now_ns),
        ]
        for handler in handlers:
            handler.setFormatter(formatter("text", journal=False))
            logging.getLogger("gateway").addHandler(handler)
        hub = Hub(["bay1"])
        bay = BayConfig(fusion=FusionConfig(period_s=0.1))
        control = BayControl(bay, hub, clock)

        async def camera() -> None:
            for _ in range(12):
                control.on_reading(VisionReading(clock.now_ns(), Quality.GOOD, Circle(300.0, 200.0, 60.0)))
                await clock.sleep(0.1)
            control.on_reading(VisionReading(clock.now_ns(), Quality.LINK_DOWN, detail=FAILED))
            raise LinkError(FAILED)

        async def ranger() -> None:
            while True:
                control.on_reading(RangeReading(clock.now_ns(), Quality.GOOD, 900.0))
                await clock.sleep(0.2)

        def on_alarm(change: AlarmChange) -> None:
            logging.getLogger("gateway.app").info("alarm %s", change)

        monitor = AlarmMonitor({"bay1": bay}, lambda _: control.state(), clock, on_alarm)
        tasks = [
            Task("bay1.vision", camera, Reconnect(min_s=0.05, max_s=0.1)),
            Task("bay1.ranger", ranger),
            Task("alarms", partial(monitor.run, GatewayConditions)),
        ]
        tasks.append(Task("bay1.control", control.run))
        running = asyncio.create_task(Supervisor(tasks, clock, random.Random(7)).run())
        try:
            for _ in range(2):
                await clock.sleep(quarter_s)
                sizes.append((len(folded.getvalue()), len(plain.getvalue())))
        finally:
            running.cancel()
            for handler in handlers:
                logging.getLogger("gateway").removeHandler(handler)

    logger = logging.getLogger("gateway")
    before, propagated = logger.level, logger.propagate
    logger.setLevel("INFO")
    logger.propagate = False
    try:
        run(main())
    finally:
        logger.setLevel(before)
        logger.propagate = propagated
    (first, first_plain), (both, both_plain) = sizes
    assert 96 * (both_plain - first_plain) > 20_000_000, "it does come and go"
    assert 96 * (both - first) < 500_000
    assert first < 40_000
