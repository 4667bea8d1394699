"""One file of evidence: a ZIP with the segments and pictures of some time as they are on the disk, and a report. IO.

Each file is read once: what is put into the ZIP is what is verified and hashed. A gateway may record meanwhile.
"""

import io
import zipfile
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import IO

from gateway.durations import NS_PER_S
from gateway.errors import ConfigError
from gateway.processes.answers import QuestionRefusedError
from gateway.records import page
from gateway.records.completeness import Verified, verified
from gateway.records.excerpt import Excerpt, needed
from gateway.records.inquiry import Inquiry
from gateway.records.picture_search import files_near, pictures_near

REPORT_S = 600.0  # of the beginning: a report of hours would need all their steps in memory
REPORT, VERIFIED, SUMS = "why.html", "verify.txt", "SHA256SUMS"


def write(
    out: IO[bytes], name: str, excerpt: Excerpt, made: str, *, pictures: bool = True, most_bytes: int | None = None
) -> tuple[int, int, Verified]:
    """Numbers of segments and files of pictures, and what their verification has found; the segment behind the last one
    is among them, as it proves that one. `name`: of the folder in the ZIP; `made`: when, and by what, for the report;
    `most_bytes`: of what is put into it. Where no report can be made, VERIFIED says why. Raises OSError, and
    QuestionRefusedError; `out` is untouched then."""
    begin_ns, end_ns = excerpt.begin_ns, excerpt.end_ns
    segments = needed(excerpt.paths, begin_ns, end_ns)
    segments += excerpt.paths[excerpt.paths.index(segments[-1]) + 1 :][:1]
    kept = [excerpt.folder / each for each in files_near(excerpt.folder, begin_ns, end_ns)] if pictures else []
    size_bytes = sum(path.stat().st_size for path in (*segments, *kept))
    if most_bytes is not None and size_bytes > most_bytes:
        most = f"{most_bytes / 1e6:.0f} MB at most; gateway export --evidence writes more"
        raise QuestionRefusedError(f"{size_bytes / 1e6:.0f} MB are recorded of that time, {most}")
    texts, without_report = {}, ""
    try:
        report = Inquiry(excerpt.folder).at(begin_ns, min(end_ns, begin_ns + round(REPORT_S * NS_PER_S)))
        near = list(pictures_near(excerpt.folder, report.begin_ns, report.end_ns)) if pictures else []
        texts[REPORT] = page.html(report, near, made)
    except ConfigError as error:  # the rest is evidence all the same
        without_report = f"no {REPORT}: {error}\n"
    sums: list[str] = []
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:

        def put(path: Path, data: bytes | None = None) -> bytes:
            data = path.read_bytes() if data is None else data
            archive.writestr(f"{name}/{path.name}", data)
            sums.append(f"{sha256(data).hexdigest()}  {path.name}\n")
            return data

        found = verified(segments, read=put)
        for path in kept:
            put(path)
        texts[VERIFIED] = "\n".join((made, *found.lines, without_report))
        for each, text in texts.items():
            put(Path(each), text.encode())
        put(Path(SUMS), "".join(sums).encode())
    return len(segments), len(kept), found


class Pieces(io.RawIOBase):
    """A file that cannot be sought: what is written to it goes to `send`."""

    def __init__(self, send: Callable[[bytes], None]) -> None:
        self._send = send

    def writable(self) -> bool:
        return True

    def write(self, data: memoryview) -> int:  # type: ignore[override]
        self._send(bytes(data))
        return len(data)
