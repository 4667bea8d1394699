"""The pages' server on real sockets: who is slow, silent, greedy or unreadable, and TLS from files."""

import asyncio
import hashlib
import inspect
import logging
import os
import socket
import ssl
import tomllib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from datetime import timedelta
from importlib.metadata import distributions, version
from pathlib import Path
from typing import Any

import httpx2
import pytest
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.typing import Origin

from gateway import config_check
from gateway.cli.main import main
from gateway.clock import SystemClock
from gateway.config import GatewayConfig, parse
from gateway.config.sections.hmi import HmiConfig
from gateway.errors import ConfigError
from gateway.net import tls
from gateway.net.tls import TlsFiles
from gateway.web.auth import slow_clients
from gateway.web.auth.security import ENDED
from gateway.web.server.process import ErrorThrottle
from tests.plant_certs import NOW, Plant
from tests.unit.web.auth import HASH, PASSWORD, USERS, SecuredApp
from tests.virtual_time import HandClock, in_real_time

HURRY_S = 30.0  # nothing here takes this long, on any machine


class QuickDeadline(slow_clients.HeadDeadlineProtocol):
    """Waits for a head for a moment only."""

    head_s = 0.3
    check_s = 0.05


@asynccontextmanager
async def served(
    application: Any,
    *,
    protocol: type[slow_clients.HeadDeadlineProtocol] = QuickDeadline,
    context: Any = None,
    **more: Any,
) -> AsyncIterator[int]:
    """The port."""
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        sock.listen(200)
        port: int = sock.getsockname()[1]
        settings = {**slow_clients.settings(context), "http": protocol, "timeout_graceful_shutdown": 1, **more}
        server = uvicorn.Server(uvicorn.Config(application, **settings))
        async with asyncio.TaskGroup() as group:
            group.create_task(server.serve([sock]))
            async with asyncio.timeout(HURRY_S):
                while not server.started:  # noqa: ASYNC110
                    await asyncio.sleep(0.01)
                try:
                    yield port
                finally:
                    server.should_exit = True


async def hello(scope: Any, receive: Any, send: Any) -> None:
    """Waits as long as the path says, and says hello."""
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.accept"})
        while (await receive())["type"] != "websocket.disconnect":
            await send({"type": "websocket.send", "text": "data"})
        return
    await asyncio.sleep(float(scope["path"].strip("/") or 0))
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"5")]})
    await send({"type": "http.response.body", "body": b"hello"})


