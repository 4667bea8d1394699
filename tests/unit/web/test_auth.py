"""Who gets through to the pages. Every row of the table is tried by everybody; then the attacks, one by one."""

import asyncio
from typing import Any

import pytest
from fastapi import FastAPI
from hypothesis import given, settings
from hypothesis import strategies as st
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import Receive, Scope, Send

from gateway.web.auth.access import BODY_BYTES, LOGIN_BYTES, Level, Rule, find
from gateway.web.auth.audit_log import AuditKind
from gateway.web.auth.bodies import BODY_S
from gateway.web.auth.security import ENDED, REQUEST_S
from gateway.web.server.app import RULES
from tests.examples import examples
from tests.unit.web.auth import ORIGIN, PASSWORD, Browser, example, secured_app
from tests.virtual_time import in_virtual_time

NEEDS = {"driver": Level.DRIVER, "viewer": Level.VIEWER, "technician": Level.TECHNICIAN, "none": Level.OPEN}
WHO = [("", "none"), ("", "driver"), ("", "viewer"), ("vera", "none"), ("vera", "driver"), ("tom", "none")]


def expected(rule: Rule, name: str, without_login: str) -> int:
    """By hand, from the roles' meaning: 401 asks for a login, 403 says that it is the wrong one, 303 shows the way."""
    level = max(NEEDS[without_login], {"": Level.OPEN, "vera": Level.VIEWER, "tom": Level.TECHNICIAN}[name])
    good = 101 if rule.method == "WS" else 200
    if rule.path in ("/api/login", "/api/logout", "/api/session") or rule.least is Level.OPEN:
        return 400 if rule.path == "/api/login" else good  # an empty login is no login
    if rule.method == "POST" and not name:
        return 401
    if level >= rule.least:
        return good
    if rule.page:
        return 303
    return 403 if name else 401


async def tried(browser: Browser, rule: Rule) -> int:
    if rule.method == "WS":
        socket = await browser.socket(example(rule))
        assert socket.status is not None
        if socket.status == 101:
            assert socket.data == 1
            await socket.leave()
        else:
            assert socket.data == 0
        return socket.status
    if rule.method == "POST":
        answer = await browser.post(example(rule))
    elif rule.method == "DELETE":
        answer = await browser.delete(example(rule))
    else:
        answer = await browser.get(example(rule))
    if answer.status in (401, 403):
        assert answer.json["error"] in ("login", "role")
        assert "who" not in answer.text
    if answer.status == 303:
        assert answer.headers["location"].startswith(f"/login?next={example(rule)}&need=")
    return answer.status


@pytest.mark.mostly_long
@pytest.mark.one_interpreter
@pytest.mark.parametrize(("name", "without_login"), WHO)
@in_virtual_time
async def test_every_address_by_everybody(name: str, without_login: str) -> None:
    for rule in RULES:
        browser = Browser(secured_app(without_login))
        if name:
            assert (await browser.login(name)).status == 200
        else:
            browser.csrf = (await browser.get("/api/session")).json["csrf"]
        assert (rule.path, await tried(browser, rule)) == (rule.path, expected(rule, name, without_login))


def test_what_technicians_do_is_closed_to_all_others() -> None:
    """The table itself, read by a person: a row that slips to a lower level is seen here."""
    bay = "/api/bays/{bay}/"
    of_bays = (
        "events history-events kept-pictures kept-pictures/{file}/{place}.jpg kept-pictures/{file}/{place}.png picture "
        "records registers snapshot.jpg snapshot.png state statistics statistics.csv trend values visits visits.csv "
        "visits/{begun_ms} why why.html mark"
    )
    viewers = {rule.path for rule in RULES if rule.least is Level.VIEWER}
    assert viewers == {f"{bay}{name}" for name in of_bays.split()} | {
        "/", "/history", "/manager", "/manual", "/manual/{name}", "/manual/images/{name}", "/metrics", "/api/state",
        "/api/live", "/api/events", "/api/openapi.json", "/api/alarms", "/api/alarms/live",
        "/api/alarms/{alarm}/acknowledge", "/api/alarms/{alarm}/reset",
    }  # fmt: skip
    assert {rule.path for rule in RULES if rule.least is Level.OPEN} == {
        "/login", "/static/{path:path}", "/favicon.ico", "/healthz", "/api/session", "/api/login", "/api/logout",
        "/api/languages", "/api/languages/{code}", "/api/pages", "/api/setup/first-password",
    }  # fmt: skip
    assert {rule.path for rule in RULES if rule.least is Level.DRIVER} == {"/driver", "/driver/{bay}", "/api/driver"}


