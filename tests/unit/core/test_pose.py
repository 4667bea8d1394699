"""The metric pose: expected numbers from the projection of discs whose place is known."""

from math import cos, hypot, inf, nan, pi, radians, sin

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.config import BayConfig, CrossCheck, DriveConfig, FusionConfig, GuidanceConfig, Intrinsics, VisionConfig
from gateway.core import interlock, pose
from gateway.core.detection import Circle, Ellipse
from gateway.core.interlock import Rules
from gateway.core.pose import MetricPose, Sight, metric_pose
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.shown import shown
from gateway.core.state import Reason, StateVector, Tick

S = 1_000_000_000
MS = 1_000_000
LENS = Intrinsics(fx=600.0, fy=600.0, cx=320.0, cy=240.0)
BARREL = Intrinsics(fx=600.0, fy=600.0, cx=320.0, cy=240.0, distortion=(-0.25, 0.08, 0.001, -0.0005))
MARKER = GuidanceConfig(marker_radius_mm=90.0)
AT_300 = FusionConfig(distance_threshold_mm=300.0)


def seen(circle: Circle | None, ellipse: Ellipse | None = None, t_ns: int = S) -> VisionReading:
    return VisionReading(t_ns, Quality.GOOD if circle else Quality.NO_TARGET, circle, ellipse=ellipse)


def heard(mm: float | None, air_c: float | None = 20.0, t_ns: int = S) -> RangeReading:
    return RangeReading(t_ns, Quality.NO_ECHO if mm is None else Quality.GOOD, mm, air_c=air_c)


def at(
    vision: VisionReading, distance: RangeReading, lens: Intrinsics = LENS, fusion: FusionConfig = AT_300,
    guidance: GuidanceConfig = MARKER, speed: float | None = 0.0, *, place_mm: float = 0.0, sound: bool = True,
) -> MetricPose | None:  # fmt: skip
    return metric_pose(vision, distance, S, Sight(lens, sound), fusion, guidance, speed, place_mm)


def numbers(of: MetricPose | None) -> tuple[float, ...]:
    assert of is not None
    return of.x_mm, of.y_mm, of.z_mm, of.x_sd_mm, of.y_sd_mm, of.z_sd_mm


def rim(x: float, y: float, z: float, tilt_deg: float, towards_deg: float, lens: Intrinsics = LENS) -> VisionReading:
    """A disc of 90 mm at (x, y, z) mm that leans back towards a direction in the picture."""
    tilt, way = radians(tilt_deg), radians(towards_deg)
    far = np.array([cos(way) * cos(tilt), sin(way) * cos(tilt), sin(tilt)])
    across = np.array([-sin(way), cos(way), 0.0])
    turns = np.linspace(0, 2 * pi, 720, endpoint=False)
    points = np.array([x, y, z]) + 90 * (np.outer(np.cos(turns), far) + np.outer(np.sin(turns), across))
    camera = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera, np.array(lens.distortion or (0.0,) * 4))[0]
    (u, v), (one, other), angle = cv2.fitEllipseDirect(pixels.astype(np.float32))
    if one < other:
        one, other, angle = other, one, angle + 90
    ellipse = Ellipse(u, v, one / 2, other / 2, radians(angle) % pi)
    return seen(Circle(u, v, one / 2), ellipse)


def test_a_circle_on_the_axis() -> None:
    """Depth of the camera 600 x 90 / 180 = 300 mm, variance 300^2 (0.005^2 + (0.1 / 180)^2) = 2.278; of the ranger
    4^2 / 12 + 1 + (300 x 0.00175 x 0.5)^2 = 2.402 mm^2: together 1.169. A tilt of 0.1 moves the ellipse's centre by
    0.3^2 x 0.1 of 300 mm."""
    found = numbers(at(seen(Circle(320.0, 240.0, 180.0)), heard(300.0)))
    assert found == pytest.approx((0, 0, 0, 2.7005, 2.7005, 1.0813), abs=1e-4)


def test_the_ellipse_of_a_disc_that_hangs_straight_says_more() -> None:
    found = numbers(at(seen(Circle(320.0, 240.0, 180.0), Ellipse(320.0, 240.0, 180.0, 180.0, 0.0)), heard(300.0)))
    assert found == pytest.approx((0, 0, 0, 0.05, 0.05, 1.0813), abs=1e-4)


