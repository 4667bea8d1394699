"""What holds for every compiled kernel alike: it is used only where it is right, and all works without it."""

import ctypes
import importlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gateway.config import VisionConfig
from gateway.vision.compiled import build
from gateway.vision.detect.paper.exact import kernel as exact
from gateway.vision.detect.robust import candidates, measurement, red_change, redness, refinement, veil
from gateway.vision.detect.robust.detect import detect
from gateway.vision.detect.robust.kernel.evidence_kernel import EvidenceKernel
from gateway.vision.detect.robust.kernel.rim_kernel import RimKernel
from gateway.vision.detect.robust.redness import pyramid
from tests import decoys
from tests.examples import examples
from tests.unit.vision import kernel_examples
from tests.vision_frames import PAPER

Load = Callable[[Path], Any]

KERNELS: dict[str, tuple[Load, Callable[[np.random.Generator], Callable[[Any], Any]]]] = {
    "paper": (partial(exact.load, PAPER), kernel_examples.paper_job),
    "rim": (refinement.load, kernel_examples.rim_job),
    "evidence": (measurement.load, kernel_examples.evidence_job),
    "candidates": (candidates.load, kernel_examples.candidate_job),
    "air": (veil.load, kernel_examples.air_job),
    "regions": (red_change.load, kernel_examples.region_job),
    "levels": (redness.load, kernel_examples.level_job),
}
ROBUST = (candidates, measurement, red_change, redness, refinement, veil)