async def received(port: int, *parts: bytes, pause_s: float = 0.0) -> bytes:
    """All that comes back, until the server closes or resets the connection."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    got = b""
    try:
        for part in parts:
            writer.write(part)
            await writer.drain()
            await asyncio.sleep(pause_s)
        while data := await reader.read(65536):
            got += data
    except ConnectionError:
        pass
    finally:
        writer.close()
    return got


# What slow_clients overrides or reads of uvicorn, as it was when that was written: name -> SHA-256 of its source.
UVICORN_PARTS = {
    "__init__": "ad1ed8e837b2db8d",
    "connection_made": "6efb565ff3d36b91",
    "connection_lost": "dbb688fa2b386000",
    "handle_events": "e63a9d1492e3efe7",
    "handle_websocket_upgrade": "6f42a029e35aed5c",
}


@pytest.mark.parametrize("name", UVICORN_PARTS)
def test_the_overridden_parts_of_uvicorn_are_those_that_were_looked_at(name: str) -> None:
    source = inspect.getsource(getattr(H11Protocol, name))
    assert hashlib.sha256(source.encode()).hexdigest()[:16] == UVICORN_PARTS[name], "look at slow_clients.py anew"


def test_of_opentelemetry_there_is_the_api_alone_which_sends_nothing() -> None:
    """Whatever is installed, extras and tests included: its SDK and exporters send to an address in the environment."""
    locked = tomllib.loads((Path(__file__).parents[3] / "uv.lock").read_text())["package"]
    assert [each["name"] for each in locked if each["name"].startswith("opentelemetry")] == ["opentelemetry-api"]
    installed = {found.name.lower().replace("_", "-") for found in distributions()}
    assert {name for name in installed if name.startswith("opentelemetry")} == {"opentelemetry-api"}


@pytest.mark.parametrize("package", ["uvicorn", "h11"])
def test_whose_private_parts_are_used_is_pinned_exactly(package: str) -> None:
    pins = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]["dependencies"]
    assert f"{package}=={version(package)}" in pins


REQUEST = b"GET / HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n"


@pytest.mark.long
@in_real_time
async def test_silent_and_slow_clients_are_disconnected_and_others_are_served() -> None:
    async with served(hello) as port:
        silent, dribbling, complete = await asyncio.gather(
            received(port), received(port, *[b"G"] + [b"x"] * 200, pause_s=0.02), received(port, REQUEST)
        )
        assert silent == b""
        assert dribbling == b""
        assert complete.endswith(b"hello")


@pytest.mark.long
@in_real_time
async def test_a_client_that_waits_for_its_answer_is_not_disconnected() -> None:
    async with served(hello) as port:
        slow = await received(
            port, b"GET /1.0 HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n"
        )  # over three times head_s
        assert slow.endswith(b"hello")
        async with connect(f"ws://127.0.0.1:{port}/") as page:
            await asyncio.sleep(1.0)
            await page.send("next")
            assert await page.recv() == "data"


@in_real_time
async def test_a_client_that_asks_again_and_again_on_one_connection_is_not_disconnected() -> None:
    """Though its requests are so short that no check finds one under way: for three times head_s."""
    async with served(hello) as port:
        kept = [b"GET / HTTP/1.1\r\nHost: a\r\n\r\n"] * 10
        got = await received(port, *kept, REQUEST, pause_s=0.1)
        assert got.count(b"hello") == 11


@in_real_time
async def test_a_head_has_a_length() -> None:
    async with served(hello) as port:
        endless = [b"GET / HTTP/1.1\r\n"] + [b"x-%d: " % n + b"a" * 4000 + b"\r\n" for n in range(100)]
        got = await received(port, *endless)
        assert got == b"" or got.startswith(b"HTTP/1.1 400 ")
        line = await received(port, b"GET /" + b"a" * 400_000)
        assert line == b"" or line.startswith(b"HTTP/1.1 400 ")
        assert (await received(port, REQUEST)).endswith(b"hello")


@pytest.mark.long
def test_what_is_no_http_is_refused_without_filling_the_log(caplog: pytest.LogCaptureFixture) -> None:
    async def scene() -> None:
        async with served(hello) as port:
            for junk in (b"\x16\x03\x01\x02\x00\x01\x00", b"\r\n" * 50 + b"x" * 50 + b"\r\n\r\n", os.urandom(500)):
                got = await received(port, junk)
                assert got == b"" or got.startswith(b"HTTP/1.1 400 ")
            two_hosts = await received(port, b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n")
            assert two_hosts.startswith(b"HTTP/1.1 400 ")

    asyncio.run(scene())
    assert caplog.records == []


@in_real_time
async def test_one_address_never_has_all_connections() -> None:
    async with served(hello, protocol=slow_clients.HeadDeadlineProtocol, limit_concurrency=20) as port:
        held = [await asyncio.open_connection("127.0.0.1", port) for _ in range(40)]
        await asyncio.sleep(0)
        ended = await asyncio.gather(*(_ended(reader) for reader, _ in held[15:]))
        assert all(ended)  # three quarters of twenty stay, idle as they are
        assert not any(reader.at_eof() for reader, _ in held[:15])
        reader, writer = await asyncio.open_connection("127.0.0.1", port, local_addr=("127.0.0.9", 0))
        writer.write(REQUEST)
        assert (await reader.read(1000)).startswith(b"HTTP/1.1 200 ")
        for _, other in [*held, (reader, writer)]:
            other.close()


async def _ended(reader: asyncio.StreamReader) -> bool:
    try:
        return await reader.read(1) == b""
    except ConnectionError:
        return True


# Server, security and login together


@in_real_time
async def test_a_login_over_real_sockets_and_its_end() -> None:
    made = SecuredApp(HmiConfig.model_validate({"without_login": "none", "users": USERS}), quick=False, real_time=True)
    async with served(made.middleware) as port:
        host = f"127.0.0.1:{port}"
        origin = Origin(f"http://{host}")
        async with httpx2.AsyncClient(base_url=f"http://{host}", timeout=HURRY_S, trust_env=False) as page:
            with pytest.raises(InvalidStatus) as refused:
                async with connect(f"ws://{host}/api/live", origin=origin):
                    pass
            assert refused.value.response.status_code == 401
            csrf = (await page.get("/api/session")).json()["csrf"]
            body = {"name": "tom", "password": PASSWORD}
            answer = await page.post("/api/login", json=body, headers={"Origin": origin, "X-CSRF-Token": csrf})
            assert (answer.status_code, answer.json()["role"]) == (200, "technician")
            mine = {"Cookie": f"g1-session={page.cookies['g1-session']}"}
            async with connect(
                f"ws://{host}/api/live",
                origin=origin,
                additional_headers=mine,
            ) as live:
                assert await live.recv() == "data"
                bye = await page.post(
                    "/api/logout", json={}, headers={"Origin": origin, "X-CSRF-Token": answer.json()["csrf"]}
                )
                assert bye.status_code == 200
                with pytest.raises(ConnectionClosed):
                    await live.recv()
                assert live.close_code == ENDED
            assert (await page.get("/api/state")).status_code == 401
    made.logins.close()


# TLS


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Plant:
    return Plant(tmp_path_factory.mktemp("certs"))


def pages(plant: Plant, **more: Any) -> GatewayConfig:
    files = {
        "tls_cert": str(plant.folder.certificate_path("gateway")),
        "tls_key": str(plant.folder.key_path("gateway")),
    }
    return GatewayConfig(hmi=HmiConfig.model_validate({"enabled": True, **files, **more}))


def trusting(plant: Plant) -> ssl.SSLContext:
    return ssl.create_default_context(cafile=str(plant.folder.certificate_path("ca")))


async def shaken(port: int, context: ssl.SSLContext) -> tuple[str | None, bytes | None]:
    """TLS version and the server's certificate."""
    _, writer = await asyncio.open_connection("127.0.0.1", port, ssl=context, server_hostname="localhost")
    tls_object = writer.get_extra_info("ssl_object")
    found = tls_object.version(), tls_object.getpeercert(binary_form=True)
    writer.close()
    return found