def test_against_the_aim_point_at_the_places_distance_with_the_camera_behind_the_ranger() -> None:
    """Seen at (0.2, -0.1) in a depth of 450 mm: (90, -45) mm. The place at (0.1, 0) in 300 - 10 + 50 = 340 mm."""
    check = CrossCheck(focal_px=600.0, marker_radius_mm=90.0, camera_offset_mm=50.0)
    fusion = FusionConfig(distance_threshold_mm=300.0, cross_check=check)
    aim = GuidanceConfig(aim_u_px=380.0, aim_v_px=240.0)
    found = numbers(at(seen(Circle(440.0, 180.0, 120.0)), heard(400.0), LENS, fusion, aim, place_mm=10.0))
    assert found[:3] == pytest.approx((56.0, -45.0, 110.0), abs=1e-3)


@pytest.mark.parametrize("lens", [LENS, BARREL])
@pytest.mark.parametrize(("x", "y"), [(60.0, 0.0), (-45.0, 40.0)])
def test_the_centre_of_a_disc_that_hangs_straight_beside_the_axis(lens: Intrinsics, x: float, y: float) -> None:
    """The ellipse's own centre is up to 1.8 mm beside it; behind this lens the radius is up to 4 % smaller. The other
    disc that looks so would lean by 23 degrees, and counts for 4 %, of 11 mm."""
    found = at(rim(x, y, 300.0, 0.0, 0.0, lens), heard(300.0), lens)
    assert numbers(found)[:3] == pytest.approx((x, y, 0.0), abs=0.5)


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (60.0, 0.0), (-45.0, 40.0)])
@pytest.mark.parametrize("tilt_deg", [-40.0, -25.0, -15.0, -8.0, -3.0, 3.0, 8.0, 15.0, 25.0, 40.0])
@pytest.mark.parametrize("towards_deg", [0.0, 50.0])
def test_of_a_tilted_disc_one_of_two_is_exact(x: float, y: float, tilt_deg: float, towards_deg: float) -> None:
    """Without noise: place in the picture, and 90 mm in 300 mm."""
    vision = rim(x, y, 300.0, tilt_deg, towards_deg)
    assert vision.ellipse is not None
    points = [seen_at(vision.ellipse, 0.4 * pi * n) for n in range(5)]
    through = pose._through([((u - LENS.cx) / LENS.fx, (v - LENS.cy) / LENS.fy) for u, v in points])
    assert through is not None
    found = pose._possible(*through)
    assert found is not None
    off = min(hypot(300 * u - x, 300 * v - y, 1000 * (rho - 0.3)) for u, v, rho, _ in found)
    assert off < 0.02


def seen_at(ellipse: Ellipse, turn: float) -> tuple[float, float]:
    du, dv = ellipse.semi_major_px * cos(turn), ellipse.semi_minor_px * sin(turn)
    along, aside = cos(ellipse.angle_rad), sin(ellipse.angle_rad)
    return ellipse.u_px + du * along - dv * aside, ellipse.v_px + du * aside + dv * along


@pytest.mark.one_interpreter
def test_tilted_discs_are_within_their_stated_deviations() -> None:
    """As many of each tilt up to 30 degrees, to each side, anywhere in the picture: nine of ten are within twice
    theirs. By one Gaussian of 6 degrees it were 76 %."""
    within: dict[bool, list[float]] = {True: [], False: []}
    for x, y in ((0.0, 0.0), (70.0, 0.0), (-40.0, 30.0), (20.0, -70.0), (110.0, 60.0)):
        for tilt_deg in (2.0, 6.0, 10.0, 14.0, 18.0, 22.0, 26.0, 30.0):
            for towards_deg in range(0, 360, 40):
                found = numbers(at(rim(x, y, 500.0, tilt_deg, towards_deg), heard(500.0)))
                within[tilt_deg > 10] += [abs(found[0] - x) / found[3], abs(found[1] - y) / found[4]]
    for deviations in within.values():
        assert np.mean(np.array(deviations) <= 2) > 0.9


@pytest.mark.parametrize("tilt_deg", [-6.0, 6.0])
def test_on_the_axis_the_side_to_which_a_disc_leans_is_open_and_stated(tilt_deg: float) -> None:
    """0.3^2 sin 6 degrees of 300 mm are 2.8 mm to the ellipse's centre, and as far again to the other disc's, which
    leans by one degree less."""
    x, y, _, x_sd, y_sd, _ = numbers(at(rim(0.0, 0.0, 300.0, tilt_deg, 0.0), heard(300.0)))
    assert (abs(x), y) == pytest.approx((3.2, 0.0), abs=0.1)
    assert (x_sd, y_sd) == pytest.approx((2.5, 0.05), abs=0.1)


def test_the_air_counts_only_for_sound_and_where_nothing_measures_it() -> None:
    """300 mm x 0.00175 x 5 = 2.625 mm; 2.278 joined with 2.333 + 6.891, with 2.333 + 0, with 2.402."""
    circle = seen(Circle(320.0, 240.0, 180.0))
    found = [at(circle, heard(300.0, None)), at(circle, heard(300.0, None), sound=False), at(circle, heard(300.0))]
    assert [numbers(one)[5] for one in found] == pytest.approx([1.3516, 1.0736, 1.0813], abs=1e-4)


