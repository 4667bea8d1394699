"""What several of these tests share."""

import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from gateway.vision.compiled import build
from gateway.vision.detect.paper.exact.kernel import Kernel, load
from tests.kept import made_once
from tests.vision_frames import PAPER


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The compiled kernels, built here, so that the tests don't depend on what the installation found.

    Compiling takes ten seconds: once for each state of the sources and each compiler. The tests have a copy.
    """
    compiler = [*(build.compiler() or ["cc"]), "-Werror"]
    told = subprocess.run([*compiler, "--version"], capture_output=True, check=True).stdout

    def compiled(path: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:  # here a warning is an error; no user's compiler shall refuse
            patch.setenv("CC", shlex.join(compiler))
            assert build.build(path) == ""

    sources = (source.read_bytes() for source in (*build.SOURCES, Path(build.__file__)))
    kept = made_once("kernels", compiled, *sources, *map(str.encode, (*build.numbers(), *compiler)), told)
    return Path(shutil.copy(kept, tmp_path_factory.mktemp("kernels") / "kernels.so"))


@pytest.fixture(scope="session")
def kernel(library: Path) -> Kernel:
    """Of the paper's own settings."""
    loaded = load(PAPER, library)
    assert loaded is not None
    return loaded
