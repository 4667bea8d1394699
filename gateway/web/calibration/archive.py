"""A session's pictures as a ZIP, from which `gateway calibrate` makes the same result. Pure."""

import io
import zipfile
from collections.abc import Iterator, Sequence

from gateway.vision.offline.calibration.boards import Board
from gateway.web.calibration.sessions import KeptView

README = "README.txt"


def command(board: Board, coefficients: int | None, marker_radius_mm: float | None = None) -> str:
    words = ["gateway calibrate .", f"--board {board.spec}"]
    words += [] if coefficients is None else [f"--distortion {coefficients}"]
    words += [] if marker_radius_mm is None else [f"--marker-radius-mm {marker_radius_mm:g}"]
    return " ".join(words)


class _Pipe(io.RawIOBase):
    """Holds what was written since it was emptied: a ZIP is sent while it is made."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []

    def writable(self) -> bool:
        return True

    def write(self, data: object) -> int:
        part = bytes(data)  # type: ignore[call-overload]
        self._parts.append(part)
        return len(part)

    def emptied(self) -> bytes:
        parts, self._parts = b"".join(self._parts), []
        return parts


def pieces(board: Board, coefficients: int | None, views: Sequence[KeptView]) -> Iterator[bytes]:
    """The ZIP, a view at a time. PNGs are compressed already."""
    pipe = _Pipe()
    with zipfile.ZipFile(pipe, "w") as archive:
        archive.writestr(README, f"In the folder of these pictures:\n\n  {command(board, coefficients)}\n")
        for view in views:
            archive.writestr(view.name, view.png)
            yield pipe.emptied()
    yield pipe.emptied()