def test_what_changes_anything_but_its_own_page_is_in_the_audit_log() -> None:
    """That which ends another user's calibration or teach-in, too."""
    of_bays = (
        "freeze upload record trial eyedropper profile/diff profile/export profile/import calibration calibration/look "
        "calibration/views/{number} teach-in test-sets/{name}/score test-sets/{name}/score/cancel"
    )
    assert {(rule.method, rule.path) for rule in RULES if rule.acts and not rule.audited} == {
        ("POST", "/api/setup/preview"),
        ("POST", "/api/setup/password"),
        ("POST", "/api/setup/update/piece"),  # two hundred of a package; what is asked for with it is
        *(("DELETE" if "views" in name else "POST", f"/api/bays/{{bay}}/{name}") for name in of_bays.split()),
    }


@in_virtual_time
async def test_everybody_is_technician_on_loopback_where_configured() -> None:
    browser = Browser(secured_app("technician", host="127.0.0.1", users=()), host="127.0.0.1:8080")
    session = (await browser.get("/api/session")).json
    assert (session["bays"], session["titles"]) == (["north", "south"], {"north": "Verladung 3 Süd"})
    browser.csrf = session["csrf"]
    answer = await browser.post("/api/bays/north/profile/apply", {"a": 1})
    assert answer.status == 200
    assert answer.json == {
        "who": "",
        "role": "technician",
        "body": '{"a": 1}',
        "by": "10.0.0.99 (without login, role technician)",
    }
    assert (await browser.post("/api/bays/north/profile/apply", {}, {"x-csrf-token": "-"})).status == 403


@in_virtual_time
async def test_the_way_to_the_login_is_not_bent() -> None:
    """What was asked for stands in one parameter, whatever it holds."""
    browser = Browser(secured_app())
    answer = await browser.get('/?a=b&need=none#x"<\r\n')
    assert answer.status == 303
    assert answer.headers["location"] == "/login?next=/%3Fa%3Db%26need%3Dnone%23x%22%3C%0D%0A&need=viewer"


# A route that was not registered with its rule


async def _nothing(_: Any) -> Any:
    raise AssertionError("no one should get here")


@pytest.mark.parametrize(
    ("route", "method", "path", "status"),
    [
        (Route("/api/new", _nothing), "GET", "/api/new", 404),
        (Route("/api/state", _nothing, methods=["DELETE"]), "DELETE", "/api/state", 405),
        (Route("/api/bays/{bay}/{anything}", _nothing), "GET", "/api/bays/north/other", 404),
        (Route("/api/bays/{bay:path}/state", _nothing), "GET", "/api/bays/north/south/state", 404),
        (WebSocketRoute("/api/state", _nothing), "WS", "/api/state", 404),
        (Mount("/other", StaticFiles(directory=".")), "GET", "/other/pyproject.toml", 404),
        (Mount("/api", routes=[Route("/new", _nothing)]), "GET", "/api/new", 404),
    ],
)
@in_virtual_time
async def test_a_route_without_a_rule_is_never_answered(route: Any, method: str, path: str, status: int) -> None:
    browser = Browser(secured_app())
    await browser.login("tom")
    application = browser.secured_app.middleware._app
    assert isinstance(application, FastAPI)
    application.router.routes.insert(0, route)
    if method == "WS":
        assert (await browser.socket(path)).status == status
    else:
        assert (await browser.get(path, method=method)).status == status


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/nothing", 404),
        ("GET", "/driver/", 404),
        ("GET", "/api/bays/north/south/state", 404),
        ("GET", "/api/bays//state", 404),
        ("GET", "//evil.example/", 404),
        ("POST", "/", 405),
        ("DELETE", "/api/state", 405),
        ("OPTIONS", "/api/state", 405),
        ("TRACE", "/login", 405),
        ("GET", "/api/login", 405),
        ("GET", "/api/live", 404),
        ("WS", "/api/live", 404),
        ("WS", "/api/driver", 404),
        ("HEAD", "/api/state", 200),
        ("GET", "/static/../app.py", 404),
        ("GET", "/static/a/../../../etc/passwd", 404),
        ("GET", "/static/..\\..\\app.py", 404),
        ("GET", "/static/./api.js", 404),
        ("GET", "/static/a\0.js", 404),
        ("GET", "/driver/a\nb", 404),
        ("GET", "/static/..js", 200),  # a name as good as any
    ],
)
@in_virtual_time
async def test_unknown_addresses_and_methods(method: str, path: str, status: int) -> None:
    browser = Browser(secured_app("viewer"))
    answer = await browser.get(path, method=method)
    assert answer.status == status
    if status == 405:
        assert answer.headers["allow"] in ("GET", "POST")