def test_what_the_vehicle_may_have_moved_since_the_older_reading_is_part_of_the_deviation() -> None:
    circle = Circle(320.0, 240.0, 180.0)
    found = at(seen(circle, t_ns=S - 50 * MS), heard(300.0, t_ns=S - 200 * MS), speed=100.0)
    assert numbers(found)[5] == pytest.approx(hypot(1.0813, 20.0), abs=1e-4)


def test_sensors_that_differ_more_than_they_should_make_the_deviation_larger() -> None:
    """310 against 300 mm: 100 / (2.278 + 2.4068) times the variance; weighted by 2.278 and 2.4068."""
    z, z_sd = numbers(at(seen(Circle(320.0, 240.0, 180.0)), heard(310.0)))[2::3]
    assert (z, z_sd) == pytest.approx((10 * 2.2778 / 4.6846, (1.17025 * 100 / 4.6846) ** 0.5), abs=1e-3)


CIRCLE = seen(Circle(320.0, 240.0, 180.0))


@pytest.mark.parametrize(
    "none",
    [
        at(seen(None), heard(300.0)),
        at(CIRCLE, heard(None)),
        at(CIRCLE, heard(300.0), speed=None),
        at(CIRCLE, heard(300.0), guidance=GuidanceConfig()),
        at(seen(Circle(320.0, 240.0, 0.0)), heard(300.0)),
        at(seen(Circle(320.0, 240.0, 700.0)), heard(300.0)),
        at(seen(Circle(9000.0, 240.0, 180.0)), heard(300.0), BARREL),
        at(CIRCLE, heard(300.0), BARREL.model_copy(update={"distortion": (*(0.1,) * 12, 0.01, 0.0)})),
    ],
)
def test_none_where_something_is_missing_or_impossible(none: MetricPose | None) -> None:
    assert none is None


ANY = st.one_of(st.floats(), st.sampled_from([0.0, nan, inf, -inf, 1e-300, 1e300, 180.0]))


@given(ANY, ANY, ANY, ANY, ANY, ANY, ANY, st.sampled_from([LENS, BARREL]))
def test_never_raises(
    u: float, v: float, a: float, b: float, angle: float, mm: float, speed: float, lens: Intrinsics
) -> None:
    at(seen(Circle(u, v, a), Ellipse(u, v, a, b, angle)), heard(mm), lens, speed=speed)
    at(seen(Circle(u, v, a)), heard(mm), lens, speed=speed)


def _standing(fusion: FusionConfig, distance_mm: float, drive: DriveConfig | None = None) -> StateVector:
    """A truck that has stood for a second, R = 180 px."""
    rules = Rules.of(BayConfig(vision=VisionConfig(intrinsics=LENS), guidance=MARKER, fusion=fusion, drive=drive))
    state = interlock.initial("bay1", 0, rules)
    for n in range(1, 60):
        now_ns = n * 20 * MS
        for observation in (seen(Circle(320.0, 240.0, 180.0), t_ns=now_ns), heard(distance_mm, t_ns=now_ns), Tick()):
            state = interlock.step(state, observation, now_ns, rules)
    return state


def test_the_state_has_it_where_the_sensors_agree_and_it_is_withdrawn_with_the_rest() -> None:
    state = _standing(FusionConfig(distance_threshold_mm=310.0), 300.0)
    assert state.pose is not None
    assert state.pose.z_mm == pytest.approx(-10.0)
    assert shown(state, state.valid_until_ns).pose == state.pose
    dead = shown(state, state.valid_until_ns + 1)
    assert (dead.reason, dead.pose) == (Reason.GATEWAY_FAULT, None)


def test_with_a_drive_the_place_is_where_it_is_to_stand() -> None:
    check = CrossCheck(focal_px=600.0, marker_radius_mm=90.0)
    state = _standing(FusionConfig(distance_threshold_mm=310.0, cross_check=check), 300.0, DriveConfig(place_mm=25.0))
    assert state.pose is not None
    assert state.pose.z_mm == pytest.approx(15.0)


def test_of_sensors_that_contradict_each_other_neither_is_believed() -> None:
    check = CrossCheck(focal_px=600.0, marker_radius_mm=90.0, lasting_s=0.5)
    state = _standing(FusionConfig(distance_threshold_mm=310.0, cross_check=check), 450.0)
    assert (state.reason, state.pose) == (Reason.SENSORS_DISAGREE, None)
