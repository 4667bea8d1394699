"""Shared by the verbs that read one bay's recording: which folder is meant."""

import argparse
from collections.abc import Iterable
from pathlib import Path

from gateway import config
from gateway.errors import ConfigError
from gateway.records import recording
from gateway.records.names import SEGMENT
from gateway.records.recorder_service import folder_of
from gateway.systemd import default_folder


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--records",
        type=Path,
        metavar="FOLDER",
        help="the bay's recording, or a folder of several (default: the usual)",
    )
    parser.add_argument("--config", type=Path, metavar="TOML", help="take the folder from this configuration")
    parser.add_argument("--bay", metavar="NAME", help="which bay, where several are recorded")


def folder(args: argparse.Namespace) -> Path:
    """The one folder of segments that is meant. Raises ConfigError where there is none, or more than one."""
    root = _root(args)
    found = sorted(
        {path.parent for depth in ("*.seg", "*/*.seg", "*/*/*.seg", "*/*/*/*.seg") for path in root.glob(depth)}
    )
    if args.bay is not None:
        named = [path for path in found if path.name == args.bay]
        if found and not named:
            raise ConfigError(f"{root}: no recording of bay {args.bay!r}; there: {_names(found)}")
        found = named
    if not found:
        raise ConfigError(f"{root}: no recording (*.seg) is in it; name its folder: --records FOLDER or --config TOML")
    if len(found) > 1:
        raise ConfigError(f"{root}: several recordings are in it: {_names(found)}. Use --bay NAME or --records FOLDER")
    return found[0]


def folders_of(paths: Iterable[Path]) -> list[Path]:
    """The folders that are meant, or in which the segments lie."""
    return list(dict.fromkeys(path if path.is_dir() else path.parent for path in paths))


def recordings_of(paths: Iterable[Path]) -> list[list[Path]]:
    """The segments that are meant, by recording: those in a folder, below it, or named. Raises ConfigError."""
    found: dict[Path, list[Path]] = {}
    for path in paths:
        below = sorted({segment.parent for segment in path.rglob(f"*{SEGMENT}")}) if path.is_dir() else []
        for segment in (segment for each in (below or [path]) for segment in recording.segments_of([each])):
            found.setdefault(segment.parent, []).append(segment)
    return list(found.values())


def _root(args: argparse.Namespace) -> Path:

    if args.records is not None:
        if not args.records.is_dir():
            raise ConfigError(f"{args.records}: no such folder")
        return Path(args.records)
    if args.config is None:
        return default_folder() / "records"
    settings = config.load(args.config)
    found = folder_of(settings)
    if found is None:
        raise ConfigError(f"{args.config}: nothing is recorded with it: state_dir or [records]")
    return found


def _names(found: list[Path]) -> str:
    return ", ".join(f"{path.parent.name}/{path.name}" for path in found)