@in_virtual_time
async def test_a_person_at_an_unknown_address_sees_a_page_and_a_program_gets_a_problem() -> None:
    browser = Browser(secured_app("viewer"))
    person = {"accept": "text/html,application/xhtml+xml,*/*;q=0.8"}
    page = await browser.get("/hystory", person)
    assert (page.status, page.headers["content-type"]) == (404, "text/html; charset=utf-8")
    assert "There is no such page" in page.text
    assert "content-security-policy" in page.headers
    for path, headers in (("/hystory", {"accept": "*/*"}), ("/api/hystory", person)):
        answer = await browser.get(path, headers)
        assert (answer.status, answer.json["error"]) == (404, "unknown")


@given(st.text(max_size=60))
@settings(max_examples=examples(300))
def test_no_path_slips_past_its_row(text: str) -> None:
    """Whatever the row lets through to the files below /static has no way up."""
    found = find("GET", "/static/" + text, RULES)
    assert found.rule is not None
    assert found.rule.path == "/static/{path:path}"
    tricked = find("GET", "/driver/" + text, RULES).rule
    assert tricked is None or "/" not in text


# The attacks


@in_virtual_time
async def test_dns_rebinding() -> None:
    browser = Browser(secured_app("viewer"))
    for host in ("evil.example", "evil.example:8080", "10.0.0.5.evil.example", "10.0.0.6", "", "10.0.0.5, evil", "-"):
        answer = await browser.get("/api/state", {"host": host})
        assert (host, answer.status) == (host, 400)
        assert answer.json["error"] == "host"
    assert (await browser.get("/api/state", {"host": "10.0.0.5"})).status == 200
    assert (await browser.get("/api/state", {"host": "10.0.0.5:9999"})).status == 200  # through a tunnel
    twice = [(b"host", b"10.0.0.5"), (b"host", b"evil.example")]
    assert (await browser.raw("GET", "/api/state", twice, [b""])).status == 400
    socket = await browser.socket("/api/live", {"host": "evil.example", "origin": "http://evil.example"})
    assert (socket.status, socket.data) == (400, 0)
    assert set(browser.secured_app.kinds()) == {AuditKind.REFUSED}
    assert "evil.example is not a host name of these pages" in str(browser.secured_app.records[0])


@pytest.mark.parametrize(
    "origin",
    ["-", "null", "http://evil.example", "https://10.0.0.5:8080", "http://10.0.0.5", "http://10.0.0.5:8081",
     "http://10.0.0.5:8080/", "http://10.0.0.5:8080@evil.example", "http://evil.example:8080", "10.0.0.5:8080", ""],
)  # fmt: skip
@in_virtual_time
async def test_another_sites_page_changes_and_hears_nothing(origin: str) -> None:
    browser = Browser(secured_app("viewer"))
    await browser.login("tom")
    answer = await browser.post("/api/bays/north/profile/save", {}, {"origin": origin})
    assert (answer.status, answer.json["error"]) == (403, "origin")
    socket = await browser.socket("/api/live", {"origin": origin})
    assert (socket.status, socket.data) == (403, 0)
    assert (await browser.post("/api/bays/north/profile/save")).status == 200
    assert browser.secured_app.kinds() == [AuditKind.LOGIN, AuditKind.REFUSED, AuditKind.REFUSED, AuditKind.CHANGED]


