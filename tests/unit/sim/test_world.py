"""The truck's motion and the camera's geometry, in numbers."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.sim.scenario import Scenario, parse
from gateway.sim.world import Motion, World
from tests.examples import examples

STILL = {"amplitude_mm": 0.0}


def still(distance_cm: float, **rest: object) -> World:
    return World(parse({"vibration": STILL, "start": {"distance_cm": distance_cm}, **rest}))


@pytest.mark.parametrize(("distance_cm", "radius_px"), [(30, 180.0), (25, 216.0), (52, 5400 / 52), (120, 45.0)])
def test_radius_times_distance_is_5400_px_cm(distance_cm: float, radius_px: float) -> None:
    truth = still(distance_cm).truth(3.0)

    assert truth.radius_px == pytest.approx(radius_px, rel=1e-12)
    assert truth.distance_mm == 10 * distance_cm
    assert (truth.u_px, truth.v_px) == (319.5, 239.5)


def test_lateral_offset_moves_the_centre_by_f_over_z() -> None:
    truth = still(60, start={"distance_cm": 60, "lateral_mm": 20, "vertical_mm": -10}).truth(0)

    assert truth.u_px == pytest.approx(319.5 + 600 * 20 / 600)
    assert truth.v_px == pytest.approx(239.5 - 600 * 10 / 600)


def test_camera_offset_is_added_to_the_rangers_distance() -> None:
    truth = still(30, camera={"offset_mm": 60}).truth(0)

    assert (truth.distance_mm, truth.camera_mm) == (300.0, 360.0)
    assert truth.radius_px == pytest.approx(150.0)


def test_principal_point_can_be_given() -> None:
    truth = still(30, camera={"cx_px": 300, "cy_px": 250.25}).truth(0)

    assert (truth.u_px, truth.v_px) == (300.0, 250.25)


@pytest.mark.parametrize(("distance_cm", "stop"), [(30.0, True), (30.001, False), (29.0, True)])
def test_stop_at_the_papers_thresholds_is_inclusive(distance_cm: float, stop: bool) -> None:
    assert still(distance_cm).truth(0).stop is stop


def test_stop_needs_both_conditions() -> None:
    far_camera = parse({"vibration": STILL, "start": {"distance_cm": 28}, "camera": {"offset_mm": 100}})
    near_camera = parse({"vibration": STILL, "start": {"distance_cm": 32}, "camera": {"offset_mm": -100}})

    assert World(far_camera).truth(0).radius_px < 180
    assert not World(far_camera).truth(0).stop
    assert World(near_camera).truth(0).radius_px > 180
    assert not World(near_camera).truth(0).stop
    assert World(far_camera, radius_threshold_px=140).truth(0).stop
    assert World(near_camera, distance_threshold_mm=330).truth(0).stop


def test_marker_is_visible_only_whole_and_uncovered() -> None:
    hidden = [{"kind": "marker_hidden", "at_s": 1, "for_s": 1}]

    assert still(30).truth(0).marker_visible
    assert not still(22).truth(0).marker_visible  # R = 245 px in 480 rows
    assert not still(60, start={"distance_cm": 60, "lateral_mm": 240}).truth(0).marker_visible
    assert [still(60, faults=hidden).truth(t).marker_visible for t in (0.5, 1.5, 2.5)] == [True, False, True]


def test_a_leg_takes_way_over_speed_plus_one_ramp_and_then_holds() -> None:
    world = World(
        parse(
            {"vibration": STILL, "legs": [{"distance_cm": 50, "speed_cm_s": 20, "acceleration_cm_s2": 40, "hold_s": 3}]}
        )
    )

    assert world.plan_s == pytest.approx(100 / 20 + 0.5 + 3)
    assert world.truth(0.25).distance_mm == pytest.approx(1500 - 200 / 2 * (0.25 - 0.5 / math.pi))
    assert world.truth(2.75).distance_mm == pytest.approx(1000)  # half way at half time
    assert world.truth(5.499).phase is Motion.APPROACH
    assert world.truth(5.501).phase is Motion.HOLD
    assert world.truth(99.0).distance_mm == 500


def test_a_leg_too_short_for_its_speed_still_arrives() -> None:
    legs = [{"distance_cm": 149, "speed_cm_s": 100, "acceleration_cm_s2": 100}]
    world = World(parse({"vibration": STILL, "legs": legs}))

    assert world.plan_s == pytest.approx(0.2)  # 1 cm = a (T/2)^2 with a = 100 cm/s^2
    assert world.truth(0.1).distance_mm == pytest.approx(1495)
    assert world.truth(0.2).distance_mm == 1490


def test_phases_and_legs_follow_the_plan() -> None:
    legs = [
        {"name": "in", "distance_cm": 50, "speed_cm_s": 50, "hold_s": 1},
        {"name": "out", "distance_cm": 150, "speed_cm_s": 50},
    ]
    world = World(parse({"legs": legs}))
    seen = [(world.truth(t).phase.value, world.truth(t).leg, world.truth(t).leg_name) for t in (-1, 1, 3.5, 5, 99)]

    assert seen == [
        ("hold", -1, ""),
        ("approach", 0, "in"),
        ("hold", 0, "in"),
        ("retreat", 1, "out"),
        ("hold", 1, "out"),
    ]


def test_repeat_begins_again() -> None:
    legs = [{"distance_cm": 50, "speed_cm_s": 50}, {"distance_cm": 150, "speed_cm_s": 50, "hold_s": 0.5}]
    world = World(parse({"repeat": True, "vibration": STILL, "legs": legs}))

    for t in (0.3, 1.7, 4.0):
        assert world.truth(t + 3 * world.plan_s).distance_mm == pytest.approx(world.truth(t).distance_mm, abs=1e-6)


def test_a_repeat_of_nothing_is_still() -> None:
    world = World(parse({"repeat": True, "vibration": STILL, "legs": [{"distance_cm": 150}]}))

    assert world.truth(5.0).distance_mm == 1500


def test_the_image_speed_is_the_derivative_of_the_centre() -> None:
    world = World(parse({"vibration": {"amplitude_mm": 5, "frequency_hz": 9, "rest_share": 1}}))
    h = 1e-3
    for t in (0.1, 0.77, 3.3):
        before, here, after = (world.truth(t + k * h) for k in (-1, 0, 1))
        assert here.u_px_s == pytest.approx((after.u_px - before.u_px) / (2 * h), rel=0.01, abs=0.05)
        assert here.v_px_s == pytest.approx((after.v_px - before.v_px) / (2 * h), rel=0.01, abs=0.05)
    speeds = [abs(world.truth(k * 0.01).u_px_s) for k in range(200)]
    assert 20 < max(speeds) < 600 / 1500 * 5 * 2 * math.pi * 9 * 1.6


@pytest.mark.long
@pytest.mark.one_interpreter
def test_vibration_stays_within_its_amplitude_and_uses_most_of_it() -> None:
    world = World(parse({"vibration": {"amplitude_mm": 4, "rest_share": 1.0, "axial_share": 0.5}}))
    points = [world.truth(k * 0.003) for k in range(20_000)]
    z = [p.distance_mm - 1500 for p in points]
    x = [(p.u_px - 319.5) * p.camera_mm / 600 for p in points]

    assert 3 < max(map(abs, x)) <= 4
    assert 1.5 < max(map(abs, z)) <= 2
    assert abs(sum(x) / len(x)) < 0.1


def test_an_idling_truck_shakes_less() -> None:
    shaking = {"amplitude_mm": 4, "rest_share": 0.25, "axial_share": 0}
    world = World(parse({"vibration": shaking, "legs": [{"distance_cm": 50, "speed_cm_s": 10, "hold_s": 60}]}))

    def aside(t: float) -> float:
        return abs(world.truth(t).u_px - 319.5) * world.truth(t).camera_mm / 600

    rest = max(aside(12 + k * 0.01) for k in range(3000))

    assert 0.6 < rest <= 1.0
    assert max(aside(1 + k * 0.01) for k in range(800)) > 2.0


def test_same_seed_same_world_other_seed_other_world() -> None:
    at = [World(Scenario(seed=seed)).truth(1.234) for seed in (5, 5, 6)]

    assert at[0] == at[1]
    assert at[0].u_px != at[2].u_px


LEGS = st.lists(
    st.fixed_dictionaries(
        {
            "distance_cm": st.floats(10, 400),
            "lateral_mm": st.floats(-300, 300),
            "speed_cm_s": st.floats(1, 200),
            "acceleration_cm_s2": st.floats(5, 500),
            "hold_s": st.floats(0, 3),
        }
    ),
    min_size=1,
    max_size=4,
)


@settings(max_examples=examples(60), deadline=None)
@given(LEGS, st.floats(0, 1))
def test_any_drive_is_smooth_keeps_its_limits_and_arrives(legs: list[dict[str, float]], share: float) -> None:
    world = World(parse({"vibration": STILL, "legs": legs}))
    fastest = max(leg["speed_cm_s"] for leg in legs) * 10
    hardest = max(leg["acceleration_cm_s2"] for leg in legs) * 10 * math.pi / 2
    t, h = share * world.plan_s, 1e-3
    before, here, after = (world.distance_mm(t + k * h) for k in (-1, 0, 1))

    assert abs(after - here) / h <= fastest * 1.001 + 1e-6
    assert abs(after - 2 * here + before) / h**2 <= hardest * 1.01 + 1e-2
    assert world.distance_mm(world.plan_s) == pytest.approx(legs[-1]["distance_cm"] * 10)
    assert world.truth(t).distance_mm == here


def test_the_spout_takes_two_seconds_to_come_down_and_to_go_up() -> None:
    world = still(28, faults=[{"kind": "spout_down", "at_s": 10, "for_s": 20}])

    assert [world.truth(t).spout for t in (9.99, 10, 11, 12, 28, 29, 30)] == [0, 0, 0.5, 1, 1, 0.5, 0]


def test_a_marker_that_the_spout_covers_a_little_is_not_whole() -> None:
    """At 28 cm the disc begins 46.6 px below the upper edge of the picture."""
    world = still(28, faults=[{"kind": "spout_down", "at_s": 10, "for_s": 20}])
    visible = {t: world.truth(t).marker_visible for t in (10.19, 10.20, 20, 29.80, 29.81)}

    assert visible == {10.19: True, 10.20: False, 20: False, 29.80: False, 29.81: True}


def test_a_short_fall_of_the_spout_goes_up_again_from_where_it_was() -> None:
    world = still(28, faults=[{"kind": "spout_down", "at_s": 10, "for_s": 2}])

    assert max(world.truth(10 + k / 100).spout for k in range(200)) == pytest.approx(0.5)


def test_another_truck_stands_there_at_once() -> None:
    legs = [
        {"distance_cm": 28, "speed_cm_s": 20, "hold_s": 2},
        {"distance_cm": 60, "another_truck": True, "lateral_mm": 7, "hold_s": 1},
        {"distance_cm": 30, "speed_cm_s": 10},
    ]
    world = still(40, legs=legs)
    swap_s = world.plan_s - (1 + 3 + 0.25)  # 30 cm at 10 cm/s, a quarter of a second of ramps, and the hold before
    before, after = world.truth(swap_s - 0.001), world.truth(swap_s + 0.001)

    assert (before.truck, round(before.distance_mm), before.speed_mm_s) == (0, 280, 0)
    assert (after.truck, round(after.distance_mm), after.speed_mm_s) == (1, 600, 0)
    assert world.truth(world.plan_s).truck == 1


def test_each_repetition_brings_another_truck() -> None:
    legs = [{"distance_cm": 28, "speed_cm_s": 20}, {"distance_cm": 60, "speed_cm_s": 20}]
    world = still(60, legs=legs, repeat=True)

    assert [world.truth(k * world.plan_s + 0.1).truck for k in range(3)] == [0, 1, 2]


def test_speed_is_that_along_the_leg() -> None:
    world = still(60, legs=[{"distance_cm": 28, "speed_cm_s": 20}])

    assert (world.truth(-1).speed_mm_s, world.truth(1).speed_mm_s, world.truth(9).speed_mm_s) == (0, 200, 0)
