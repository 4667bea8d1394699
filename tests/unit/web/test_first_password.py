"""The first password: what is seen before, who may make it, and that exactly one does."""

import asyncio
import logging
import socket
import tomllib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import pytest
from argon2 import PasswordHasher

from gateway import config
from gateway.clock import SystemClock
from gateway.config import HmiConfig, parse
from gateway.doctor import network
from gateway.errors import ConfigError
from gateway.hub import Hub
from gateway.net import own_host
from gateway.web.auth.access import Level
from gateway.web.auth.audit_log import AuditKind
from gateway.web.auth.login_throttle import is_of_network
from gateway.web.auth.security import SecurityMiddleware
from gateway.web.host.status import StatusCollector
from gateway.web.host.web_process_service import WebProcessService
from gateway.web.ipc.messages import WebSetup
from gateway.web.server.app import RULES, routes_app
from gateway.web.server.services import services_of
from tests.unit.web.asgi import Answer
from tests.unit.web.auth import HASH, Browser, SecuredApp, example
from tests.unit.web.gateway_client import plant
from tests.virtual_time import AtOnce, in_virtual_time

ON = {"enabled": True, "host": "0.0.0.0", "tls_cert": "auto", "first_password": True}
FILE = """\
[hmi]                         # the pages
enabled = true
host = "0.0.0.0"
tls_cert = "auto"
first_password = true         # until there is a user
"""
USER = f'[[hmi.users]]\nname = "tom"\nrole = "technician"\npassword_hash = "{HASH}"\n'
NEW = "truck stands under a spout"
ADDRESS = "/api/setup/first-password"


@pytest.fixture(autouse=True)
def names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(own_host, "own_names", lambda: ("bay-pc.local", "bay-pc"))


def browser_of(secured: SecuredApp, **more: Any) -> Browser:
    return Browser(secured, **{"scheme": "https", **more})


def closed(**keys: Any) -> SecuredApp:
    return SecuredApp(HmiConfig.model_validate({**ON, **keys}))


@in_virtual_time
async def test_before_there_is_a_user_every_address_leads_to_one_page_and_nothing_of_the_plant_is_read() -> None:
    """Whatever is read without a login later."""
    for rule in RULES:
        browser = browser_of(closed(without_login="viewer"))
        session = (await browser.get("/api/session")).json
        assert (session["first_password"], session["role"], session["bays"]) == (True, "none", [])
        browser.csrf = session["csrf"]
        if rule.method == "WS":
            socket = await browser.socket(example(rule))
            assert (socket.status, socket.data) == (401, 0), rule.path
            continue
        of_pages = rule.least is Level.OPEN and rule.path not in ("/healthz", "/api/login")
        ask: Any = {"POST": browser.post, "DELETE": browser.delete}.get(rule.method, browser.get)
        answer = await ask(example(rule))
        expected = 200 if of_pages else 303 if rule.page else 401
        assert (rule.path, answer.status) == (rule.path, expected)
        if expected == 303:
            assert answer.headers["location"].startswith("/login?")
    for path in ("/no-such-page", "/setup/x"):
        answer = await browser.get(path, {"accept": "text/html"})
        assert (answer.status, answer.headers["location"]) == (303, "/login")
    assert (await browser.get("/api/none")).status == 404


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("10.0.0.5:8080", 200),  # the address of the machine that was reached
        ("bay-pc.local:8080", 200),
        ("BAY-PC:8080", 200),
        ("bay-pc-2.local", 200),  # two machines of one name
        ("localhost:8443", 200),  # through a tunnel
        ("10.0.0.6:8080", 400),
        ("bay-pc.attacker.example:8080", 400),
        ("attacker.example", 400),
    ],
)
@in_virtual_time
async def test_only_requests_for_the_machine_s_own_names_are_answered(host: str, status: int) -> None:
    for secured in (closed(), SecuredApp(HmiConfig.model_validate({**ON, **tomllib.loads(USER)["hmi"]}))):
        assert (await browser_of(secured, host=host).get("/login")).status == status