@in_virtual_time
async def test_who_takes_evidence_away_is_in_the_audit_log() -> None:
    browser = Browser(secured_app("driver"))
    await browser.login("tom")
    before = len(browser.secured_app.records)
    assert (await browser.get("/api/bays/north/visits/5")).status == 200
    assert len(browser.secured_app.records) == before
    assert (await browser.get("/api/bays/north/visits/5/evidence.zip")).status == 200
    (told,) = browser.secured_app.records[before:]
    assert (told.kind, told.who, told.detail) == (
        AuditKind.CHANGED, "tom", "/api/bays/north/visits/5/evidence.zip: 200",
    )  # fmt: skip


@in_virtual_time
async def test_evidence_may_take_minutes_and_what_was_not_given_is_not_in_the_audit_log() -> None:
    async def busy(request: Request) -> Response:
        return Response(status_code=503)

    browser = Browser(secured_app("driver"))
    await browser.login("tom")
    url = "/api/bays/north/visits/5/evidence.zip"
    assert (await browser.get(f"{url}?wait_s=600")).status == 200
    before = len(browser.secured_app.records)
    browser.secured_app.middleware._app = Starlette(routes=[Route(url, busy)])
    assert (await browser.get(url)).status == 503
    assert len(browser.secured_app.records) == before


@in_virtual_time
async def test_origin_twice_is_no_origin() -> None:
    browser = Browser(secured_app("technician", host="127.0.0.1"), host="127.0.0.1")
    headers = [(b"host", b"127.0.0.1"), (b"origin", b"http://127.0.0.1"), (b"origin", b"http://evil.example")]
    assert (await browser.raw("POST", "/api/bays/north/freeze", headers, [b""])).status == 403


@pytest.mark.parametrize("token", ["-", "", "x" * 43, "another's", "strangers", "before"])
@in_virtual_time
async def test_forged_requests(token: str) -> None:
    built = secured_app("driver")
    other, browser = Browser(built), Browser(built)
    await other.login("tom")
    strangers = (await browser.get("/api/session")).json["csrf"]
    await browser.login("tom")
    before = browser.csrf
    await browser.login("tom")
    real = browser.csrf
    assert len({strangers, before, real, other.csrf}) == 4
    forged = {"another's": other.csrf, "strangers": strangers, "before": before}.get(token, token)
    answer = await browser.post("/api/bays/north/profile/apply", {}, {"x-csrf-token": forged})
    assert (answer.status, answer.json["error"]) == (403, "csrf")
    assert AuditKind.CHANGED not in built.kinds()
    assert (await browser.post("/api/bays/north/profile/apply")).status == 200
    assert (await browser.delete("/api/bays/north/teach-in", {"x-csrf-token": forged})).status == 403
    assert (await browser.delete("/api/bays/north/teach-in", {"origin": "http://evil.example"})).status == 403
    assert (await browser.delete("/api/bays/north/teach-in")).status == 200


@in_virtual_time
async def test_a_login_leads_to_a_page_of_this_server_alone() -> None:
    browser = Browser(secured_app())
    for wanted, leads in ((None, "/"), ("/tune/a?b=c#d", "/tune/a?b=c#d"), ("https://evil.example/", "/")):
        browser.csrf = (await browser.get("/api/session")).json["csrf"]
        answer = await browser.post("/api/login", {"name": "tom", "password": PASSWORD, "next": wanted})
        assert (answer.status, answer.json["next"]) == (200, leads)


@in_virtual_time
async def test_a_login_is_not_forged_either() -> None:
    browser = Browser(secured_app())
    answer = await browser.post("/api/login", {"name": "tom", "password": PASSWORD}, {"x-csrf-token": "-"})
    assert answer.status == 403
    answer = await browser.post("/api/login", {"name": "tom", "password": PASSWORD}, {"origin": "http://evil.example"})
    assert answer.status == 403
    assert browser.cookies == {}


@in_virtual_time
async def test_a_session_is_not_planted() -> None:
    """Session fixation: an id that the attacker knows never becomes the victim's."""
    built = secured_app()
    attacker, victim = Browser(built), Browser(built, address="10.0.0.7")
    await attacker.login("vera")
    planted = attacker.cookies["g1-session"]
    victim.cookies["g1-session"] = planted
    assert (await victim.get("/api/session")).json["name"] == "vera"
    await victim.login("tom")
    assert victim.cookies["g1-session"] != planted
    assert (await attacker.get("/api/session")).json["role"] == "driver"  # and the planted one has ended
    victim.cookies = {"g1-session": "chosen-by-the-attacker"}
    await victim.login("tom")
    assert victim.cookies["g1-session"] != "chosen-by-the-attacker"


