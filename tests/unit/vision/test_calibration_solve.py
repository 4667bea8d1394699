"""From exact points, with noise, to the camera they came from; and what is said of poor pictures."""

import re
import tomllib

import cv2
import numpy as np
import pytest

from gateway import config
from gateway.errors import ConfigError
from gateway.vision.detect.lens import normalise
from gateway.vision.offline.calibration import plots, report
from gateway.vision.offline.calibration.boards import Board, parse
from gateway.vision.offline.calibration.report import focal_px, toml
from gateway.vision.offline.calibration.solve import BoardView, Calibration, calibrate
from tests.self_contained import fetches_nothing
from tests.unit.vision.board_pictures import FRONTAL, POSES, Camera, Pose, truth

BOARD = parse("checkerboard:8x6:18mm")
SIZE = (480, 360)


def views(
    poses: tuple[Pose, ...] = POSES, noise: float = 0.05, board: Board = BOARD, camera: Camera | None = None
) -> list[BoardView]:
    rng = np.random.default_rng(1)
    found = []
    for n, pose in enumerate(poses):
        points = truth(board, pose, camera)
        found.append(BoardView(f"{n}.png", np.asarray(points + rng.normal(0, noise, points.shape), np.float32)))
    return found


@pytest.fixture(scope="module")
def solved() -> Calibration:
    return calibrate(BOARD, views(), SIZE)


def test_the_camera_is_found_again(solved: Calibration) -> None:
    camera = Camera()
    lens, sigma = solved.lens, dict(solved.sigma)
    assert lens.fx == pytest.approx(camera.fx, rel=0.003)
    assert lens.fy == pytest.approx(camera.fy, rel=0.003)
    assert (abs(lens.cx - camera.cx), abs(lens.cy - camera.cy)) < (2, 2)
    assert len(lens.distortion) == 4, "k3 is 0 and cannot be told from it"
    for name, true in zip(("fx", "fy", "cx", "cy"), (camera.fx, camera.fy, camera.cx, camera.cy), strict=True):
        assert abs(getattr(lens, name) - true) < 4 * sigma[name]
        assert 0.05 < sigma[name] < 2
    assert solved.rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.1)
    assert solved.views[1].tilt_deg == pytest.approx(25, abs=0.5)
    assert solved.views[0].tilt_deg == pytest.approx(0, abs=0.5)
    assert solved.views[0].distance_mm == pytest.approx(420, rel=0.005)
    assert solved.views[3].rms_px <= solved.views[3].largest_px < 0.3
    assert solved.rejected == ()


def test_equation_11_reads_the_lens_as_it_was_solved(solved: Calibration) -> None:
    """A pixel becomes the direction it came from, everywhere the board was seen."""
    camera = Camera()
    for x_n, y_n in ((0.0, 0.0), (0.2, -0.15), (-0.25, 0.2), (0.3, 0.1)):
        pixel, _ = cv2.projectPoints(
            np.array([[x_n, y_n, 1.0]]), np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion)
        )
        u_px, v_px = (float(value) for value in pixel.ravel())
        assert normalise(u_px, v_px, solved.lens) == pytest.approx((x_n, y_n), abs=3e-3)


def test_without_noise_it_is_exact() -> None:
    found = calibrate(BOARD, views(noise=0), SIZE, 4)
    camera = Camera()
    assert found.lens.fx == pytest.approx(camera.fx, abs=0.01)
    assert found.lens.distortion == pytest.approx(camera.distortion, abs=1e-4)
    assert found.rms_px < 1e-3


@pytest.mark.long
@pytest.mark.one_interpreter
def test_how_many_coefficients() -> None:
    for wanted in (0, 4, 5, 8):
        found = calibrate(BOARD, views(), SIZE, wanted)
        assert len(found.lens.distortion) == wanted
        assert len(found.sigma) == 4 + wanted
    strong = Camera(distortion=(-0.3, 0.2, 0.0, 0.0, -0.6))
    near = tuple(Pose(1.5 * p.x_mm, 1.3 * p.y_mm, 0.8 * p.z_mm, p.turn_deg) for p in POSES)
    found = calibrate(BOARD, views(near, 0.01, camera=strong), SIZE)
    assert len(found.lens.distortion) == 5, "here k3 is told from 0"
    assert found.lens.distortion[4] == pytest.approx(-0.6, abs=0.2)


def test_a_view_that_fits_badly_is_left_out_and_named() -> None:
    shots = views()
    rng = np.random.default_rng(5)
    shots[4] = BoardView("moved.png", np.asarray(shots[4].points + rng.normal(0, 2, shots[4].points.shape), np.float32))
    found = calibrate(BOARD, shots, SIZE)
    ((name, rms),) = found.rejected
    assert name == "moved.png"
    assert rms > 1
    assert len(found.views) == len(POSES) - 1
    assert found.lens.fx == pytest.approx(Camera().fx, rel=0.003)
    wanted = re.compile(r"left out, it fits far worse than the others \(rms [\d.]+ px\): moved\.png")
    assert any(map(wanted.fullmatch, found.warnings))


