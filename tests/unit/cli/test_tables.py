"""Tables on narrow terminals."""

import io

from rich.console import Console

from gateway.cli import tables
from gateway.vision.offline.reports.tables import ReportTable

TIME = "2026-11-23 04:16:22.901+00:00"
CELLS = (TIME, "0.18 s", "stop 0 -> 1, may_move 1 -> 0", "target_reached", "00000043-20261123T041625Z.pictures")


def test_at_80_columns_the_first_column_is_whole_and_no_other_loses_anything() -> None:
    out = io.StringIO()
    heads = ("time", "for", "output", "reason now", "pictures")
    tables.show(Console(width=80, file=out), ReportTable("", heads, [("", CELLS)]))
    text = out.getvalue()
    assert TIME in text
    assert "…" not in text
    assert all(len(line) <= 80 for line in text.splitlines())
    assert len("".join(text.split())) >= len("".join("".join(CELLS).split()))
