"""The order of these modules, and what several of them use."""

import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from gateway.cli.main import main
from tests.e2e.processes import Done

# A shell lets what it begins in the background ignore Ctrl-C, and every process that the tests start with it.
signal.signal(signal.SIGINT, signal.default_int_handler)

FIRST = {
    f"test_{name}" for name in ("visit", "simulate", "firmware_in_the_loop", "tracking", "hmi_process", "bench_wire")
}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Where several processes share these tests, those that take minutes begin first."""
    items.sort(key=lambda item: item.path.stem not in FIRST)


Cli = Callable[..., Done]


@pytest.fixture
def cli(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Cli:
    """`cli(*arguments, cwd=folder)`: a command in this process, where a process of its own would make no difference."""

    def run(*arguments: str, cwd: Path | None = None) -> Done:
        if cwd is not None:
            monkeypatch.chdir(cwd)
        capfd.readouterr()
        try:
            code = main(arguments)
        except SystemExit as error:  # argparse
            code = int(error.code or 0)
        done = Done(code, *capfd.readouterr())
        assert "Traceback" not in done.err, done.err
        return done

    return run
