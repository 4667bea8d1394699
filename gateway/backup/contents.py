"""Which files belong to a gateway. IO: lists folders.

What is not in a backup is made anew, or must not come back: the index of the records is rebuilt from them, and events
that wait for a broker or a database would be those of another day.
"""

import os
from collections.abc import Iterator
from pathlib import Path

from gateway import bay_file
from gateway.backup.manifest import Kind
from gateway.config import GatewayConfig
from gateway.config import named_files as config_files
from gateway.marker_history import marker_path_of
from gateway.records import recorder_service as records
from gateway.records.names import PIN, parsed
from gateway.web.languages import CODE
from gateway.web.testsets.folder import folder_of as test_sets_folder
from gateway.web.testsets.folder import is_part

KEYRING = "release.gpg"  # beside the configuration: the keys by which this plant trusts packages (docs/update.md)


def named_files(config: GatewayConfig) -> Iterator[tuple[str, str, Kind]]:
    """Every certificate, key and password file that the configuration names: its key, the path as it is written."""
    for key, path, private in config_files.named_files(config):
        yield key, path, Kind.SECRET if private else Kind.CERTIFICATE


def bay_files(config: GatewayConfig) -> Iterator[Path]:
    """Those that exist."""
    for bay in config.bays:
        for path in (of(config, bay.name) for of in (bay_file.path_of, bay_file.tried_path_of, marker_path_of)):
            if path is not None and path.exists():
                yield path


def language_files(config: GatewayConfig) -> Iterator[Path]:
    """The plant's own texts. Raises OSError where their folder can't be listed."""
    if config.hmi.languages_folder is not None:
        folder = Path(config.hmi.languages_folder)
        yield from sorted(path for path in folder.iterdir() if is_language(path))


def test_set_files(config: GatewayConfig) -> Iterator[Path]:
    """Pictures and labels of all bays' test sets."""
    folder = test_sets_folder(config)
    if folder is None:
        return
    for bay in config.bays:
        place = folder / bay.name
        found = sorted(place.glob("*/*")) if place.is_dir() else []
        yield from (path for path in found if is_part(path) and path.is_file() and not path.is_symlink())


def record_files(config: GatewayConfig) -> Iterator[Path]:
    """Recordings, kept pictures and rows of all bays, the oldest first."""
    folder = records.folder_of(config)
    if folder is None:
        return
    for bay in config.bays:
        place = folder / bay.name
        if not place.is_dir():
            continue
        with os.scandir(place) as entries:
            names = sorted(entry.name for entry in entries if entry.is_file(follow_symlinks=False))
        yield from (place / name for name in names if is_record(name))


def is_record(name: str) -> bool:
    """Is a file of this name one of a bay's recording?"""
    return parsed(name.removesuffix(PIN)) is not None


def is_language(path: Path) -> bool:
    """Is this the path of a language, as far as its name says?"""
    return path.suffix == ".json" and CODE.fullmatch(path.stem) is not None
