"""The kept pictures of a bay by their times, read without reading the pictures themselves. IO.

A picture is named by the number of its file and its place among the pictures of that file, from 0.
"""

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gateway.errors import ProtocolError
from gateway.records import names, picture_search, recording, segment
from gateway.records.segment import HEADER, MAGIC, MARK, MAX_PAYLOAD, Block, BlockKind, PictureHead, RecordedPicture

HEAD_BYTES = 4096  # a picture's head is smaller


@dataclass(frozen=True, slots=True)
class KeptPicture:
    """`file` and `place` are its name."""

    file: int
    place: int
    head: PictureHead


def kept(folder: Path, begin_ns: int, end_ns: int, most: int) -> list[KeptPicture]:
    """Those taken from `begin_ns` to `end_ns` (Unix ns), in their order, each once; of more than `most` the newest.

    Empty where nothing was ever kept. Raises OSError.
    """
    found: dict[tuple[int, int], KeptPicture] = {}
    if not folder.exists():
        return []
    for path in reversed(list(picture_search.files_of_time(recording.pictures_in(folder), begin_ns, end_ns))):
        for picture in heads(path):
            if begin_ns <= picture.head.unix_ns <= end_ns:
                found[picture.head.t_ns, picture.head.frame_id] = picture
        if len(found) >= most:
            break
    ordered = sorted(found.values(), key=lambda picture: picture.head.unix_ns)
    return ordered[-most:]


def nearest(
    folder: Path, times_ns: Sequence[int | None], within_ns: int, advance: Callable[[], None] = lambda: None
) -> list[KeptPicture | None]:
    """For each time (Unix ns) the picture nearest to it, `within_ns` of it at most; None: there is none.

    Raises OSError.
    """
    files = sorted(picture_search.dated(recording.pictures_in(folder) if folder.exists() else []))
    known: dict[Path, list[KeptPicture]] = {}
    found: list[KeptPicture | None] = []
    for at_ns in times_ns:
        near: list[tuple[int, KeptPicture]] = []
        if at_ns is not None:
            for _, path in picture_search.between(files, at_ns - within_ns, at_ns + within_ns):
                if path not in known:
                    known[path] = list(heads(path))
                near += [(abs(picture.head.unix_ns - at_ns), picture) for picture in known[path]]
        distance_ns, picture = min(near, key=lambda each: each[0], default=(within_ns + 1, None))
        found.append(picture if distance_ns <= within_ns else None)
        advance()
    return found


def picture(folder: Path, file: int, place: int) -> RecordedPicture | None:
    """That one; None: there is none, or not any more. Raises OSError, and ProtocolError where it is damaged."""
    paths = recording.pictures_in(folder) if folder.exists() else []
    path = next((path for path in paths if (name := names.parsed(path.name)) and name.number == file), None)
    if path is None:
        return None
    with contextlib.suppress(FileNotFoundError), _opened(path) as fd:
        for number, (offset, length) in enumerate(_blocks(fd)):
            if number == place:
                found = next(segment.blocks(os.pread(fd, HEADER.size + length, offset)), None)
                if not isinstance(found, Block):
                    raise ProtocolError(f"{path.name}: picture {place} is damaged")
                return segment.picture_of(found.payload)
    return None


def heads(path: Path) -> Iterator[KeptPicture]:
    """Until the end, or the first damage; none where the file has been deleted meanwhile."""
    name = names.parsed(path.name)
    assert name is not None
    with contextlib.suppress(FileNotFoundError, ProtocolError), _opened(path) as fd:
        for place, (offset, length) in enumerate(_blocks(fd)):
            data = os.pread(fd, min(length, HEAD_BYTES), offset + HEADER.size)
            yield KeptPicture(name.number, place, segment.picture_head_of(data))


def _blocks(fd: int) -> Iterator[tuple[int, int]]:
    """Offset and length of the payload of each picture's block, by the blocks' headers; until one is not a header."""
    at = len(MAGIC)
    while len(header := os.pread(fd, HEADER.size, at)) == HEADER.size:
        mark, kind, length, _ = HEADER.unpack(header)
        if mark != MARK or length > MAX_PAYLOAD:
            return
        if kind == BlockKind.PICTURE:
            yield at, length
        at += HEADER.size + length


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[int]:
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        yield fd
    finally:
        os.close(fd)
