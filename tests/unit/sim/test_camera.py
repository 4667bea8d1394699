"""The simulated camera keeps the contract of a source: paced, stamped, honest about its faults. No real time passes."""

import numpy as np
import pytest

from gateway.errors import LinkError
from gateway.sim.camera import SimCamera, SimCameraSpec
from gateway.sim.render import render
from gateway.sim.scenario import Scenario, parse
from gateway.sim.world import World
from gateway.vision.transport.messages import SourceRecord
from tests.virtual_time import BlockingClock

MS = 1_000_000
S = 1_000_000_000
ORIGIN_NS = 7_000 * S + 123
SMALL = {"camera": {"width_px": 160, "height_px": 120, "focal_px": 150, "fps": 25}}
DRIVE = {**SMALL, "legs": [{"distance_cm": 50, "speed_cm_s": 50}]}


def opened(clock: BlockingClock, scenario: Scenario | None = None) -> SimCamera:
    return SimCameraSpec(scenario or parse(DRIVE), ORIGIN_NS).open(clock)


@pytest.mark.long
@pytest.mark.one_interpreter
def test_frames_come_at_the_scenarios_rate() -> None:
    clock = BlockingClock(ORIGIN_NS)
    camera = opened(clock)
    stamps = [camera.read().t_capture_ns - ORIGIN_NS for _ in range(5)]

    assert stamps == [40 * MS, 80 * MS, 120 * MS, 160 * MS, 200 * MS]
    assert camera.lossless is False


def test_a_late_reader_gets_the_frame_of_now_and_then_the_old_rhythm() -> None:
    clock = BlockingClock(ORIGIN_NS)
    camera = opened(clock)
    camera.read()
    clock.now = ORIGIN_NS + 1_013 * MS
    late, after = camera.read(), camera.read()

    assert late.t_capture_ns == ORIGIN_NS + 1_013 * MS
    assert after.t_capture_ns == ORIGIN_NS + 1_040 * MS


def test_a_stuck_camera_shows_one_picture_with_new_times_and_then_the_world_again() -> None:
    clock = BlockingClock(ORIGIN_NS)
    scenario = parse({**DRIVE, "faults": [{"kind": "camera_stuck", "at_s": 0.2, "for_s": 0.39}]})
    camera = opened(clock, scenario)
    frames = [camera.read() for _ in range(20)]
    assert [frame.t_capture_ns - ORIGIN_NS for frame in frames] == [40 * MS * n for n in range(1, 21)]
    same = [np.array_equal(frame.image, frames[4].image) for frame in frames]
    assert same == [False] * 4 + [True] * 10 + [False] * 6
    np.testing.assert_array_equal(frames[4].image, render(scenario, World(scenario).truth(0.2), 5))
    np.testing.assert_array_equal(frames[14].image, render(scenario, World(scenario).truth(0.6), 15))


@pytest.mark.parametrize(("noise", "may_repeat"), [(2, False), (0, True)])
def test_only_a_camera_without_noise_may_show_the_same_twice(noise: float, may_repeat: bool) -> None:
    scenario = parse({**DRIVE, "camera": {**SMALL["camera"], "noise": noise}})
    assert opened(BlockingClock(ORIGIN_NS), scenario).may_repeat is may_repeat


def test_the_frame_shows_the_world_at_its_stamp() -> None:
    clock = BlockingClock(ORIGIN_NS)
    scenario = parse(DRIVE)
    camera = opened(clock, scenario)
    clock.now = ORIGIN_NS + 1_777 * MS
    frame = camera.read()
    truth = World(scenario).truth((frame.t_capture_ns - ORIGIN_NS) / S)

    np.testing.assert_array_equal(frame.image, render(scenario, truth, 44))
    assert frame.image.shape == (120, 160, 3)


def test_a_replaced_camera_shows_the_same_world() -> None:
    frames = []
    for start_ms in (0, 900):
        clock = BlockingClock(ORIGIN_NS + start_ms * MS)
        spec = SourceRecord.of(SimCameraSpec(parse(DRIVE), ORIGIN_NS, "bay 3")).spec()
        camera = spec.open(clock)
        clock.now = ORIGIN_NS + 1_000 * MS
        frames.append(camera.read().image)

    np.testing.assert_array_equal(frames[0], frames[1])


def test_before_world_time_0_there_are_frames_too() -> None:
    clock = BlockingClock(ORIGIN_NS - 990 * MS)
    camera = opened(clock)

    assert camera.read().t_capture_ns == ORIGIN_NS - 960 * MS
    assert camera.read().t_capture_ns == ORIGIN_NS - 920 * MS


def test_a_clock_that_wakes_early_is_waited_for_again() -> None:
    class Hasty(BlockingClock):
        def block(self, seconds: float) -> None:
            super().block(seconds / 2)

    clock = Hasty(ORIGIN_NS)
    stamp = opened(clock).read().t_capture_ns

    assert stamp - ORIGIN_NS >= 40 * MS


def faulty(kind: str) -> Scenario:
    return parse({**SMALL, "faults": [{"kind": kind, "at_s": 1.0, "for_s": 2.0}]})


def test_a_frozen_camera_blocks_and_then_goes_on() -> None:
    clock = BlockingClock(ORIGIN_NS)
    camera = opened(clock, faulty("camera_freeze"))
    clock.now = ORIGIN_NS + 990 * MS
    camera.read()
    frame = camera.read()

    assert 3_000 * MS <= frame.t_capture_ns - ORIGIN_NS < 3_050 * MS
    assert len(clock.waits) > 30, "it looks again and again, so that the end is noticed"


def test_a_lost_camera_raises_on_read_and_on_open_while_it_lasts() -> None:
    clock = BlockingClock(ORIGIN_NS)
    camera = opened(clock, faulty("camera_lost"))
    clock.now = ORIGIN_NS + 990 * MS
    camera.read()

    with pytest.raises(LinkError, match="simulated camera: the camera is lost"):
        camera.read()
    with pytest.raises(LinkError, match="the camera is lost"):
        opened(clock, faulty("camera_lost"))
    clock.now = ORIGIN_NS + 3_000 * MS
    assert opened(clock, faulty("camera_lost")).read().image.shape == (120, 160, 3)


def test_a_camera_lost_while_frozen_is_reported_lost() -> None:
    freeze, lost = ({"kind": k, "at_s": a, "for_s": 5.0} for k, a in (("camera_freeze", 1.0), ("camera_lost", 2.0)))
    clock = BlockingClock(ORIGIN_NS)
    camera = opened(clock, parse({**SMALL, "faults": [freeze, lost]}))
    clock.now = ORIGIN_NS + 1_000 * MS

    with pytest.raises(LinkError):
        camera.read()
    assert 2_000 * MS <= clock.now - ORIGIN_NS < 2_050 * MS


def test_a_black_camera_goes_on_sending() -> None:
    clock = BlockingClock(ORIGIN_NS)
    camera = opened(clock, faulty("camera_black"))
    clock.now = ORIGIN_NS + 500 * MS
    bright = camera.read().image.mean()
    clock.now = ORIGIN_NS + 1_500 * MS

    assert bright > 50
    assert camera.read().image.mean() < 3


def test_closing_twice_is_fine_and_reading_after_it_is_not() -> None:
    camera = opened(BlockingClock(ORIGIN_NS))
    camera.close()
    camera.close()

    with pytest.raises(LinkError, match="closed"):
        camera.read()


def test_the_spec_is_small_on_the_wire() -> None:
    assert len(SourceRecord.of(SimCameraSpec(parse(DRIVE), ORIGIN_NS)).fields) < 10_000