@pytest.fixture(scope="module")
def narrow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The library for processors without wide registers."""
    path = tmp_path_factory.mktemp("narrow") / "narrow.so"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CC", "cc -DGATEWAY_NARROW")
        assert build.build(path) == ""
    return path


@pytest.mark.one_interpreter
@pytest.mark.long
@pytest.mark.parametrize("name", KERNELS)
def test_without_wide_registers_not_a_bit_differs(name: str, library: Path, narrow: Path) -> None:
    load, job_of = KERNELS[name]
    wide, other = load(library), load(narrow)
    assert wide is not None
    assert other is not None
    chance = np.random.default_rng(3)
    for _ in range(examples(100)):
        job = job_of(chance)
        assert job(wide) == job(other)


@pytest.mark.parametrize("name", [name for name in KERNELS if name != "paper"])  # that one is its detector's own
def test_many_threads_do_not_disturb_each_other(name: str, library: Path) -> None:
    load, job_of = KERNELS[name]
    kernel, chance = load(library), np.random.default_rng(7)
    jobs = [job_of(chance) for _ in range(16)] * 4
    alone = [job(kernel) for job in jobs]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(lambda job: job(kernel), jobs)) == alone


@pytest.mark.parametrize("veiled", [False, True])
def test_the_robust_method_finds_the_same_without_a_library(
    veiled: bool, library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sheet = decoys.sheet(320, 240, "concrete", 1)
    sheet.disc(163.3, 118.8, 41.7)
    sheet.disc(50.0, 60.0, 18.0)
    image = sheet.finished()
    if veiled:
        image = (0.3 * image + 0.7 * 180).astype(np.uint8)
    found = []
    for path in (library, tmp_path / "none.so"):
        for module in ROBUST:
            kernel = module.load(path)
            assert (kernel is None) == (path is not library)
            monkeypatch.setattr(module, "compiled_kernel", lambda kernel=kernel: kernel)
        found.append(detect(image, VisionConfig()))
    assert found[0].circle is not None
    assert found[0].ellipse is not None
    assert found[1].ellipse is not None
    assert (found[0].candidates, len(found[0].rejected)) == (found[1].candidates, len(found[1].rejected))
    for field in ("u_px", "v_px", "semi_major_px", "semi_minor_px"):
        assert getattr(found[0].ellipse, field) == pytest.approx(getattr(found[1].ellipse, field), abs=1e-5)


def moved(rim: Any) -> Any:
    return rim and replace(rim, ellipse=replace(rim.ellipse, u_px=rim.ellipse.u_px + 1e-3))


def one_pixel_off(mask: Any) -> Any:
    mask[20, 30] ^= 255
    return mask


@pytest.mark.parametrize(
    ("name", "method", "wrong"),
    [
        ("paper", "Kernel.mask", one_pixel_off),
        ("rim", "RimKernel.refine", moved),
        ("rim", "RimKernel.fall", lambda fall: fall + 1.5),
        ("evidence", "EvidenceKernel.of_ellipses", lambda all_: [e and replace(e, leak=e.leak + 0.001) for e in all_]),
        ("candidates", "CandidateKernel.redness", lambda red: red[:-1]),
        ("candidates", "CandidateKernel.votes", lambda peaks: peaks[:-1]),
        ("candidates", "CandidateKernel.blobs", lambda blobs: blobs[:-1]),
        ("air", "AirKernel.is_clear", lambda _: True),
        ("air", "AirKernel.unveiled", lambda picture: picture // 2 * 2),
        ("levels", "LevelKernel.reduced", lambda picture: picture // 2 * 2),
        ("regions", "RegionKernel.regions", lambda found: found and (found[0][1:], found[1])),
    ],
)
def test_a_kernel_that_gives_anything_else_is_not_used(
    name: str,
    method: str,
    wrong: Callable[[Any], Any],
    library: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    load, _ = KERNELS[name]
    owner, _, attribute = method.partition(".")
    kernel = type(load(library))
    assert kernel.__name__ == owner
    right = getattr(kernel, attribute)
    monkeypatch.setattr(kernel, attribute, lambda *arguments: wrong(right(*arguments)))
    assert load(library) is None
    assert f"{owner} does not agree with gateway.vision.detect." in caplog.text


@pytest.mark.parametrize(
    ("made", "agrees", "table"),
    [
        (RimKernel, refinement.agrees, "kernel.rim_kernel.directions_of"),
        (RimKernel, refinement.agrees, "kernel.lab.linear"),
        (RimKernel, refinement.agrees, "kernel.lab.root"),
        (EvidenceKernel, measurement.agrees, "radial_sampling.COS"),
        (EvidenceKernel, measurement.agrees, "radial_sampling.SIN"),
        (EvidenceKernel, measurement.agrees, "redness.LOG"),
        (EvidenceKernel, measurement.agrees, "evidence.WIDE"),
        (EvidenceKernel, measurement.agrees, "evidence.CLOSE"),
        (EvidenceKernel, measurement.agrees, "evidence.RINGS"),
    ],
)
def test_a_kernel_with_a_wrong_table_is_not_used(
    made: Callable[[ctypes.CDLL], Any],
    agrees: Callable[[Any], bool],
    table: str,
    library: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    name = f"gateway.vision.detect.robust.{table}"
    module, _, attribute = name.rpartition(".")
    right = getattr(importlib.import_module(module), attribute)
    with monkeypatch.context() as patch:
        patch.setattr(
            name, (lambda *count: right(*count) + right(*count) // 50) if callable(right) else right * np.float32(1.01)
        )
        kernel = made(ctypes.CDLL(str(library)))
    assert not agrees(kernel)


def test_no_library_a_stale_one_and_a_broken_one_are_not_used(
    library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    assert exact.load(PAPER, tmp_path / "none.so") is None
    assert not caplog.records
    (tmp_path / "broken.so").write_bytes(b"\x7fELF but not much more")
    assert exact.load(PAPER, tmp_path / "broken.so") is None
    assert "cannot be loaded" in caplog.text
    monkeypatch.setattr("gateway.vision.compiled.library.source_sum", lambda: build.source_sum() ^ 1)
    assert exact.load(PAPER, library) is None
    assert "another source" in caplog.text


def test_a_compiler_that_is_missing_or_fails_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "false")
    assert build.build(tmp_path / "kernel.so").startswith("false failed")
    monkeypatch.setenv("CC", "")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "no C compiler" in build.build(tmp_path / "kernel.so")
    assert list(tmp_path.iterdir()) == []


def test_a_reduced_picture_has_the_means_of_squares_rounded_to_even() -> None:
    """A half and one and a half, of 16 pixels each; what is left over on the right and below does not count."""
    picture = np.full((7, 11, 3), 255, np.uint8)
    picture[:4, :4], picture[:2, :4] = 0, 1
    picture[:4, 4:8], picture[:2, 4:8] = 1, 2
    assert pyramid(picture, 4, 8)[0].bgr.tolist() == [[[0, 0, 0], [2, 2, 2]]]


@pytest.mark.parametrize("factor", [256, 257, 300])
def test_a_picture_is_reduced_by_any_factor(factor: int) -> None:
    """The column's sum of 257 white pixels is the last of 16 bits."""
    (level,) = pyramid(np.full((factor, 2 * factor, 3), 255, np.uint8), factor, 8)
    assert level.bgr.tolist() == [[[255] * 3] * 2]