@in_virtual_time
async def test_brute_force_at_speed() -> None:
    browser = Browser(secured_app())
    browser.csrf = (await browser.get("/api/session")).json["csrf"]
    answers = [await browser.post("/api/login", {"name": "tom", "password": f"guess {n:04}"}) for n in range(500)]
    assert [answer.status for answer in answers] == [401] * 10 + [429] * 490
    assert answers[-1].headers["retry-after"] == "60"
    assert browser.secured_app.checks == 10
    assert (await browser.login("tom")).status == 429  # not even the right one
    assert browser.secured_app.kinds().count(AuditKind.LOGIN_FAILED) == 10
    assert browser.secured_app.kinds().count(AuditKind.LOGIN_THROTTLED) == 20  # reported, but not five hundred times
    await asyncio.sleep(60)
    assert (await browser.login("tom")).status == 200
    last = browser.secured_app.records[-1]
    assert (last.kind, last.who, last.address) == (AuditKind.LOGIN, "tom", "10.0.0.99")


@in_virtual_time
async def test_brute_force_all_at_once() -> None:
    browser = Browser(secured_app())
    browser.csrf = (await browser.get("/api/session")).json["csrf"]
    logins = [browser.post("/api/login", {"name": "tom", "password": f"guess {n:04}"}) for n in range(100)]
    answers = await asyncio.gather(*logins)
    assert sorted(answer.status for answer in answers) == [401] * 10 + [429] * 90


@in_virtual_time
async def test_the_right_password_is_never_throttled() -> None:
    browser = Browser(secured_app())
    for _ in range(30):
        assert (await browser.login("tom")).status == 200
    program = Browser(browser.secured_app, address="10.0.0.8")
    for _ in range(30):
        assert (await program.get("/metrics", basic("vera", PASSWORD))).status == 200
        await asyncio.sleep(301)  # so that each is checked anew


@in_virtual_time
async def test_a_refused_login_does_not_show_whether_the_user_exists() -> None:
    browser = Browser(secured_app())
    known, unknown = await browser.login("tom", "wrong password"), await browser.login("tim", "wrong password")
    assert (known.status, known.text) == (unknown.status, unknown.text) == (401, unknown.text)