@pytest.mark.parametrize(
    ("address", "near"),
    [
        ("192.168.1.20", True),
        ("10.0.0.99", True),
        ("172.31.0.1", True),
        ("169.254.7.7", True),
        ("127.0.0.1", True),
        ("fe80::1%eth0", True),
        ("fd00::5", True),
        ("::ffff:192.168.1.20", True),
        ("8.8.8.8", False),
        ("::ffff:8.8.8.8", False),
        ("2001:4860:4860::8888", False),
        ("172.32.0.1", False),
        ("100.64.3.4", False),  # of other customers of a mobile network
        ("2001:0:4137:9e76:0:ff:f7f7:f7f7", False),  # 8.8.8.8 behind Teredo
        ("2002:808:808::1", False),  # and by 6to4
        ("?", False),
    ],
)
@in_virtual_time
async def test_before_there_is_a_user_nobody_beyond_the_network_is_answered(address: str, near: bool) -> None:
    assert is_of_network(address) == near
    secured = closed()
    for path in ("/login", "/", "/static/style.css", "/api/session"):
        answer = await browser_of(secured, address=address).get(path)
        assert (answer.status == 403) != near
        if not near:
            assert answer.json["error"] == "address"
    assert secured.kinds().count(AuditKind.REFUSED) == (0 if near else 4)
    users = tomllib.loads(USER)["hmi"]
    assert (
        await browser_of(SecuredApp(HmiConfig.model_validate({**ON, **users})), address=address).get("/login")
    ).status == 200


@dataclass
class First:
    """The real application of a file behind its security, and browsers at it."""

    path: Path
    secured: SecuredApp
    reloads: list[None] = field(default_factory=list)

    async def post(self, name: str, password: str = NEW, *, address: str = "192.168.1.20", **headers: str) -> Answer:
        browser = browser_of(self.secured, address=address)
        browser.csrf = (await browser.get("/api/session")).json["csrf"]
        return await browser.post(ADDRESS, {"name": name, "password": password}, headers)

    @property
    def users(self) -> list[dict[str, str]]:
        found: list[dict[str, str]] = tomllib.loads(self.path.read_text())["hmi"].get("users", [])
        return found


@asynccontextmanager
async def first(folder: Path, text: str = FILE) -> AsyncIterator[First]:
    path = folder / "plant.toml"
    path.write_text(text)
    reloads: list[None] = []
    settings = config.load(path)
    async with plant(config=settings, source=str(path), reload=lambda: reloads.append(None)) as made:
        secured = SecuredApp(settings.hmi, quick=False)
        secured.logins.passwords._thread = AtOnce()
        app = routes_app(services_of(made.client, made.client.clock, AtOnce()), secured.logins)
        secured.middleware = SecurityMiddleware(app, RULES, secured.logins, made.client.clock)
        yield First(path, secured, reloads)


