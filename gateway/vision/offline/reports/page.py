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

STYLE = Path(__file__).with_name("report.css").read_text(encoding="utf-8")


def page(title: str, body: Sequence[str], foot: str) -> str:
    """The complete document; `title` and `foot` are plain text, `body` is HTML."""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width,initial-scale=1">\n'
        f"<title>{plain(title)}</title>\n<style>\n{STYLE}</style></head>\n<body>\n"
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
