"""Of the verbs' modules only the one that was asked for is loaded, with OpenCV's limits set before it."""

import os
from importlib import import_module
from importlib.util import find_spec
from types import SimpleNamespace

import pytest

cli = import_module("gateway.cli.main")  # the package has its function under this name
LIMIT = "OPENCV_IO_MAX_IMAGE_PIXELS"


@pytest.fixture
def loaded(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str | None]]:
    """Name of each module that is loaded, and OpenCV's limit then."""
    found: list[tuple[str, str | None]] = []

    def load(name: str) -> SimpleNamespace:
        found.append((name, os.environ.get(LIMIT)))
        return SimpleNamespace(__doc__="what it does", configure=lambda parser: None, main=lambda args: 0)

    monkeypatch.delenv(LIMIT, raising=False)
    monkeypatch.setattr(cli, "import_module", load)
    return found


@pytest.mark.parametrize(
    ("verb", "limit"), [("certs", None), ("run", None), ("detect", "268435456"), ("why", "268435456")]
)
def test_only_the_verb_s_own_module_is_loaded(
    verb: str, limit: str | None, loaded: list[tuple[str, str | None]], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("OPENCV_LOG_LEVEL", "OPENCV_FFMPEG_LOGLEVEL", LIMIT):  # set again: taken back after the test
        monkeypatch.setenv(name, "x")
        monkeypatch.delenv(name)

    assert cli.main([verb]) == 0
    assert loaded == [(f"gateway.cli.{verb}", limit)]


def test_the_user_s_limit_is_kept(loaded: list[tuple[str, str | None]], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LIMIT, "1000")
    cli.main(["detect"])
    assert loaded == [("gateway.cli.detect", "1000")]


def test_help_lists_every_verb_and_loads_none(
    loaded: list[tuple[str, str | None]], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        cli.main(["--help"])
    listed = {
        line.split()[0] for line in capsys.readouterr().out.splitlines() if line.startswith("    ") and line[4] != " "
    }
    assert set(cli.VERBS) - listed == set()
    assert loaded == []


def test_every_verb_has_a_module() -> None:
    assert [verb for verb in cli.VERBS if find_spec(f"gateway.cli.{verb}") is None] == []
    assert set(cli.PICTURES) <= set(cli.VERBS)
