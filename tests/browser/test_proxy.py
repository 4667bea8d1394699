"""The pages behind nginx, which ends TLS and serves them below a base path: each page with links and live data."""

import json
import os
import re
import socket
import ssl
import subprocess
from collections.abc import Iterator
from http.client import HTTPConnection, HTTPSConnection
from pathlib import Path

import pytest
from playwright.sync_api import expect

from gateway.web.auth.passwords import hashed
from tests.browser.chromium import Watch, until
from tests.browser.conftest import Visit
from tests.browser.plant import STANDING, Plant, plant
from tests.browser.test_login import log_in
from tests.e2e.brokers import program
from tests.plant_certs import Plant as PlantCertificates

PASSWORD = "spout-and-truck-41"
KEYS = f"""
base_path = "/bay1"
trusted_proxies = ["127.0.0.1"]
[[hmi.users]]
name = "theo"
role = "technician"
password_hash = "{hashed(PASSWORD)}"
"""
NGINX = """
daemon off;
pid {folder}/nginx.pid;
error_log {folder}/error.log;
events {{}}
http {{
  access_log off;
  client_body_temp_path {folder}/body;
  proxy_temp_path {folder}/proxy;
  fastcgi_temp_path {folder}/fastcgi;
  uwsgi_temp_path {folder}/uwsgi;
  scgi_temp_path {folder}/scgi;
  proxy_max_temp_file_size 0;
  client_body_buffer_size 1m;
  server {{
    listen 127.0.0.1:{plain};
    listen 127.0.0.1:{tls} ssl;
    ssl_certificate {certificate};
    ssl_certificate_key {key};
{location}  }}
}}
"""


def documented() -> str:
    """The part that docs/hmi-security.md shows."""
    text = (Path(__file__).parents[2] / "docs" / "hmi-security.md").read_text(encoding="utf-8")
    found = re.search(r"```nginx\n(.*?)```", text, re.DOTALL)
    assert found is not None
    return found[1]


@pytest.fixture
def proxied(tmp_path: Path) -> Iterator[tuple[Plant, int, int]]:
    """The bay, and the ports at which nginx serves it: plain, and with TLS."""
    certificates = PlantCertificates(tmp_path / "certificates").folder
    with plant(tmp_path, STANDING, role="driver", users=KEYS) as bay:
        assert bay.url.endswith("/bay1")
        config, errors = tmp_path / "nginx.conf", tmp_path / "error.log"
        # It takes over sockets that listen already, as in an update of itself: who asks before it runs waits. This
        # process closes its own, so that after the end of nginx nobody waits.
        with socket.create_server(("127.0.0.1", 0)) as plain, socket.create_server(("127.0.0.1", 0)) as tls:
            ports = plain.getsockname()[1], tls.getsockname()[1]
            config.write_text(
                NGINX.format(
                    folder=tmp_path,
                    plain=ports[0],
                    tls=ports[1],
                    certificate=certificates.certificate_path("gateway"),
                    key=certificates.key_path("gateway"),
                    location=documented().replace("127.0.0.1:8080", bay.url.split("/")[2]),
                )
            )
            nginx = subprocess.Popen(
                [program("nginx", "apt-get install nginx-light"), "-c", str(config), "-e", str(errors)],
                pass_fds=(plain.fileno(), tls.fileno()),
                env=os.environ | {"NGINX": f"{plain.fileno()};{tls.fileno()};"},
            )
        try:
            yield bay, *ports
        finally:
            nginx.terminate()
            nginx.wait(30)


def test_every_page_works_behind_nginx_below_a_base_path(
    proxied: tuple[Plant, int, int], visit: Visit, watches: list[Watch]
) -> None:
    bay, plain, tls = proxied
    root = f"http://127.0.0.1:{plain}/bay1"
    page = visit(f"{root}/tune/bay1")
    watches[0].excused = re.compile("status of 503")  # the manager's page: it records nothing
    asked: list[str] = []
    page.context.on("request", lambda request: asked.append(request.url))
    expect(page).to_have_url(
        re.compile(rf"^{root}/login\?next=%2Fbay1%2Ftune%2Fbay1|^{root}/login\?next=/bay1/tune/bay1")
    )
    log_in(page, "theo", PASSWORD)
    expect(page).to_have_url(f"{root}/tune/bay1")
    (cookie,) = page.context.cookies()
    assert (cookie["path"], cookie["secure"]) == ("/bay1", False)
    for name, path in (("Live", "/"), ("Settings", "/setup"), ("Lens", "/calibrate/bay1"), ("Manual", "/manual")):
        link = page.get_by_role("link", name=name, exact=True)
        expect(link).to_have_attribute("href", re.compile(rf"^/bay1{path}(#bay1)?$"))
    shown = (
        ("/", page.locator(".picture .tag").filter(has_text="LIVE")),
        ("/history", page.get_by_role("heading", name="History").first),
        ("/manager", page.locator("main")),
        ("/calibrate/bay1", page.get_by_role("link", name="Print this board")),
        ("/setup", page.get_by_role("button", name="Look at the changes")),
        ("/setup/new-bay", page.locator("main")),
        ("/manual", page.get_by_role("link", name="Modbus").first),
        ("/driver/bay1", page.locator("body[data-fresh='true']")),
    )
    for path, fact in shown:
        page.goto(root + path)
        expect(fact).to_be_visible(timeout=60_000)
        page.wait_for_timeout(500)
    page.goto(f"{root}/manual")
    page.get_by_role("link", name="Modbus").first.click()
    expect(page.locator("article h1")).to_be_visible()
    until(page, lambda: any("/api/bays/bay1/picture" in url for url in asked))
    assert [url for url in asked if not url.startswith((f"{root}/", "blob:", "data:"))] == []

    secure = HTTPSConnection("127.0.0.1", tls, context=ssl._create_unverified_context(), timeout=60)
    secure.request("GET", "/bay1/api/session")
    answer = secure.getresponse()
    csrf = json.loads(answer.read())["csrf"]
    body = json.dumps({"name": "theo", "password": PASSWORD, "next": "/"})
    headers = {"Content-Type": "application/json", "X-CSRF-Token": csrf, "X-Forwarded-For": "127.0.0.1, 192.0.2.1"}
    secure.request("POST", "/bay1/api/login", body, headers | {"Origin": f"https://127.0.0.1:{tls}"})
    answer = secure.getresponse()
    assert (answer.status, json.loads(answer.read())["next"]) == (200, "/bay1/")
    assert re.match(r"__Secure-.*; Path=/bay1; SameSite=strict; Secure$", answer.headers["Set-Cookie"])
    secure.close()
    direct = HTTPConnection(bay.url.removeprefix("http://").removesuffix("/bay1"), timeout=60)
    direct.request("GET", "/login")  # beside the base path is nothing
    assert direct.getresponse().status == 404
    direct.close()