@pytest.mark.long
@in_real_time
async def test_tls_and_a_certificate_that_is_renewed(
    plant: Plant, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tls, "LOOK_NS", 20_000_000)
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    cert.write_bytes(plant.folder.certificate_path("gateway").read_bytes())
    key.write_bytes(plant.folder.key_path("gateway").read_bytes())
    files = TlsFiles.of_pages(pages(plant, tls_cert=str(cert), tls_key=str(key)))
    assert files is not None
    reloading = tls.ReloadingContext(files, SystemClock())
    context = reloading.initial
    assert context.minimum_version is ssl.TLSVersion.TLSv1_2

    async def renewed(port: int, before: bytes | None) -> bytes | None:
        async with asyncio.timeout(HURRY_S):
            while (found := (await shaken(port, trusting(plant)))[1]) == before:  # noqa: ASYNC110
                await asyncio.sleep(0.02)
            return found

    async with asyncio.TaskGroup() as group, served(hello, context=context) as port:
        fresh = group.create_task(reloading.keep_current(0.02))
        version, first = await shaken(port, trusting(plant))
        assert version == "TLSv1.3"
        old = trusting(plant)
        old.maximum_version = ssl.TLSVersion.TLSv1_2
        assert (await shaken(port, old))[0] == "TLSv1.2"
        key.write_text("nonsense")  # half of a renewal, or a mistake: the pair read before goes on
        await asyncio.sleep(0.3)
        assert (await shaken(port, trusting(plant)))[1] == first
        assert main(["certs", "server", "--dir", str(plant.folder.path), "--host", "localhost", "--name", "next"]) == 0
        cert.write_bytes(plant.folder.certificate_path("next").read_bytes())
        key.write_bytes(plant.folder.key_path("next").read_bytes())
        assert await renewed(port, first) is not None
        fresh.cancel()


