"""What several of these tests share."""

from pathlib import Path

import pytest

from gateway.vision.detect.paper.exact import build
from gateway.vision.detect.paper.exact.kernel import Kernel, load
from tests.vision_frames import PAPER


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The compiled kernel, built here, so that the tests don't depend on what the installation found."""
    path = tmp_path_factory.mktemp("kernel") / "kernel.so"
    assert build.build(path) == ""
    return path


@pytest.fixture(scope="session")
def kernel(library: Path) -> Kernel:
    """Of the paper's own settings."""
    loaded = load(PAPER, library)
    assert loaded is not None
    return loaded
