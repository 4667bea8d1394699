"""Fixtures that several of these modules use."""

from collections.abc import Callable
from pathlib import Path

import pytest

from gateway.cli.main import main
from tests.e2e.processes import Done

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
