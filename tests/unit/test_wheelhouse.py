"""uv.lock has a wheel of everything the packages carry, for each Python and architecture they are built for."""

import sys
from pathlib import Path
from typing import Any

import pytest

PACKAGING = Path(__file__).parents[2] / "packaging"

sys.path.insert(0, str(PACKAGING))
try:
    import package as command
    import wheelhouse
    from wheelhouse import ARCHITECTURES, Architecture, PackageError
finally:
    sys.path.remove(str(PACKAGING))

# It reads the lock file, with the tool of the main environment.
pytestmark = pytest.mark.one_interpreter


@pytest.fixture(scope="module")
def packages() -> list[dict[str, Any]]:
    """As `wheelhouse.write` takes them: what the gateway needs, and the pip that installs it."""
    extras = [f"--extra={extra}" for extra in wheelhouse.EXTRAS]
    needed = wheelhouse.locked("--no-dev", "--no-emit-project", *extras)
    assert {"numpy", "opencv-python-headless", "asyncpg", "asyncua", "mcap"} <= {package["name"] for package in needed}
    return [*needed, *(one for one in wheelhouse.locked("--only-group=package") if one["name"] == "pip")]


@pytest.mark.parametrize("architecture", ARCHITECTURES.values(), ids=list(ARCHITECTURES))
@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13", "3.14"])
def test_nothing_is_missing(packages: list[dict[str, Any]], architecture: Architecture, python: str) -> None:
    assert python in command.PYTHONS
    chosen: dict[str, list[str]] = {}  # a package may be locked twice, with markers: for older Pythons, and newer
    for package in packages:
        for wheel in wheelhouse.chosen(package, architecture, [python]):
            chosen.setdefault(package["name"], []).append(wheel["url"].rsplit("/", 1)[1])
            assert len(wheel["hashes"]["sha256"]) == 64
    assert {len(files) for files in chosen.values()} == {1}
    assert {"pip", "numpy", "opencv-python-headless", "pydantic-core", "msgspec"} <= set(chosen)
    for (file,) in chosen.values():
        assert file.endswith(("-any.whl", f"{architecture.machine}.whl")), file


def test_a_missing_one_is_an_error(packages: list[dict[str, Any]]) -> None:
    (opencv,) = [package for package in packages if package["name"] == "opencv-python-headless"]
    only = {**opencv, "wheels": [wheel for wheel in opencv["wheels"] if "aarch64" not in wheel["url"]]}
    with pytest.raises(PackageError, match=r"no wheel for Python 3\.12"):
        list(wheelhouse.chosen(only, ARCHITECTURES["arm64"], ["3.12"]))
