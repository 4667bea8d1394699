"""The frame of a report: one HTML text with its style inside, readable on a screen and on paper. Pure.

`embed` turns a picture into a data URI, so that one file can be sent and opened without a network.
"""

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

import cv2

from gateway.errors import ConfigError
from gateway.vision.offline.reports.tables import Cell, ReportTable
from gateway.vision.pixels import Image

STYLE = """
:root{--ink:#1d2430;--soft:#5b6472;--line:#d9dee5;--pale:#f4f6f8;--good:#0a7d4f;--bad:#b3261e;--warn:#9a6200}
*{box-sizing:border-box}
html{-webkit-print-color-adjust:exact;print-color-adjust:exact}
body{margin:0 auto;max-width:1180px;padding:28px 32px 60px;color:var(--ink);background:#fff;
 font:15px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"Liberation Sans","DejaVu Sans",sans-serif}
h1{font-size:27px;line-height:1.2;margin:0 0 4px}h2{font-size:19px;margin:38px 0 10px;padding-top:10px;
border-top:2px solid var(--ink)}h3{font-size:15.5px;margin:22px 0 8px}
p{margin:6px 0;max-width:860px}.soft{color:var(--soft)}small,.soft small{color:var(--soft)}
code{font:13px ui-monospace,"DejaVu Sans Mono",Consolas,monospace;
background:var(--pale);padding:1px 4px;border-radius:3px}
pre{background:var(--pale);border:1px solid var(--line);padding:12px 14px;overflow:auto;border-radius:6px;
font:13px/1.45 ui-monospace,"DejaVu Sans Mono",Consolas,monospace}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(136px,1fr));gap:10px;margin:12px 0}
.tile{border:1px solid var(--line);border-radius:8px;padding:10px 13px;break-inside:avoid}
.tile b{display:block;font-size:24px;line-height:1.15;font-weight:650;font-variant-numeric:tabular-nums}
.tile span{font-size:12.5px;color:var(--soft)}.tile.bad{border-left:5px solid var(--bad)}
.tile.good{border-left:5px solid var(--good)}.tile.plain{border-left:5px solid var(--line)}
table{border-collapse:collapse;margin:8px 0 16px;font-variant-numeric:tabular-nums;font-size:13.5px}
th,td{padding:4px 10px;text-align:right;border-bottom:1px solid var(--line);white-space:nowrap}
th{font-weight:600;color:var(--soft);border-bottom:1.5px solid var(--ink);vertical-align:bottom}
th:first-child,td:first-child,.left{text-align:left}tr.whole td{font-weight:650;background:var(--pale)}
tr.half td{background:var(--pale)}td.bad,tr.bad td,.bad>b,strong.bad{color:var(--bad);font-weight:650}
td.good,strong.good{color:var(--good)}
strong.warn{color:var(--warn)}.scroll{overflow-x:auto}
.charts{display:grid;grid-template-columns:repeat(auto-fit,minmax(430px,1fr));gap:14px}
figure{margin:0;break-inside:avoid}figcaption{font-size:13px;color:var(--soft);margin-top:3px}
svg.chart{max-width:100%;height:auto;background:#fff}svg text{font-family:inherit;fill:var(--ink)}
svg .tick,svg .small{font-size:11px;fill:var(--soft)}svg .name{font-size:12px}
svg .legend{fill:var(--ink);paint-order:stroke;stroke:#fff;stroke-width:3px}
svg .grid{stroke:#e7ebef;stroke-width:1}svg .axis{fill:none;stroke:#8b95a3;stroke-width:1}
svg .rule{stroke:#5b6472;stroke-width:1;stroke-dasharray:3 3}
.cases{display:grid;grid-template-columns:repeat(auto-fill,minmax(330px,1fr));gap:16px}
.case{border:1px solid var(--line);border-radius:8px;overflow:hidden;break-inside:avoid;background:#fff}
.case svg{display:block;width:100%;height:auto;background:#11151b}
.case .text{padding:9px 12px 11px;font-size:13px;line-height:1.42}
.case .file{font-weight:650;overflow-wrap:anywhere}.case ul{margin:4px 0 0;padding-left:17px}
.mark{display:inline-block;font-size:11.5px;font-weight:650;padding:1px 7px;border-radius:9px;border:1px solid;
margin-left:5px;vertical-align:1px}.mark.bad{color:var(--bad)}.mark.good{color:var(--good)}.mark.warn{color:var(--warn)}
.mark.plain{color:var(--soft)}
details summary{cursor:pointer;font-weight:600;margin:10px 0}
ul.notes{padding-left:20px;max-width:860px}ul.notes li{margin:3px 0}
footer{margin-top:44px;border-top:1px solid var(--line);padding-top:8px;font-size:12.5px;color:var(--soft)}
@page{margin:14mm}
@media print{body{max-width:none;padding:0;font-size:10.5pt}h2{break-after:avoid}.cases{grid-template-columns:1fr 1fr}
.charts{grid-template-columns:1fr 1fr}a{color:inherit;text-decoration:none}.scroll{overflow:visible}
table{font-size:8.5pt}th,td{padding:2px 5px}tr{break-inside:avoid}}
"""


def page(title: str, body: Sequence[str], foot: str) -> str:
    """The complete document; `title` and `foot` are plain text, `body` is HTML."""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width,initial-scale=1">\n'
        f"<title>{plain(title)}</title>\n<style>{STYLE}</style></head>\n<body>\n"
        + "\n".join(body)
        + f"\n<footer>{plain(foot)}</footer>\n</body></html>\n"
    )


def plain(text: str) -> str:
    """Any text, safe inside HTML and inside a UTF-8 file: control characters and stray bytes of names are escaped."""
    shown = "".join(c if c.isprintable() or c in "\n\t" else c.encode("unicode_escape").decode() for c in text)
    return escape(shown)


def table(found: ReportTable, *, titled: bool = True) -> str:
    """The styles of rows and cells are classes of STYLE."""
    title = f"<h3>{plain(found.title)}</h3>" if titled else ""
    heads = "".join(f"<th>{plain(head)}</th>" for head in found.heads)
    lines = [f'{title}<div class="scroll"><table><thead><tr>{heads}</tr></thead><tbody>']
    for style, cells in found.rows:
        lines.append(f'<tr class="{style}">')
        lines += [f'<td class="{kind}">{plain(text)}</td>' for text, kind in map(_with_style, cells)]
        lines.append("</tr>")
    return "".join([*lines, "</tbody></table></div>"])


def _with_style(cell: Cell) -> tuple[str, str]:
    return (cell, "") if isinstance(cell, str) else cell


def tile(value: str, text: str, style: str = "plain") -> str:
    return f'<div class="tile {style}"><b>{value}</b><span>{text}</span></div>'


def figure(svg: str, caption: str) -> str:
    return f"<figure>{svg}<figcaption>{caption}</figcaption></figure>"


def embed(image: Image, quality: int = 82) -> str:
    """A picture as a JPEG data URI."""
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise ValueError("the picture cannot be encoded")
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode("ascii")


def write(path: Path, text: str) -> None:
    """Raises ConfigError where the file cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
