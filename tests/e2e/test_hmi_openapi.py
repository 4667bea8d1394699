"""The real application, on a real socket, keeps what its OpenAPI description promises: schemathesis asks everything.

Which operations there are is read from docs/openapi.json: to load schemathesis takes seconds, which the process that
runs these tests spends and not each that collects them.
"""

import asyncio
import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import httpx2
import numpy as np
import pytest
import uvicorn
from hypothesis import HealthCheck, Phase, given, settings

from gateway.clock import SystemClock
from gateway.config.sections.hmi import HmiConfig
from gateway.core.readings import Quality, VisionReading
from gateway.web.auth.logins import Logins
from gateway.web.server import openapi
from gateway.web.server.app import ROUTES, app
from gateway.web.server.services import services_of
from gateway.web.testsets import routes as testsets
from gateway.web.tuning import routes as tuning
from tests.unit.web.auth import PASSWORD, USERS
from tests.unit.web.gateway_client import Plant, plant
from tests.unit.web.links import full
from tests.unit.web.testsets import keeping

if TYPE_CHECKING:
    import schemathesis

pytestmark = pytest.mark.xdist_group("openapi")  # of one application, and one schemathesis

HURRY_S = 60.0
EXAMPLES = 12
DESCRIPTION = json.loads(
    (Path(__file__).parents[2] / "docs" / "openapi.json").read_text()
)  # current: tests/unit/test_docs
OPERATIONS = [(method.upper(), path) for path, item in DESCRIPTION["paths"].items() for method in item]
LABELS = [f"{method} {path}" for method, path in OPERATIONS]
SLOW = {f"/api/bays/{{bay}}/{name}" for name in ("record", "function-check")}  # take seconds at a real bay
TUNING = {rule.path for rule in (*tuning.ADDRESSES.rules, *testsets.ADDRESSES.rules)}

# Here is no configuration file, no process that opens devices, and nothing that would start again: their own tests have
# these. What is left to judge is that each refusal is one that the description has.
OF_MACHINE = {"/api/setup/settings", "/api/setup/preview", "/api/setup/save", "/api/setup/restart", "/api/doctor"}
FIRST_PASSWORD = "/api/setup/first-password"
NEW_PASSWORD = "/api/setup/password"
UPDATE = {"/api/setup/update", "/api/setup/update/piece"}
REFUSED_HERE = {*OF_MACHINE, *UPDATE, FIRST_PASSWORD}  # there are users, and this is no installed package


class Bay:
    """Two bays whose main process's side and web application run in a thread's event loop."""

    def __init__(self) -> None:
        self.port = 0
        self.ready = threading.Event()
        self._stop: asyncio.Event | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self.thread = threading.Thread(target=lambda: asyncio.run(self._run()))

    async def _run(self) -> None:
        self._stop, self._loop = asyncio.Event(), asyncio.get_running_loop()
        with TemporaryDirectory() as folder:
            async with keeping(Path(folder), "bay1") as test_sets, plant(bays=2, test_sets=test_sets) as made:
                await self._serve(made, self._stop)

    async def _serve(self, made: Plant, stop: asyncio.Event) -> None:
        made.links = full()
        made.rings["bay1"].write(np.zeros((48, 64, 3), np.uint8), 1, made.client.clock.now_ns())
        made.controls["bay1"].on_reading(VisionReading(made.client.clock.now_ns(), Quality.LINK_DOWN, detail="gone"))
        config = HmiConfig(enabled=True, without_login="none", users=USERS)
        pace = SystemClock()
        logins = Logins(config, pace, lambda _: None, instance="gateway")
        with socket.socket() as sock:
            sock.bind(("127.0.0.1", 0))
            sock.listen(100)
            self.port = sock.getsockname()[1]
            services = services_of(made.client, pace)
            made_app = app(services, logins, pace)
            server = uvicorn.Server(uvicorn.Config(made_app, log_level="error", lifespan="off", access_log=False))
            serving = asyncio.create_task(server.serve([sock]))
            self.ready.set()
            await stop.wait()
            server.should_exit = True
            await serving
            services.test_sets.close()

    def stop(self) -> None:
        if self._loop is not None and self._stop is not None:
            self._loop.call_soon_threadsafe(self._stop.set)
        self.thread.join(HURRY_S)


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    bay = Bay()
    bay.thread.start()
    try:
        assert bay.ready.wait(HURRY_S)
        yield f"http://127.0.0.1:{bay.port}"
    finally:
        bay.stop()