@in_virtual_time
async def test_who_makes_it_is_the_technician_in_the_file_which_keeps_its_comments(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    async with first(tmp_path) as made:
        answer = await made.post("anna")
        assert (answer.status, answer.json) == (200, {"name": "anna"})
        (user,) = made.users
        assert (user["name"], user["role"]) == ("anna", "technician")
        PasswordHasher().verify(user["password_hash"], NEW)
        assert made.path.read_text().startswith(FILE)
        assert len(made.reloads) == 1, "in force without a restart"
        assert not parse(tomllib.loads(made.path.read_text())).hmi.awaits_first_user
        (record,) = made.secured.records
        assert str(record) == "changed: anna at 192.168.1.20: the first password, as technician"
        assert f"{made.path}: hmi.users.anna saved by 192.168.1.20" in caplog.text
        assert NEW not in caplog.text
        assert user["password_hash"] not in caplog.text


@in_virtual_time
async def test_of_two_visitors_one_makes_it_and_the_other_is_told(tmp_path: Path) -> None:
    async with first(tmp_path) as made:
        answers = await asyncio.gather(*(made.post(name) for name in ("anna", "otto", "anna")))
        assert sorted(answer.status for answer in answers) == [200, 409, 409]
        for answer in answers:
            if answer.status == 409:
                assert "somebody else has made the first password meanwhile: log in" in answer.json["detail"]
        assert len(made.users) == 1
        assert (await made.post("eva")).status == 409
        assert len(made.users) == 1


@in_virtual_time
async def test_where_there_is_a_user_or_the_key_is_not_set_nobody_is_made(tmp_path: Path) -> None:
    for text in (FILE + USER, FILE.replace("first_password = true", "")):
        async with first(tmp_path, text) as made:
            answer = await made.post("anna")
            assert (answer.status, answer.json["error"]) == (409, "made")
            assert made.path.read_text() == text


@pytest.mark.parametrize(
    ("name", "password", "headers", "status", "error"),
    [
        ("anna", "short", {}, 400, "password"),
        ("annamaria", "annamaria12", {}, 400, "password"),
        ("an na", NEW, {}, 400, "body"),
        ("anna", NEW, {"origin": "https://attacker.example"}, 403, "origin"),
        ("anna", NEW, {"origin": "-"}, 403, "origin"),
        ("anna", NEW, {"x-csrf-token": "-"}, 403, "csrf"),
    ],
)
@in_virtual_time
async def test_what_is_refused(
    tmp_path: Path, name: str, password: str, headers: dict[str, str], status: int, error: str
) -> None:
    async with first(tmp_path) as made:
        answer = await made.post(name, password, **headers)
        assert (answer.status, answer.json["error"]) == (status, error)
        assert made.path.read_text() == FILE


@in_virtual_time
async def test_tries_are_limited_and_a_file_that_waits_for_a_restart_is_not_written(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async with first(tmp_path) as made:
        waits = FILE.replace("enabled = true", "enabled = true\nport = 8081")
        made.path.write_text(waits)
        answer = await made.post("anna")
        assert answer.status == 422
        assert "wait for a restart" in caplog.text
        assert answer.json["detail"] == "the configuration's file does not take it: the gateway's log says why"
        for n in range(9):
            assert (await made.post("anna", address=f"192.168.1.{n}")).status == 422
        answer = await made.post("anna", address="192.168.1.99")
        assert (answer.status, answer.json["error"]) == (429, "throttled")
        assert made.path.read_text() == waits


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (FILE.replace("0.0.0.0", "127.0.0.1") + 'without_login = "technician"', "needs no password"),
        (FILE.replace("0.0.0.0", "10.0.0.5").replace('tls_cert = "auto"', ""), "it would be sent without TLS"),
        (FILE + 'base_path = "/bay1"', "a proxy hides who is of this network"),
        (FILE + 'trusted_proxies = ["10.0.0.7"]', "a proxy hides who is of this network"),
        (FILE + "setup_page = false", "lets only this file make users"),
    ],
)
def test_where_it_makes_no_sense_the_file_is_refused(text: str, expected: str) -> None:
    with pytest.raises(ConfigError, match=rf"hmi\.first_password = true: .*{expected}"):
        parse(tomllib.loads(text), text=text)


def test_nothing_is_read_without_a_login_afterwards_where_none_is_wanted() -> None:
    parse(tomllib.loads(FILE + 'without_login = "none"'))


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        (FILE, "nobody has made the first password yet, at {urls}"),
        (FILE + USER, "pages at {urls}"),
        (FILE.replace("0.0.0.0", "127.0.0.1"), ""),
    ],
)
def test_the_status_and_the_doctor_say_where_the_pages_are(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, more: str, expected: str
) -> None:
    monkeypatch.setattr(own_host, "own_addresses", lambda: ["192.168.1.50", "127.0.0.1"])
    monkeypatch.setattr(own_host, "MDNS_SOCKET", tmp_path / "avahi")
    found = parse(tomllib.loads(more + "[modbus]\nport = 0\n"))
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        service = WebProcessService(cast(Any, None), WebSetup(found, SystemClock(), {}), (listening,))
        urls = f"https://192.168.1.50:{listening.getsockname()[1]}/"
        told = StatusCollector(found, Hub(["bay1"]), pages=service.where).summary(0).split("; ")[1:]
    assert (told[0] if expected else "") == expected.format(urls=urls)
    of_doctor = [line.result for line in network.ports(found, running=True) if line.part == "pages"]
    assert of_doctor == (["open https://192.168.1.50:8080/"] if expected else [])