@pytest.mark.parametrize(
    ("path", "limit"), [("/api/login", LOGIN_BYTES), ("/api/bays/north/trial", BODY_BYTES), ("/api/state", 0)]
)
@in_virtual_time
async def test_too_long_bodies(path: str, limit: int) -> None:
    browser = Browser(secured_app())
    await browser.login("tom")
    headers = browser.signed()
    method = "GET" if path == "/api/state" else "POST"
    longer = str(limit + 1).encode()
    for length in (longer, b"99999999999999999999", b"-1", b"1_0", b"0x10", b""):
        answer = await browser.raw(method, path, [*headers, (b"content-length", length)], [b""])
        assert (length, answer.status) == (length, 413)
    two = [(b"content-length", b"0"), (b"content-length", b"7")]
    assert (await browser.raw(method, path, [*headers, *two], [b""])).status == 413
    if method == "POST":
        grown = [b"x" * 1024] * (limit // 1024) + [b"x"]  # without its length
        answer = await browser.raw(method, path, headers, grown)
        assert (answer.status, answer.headers["connection"]) == (413, "close")
        fits = await browser.raw(method, path, headers, grown[:-1])
        assert fits.status != 413


@in_virtual_time
async def test_a_body_that_does_not_arrive() -> None:
    browser = Browser(secured_app())
    browser.csrf = (await browser.get("/api/session")).json["csrf"]
    before_s = asyncio.get_running_loop().time()
    assert (await browser.raw("POST", "/api/login", browser.signed(), [])).status == 408
    assert asyncio.get_running_loop().time() - before_s == pytest.approx(BODY_S)


@in_virtual_time
async def test_a_body_arrives_complete_in_any_pieces() -> None:
    browser = Browser(secured_app())
    await browser.login("tom")
    answer = await browser.raw("POST", "/api/bays/north/trial", browser.signed(), [b"a", b"", b"bc", b"d"])
    assert answer.json["body"] == "abcd"


@in_virtual_time
async def test_other_sites_embed_nothing() -> None:
    browser = Browser(secured_app("viewer"))
    for site, status in (("cross-site", 403), ("same-site", 403), ("same-origin", 200), ("none", 200)):
        for path in ("/api/bays/north/picture", "/metrics", "/static/lib/api.js"):
            assert (site, (await browser.get(path, {"sec-fetch-site": site})).status) == (site, status)
    followed = {"sec-fetch-site": "cross-site", "sec-fetch-dest": "document"}  # a link on the plant's wiki
    assert (await browser.get("/metrics", followed)).status == 200
    assert (await browser.get("/", {"sec-fetch-site": "cross-site"})).status == 200


# Sessions, as pages notice them


@pytest.mark.parametrize("name", ["vera", "tom"])
@in_virtual_time
async def test_logging_out_ends_what_is_open(name: str) -> None:
    built = secured_app()
    browser, other = Browser(built), Browser(built)
    await browser.login(name)
    await other.login(name)
    socket, others = await browser.socket("/api/live"), await other.socket("/api/live")
    await socket.say()
    assert (socket.status, socket.data, socket.closed) == (101, 2, None)
    waiting = asyncio.get_running_loop().create_task(browser.get("/api/bays/north/picture?wait_s=5"))
    await asyncio.sleep(1)
    before_s = asyncio.get_running_loop().time()
    cookies = dict(browser.cookies)
    assert (await browser.post("/api/logout")).status == 200
    await socket.settle()
    assert (socket.closed, socket.task.done()) == (ENDED, True)
    answer = await waiting
    assert (answer.status, answer.json["error"]) == (401, "login")
    assert asyncio.get_running_loop().time() - before_s < 0.1
    assert browser.cookies == {}
    browser.cookies = cookies  # a thief's copy is worth nothing
    assert (await browser.get("/api/state")).status == 401
    await others.say()
    assert (others.data, others.closed) == (2, None)
    await others.leave()
    assert built.kinds()[-1] is AuditKind.LOGOUT
    assert built.middleware._open == {}


@in_virtual_time
async def test_a_session_is_over_after_its_time_however_busy_its_page() -> None:
    browser = Browser(secured_app(session_hours=1.0, session_idle_minutes=10.0))
    assert (await browser.login("vera")).json["expires_in_s"] == 3600
    socket = await browser.socket("/api/live")
    for _ in range(7):
        await asyncio.sleep(500)
        await socket.say()
    assert (socket.data, socket.closed) == (8, None)
    assert (await browser.get("/api/session")).json["expires_in_s"] == 100
    await asyncio.sleep(101)
    assert (socket.closed, socket.task.done()) == (ENDED, True)
    assert (await browser.get("/api/session")).json["name"] is None


@in_virtual_time
async def test_an_idle_session_ends() -> None:
    browser = Browser(secured_app(session_idle_minutes=10.0))
    await browser.login("vera")
    socket = await browser.socket("/api/live")
    await asyncio.sleep(599)
    await socket.say()  # an open page is not idle
    await asyncio.sleep(599)
    assert (await browser.get("/api/session")).json["name"] == "vera"
    await asyncio.sleep(601)
    assert (await browser.get("/api/session")).json["name"] is None
    await socket.settle()
    assert socket.closed == ENDED


@in_virtual_time
async def test_what_a_technician_began_is_not_left_half_done() -> None:
    browser = Browser(secured_app())
    await browser.login("tom")
    saving = asyncio.get_running_loop().create_task(browser.post("/api/bays/north/profile/save?wait_s=5"))
    await asyncio.sleep(1)
    await browser.post("/api/logout")
    assert (await saving).status == 200
    assert browser.secured_app.records[-1].kind is AuditKind.CHANGED
    assert str(browser.secured_app.records[-1]) == "changed: tom at 10.0.0.99: /api/bays/north/profile/save: 200"


@pytest.mark.parametrize(("answers", "expected"), [(True, "500"), (False, "no answer")])
def test_a_change_is_recorded_even_if_the_answer_fails(answers: bool, expected: str) -> None:
    """A fault in the software after the settings have gone live: somebody has changed something all the same."""
    done: list[str] = []

    async def acts_and_breaks(request: Request) -> Response:
        done.append(request.url.path)
        raise KeyError("a bug")

    @in_virtual_time
    async def scene() -> None:
        built = secured_app()
        inner = Starlette(routes=[Route("/api/bays/{bay}/profile/apply", acts_and_breaks, methods=["POST"])])

        async def app(scope: Scope, receive: Receive, send: Send) -> None:
            if scope["path"].endswith("apply") and not answers:
                done.append(scope["path"])
                raise KeyError("a bug")
            await (inner if scope["path"].endswith("apply") else good)(scope, receive, send)

        good, built.middleware._app = built.middleware._app, app
        browser = Browser(built)
        await browser.login("tom")
        with pytest.raises(KeyError):
            await browser.post("/api/bays/north/profile/apply")
        assert done == ["/api/bays/north/profile/apply"]
        assert str(built.records[-1]) == f"changed: tom at 10.0.0.99: /api/bays/north/profile/apply: {expected}"

    scene()


@in_virtual_time
async def test_no_request_lasts_for_ever() -> None:
    browser = Browser(secured_app("viewer"))
    before_s = asyncio.get_running_loop().time()
    assert (await browser.get("/api/state?wait_s=1000")).status == 503
    assert asyncio.get_running_loop().time() - before_s == pytest.approx(REQUEST_S)


# What every answer says


@pytest.mark.parametrize("tls", [False, True])
@in_virtual_time
async def test_headers_of_every_answer(tls: bool) -> None:
    files: dict[str, Any] = {"tls_cert": "a.pem", "tls_key": "a.key", "port": 443} if tls else {}
    built = secured_app(**files)
    browser = Browser(built, scheme="https" if tls else "http")
    answers = [await browser.get(path) for path in ("/login", "/nothing", "/api/state", "/static/a.js", "/tune/a")]
    answers.append(await browser.post("/api/login", {}))
    answers.append(await browser.get("/login", {"host": "evil.example"}))
    login = await browser.login("tom")
    assert [a.status for a in answers] == [200, 404, 401, 200, 303, 403, 400]
    for answer in [*answers, login]:
        sent = answer.headers
        assert sent["content-security-policy"].split("; ") == [
            "default-src 'self'", "img-src 'self' blob: data:", "connect-src 'self'", "object-src 'none'",
            "base-uri 'none'", "form-action 'self'", "frame-ancestors 'none'",
        ]  # fmt: skip
        assert sent["x-content-type-options"] == "nosniff"
        assert sent["x-frame-options"] == "DENY"
        assert sent["referrer-policy"] == "same-origin"
        assert "camera=()" in sent["permissions-policy"]
        assert sent["cross-origin-resource-policy"] == "same-origin"
        assert sent.get("cross-origin-opener-policy") == ("same-origin" if tls else None)
        assert sent.get("strict-transport-security") == ("max-age=2592000" if tls else None)
    assert [a.headers["cache-control"] for a in answers[:4]] == ["no-store", "no-store", "no-store", "no-cache"]
    cookie = login.headers["set-cookie"]
    name, _, flags = cookie.partition("=")
    assert name == ("__Host-g1-session" if tls else "g1-session")
    flags = flags.partition("; ")[2].lower()
    assert set(flags.split("; ")) == {
        "httponly", "samesite=strict", "path=/", "max-age=43200", *(["secure"] if tls else []),
    }  # fmt: skip


@in_virtual_time
async def test_hsts_only_where_the_pages_are_the_hosts_web_site() -> None:
    browser = Browser(secured_app(tls_cert="a", tls_key="b", port=8443), scheme="https")
    assert "strict-transport-security" not in (await browser.get("/login")).headers


# HTTP Basic, for programs


def basic(name: str, password: str) -> dict[str, str]:
    from base64 import b64encode

    return {"authorization": "Basic " + b64encode(f"{name}:{password}".encode()).decode()}


@in_virtual_time
async def test_a_program_logs_in_with_every_request_and_costs_one_check() -> None:
    program = Browser(secured_app("none"))
    for _ in range(20):
        assert (await program.get("/metrics", basic("vera", PASSWORD))).json["who"] == "vera"
        await asyncio.sleep(10)
    assert program.secured_app.checks == 1
    await asyncio.sleep(300)
    assert (await program.get("/metrics", basic("vera", PASSWORD))).status == 200
    assert program.secured_app.checks == 2
    assert program.secured_app.kinds() == [AuditKind.LOGIN]
    assert program.cookies == {}


@in_virtual_time
async def test_where_programs_may_not() -> None:
    program = Browser(secured_app("none"))
    good = basic("tom", PASSWORD)
    program.csrf = (await program.get("/api/session")).json["csrf"]
    assert (await program.get("/api/bays/north/profile", good)).status == 200
    assert (await program.get("/api/bays/north/profile", basic("vera", PASSWORD))).status == 403
    assert (await program.post("/api/bays/north/profile/save", {}, good)).status == 401
    assert (await program.get("/tune/north", good)).status == 303
    assert (await program.socket("/api/live", good)).status == 401
    bare = await program.get("/metrics")
    assert (bare.status, bare.headers["www-authenticate"]) == (401, 'Basic realm="gateway", charset="UTF-8"')
    assert "www-authenticate" not in (await program.get("/api/state")).headers  # or browsers would ask by themselves


@pytest.mark.parametrize(
    "value",
    ["Basic", "Basic !!!", "Basic dG9t", "Bearer abc", "Basic \xe4", "Basic " + "A" * 2000, "Basic /w==", ""],
)
@in_virtual_time
async def test_malformed_basic_is_refused(value: str) -> None:
    answer = await Browser(secured_app("none")).get("/metrics", {"authorization": value})
    assert (answer.status, answer.json["error"]) == (401, "basic")
    assert answer.headers["www-authenticate"].startswith("Basic ")


@in_virtual_time
async def test_basic_is_throttled_as_the_login_is() -> None:
    program = Browser(secured_app("none"))
    wrong = [(await program.get("/metrics", basic("tom", f"guess {n}"))).status for n in range(30)]
    assert wrong == [401] * 10 + [429] * 20
    assert program.secured_app.checks == 10


@in_virtual_time
async def test_a_wrong_password_is_never_served_from_memory() -> None:
    program = Browser(secured_app("none"))
    assert (await program.get("/metrics", basic("tom", PASSWORD))).status == 200
    assert (await program.get("/metrics", basic("tom", PASSWORD + "x"))).status == 401
    assert (await program.get("/metrics", basic("vera", "guess"))).status == 401


# Wild input


texts = st.text(st.characters(max_codepoint=255), max_size=200)


@pytest.mark.long
@pytest.mark.one_interpreter
@given(cookie=texts, host=texts, origin=texts, token=texts, authorization=texts)
@settings(max_examples=examples(200))
@in_virtual_time
async def test_wild_headers_give_no_access_and_no_fault(
    cookie: str, host: str, origin: str, token: str, authorization: str
) -> None:
    built = secured_app("none")
    browser = Browser(built)
    wild = {"cookie": cookie, "authorization": authorization}
    assert (await browser.get("/api/state", wild)).status == 401
    assert (await browser.get("/api/state", {**wild, "host": host})).status in (400, 401)
    posted = {**wild, "origin": origin, "x-csrf-token": token}
    assert (await browser.post("/api/bays/north/freeze", {}, posted)).status in (401, 403)
    assert (await browser.post("/api/login", {}, {**posted, "origin": ORIGIN})).status == 403
    assert built.records == [] or set(built.kinds()) <= {AuditKind.REFUSED, AuditKind.LOGIN_FAILED}
    assert all(str(record).isprintable() for record in built.records)


@pytest.mark.long
@pytest.mark.one_interpreter
@given(st.lists(st.tuples(st.sampled_from(["g1-session", "other", " g1-session ", "", "G1-SESSION"]), texts)))
@settings(max_examples=examples(100))
@in_virtual_time
async def test_a_cookie_beside_ours_does_not_hide_it(others: list[tuple[str, str]]) -> None:
    browser = Browser(secured_app("none"))
    await browser.login("vera")
    ours = f"g1-session={browser.cookies['g1-session']}"
    before = "; ".join(f"{name}={value.replace(';', '')}" for name, value in others)
    answer = await browser.get("/api/session", {"cookie": f"{before}; {ours}" if before else ours})
    assert answer.json["name"] == ("vera" if len(before) < 4000 else None)
