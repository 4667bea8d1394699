"""What several of these tests share."""

import fcntl
import shlex
from pathlib import Path

import pytest

from gateway.vision.compiled import build
from gateway.vision.detect.paper.exact.kernel import Kernel, load
from tests.vision_frames import PAPER


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory, testrun_uid: str) -> Path:
    """The compiled kernels, built here, so that the tests don't depend on what the installation found.

    Once for all processes of a run: it takes seconds.
    """
    path = tmp_path_factory.getbasetemp().parent / f"kernels-{testrun_uid}.so"
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            with pytest.MonkeyPatch.context() as patch:  # here a warning is an error; no user's compiler shall refuse
                patch.setenv("CC", shlex.join([*(build.compiler() or ["cc"]), "-Werror"]))
                assert build.build(path) == ""
    return path


@pytest.fixture(scope="session")
def kernel(library: Path) -> Kernel:
    """Of the paper's own settings."""
    loaded = load(PAPER, library)
    assert loaded is not None
    return loaded
