"""The files of one bay's recording, by number. IO; may raise OSError."""

import os
from pathlib import Path

from gateway.records import names
from gateway.records.names import PIN
from gateway.records.retention import StoredFile


def files_in(folder: Path) -> list[StoredFile]:
    """The files of a recording, by number; other files are not looked at."""
    found, pins = [], set()
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith(PIN):
                pins.add(entry.name.removesuffix(PIN))
            elif (name := names.parsed(entry.name)) is not None and entry.is_file(follow_symlinks=False):
                found.append((name, entry.stat(follow_symlinks=False).st_size))
    return sorted(
        (StoredFile(name, size, str(name) in pins) for name, size in found), key=lambda f: (f.name.number, f.name.kind)
    )