def test_too_few() -> None:
    for count, says in ((0, "0 pictures show"), (1, "1 picture shows"), (2, "2 pictures show")):
        with pytest.raises(ConfigError, match=f"{says} the whole board; at least 3 are needed"):
            calibrate(BOARD, views()[:count], SIZE)
    few = calibrate(BOARD, views()[1:6], SIZE)
    assert any(said.startswith("only 5 views") for said in few.warnings)


def test_all_from_the_front_is_warned_of() -> None:
    straight = Camera(distortion=(0.0, 0.0, 0.0, 0.0))
    found = calibrate(BOARD, views(FRONTAL, 0.02, camera=straight), SIZE, 0)
    assert any(said.startswith("0 views are tilted by 15 degrees or more") for said in found.warnings)


@pytest.mark.one_interpreter
def test_a_focal_length_that_is_left_open_is_no_result() -> None:
    """Both come out precise-looking and wrong by up to a factor of four."""
    flat = tuple(Pose(p.x_mm, p.y_mm, p.z_mm, (0, 0, p.turn_deg[2])) for p in POSES)
    for noise in (0.0, 0.02):
        with pytest.raises(ConfigError, match="seen only from the front"):
            calibrate(BOARD, views(flat, noise), SIZE)
    with pytest.raises(ConfigError, match=r"too few or too alike|seen only from the front"):
        calibrate(BOARD, views((POSES[1],) * 3, 0.2), SIZE)


def test_what_is_warned_of(solved: Calibration) -> None:
    assert any("% of the frame" in said for said in solved.warnings)
    assert not any("tilted" in said or "only" in said or "differ" in said for said in solved.warnings)
    wide = calibrate(parse("checkerboard:8x6:18mm"), views(camera=Camera(fx=560), noise=0.02), SIZE)
    assert any("fx and fy differ by" in said for said in wide.warnings)
    away = calibrate(BOARD, views(camera=Camera(cx=310), noise=0.02), SIZE)
    assert any(said.startswith("the principal point lies 7") for said in away.warnings)
    rough = calibrate(BOARD, views(noise=1.2), SIZE)
    assert any(said.startswith("reprojection error of") for said in rough.warnings)
    assert any(said.startswith("fx is uncertain by") for said in rough.warnings)


def test_the_toml_is_taken_by_the_configuration(solved: Calibration) -> None:
    text = toml(BOARD, solved, 150)
    loaded = config.parse(tomllib.loads(text), text=text).bays[0]
    lens = loaded.vision.intrinsics
    assert lens is not None
    assert (lens.width_px, lens.height_px) == SIZE
    assert lens.fx == pytest.approx(solved.lens.fx, rel=1e-6)
    assert lens.distortion == pytest.approx(solved.lens.distortion, rel=1e-6)
    check = loaded.fusion.cross_check
    assert check is not None
    assert check.marker_radius_mm == 150
    assert check.focal_px == pytest.approx((solved.lens.fx + solved.lens.fy) / 2, rel=1e-6)
    assert focal_px(solved) == pytest.approx(518, rel=0.003)
    assert "cross_check" not in toml(BOARD, solved)
    assert config.parse(tomllib.loads(toml(BOARD, calibrate(BOARD, views(), SIZE, 0)))).bays[0].vision.intrinsics


def test_coverage_counts_every_point_once(solved: Calibration) -> None:
    assert solved.coverage.shape == (6, 8)
    assert solved.coverage.sum() == len(POSES) * 48
    points = np.concatenate([view.points for view in solved.views])
    assert solved.coverage[2, 3] == ((points >= (179.5, 119.5)) & (points < (239.5, 179.5))).all(axis=1).sum()
    lines = plots.coverage_text(solved)
    assert [len(line) for line in lines] == [16] * 6
    assert ("·" in lines[0]) is bool((solved.coverage[0] == 0).any())


def test_the_picture_shows_every_point_and_its_residual(solved: Calibration) -> None:
    svg = plots.frame_map(solved)
    marks = re.findall(r"M(-?[\d.]+) (-?[\d.]+)l(-?[\d.]+) (-?[\d.]+)", svg)
    assert len(marks) == len(POSES) * 48
    scale, larger = 940 / 480, plots.magnification(solved)
    x, y, dx, dy = (float(value) for value in marks[0])
    assert [x, y] == pytest.approx((solved.views[0].points[0] + 0.5) * scale, abs=0.06)
    assert [dx, dy] == pytest.approx(solved.views[0].residuals[0] * larger * scale, abs=0.06)
    lengths = np.concatenate([np.hypot(*view.residuals.T) for view in solved.views])
    assert 10 <= np.percentile(lengths, 95) * larger * scale <= 26.1
    page = report.html(BOARD, solved, toml(BOARD, solved), ("x",), ["lost.png"])
    assert fetches_nothing(page)
    assert "lost.png" in page
    assert "[vision.intrinsics]" in page
