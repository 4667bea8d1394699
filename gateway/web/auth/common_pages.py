"""What every server of pages has: the login page, the files, and the texts in each language.

Of the application's state they use `base_path` and `languages`.
"""

from hashlib import sha256

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from gateway.web.auth.access import Level
from gateway.web.auth.addresses import Addresses
from gateway.web.auth.page_files import STATIC, page_file, pages_digest
from gateway.web.languages import Languages

ADDRESSES = Addresses()


@ADDRESSES.get("/login", Level.OPEN, "the login page")
async def _login_page(request: Request) -> Response:
    return page_file(STATIC / "login.html", request.app.state.base_path)


ADDRESSES.files("/static", STATIC, Level.OPEN, "scripts, styles and symbols of the pages; nothing of the plant")


@ADDRESSES.get("/api/pages", Level.OPEN, "which pages are served: `digest` changes when they do")
def _pages() -> JSONResponse:
    return JSONResponse({"digest": pages_digest()})


@ADDRESSES.get("/favicon.ico", Level.OPEN, "the pages' symbol")
async def _favicon() -> Response:
    raise HTTPException(404)  # each page names its own


@ADDRESSES.get("/api/languages", Level.OPEN, "the languages of the pages")
async def _languages(request: Request) -> JSONResponse:
    found: Languages = request.app.state.languages
    return JSONResponse({"languages": found.listed()})


@ADDRESSES.get("/api/languages/{code}", Level.OPEN, "the pages' texts in a language; nothing of the plant")
async def _language(request: Request, code: str) -> Response:
    languages: Languages = request.app.state.languages
    if (found := languages.catalogues.get(code)) is None:
        raise HTTPException(404, f"no language has the code {code[:20]!r}")
    answer = JSONResponse(found.model_dump())
    tag = f'"{sha256(answer.body).hexdigest()[:16]}"'
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers={"ETag": tag})
    answer.headers["ETag"] = tag
    return answer
