"""Shared by the verbs that process pictures: a bay's settings, a progress bar."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from gateway import __version__
from gateway.clock import SystemClock
from gateway.config import VisionConfig, load
from gateway.config.sections.vision import DETECTION_METHODS
from gateway.errors import ConfigError
from gateway.vision.offline.evaluation.runner import MakeDetector, makers


def bay_vision(config: Path | None, bay: str | None) -> VisionConfig:
    """`[vision]` of a bay of a configuration file (the first, where none is named); without a file, the defaults.

    Raises ConfigError.
    """

    if config is None:
        if bay is not None:
            raise ConfigError("--bay needs --config")
        return VisionConfig()
    bays = {found.name: found for found in load(config).bays}
    name = next(iter(bays)) if bay is None else bay
    if name not in bays:
        raise ConfigError(f"{config}: no bay {name}; there is: {', '.join(bays)}")
    return bays[name].vision


def methods(params: VisionConfig, asked: str | None) -> dict[str, MakeDetector]:
    """A maker of detectors for the method asked for, all of them, or the configuration's. Raises ConfigError."""

    known = DETECTION_METHODS.names()
    if asked is not None and asked != "all" and asked not in known:
        raise ConfigError(f"--method {asked}: there is: {', '.join(known)}, all")
    names = known if asked == "all" else (asked or params.method,)
    return makers(params, names, SystemClock().now_ns)


def made_now() -> str:
    """For a report: the time, and the program that made it."""

    when = datetime.fromtimestamp(SystemClock().wall_ns() / 1e9, UTC)
    return f"{when:%Y-%m-%d %H:%M} UTC, gateway {__version__}"


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[[], None]]:
    """A bar on stderr, where that is a terminal; call what is yielded once for each piece of work done."""
    if total < 2 or not sys.stderr.isatty():
        yield lambda: None
        return

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, redirect_stdout=False) as bar:
        task = bar.add_task(what, total=total)
        yield lambda: bar.advance(task)