@in_real_time
async def test_http_where_https_is_served_is_answered_with_the_way_there(plant: Plant) -> None:
    files = TlsFiles.of_pages(pages(plant))
    assert files is not None
    async with served(hello, context=tls.server_context(files)) as port:
        for first in (REQUEST, REQUEST.replace(b"GET", b"POST")):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(first)
            head, _, body = (await reader.readuntil(b"not at http://.")).partition(b"\r\n\r\n")
            assert head.startswith(b"HTTP/1.1 400 ")
            assert f"Content-Length: {len(body)}".encode() in head
            assert b"location.protocol = 'https:'" in body
            writer.write(REQUEST)  # a second one: nobody is there
            with suppress(ConnectionError):
                assert await reader.read(1) == b""
            writer.close()
        assert (await received(port, b"junk\r\n\r\n")) == b""
        assert (await shaken(port, trusting(plant)))[0] == "TLSv1.3"


@pytest.mark.parametrize(
    ("key", "text", "expected"),
    [
        ("tls_cert", None, "g.toml:3: hmi.tls_cert: cannot read "),
        ("tls_key", None, "g.toml:4: hmi.tls_key: cannot read "),
        ("tls_cert", "nonsense", "g.toml:3: hmi.tls_cert: "),
        ("tls_key", "other", "key values mismatch"),
    ],
)
def test_files_that_are_no_good(plant: Plant, tmp_path: Path, key: str, text: str | None, expected: str) -> None:
    path = tmp_path / "file.pem"
    if text is not None:
        path.write_bytes(plant.folder.key_path("ca").read_bytes() if text == "other" else text.encode())
    good = pages(plant).hmi
    files = {"tls_cert": good.tls_cert, "tls_key": good.tls_key, key: str(path)}
    toml = f"[hmi]\nenabled = true\ntls_cert = '{files['tls_cert']}'\ntls_key = '{files['tls_key']}'\n"
    with pytest.raises(ConfigError) as caught:
        config_check.check(parse(tomllib.loads(toml), text=toml), source="g.toml", text=toml)
    assert expected in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_certificate_that_ends_soon_and_a_key_that_others_read(plant: Plant, tmp_path: Path) -> None:
    config = pages(plant)

    def at(days: float) -> list[str]:
        return tls.warnings(TlsFiles.of_pages(config), round((NOW + timedelta(days=days)).timestamp() * 1e9))

    assert tls.warnings(TlsFiles.of_pages(GatewayConfig()), 0) == []
    assert at(0) == []
    assert at(19.5) == []  # more than a third of its 30 days is left
    (soon,) = at(20.5)
    assert soon.startswith("hmi.tls_cert: ")
    assert soon.endswith("in 9 days")
    (late,) = at(31)
    assert late.endswith("no client will connect; renew it")
    key = tmp_path / "open.key"
    key.write_bytes(plant.folder.key_path("gateway").read_bytes())
    key.chmod(0o644)
    assert tls.warnings(TlsFiles.of_pages(pages(plant, tls_key=str(key))), round(NOW.timestamp() * 1e9)) == [
        f"hmi.tls_key: {key} can be read by others; chmod o-rwx"
    ]
    (gone,) = tls.warnings(TlsFiles.of_pages(pages(plant, tls_cert=str(tmp_path / "none.pem"))), 0)
    assert "can't be read" in gone


def test_check_prints_users_and_roles(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "g.toml"
    path.write_text(
        "[hmi]\nenabled = true\nhost = '10.0.0.5'\n"
        f"[[hmi.users]]\nname = 'anna'\nrole = 'technician'\npassword_hash = '{HASH}'\n"
    )
    assert main(["check", str(path)]) == 0
    out = capsys.readouterr().out
    assert "pages on 10.0.0.5:8080, without TLS, the driver's display without a login; users: anna (technician)" in out
    assert "warning: hmi.tls_cert: is missing, and host = 10.0.0.5 is no loopback address" in out
    assert main(["check", str(path), "--full"]) == 0
    assert 'hmi.users[0].password_hash = "***"' in capsys.readouterr().out


def test_errors_that_a_peer_causes_can_not_fill_the_log(caplog: pytest.LogCaptureFixture) -> None:
    clock = HandClock()
    library = logging.getLogger("library-of-the-pages")
    library.addFilter(ErrorThrottle(clock))
    for n in range(1000):
        library.error("Fatal error on transport %s\n<object at 0x%x>", "TCP", n)
        library.error("another kind")
    clock.t_ns += 11 * 1_000_000_000
    library.error("another kind")
    assert [record.getMessage().partition("\n")[0] for record in caplog.records] == [
        "Fatal error on transport TCP",
        "another kind",
        "another kind (999 more of these since the last such line)",
    ]
