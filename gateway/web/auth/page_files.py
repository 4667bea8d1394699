"""The files of the pages: HTML with the addresses as a browser reaches them, scripts and styles that it may keep.

HTML is read anew each time and names scripts and styles by a digest of all files: what has such an address never
changes, and needs no question.
"""

import functools
import hashlib
import re
from importlib.resources import files
from pathlib import Path

from starlette.responses import HTMLResponse, Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

STATIC = Path(str(files("gateway.web") / "static"))
MISSING_PAGE = STATIC / "missing.html"
KEPT = b"public, max-age=31536000, immutable"
_DIGEST = re.compile(r"~([0-9a-f]{16})/")


@functools.cache
def pages_digest() -> str:
    """Of all files of the pages: another one, and a page that is open is an old one."""
    digest = hashlib.sha256()
    for path in sorted(path for path in STATIC.rglob("*") if path.is_file()):
        digest.update(f"{path.relative_to(STATIC)}\0".encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


def page_file(path: Path, base_path: str, status: int = 200) -> Response:
    return HTMLResponse(placed(path.read_text(encoding="utf-8"), base_path), status)


def missing_page(base_path: str) -> Response:
    return page_file(MISSING_PAGE, base_path, 404)


def placed(html: str, base_path: str) -> str:
    """The page's addresses below `base_path`, its files by their digest."""
    html = re.sub(r'( (?:href|src)=")/', rf"\g<1>{base_path}/", html)
    return re.sub(rf'( (?:href|src)="{base_path}/static/)', rf"\g<1>~{pages_digest()}/", html)


class PageFiles(StaticFiles):
    """Also below a digest; a browser keeps what has that of today."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        found = _DIGEST.match(path)
        answer = await super().get_response(path[found.end() :] if found else path, scope)
        if found and found[1] == pages_digest() and answer.status_code in (200, 304):
            answer.headers["cache-control"] = KEPT.decode()
        return answer
