"""The pages below a base path, behind proxies that are named: what a header of theirs changes, and what none does."""

from typing import Any

import pytest
from pydantic import ValidationError
from starlette.applications import Starlette

from gateway.config.sections.hmi import HmiConfig
from gateway.web.auth import common_pages
from gateway.web.auth.audit_log import AuditKind
from gateway.web.auth.page_files import pages_digest, placed
from tests.unit.web.auth import ORIGIN, Browser, SecuredApp, secured_app
from tests.virtual_time import in_real_time, in_virtual_time

PROXY = "10.0.0.1"
VIA = {"x-forwarded-for": "203.0.113.9", "x-forwarded-proto": "https"}
HTTPS = {**VIA, "origin": ORIGIN.replace("http", "https")}


def browser(address: str = PROXY, **keys: Any) -> Browser:
    return Browser(secured_app(trusted_proxies=(PROXY,), **keys), address=address)


async def login(page: Browser, headers: dict[str, str], path: str = "", **more: str) -> Any:
    page.csrf = (await page.get(f"{path}/api/session", headers)).json["csrf"]
    body = {"name": "tom", "password": "correct horse battery", **more}
    answer = await page.post(f"{path}/api/login", body, headers)
    if answer.status == 200:
        page.csrf = answer.json["csrf"]
    return answer


@in_virtual_time
async def test_a_named_proxy_names_address_and_scheme() -> None:
    page = browser()
    answer = await login(page, HTTPS)
    assert answer.headers["set-cookie"].startswith("__Host-g1-session=")
    assert "; Secure" in answer.headers["set-cookie"]
    (record,) = page.secured_app.records
    assert (record.kind, record.address) == (AuditKind.LOGIN, "203.0.113.9")
    done = await page.post("/api/setup/save", {}, HTTPS)
    assert done.json["by"] == "203.0.113.9 (tom, role technician)"
    refused = await page.post("/api/setup/save", {}, VIA | {"origin": ORIGIN})
    assert refused.json["error"] == "origin"  # of http, and the browser uses https


@in_virtual_time
@pytest.mark.parametrize(
    "header", ["x-forwarded-host", "forwarded", "x-real-ip", "x-forwarded-prefix", "x-original-url"]
)
async def test_no_other_header_changes_anything(header: str) -> None:
    page = browser(base_path="/bay1")
    answer = await page.get("/bay1/api/session", {header: "/tune/north"})
    assert answer.json["role"] == "driver"
    await login(page, {header: "for=203.0.113.9;host=evil.example"}, "/bay1")
    assert page.secured_app.records[-1].address == PROXY


@in_virtual_time
async def test_nobody_else_names_anything() -> None:
    page = browser("10.0.0.99")
    assert (await login(page, HTTPS)).json["error"] == "origin"
    answer = await login(page, VIA | {"origin": ORIGIN})
    assert answer.headers["set-cookie"].startswith("g1-session=")
    assert "Secure" not in answer.headers["set-cookie"]
    assert page.secured_app.records[-1].address == "10.0.0.99"
    unnamed = Browser(secured_app(), address=PROXY)
    await login(unnamed, VIA | {"origin": ORIGIN})
    assert unnamed.secured_app.records[-1].address == PROXY


@in_virtual_time
async def test_failed_logins_are_counted_by_the_client_and_not_by_the_proxy() -> None:
    page = browser()
    page.csrf = (await page.get("/api/session", HTTPS)).json["csrf"]
    statuses = [
        (await page.post("/api/login", {"name": f"user{n}", "password": "guess"}, HTTPS)).status for n in range(12)
    ]
    assert statuses == [401] * 10 + [429] * 2
    other = HTTPS | {"x-forwarded-for": "203.0.113.9, 203.0.113.10"}
    assert (await login(page, other)).status == 200


