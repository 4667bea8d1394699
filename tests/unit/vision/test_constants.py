"""The numbers that kernels and references share: a change reaches both."""

import re
from pathlib import Path

import pytest

from gateway.vision.compiled import build, sizes
from gateway.vision.detect.robust import candidates, constants, measurement, red_change, refinement, rim_coarse, veil

SHARED = tuple(name for name in vars(constants) if name.isupper())
VISION = build.HERE.parent


@pytest.mark.parametrize("numbers", [sizes, constants])
def test_each_number_is_used_in_c_and_in_numpy(numbers: object) -> None:
    own = Path(str(getattr(numbers, "__file__", "")))
    c = "\n".join(path.read_text() for path in build.SOURCES)
    python = "\n".join(path.read_text() for path in VISION.rglob("*.py") if path != own)
    for name in (name for name in vars(numbers) if name.isupper()):
        assert re.search(rf"\b{name}\b", c), name
        assert re.search(rf"\b{name}\b", python), name


@pytest.mark.long
@pytest.mark.one_interpreter
def test_with_all_numbers_changed_every_kernel_still_agrees(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    others = {name: value + 1 if isinstance(value, int) else 1.02 * value for name, value in vars(constants).items()
              if name in SHARED}  # fmt: skip
    file = tmp_path / "constants.py"
    file.write_text("\n".join(f"{name} = {value!r}" for name, value in others.items()))
    monkeypatch.setattr(build, "NUMBERS", (Path(sizes.__file__), file))
    library = tmp_path / "others.so"
    assert build.build(library) == ""
    for name, value in others.items():
        monkeypatch.setattr(constants, name, value)
    rim_coarse.edge_filter.cache_clear()
    try:
        assert all(part.load(library) for part in (candidates, measurement, red_change, refinement, veil))
    finally:
        rim_coarse.edge_filter.cache_clear()


@pytest.mark.parametrize(("module", "was", "is_"), [(sizes, "PEAKS = 7", "PEAKS = 8"), (constants, "0.4", "0.45")])
def test_a_library_of_other_numbers_is_stale(
    module: object, was: str, is_: str, library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    file = Path(str(getattr(module, "__file__", "")))
    others = tmp_path / "others.py"
    others.write_text(file.read_text().replace(was, is_))
    monkeypatch.setattr(build, "NUMBERS", tuple(others if one == file else one for one in build.NUMBERS))
    assert candidates.load(library) is None
    assert "another source" in caplog.text
