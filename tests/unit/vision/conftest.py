"""What several of these tests share."""

from pathlib import Path

import pytest

from gateway.vision.detect.paper.exact import build


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The compiled kernel, built here, so that the tests don't depend on what the installation found."""
    path = tmp_path_factory.mktemp("kernel") / "kernel.so"
    assert build.build(path) == ""
    return path
