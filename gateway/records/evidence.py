"""One file of evidence: a ZIP with the segments and pictures of some time as they are on the disk, and a report. IO.

Everything is copied first, then verified and hashed as it was copied: a gateway may record meanwhile.
"""

import shutil
import zipfile
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from gateway.durations import NS_PER_S
from gateway.records import page
from gateway.records.completeness import Verified, verified
from gateway.records.excerpt import Excerpt, needed
from gateway.records.inquiry import Inquiry
from gateway.records.picture_search import files_near, pictures_near
from gateway.records.store import digest

REPORT_S = 600.0  # of the beginning: a report of hours would need all their steps in memory
REPORT, VERIFIED, SUMS = "why.html", "verify.txt", "SHA256SUMS"


def write(target: Path, excerpt: Excerpt, made: str) -> tuple[int, int, Verified]:
    """Numbers of segments and files of pictures, and what their verification has found; the segment behind the last one
    is among them, as it proves that one. `made`: when, and by what, for the report. Raises OSError, FileExistsError
    among them, and ConfigError where nothing of that time can be read."""
    begin_ns, end_ns = excerpt.begin_ns, excerpt.end_ns
    segments = needed(excerpt.paths, begin_ns, end_ns)
    segments += excerpt.paths[excerpt.paths.index(segments[-1]) + 1 :][:1]
    pictures = [excerpt.folder / name for name in files_near(excerpt.folder, begin_ns, end_ns)]
    report = Inquiry(excerpt.folder).at(begin_ns, min(end_ns, begin_ns + round(REPORT_S * NS_PER_S)))
    near = list(pictures_near(excerpt.folder, report.begin_ns, report.end_ns))
    with ExitStack() as undone, TemporaryDirectory(dir=target.parent, prefix=".evidence-") as name:
        file = zipfile.ZipFile(target, "x", zipfile.ZIP_DEFLATED)
        undone.callback(target.unlink)
        copied = [Path(shutil.copy2(path, name)) for path in (*segments, *pictures)]
        found = verified(copied[: len(segments)])
        texts = {REPORT: page.html(report, near, made), VERIFIED: "\n".join((made, *found.lines, ""))}
        for each, text in texts.items():
            copied.append(Path(name) / each)
            copied[-1].write_text(text, encoding="utf-8")
        sums = Path(name) / SUMS
        sums.write_text("".join(f"{digest(path)}  {path.name}\n" for path in copied), encoding="utf-8")
        with file:
            for path in (*copied, sums):
                file.write(path, f"{target.stem}/{path.name}")
        undone.pop_all()
    return len(segments), len(pictures), found