@in_virtual_time
async def test_all_addresses_are_below_the_base_path() -> None:
    page = browser(base_path="/bay1")
    assert (await page.get("/bay1")).headers["location"] == "/bay1/"
    to_login = await page.get("/bay1/tune/north?x=1")
    assert to_login.headers["location"] == "/bay1/login?next=/bay1/tune/north%3Fx%3D1&need=technician"
    for path in ("/", "/login", "/api/session", "/bay10/login", "/bay1login", "//bay1/login", "/bay1//login"):
        assert (await page.get(path)).status == 404, path
    for path in ("/bay1/../bay1/login", "/bay1/..", "/bay1/./login", "/x/../bay1/login"):
        assert (await page.get(path)).status == 404, path
    answer = await login(page, {}, "/bay1", next="/wiki")
    assert answer.json["next"] == "/bay1/"
    assert "; Path=/bay1;" in answer.headers["set-cookie"]
    secure = await login(page, HTTPS, "/bay1")
    assert secure.headers["set-cookie"].startswith("__Secure-g1-session=")
    assert (await page.get("/bay1/tune/north", VIA)).status == 200
    out = await page.post("/bay1/api/logout", {}, HTTPS)
    assert "; Path=/bay1;" in out.headers["set-cookie"]


@in_virtual_time
async def test_who_may_show_the_pages_in_a_frame_is_named() -> None:
    alone = await browser().get("/driver")
    assert alone.headers["content-security-policy"].endswith("; frame-ancestors 'none'")
    assert alone.headers["x-frame-options"] == "DENY"
    framed = await browser(frame_ancestors=("https://portal.plant.example", "http://10.0.0.7:3000")).get("/driver")
    policy = framed.headers["content-security-policy"]
    assert policy.endswith("; frame-ancestors https://portal.plant.example http://10.0.0.7:3000")
    assert "x-frame-options" not in framed.headers


@pytest.mark.parametrize(
    "keys",
    [
        {"base_path": "bay1"}, {"base_path": "/bay1/"}, {"base_path": "/"}, {"base_path": "/a/../b"},
        {"base_path": "//evil.example"}, {"base_path": "/a b"}, {"base_path": "/a;b"}, {"base_path": "/a\nb"},
        {"trusted_proxies": ("proxy.plant.example",)}, {"trusted_proxies": ("10.0.0.0/8",)},
        {"frame_ancestors": ("*",)}, {"frame_ancestors": ("https://*.example",)}, {"frame_ancestors": ("'self'",)},
        {"frame_ancestors": ("https://a.example; script-src *",)}, {"frame_ancestors": ("https://a.example/path",)},
        {"frame_ancestors": ("https://a.example\n",)}, {"frame_ancestors": ("data:",)},
        {"without_login": "technician", "trusted_proxies": ("127.0.0.1",)},  # loopback is the proxy, and not the people
        {"without_login": "technician", "base_path": "/bay1"},
    ],
)  # fmt: skip
def test_what_is_refused(keys: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        HmiConfig.model_validate(keys)


@in_real_time
async def test_a_browser_keeps_what_never_changes_and_asks_for_the_rest() -> None:
    """A page names scripts by the digest of all; any other address of them is asked for again."""
    secured = SecuredApp(
        HmiConfig(base_path="/bay1"), app=Starlette(routes=common_pages.ADDRESSES.routes), real_time=True
    )
    page = Browser(secured, host="127.0.0.1:8080")
    html = placed('<link href="/static/icon.svg"><a href="/login"><a href="https://a/static/b">', "/bay1")
    current = f"/bay1/static/~{pages_digest()}"
    assert html == f'<link href="{current}/icon.svg"><a href="/bay1/login"><a href="https://a/static/b">'
    kept = await page.get(f"{current}/lib/api.js")
    assert (kept.status, kept.headers["cache-control"]) == (200, "public, max-age=31536000, immutable")
    assert kept.body == (await page.get("/bay1/static/lib/api.js")).body
    unchanged = await page.get(f"{current}/lib/api.js", {"if-none-match": kept.headers["etag"]})
    assert (unchanged.status, unchanged.headers["cache-control"]) == (304, kept.headers["cache-control"])
    for path in ("lib/api.js", "~0123456789abcdef/lib/api.js"):
        assert (await page.get(f"/bay1/static/{path}")).headers["cache-control"] == "no-cache"
    for path in ("lib/none.js", "../pages.py", "~../lib/api.js", f"~{pages_digest()}/lib/api.js"):
        missing = await page.get(f"{current}/{path}")
        assert (missing.status, missing.headers["cache-control"][:2]) == (404, "no")