@pytest.fixture(scope="module")
def described() -> "schemathesis.BaseSchema":
    import schemathesis

    return schemathesis.openapi.from_dict(openapi.document(ROUTES))


@pytest.fixture(scope="module")
def technician(address: str) -> dict[str, str]:
    """What a browser sends once tom has logged in."""
    with httpx2.Client(base_url=address, timeout=HURRY_S, headers={"Origin": address}) as browser:
        csrf = browser.get("/api/session").json()["csrf"]
        said = browser.post("/api/login", json={"name": "tom", "password": PASSWORD}, headers={"X-CSRF-Token": csrf})
        assert said.status_code == 200, said.text
        cookie = f"{openapi.COOKIE}={browser.cookies[openapi.COOKIE]}"
        return {"Origin": address, "X-CSRF-Token": said.json()["csrf"], "Cookie": cookie}


@pytest.mark.mostly_long(short=12)
@pytest.mark.parametrize(("method", "path"), OPERATIONS, ids=LABELS)
def test_what_is_promised_is_kept(
    method: str, path: str, described: "schemathesis.BaseSchema", address: str, technician: dict[str, str]
) -> None:
    from schemathesis.checks import not_a_server_error
    from schemathesis.specs.openapi.checks import ignored_auth, positive_data_acceptance

    operation: Any = described[path][method]
    asked: list[int] = []

    @settings(
        max_examples=EXAMPLES,
        deadline=None,
        derandomize=True,
        database=None,
        phases=[Phase.explicit, Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=operation.as_strategy())
    def ask(case: "schemathesis.Case[Any]") -> None:
        if path in TUNING - SLOW:
            known = {"bay": "bay1"} | ({"name": "dusk"} if "test-sets" in path else {})
            case.path_parameters |= {key: known[key] for key in case.path_parameters if key in known}  # not at random
        response = case.call(base_url=address, headers=technician)
        asked.append(response.status_code)
        excluded = [ignored_auth]  # its false login beside our good cookie
        if path in REFUSED_HERE:
            excluded += [positive_data_acceptance, not_a_server_error]
        if path in TUNING | {NEW_PASSWORD}:
            excluded.append(positive_data_acceptance)  # which settings are possible is more than a schema says
        case.validate_response(response, excluded_checks=excluded)

    ask()
    assert asked
    if path in REFUSED_HERE:
        assert 200 not in asked
    elif path == NEW_PASSWORD:
        assert set(asked) <= {200, 400, 422, 429}  # most of what is made up is weak
    elif "{" not in path:
        assert 200 in asked


@pytest.mark.parametrize(("method", "path"), OPERATIONS, ids=LABELS)
def test_without_a_login_nothing_but_health_is_told(method: str, path: str, address: str) -> None:
    path = path.replace("{bay}", "bay1").replace("{alarm}", "bay1.camera_down")
    said = httpx2.request(method, f"{address}{path}", headers={"Origin": address}, timeout=HURRY_S)
    if path == FIRST_PASSWORD:  # it needs no login, and the token all the same
        assert (said.status_code, said.json()["error"]) == (403, "csrf")
        return
    assert said.status_code == (200 if path == "/healthz" else 401)
    if said.status_code == 401:
        assert said.headers["content-type"] == "application/problem+json"
        assert said.json()["error"] == "login"
