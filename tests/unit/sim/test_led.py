"""The beacon's LED in rendered pictures: from the simulated board through the camera to the bay's own step."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gateway.config import parse as settings
from gateway.core import interlock
from gateway.core.beacon import BeaconLight, BeaconStatus
from gateway.core.detection import Circle
from gateway.core.interlock import Rules
from gateway.core.readings import Quality, VisionReading
from gateway.core.state import Reason, StateVector, Tick
from gateway.ranger.hcsr04.session import Hcsr04Session
from gateway.sim.camera import SimCameraSpec
from gateway.sim.led import CYCLES, Led, LedFile
from gateway.sim.ranger_board import POWER_ON, RangerBoard
from gateway.sim.scenario import parse
from gateway.vision.picture.beacon import BeaconMeter
from gateway.vision.source.contract import Frame
from gateway.vision.source.framing import Framing
from tests.virtual_time import BlockingClock

MS = 1_000_000
S = 1000 * MS
T0 = 100 * S
PLACE = {"u_px": 130.0, "v_px": 25.0, "radius_px": 4.0}
CONFIG = settings(
    {
        "camera": {"beacon": PLACE},
        "ranger": {"hcsr04": {"beacon": True}},
        "fusion": {"recovery_s": 0.0, "clear_hold_s": 0.0},
    }
)
SMALL = {"width_px": 160, "height_px": 120, "focal_px": 150, "fps": 25}
FAULT_S = 8.0


def states(folder: Path, fault: dict[str, Any] | None = None) -> Iterator[tuple[float, StateVector]]:
    """World time, s, and the state after each frame; the detector finds the marker in every one."""
    bay = CONFIG.bays[0]
    rules = Rules.of(bay, CONFIG)
    faults = [] if fault is None else [{"at_s": FAULT_S, "for_s": 60.0, **fault}]
    scenario = parse({"camera": SMALL, "start": {"distance_cm": 60}, "faults": faults})
    board, session = RangerBoard(lambda _: 600.0), Hcsr04Session(bay.ranger)
    path = str(folder / "led")
    board.show = (file := LedFile(path)).show
    clock = BlockingClock(T0)
    camera = SimCameraSpec(scenario, T0, led=Led.of(bay.camera, path, (160, 120))).open(clock)
    assert bay.camera.beacon is not None
    meter = BeaconMeter(bay.camera.beacon)
    board.boot(T0, POWER_ON)
    session.opened(T0)
    state = interlock.initial("bay1", T0, rules)
    try:
        while True:
            frame = camera.read()
            for now_ns in range(clock.now - 35 * MS, clock.now + 1, 5 * MS):
                board.hear(session.request(now_ns), now_ns)
                for reading in session.feed(board.advance(now_ns), now_ns):
                    state = interlock.step(state, reading, now_ns, rules)
            level = meter.level(frame.image)
            assert level is not None
            light = BeaconLight(frame.t_capture_ns, level)
            seen = VisionReading(frame.t_capture_ns, Quality.GOOD, Circle(80.0, 60.0, 22.0), beacon=light)
            state = interlock.step(state, seen, clock.now, rules)
            state = interlock.step(state, Tick(), clock.now, rules)
            yield (clock.now - T0) / S, state
    finally:
        file.close()


def test_rendered_pictures_of_the_present_are_proven_and_a_delay_is_measured(tmp_path: Path) -> None:
    until = [(t_s, state) for (t_s, state), _ in zip(states(tmp_path), range(10 * 25), strict=False)]
    proven = [t_s for t_s, state in until if state.beacon.status is BeaconStatus.PROVEN]
    assert proven[0] < 5.0
    assert len(proven) == len([t_s for t_s, _ in until if t_s >= proven[0]])
    lag_ns, latency_ns = until[-1][1].beacon.lag_ns, until[-1][1].beacon.latency_ns
    assert lag_ns is not None
    assert -20 * MS <= lag_ns <= 20 * MS
    assert latency_ns == max(0, lag_ns)
    assert not until[-1][1].stop


@pytest.mark.failure_mode("C12")
@pytest.mark.parametrize(
    "fault",
    [
        pytest.param({"kind": "camera_looped"}, id="looped"),
        pytest.param({"kind": "camera_late", "delay_s": 0.9}, id="late"),
        pytest.param({"kind": "camera_stuck"}, id="frozen"),
    ],
)
def test_pictures_of_another_time_are_noticed_within_two_seconds(fault: dict[str, Any], tmp_path: Path) -> None:
    course = states(tmp_path, fault)
    before = next(state for t_s, state in course if t_s >= FAULT_S)
    assert (before.stop, before.beacon.status) == (False, BeaconStatus.PROVEN)
    t_s, state = next((t_s, state) for t_s, state in course if state.reason is Reason.BEACON_LOST)
    assert t_s <= FAULT_S + 2.0
    assert (state.stop, state.beacon.status, state.vision.quality) == (True, BeaconStatus.LOST, Quality.STALE)


def test_late_pictures_are_late_by_the_beacon(tmp_path: Path) -> None:
    course = states(tmp_path, {"kind": "camera_late", "delay_s": 0.9})
    late = next(state for t_s, state in course if t_s > FAULT_S and state.beacon.status is BeaconStatus.LATE)
    assert late.beacon.lag_ns is not None
    assert 870 * MS <= late.beacon.lag_ns <= 930 * MS
    assert late.stop


def test_an_exposure_sees_the_share_of_its_time_in_which_it_is_lit(tmp_path: Path) -> None:
    led = Led(str(tmp_path / "led"), 0.0, 0.0, 4.0)
    assert led.lit(0, 10) == 0.0
    file = LedFile(led.path)
    for n in range(CYCLES + 4):  # the oldest four are forgotten
        file.show(60 * MS * n, n % 2 == 1)
    file.close()
    assert led.lit(60 * MS * 9, 60 * MS * 10) == 1.0
    assert led.lit(60 * MS * 9 + 50 * MS, 60 * MS * 10 + 30 * MS) == pytest.approx(0.25)
    assert led.lit(60 * MS * 10, 60 * MS * 10) == 0.0
    assert led.lit(60 * MS * (CYCLES + 3), 60 * MS * (CYCLES + 9)) == 1.0  # the newest goes on
    assert led.lit(60 * MS, 120 * MS) == 0.0


@pytest.mark.parametrize("turn", [0, 90, 180, 270])
def test_the_led_is_drawn_where_the_used_picture_is_to_show_it(turn: int) -> None:
    """Of 160 x 120 px the part of 100 x 110 px at (10, 5) is used, and turned."""
    framing = Framing((10, 5, 100, 110), turn)
    image = np.zeros((120, 160, 3), np.uint8)
    u, v = framing.delivered(7, 20, (160, 120))
    image[int(v), int(u)] = 255
    assert np.argwhere(framing.used(Frame(image, T0)).pixels[..., 0]).tolist() == [[20, 7]]
