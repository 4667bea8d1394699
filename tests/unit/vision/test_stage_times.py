"""Per-stage times on their way from a reading through the state to the technician's screen."""

import io

from rich.console import Console

from gateway.cli.view import bay_panel
from gateway.config import BayConfig
from gateway.core import fusion
from gateway.core.detection import Circle
from gateway.core.readings import Quality, VisionReading
from gateway.core.state import StateVector
from tests import fused

NOW_NS = 5_000_000_000
TIMES = (("gaussian", 640_000), ("hsv", 349_000), ("contours", 51_000), ("normalise", 0))


def state_after(reading: VisionReading) -> StateVector:
    return fused.step(fusion.initial("bay1", NOW_NS), reading, NOW_NS + 1, BayConfig().fusion)


def shown(state: StateVector) -> list[str]:
    screen = io.StringIO()
    Console(file=screen, width=200).print(bay_panel(BayConfig(), state, NOW_NS))
    return [line.strip("│ ") for line in screen.getvalue().splitlines()]


def test_stage_times_reach_the_state_and_have_a_line_of_their_own() -> None:
    state = state_after(VisionReading(NOW_NS, Quality.GOOD, Circle(1.0, 2.0, 3.0), 7, stage_ns=TIMES))

    assert state.vision.stage_ns == TIMES
    lines = shown(state)
    at = lines.index("stages: gaussian 0.6 ms · hsv 0.3 · contours 0.1 · normalise 0.0")
    assert lines[at - 1].startswith("latency ")


def test_a_frame_without_a_marker_has_its_times_too() -> None:
    assert state_after(VisionReading(NOW_NS, Quality.NO_TARGET, frame_id=7, stage_ns=TIMES)).vision.stage_ns == TIMES


def test_without_a_result_there_is_no_line() -> None:
    lines = shown(state_after(VisionReading(NOW_NS, Quality.LINK_DOWN, detail="unplugged")))

    assert "camera: unplugged" in lines
    assert not any("stages" in line for line in lines)
