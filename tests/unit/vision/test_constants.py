"""The numbers that kernels and references share: a change reaches both."""

import ctypes
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gateway.core.detection import Circle, Ellipse
from gateway.vision.compiled import build, sizes
from gateway.vision.detect.robust import candidates, constants, measurement, red_change, refinement, rim_coarse, veil
from gateway.vision.detect.robust.kernel.air_kernel import AirKernel
from gateway.vision.detect.robust.kernel.candidate_kernel import CandidateKernel
from gateway.vision.detect.robust.kernel.evidence_kernel import EvidenceKernel
from gateway.vision.detect.robust.kernel.region_kernel import RegionKernel
from gateway.vision.detect.robust.kernel.rim_kernel import RimKernel
from gateway.vision.detect.robust.redness import redness

SHARED = tuple(name for name in vars(constants) if name.isupper())


@pytest.fixture
def fresh() -> Iterator[None]:
    """The table of the edge filter is made anew, and again afterwards."""
    rim_coarse.edge_filter.cache_clear()
    yield
    rim_coarse.edge_filter.cache_clear()


def changed(value: float) -> float:
    return value + 1 if isinstance(value, int) else 1.02 * value


def all_agree(library: Path) -> bool:
    return all(part.load(library) is not None for part in (candidates, measurement, red_change, refinement, veil))


@pytest.mark.one_interpreter
def test_with_all_numbers_changed_every_kernel_still_agrees(
    library: Path, monkeypatch: pytest.MonkeyPatch, fresh: None
) -> None:
    for name in SHARED:
        monkeypatch.setattr(constants, name, changed(getattr(constants, name)))
    assert all_agree(library)


def answers(library: ctypes.CDLL) -> Iterator[str]:
    """Of kernels that are handed the numbers now, to what they are asked when they are loaded."""
    levels, seeds = measurement._example()
    picture = np.asarray(levels[0].bgr, np.uint8)
    kernel = CandidateKernel(library)
    red = redness(picture)
    yield repr(kernel.votes(candidates.gradients(red), candidates.RADII, candidates.blur_weights()))
    yield repr(kernel.blobs(red, candidates.SHARES, 2, (4.0, 60.0)))
    evidence = EvidenceKernel(library)
    yield repr(evidence.gather(levels, seeds))
    yield repr(evidence.of_ellipses(levels, [Ellipse(s.u_px, s.v_px, s.radius_px, s.radius_px, 0.0) for s in seeds]))
    regions = RegionKernel(library)
    yield repr(regions.regions(picture, 1, *red_change.disc_of(Circle(60.0, 70.0, 32.0), 1)))
    air, chance = AirKernel(library), np.random.default_rng(9)
    yield repr([air.is_clear(chance.integers(2 * dark, 200, (60, 80, 3), np.uint8)) for dark in range(40, 70, 3)])
    rim = RimKernel(library)
    for image, seed, search_px, opponent in refinement._examples():
        yield repr(rim.refine(image, seed, search_px, refinement.DOUBT, opponent))


@pytest.mark.long
@pytest.mark.one_interpreter
def test_each_number_is_handed_to_a_kernel(library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded, numbers = ctypes.CDLL(str(library)), constants.passed()
    usual = list(answers(loaded))

    def has_effect(name: str, factor: float) -> bool:
        others: NDArray[np.float64] = numbers.copy()
        others[SHARED.index(name)] *= factor
        monkeypatch.setattr(constants, "passed", lambda: others)
        return any(answer != before for answer, before in zip(answers(loaded), usual, strict=True))

    factors = (1e-3, 0.3, 20.0, 1e9)
    whole = (0.5, 20.0, 1000.0)
    idle = [
        name
        for name in SHARED
        if not any(has_effect(name, by) for by in (whole if isinstance(getattr(constants, name), int) else factors))
    ]
    assert idle == []


def test_the_order_is_the_compiled_one() -> None:
    header = (build.HERE.parent / "detect" / "robust" / "kernel" / "constants.h").read_text()
    fields = [name.strip() for line in re.findall(r"double (.*);", header) for name in line.split(",")]
    assert fields == [name.lower() for name in SHARED]
    assert constants.passed().tolist() == [getattr(constants, name) for name in SHARED]


def test_a_kernel_of_other_numbers_is_not_used_and_the_log_names_its_reference(
    library: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    others = constants.passed()
    others[SHARED.index("SHOWN")] = 0.45
    monkeypatch.setattr(constants, "passed", lambda: others)
    assert measurement.load(library) is None
    reference = "gateway.vision.detect.robust.evidence.gather_plain"
    assert f"EvidenceKernel does not agree with {reference}" in caplog.text
    assert "OpenCV" not in caplog.text


def test_a_library_of_other_sizes_is_stale(
    library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    others = tmp_path / "sizes.py"
    others.write_text(Path(sizes.__file__).read_text().replace("PEAKS = 7", "PEAKS = 8"))
    monkeypatch.setattr(build, "SIZES", others)
    assert candidates.load(library) is None
    assert "another source" in caplog.text
