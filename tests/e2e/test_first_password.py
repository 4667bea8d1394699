"""A gateway as the package installs it, before anybody has a password: from the first request to the first login."""

import http.client
import signal
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

from tests.e2e.page_client import PageClient
from tests.e2e.processes import Gateway
from tests.e2e.test_run import started

CONFIG = """\
# The file of a new machine. Neither camera nor ranger are there yet.
site = "new"
instance = "{folder.name}"
state_dir = "{folder}/state"
[hmi]
enabled = true
port = 0
tls_cert = "auto"
first_password = true   # until there is a user
without_login = "driver"
[modbus]
port = 0
[camera]
url = "{folder}/none"
[ranger]
port = "{folder}/none-either"
"""
NAME, PASSWORD = "anna", "lime-kiln-dust-77"


@contextmanager
def fresh_gateway(folder: Path) -> Iterator[tuple[Gateway, str, Path]]:
    """As it runs after its installation, the pages' address, and its file."""
    config = folder / "gateway.toml"
    config.write_text(CONFIG.format(folder=folder))
    with Gateway("run", str(config)) as gateway:
        yield gateway, started(gateway).split("pages on ")[1].split("/,")[0], config


def until(fact: Callable[[], bool], seconds: float = 100.0) -> None:
    end = time.monotonic() + seconds
    while not fact():
        assert time.monotonic() < end, "in vain"
        threading.Event().wait(0.1)


def first_password(url: str, trusting: ssl.SSLContext) -> bool:
    try:
        with PageClient(url, trusting) as pages:
            return bool(pages.get("/api/session")["first_password"])
    except (OSError, http.client.HTTPException):  # the web process is replaced
        return True


def test_from_the_first_request_to_the_first_login(tmp_path: Path) -> None:
    with fresh_gateway(tmp_path) as (gateway, url, config):
        host = urlsplit(url).netloc
        assert url == f"https://{host}"
        plain = http.client.HTTPConnection(host, timeout=100)
        plain.request("GET", "/")
        answer = plain.getresponse()
        assert (answer.status, b"https://" in answer.read()) == (400, True)
        plain.close()

        key, certificate = tmp_path / "state/pages.key", tmp_path / "state/pages.pem"
        assert key.stat().st_mode & 0o777 == 0o600
        trusting = ssl.create_default_context(cafile=str(certificate))
        for name in (host, host.replace("127.0.0.1", "localhost")):
            with PageClient(f"https://{name}", trusting) as pages:
                for path in ("/api/state", "/api/bays/bay1/snapshot.jpg", "/metrics", "/healthz", "/api/doctor"):
                    assert b"bay1" not in pages.data(path, 401)
                assert pages.data("/driver", 303) == b""
                assert b"login.js" in pages.data("/login")
                assert pages.get("/api/session")["bays"] == []

        def make(name: str) -> int:
            try:
                with PageClient(url, trusting) as pages:
                    return pages.posted("/api/setup/first-password", {"name": name, "password": PASSWORD})
            except http.client.RemoteDisconnected:  # too late: the first one has the web process replaced
                return 409

        with ThreadPoolExecutor(2) as visitors:
            first, second = visitors.map(make, (NAME, "otto"))
        assert sorted((first, second)) == [200, 409]
        made = NAME if first == 200 else "otto"
        pid = gateway.process.pid

        until(lambda: not first_password(url, trusting))
        with PageClient(url, trusting) as pages:
            session = pages.post("/api/login", {"name": made, "password": PASSWORD, "next": "/setup/new-bay"})
            assert (session["role"], session["next"], session["bays"]) == ("technician", "/setup/new-bay", ["bay1"])
        assert make("eva") == 409
        assert set(CONFIG.format(folder=tmp_path).splitlines()) <= set(config.read_text().splitlines())
        assert (gateway.process.pid, gateway.process.poll()) == (pid, None)
        assert f"changed: {made} at 127.0.0.1: the first password, as technician" in gateway.stderr
        assert "bay1: settings changed: configuration file: hmi.users" in gateway.stderr
        assert PASSWORD not in gateway.stderr

        config.write_text(CONFIG.format(folder=tmp_path))  # the way out of a forgotten password
        gateway.process.send_signal(signal.SIGHUP)
        until(lambda: first_password(url, trusting))
        assert gateway.end() == 0
