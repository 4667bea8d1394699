"""Ellipses by their support function: conversions there and back, and the conic they stand for."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.core.detection import Ellipse
from gateway.vision.detect.robust.conic import SupportEllipse, from_ellipse, from_matrix, matrix, to_ellipse

ellipses = st.builds(
    lambda u, v, a, ratio, angle: Ellipse(u, v, a, a * ratio, angle),
    st.floats(-2000, 4000),
    st.floats(-2000, 4000),
    st.floats(3, 2000),
    st.floats(0.2, 0.99),
    st.floats(0, math.pi, exclude_max=True),
)


def near(one: Ellipse, other: Ellipse, tolerance_px: float) -> bool:
    turn = abs(one.angle_rad - other.angle_rad)
    turn = min(turn, math.pi - turn) * (one.semi_major_px - one.semi_minor_px)
    lengths = (
        one.u_px - other.u_px,
        one.v_px - other.v_px,
        one.semi_major_px - other.semi_major_px,
        one.semi_minor_px - other.semi_minor_px,
        turn,
    )
    return max(map(abs, lengths)) <= tolerance_px


@given(ellipses)
def test_support_function_and_back(ellipse: Ellipse) -> None:
    assert near(to_ellipse(from_ellipse(ellipse)), ellipse, 1e-6)


@given(ellipses, st.sampled_from([1.0, -1.0, 1e-6, -3e4]))
def test_conic_and_back_whatever_its_scale(ellipse: Ellipse, scale: float) -> None:
    back = from_matrix(matrix(ellipse) * scale)
    assert back is not None
    assert near(back, ellipse, 1e-4)


@pytest.mark.one_interpreter
@given(ellipses, st.floats(0, 2 * math.pi))
def test_tangent_lies_as_far_out_as_the_support_function_says(ellipse: Ellipse, phi: float) -> None:
    outline = from_ellipse(ellipse)
    t = np.linspace(0, 2 * np.pi, 20_001)
    along, across = ellipse.semi_major_px * np.cos(t), ellipse.semi_minor_px * np.sin(t)
    c, s = math.cos(ellipse.angle_rad), math.sin(ellipse.angle_rad)
    farthest = ((c * along - s * across) * math.cos(phi) + (s * along + c * across) * math.sin(phi)).max()
    squared = outline.alpha + outline.beta * math.cos(2 * phi) + outline.gamma * math.sin(2 * phi)
    assert math.sqrt(squared) == pytest.approx(farthest, rel=1e-6)


def test_a_circle_is_no_special_case() -> None:
    circle = to_ellipse(SupportEllipse(10.0, 20.0, 2500.0, 0.0, 0.0))
    assert circle == Ellipse(10.0, 20.0, 50.0, 50.0, 0.0)


def test_swapped_axes_are_put_in_order() -> None:
    back = to_ellipse(from_ellipse(Ellipse(0.0, 0.0, 30.0, 50.0, 0.3)))
    assert (back.semi_major_px, back.semi_minor_px) == pytest.approx((50.0, 30.0))
    assert back.angle_rad == pytest.approx(0.3 + math.pi / 2)


def test_conic_is_zero_on_the_rim_and_negative_inside() -> None:
    conic = matrix(Ellipse(100.0, 80.0, 50.0, 25.0, 0.0))
    for point, sign in (((150.0, 80.0), 0), ((100.0, 105.0), 0), ((100.0, 80.0), -1), ((151.0, 80.0), 1)):
        x = np.array([*point, 1.0])
        value = float(x @ conic @ x)
        assert abs(value) < 1e-9 if sign == 0 else value * sign > 0.01


@pytest.mark.parametrize(
    "conic",
    [
        np.diag([1.0, -1.0, -1.0]),  # a hyperbola
        np.diag([1.0, 1.0, 1.0]),  # no real point
        np.array([[1.0, 0, 0], [0, 0, -1], [0, -1, 0]]),  # a parabola
        np.zeros((3, 3)),
        np.full((3, 3), np.nan),
    ],
)
def test_what_is_no_ellipse_is_none(conic: np.ndarray) -> None:
    assert from_matrix(conic) is None


@pytest.mark.parametrize("broken", [math.nan, math.inf, 1e200])
def test_absurd_axes_are_not_real(broken: float) -> None:
    assert not from_ellipse(Ellipse(0.0, 0.0, broken, 10.0, 0.0)).real
    assert not from_ellipse(Ellipse(0.0, 0.0, 10.0, 10.0, math.nan)).real
    assert not from_ellipse(Ellipse(0.0, 0.0, 10.0, 10.0, 1e308)).real
    assert not from_ellipse(Ellipse(0.0, 0.0, -10.0, 10.0, 0.0)).real
