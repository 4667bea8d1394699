"""The web process as a user meets it: it comes with the first visitor, and whatever becomes of it, the bay goes on."""

import asyncio
import http.client
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.parse
from collections.abc import Iterator
from contextlib import AsyncExitStack, suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
from websockets.asyncio.client import ClientConnection, connect

from gateway.core.state import Reason
from gateway.web.languages import SHIPPED
from tests.e2e.plc import Plc
from tests.e2e.processes import Gateway, Row, command, survivors
from tests.long import mostly_long

QUICK = ("--modbus-port", "0", "--json")


@pytest.fixture
def gateway() -> Iterator[Gateway]:
    with Gateway("simulate", *QUICK, "--hmi-port", "0") as gateway:
        yield gateway


def address_of(gateway: Gateway) -> str:
    """Where its pages are, once it has seen its marker: then there is a picture to show."""
    url: str = gateway.started()["hmi"]
    gateway.wait_for(lambda row: row["type"] == "state" and row["vision"] == "good")
    return url


def web(gateway: Gateway) -> list[psutil.Process]:
    return [process for process in gateway.family() if process.name() == "gw-hmi"]


def got(url: str, path: str, timeout_s: float = 60.0) -> tuple[int, dict[str, str], bytes]:
    address = urllib.parse.urlsplit(url)
    connection = http.client.HTTPConnection(address.hostname or "", address.port, timeout=timeout_s)
    try:
        connection.request("GET", path)
        response = connection.getresponse()
        return response.status, {key.lower(): value for key, value in response.getheaders()}, response.read()
    finally:
        connection.close()


def state(gateway: Gateway) -> Row:
    return gateway.wait_for(lambda row: row["type"] == "state")


def eventually(fact: Any, timeout_s: float = 20.0) -> Any:
    deadline = time.monotonic() + timeout_s
    while not (value := fact()):
        assert time.monotonic() < deadline, "not in time"
        time.sleep(0.05)
    return value


@pytest.mark.failure_mode("W1")
def test_no_web_process_without_a_visitor_and_a_killed_one_comes_back_on_the_same_port(gateway: Gateway) -> None:
    url = address_of(gateway)
    assert web(gateway) == []
    os.sched_setscheduler(gateway.process.pid, os.SCHED_BATCH, os.sched_param(0))  # as a plant's real-time policy would
    status, headers, jpeg = got(url, "/api/bays/bay1/picture?width=320")
    assert (status, headers["content-type"], jpeg[:3]) == (200, "image/jpeg", b"\xff\xd8\xff")
    # A picture that nobody has looked at comes without what was seen in it; on a machine with room there is none such.
    while "x-frame-view" not in headers:
        headers = got(url, "/api/bays/bay1/picture?width=320")[1]
    seen = json.loads(headers["x-frame-view"])
    assert seen["frame_id"] == int(headers["x-frame-id"])
    (first,) = web(gateway)
    assert os.sched_getscheduler(first.pid) == os.SCHED_OTHER  # where `nice` counts
    assert first.nice() == min(psutil.Process(gateway.process.pid).nice() + 10, 19)

    before = state(gateway)
    first.kill()
    assert survivors([first]) == []
    assert got(url, "/api/bays/bay1/picture")[0] == 200  # the connection waits until the next one has come up
    after = state(gateway)
    assert [process.pid for process in web(gateway)] != [first.pid]
    assert after["seq"] > before["seq"]
    faults = [row for row in gateway.rows if row["type"] == "event" and row["kind"] == "sensor_fault"]
    # A machine that stands still for a moment, and no more: nothing has ended.
    assert [row for row in faults if row["quality"] != "stale" and " within " not in row["detail"]] == []
    gateway.wait_for(lambda row: row["type"] == "state" and (row["vision"], row["range"]) == ("good", "good"))


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_web_process_that_is_killed_comes_back_on_a_loaded_machine(gateway: Gateway) -> None:
    """Its start takes two seconds of the processor, at low priority beside fourteen that never wait."""
    url = address_of(gateway)
    assert got(url, "/healthz")[0] == 200
    (first,) = web(gateway)
    cpu = {max(os.sched_getaffinity(0))}
    os.sched_setaffinity(gateway.process.pid, cpu)  # its children inherit it
    loops = [subprocess.Popen([sys.executable, "-c", "import os; os.nice(5)\nwhile True: pass"]) for _ in range(14)]
    try:
        for loop in loops:
            os.sched_setaffinity(loop.pid, cpu)
        first.kill()
        assert got(url, "/login", timeout_s=550.0)[0] == 200
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()
    (second,) = web(gateway)
    assert second.pid != first.pid
    ended = re.findall(r"hmi: the web process (.*); trying again", gateway.stderr)
    late = [f"was not ready within {30 * 2**n} s" for n in range(4)]  # where this machine is loaded by others, too
    assert ended == ["was killed by SIGKILL", *late][: len(ended)]


def frames_open_for(process: psutil.Process) -> set[int]:
    """The access modes of a process's descriptors of frame memory."""
    folder = Path(f"/proc/{process.pid}")
    flags = []
    for fd in (folder / "fd").iterdir():
        with suppress(FileNotFoundError):  # closed meanwhile: no memory of frames is
            if "gateway-frames" in os.readlink(fd):
                flags.append(re.search(r"flags:\s+([0-7]+)", (folder / "fdinfo" / fd.name).read_text()))
    return {int(found[1], 8) & os.O_ACCMODE for found in flags if found}


def test_the_web_process_has_less_than_the_gateway_s_rights_and_only_the_vision_process_can_write_frames(
    gateway: Gateway,
) -> None:
    url = address_of(gateway)
    assert got(url, "/api/bays/bay1/picture")[0] == 200
    (process,) = web(gateway)
    status = dict(
        line.split(":", 1) for line in Path(f"/proc/{process.pid}/status").read_text().splitlines() if ":" in line
    )
    rights = {key: status[key].strip() for key in ("CapPrm", "CapEff", "CapAmb", "NoNewPrivs", "Seccomp")}
    assert rights == {"CapPrm": "0" * 16, "CapEff": "0" * 16, "CapAmb": "0" * 16, "NoNewPrivs": "1", "Seccomp": "2"}
    modes = {one.name().split("-")[1]: frames_open_for(one) for one in gateway.family() if one.name()[:3] == "gw-"}
    assert modes == {"template": set(), "worker": {os.O_RDWR}, "hmi": {os.O_RDONLY}}
    assert got(url, "/login")[0] == 200  # a file is still read


@pytest.mark.long
@pytest.mark.failure_mode("W2")
def test_a_hung_web_process_costs_the_bay_nothing_and_is_not_missed_at_the_end(gateway: Gateway) -> None:
    url = address_of(gateway)
    assert got(url, "/api/bays/bay1/picture")[0] == 200
    (process,) = web(gateway)
    os.kill(process.pid, signal.SIGSTOP)
    first = state(gateway)
    gateway.wait_for(lambda row: row["type"] == "state" and row["seq"] > first["seq"] + 50 and not row["stop"])
    assert gateway.end() == 0
    assert survivors([process]) == []


@pytest.mark.long
def test_a_main_process_that_hangs_is_reported_and_outlived(gateway: Gateway) -> None:
    url = address_of(gateway)
    assert eventually(lambda: got(url, "/healthz")[0] == 200)
    (process,) = web(gateway)
    os.kill(gateway.process.pid, signal.SIGSTOP)
    stopped_s = time.monotonic()
    try:
        status, _, body = got(url, "/healthz")
        assert (status, json.loads(body)["reasons"][0]["part"]) == (503, "main")
        eventually(lambda: time.monotonic() - stopped_s > 8.0)
        state = json.loads(got(url, "/api/bays/bay1/state")[2])
        assert state["age_ms"] >= 7000
        assert [state["state"][key] for key in ("stop", "may_move", "radius_px", "distance_mm")] == [
            True,
            False,
            None,
            None,
        ]
        assert state["state"]["reason"]["name"] == "GATEWAY_FAULT"
        status, headers, _ = got(url, "/api/alarms")
        assert (status, headers["content-type"], headers["retry-after"]) == (503, "application/problem+json", "1")
        assert got(url, "/api/bays/bay1/picture")[0] == 204
    finally:
        os.kill(gateway.process.pid, signal.SIGCONT)
    assert eventually(lambda: got(url, "/healthz")[0] == 200)
    assert got(url, "/api/alarms")[0] == 200
    assert web(gateway) == [process]


@pytest.mark.long
def test_the_web_process_dies_with_a_gateway_that_is_killed(gateway: Gateway) -> None:
    url = address_of(gateway)
    assert got(url, "/api/bays/bay1/picture")[0] == 200
    family = gateway.family()
    assert [process for process in family if process.name() == "gw-hmi"]
    gateway.process.kill()
    gateway.process.wait(10)
    assert survivors(family) == []


@pytest.mark.parametrize("verb", mostly_long(["run", "simulate"]))
def test_a_certificate_that_cannot_be_read_is_an_error_at_the_start(verb: str, tmp_path: Path) -> None:
    """Not a port that takes connections and never answers."""
    config = tmp_path / "bay.toml"
    gone = "tls_cert = '/nowhere/pages.pem'\ntls_key = '/nowhere/pages.key'"
    config.write_text(f"instance = 'no-certificate'\n[modbus]\nport = 0\n[hmi]\nenabled = true\nport = 0\n{gone}\n")
    words = ["run", str(config)] if verb == "run" else ["simulate", "--config", str(config), "--json"]
    done = command(*words, "--duration", "5")
    assert (done.code, done.out) == (2, "")
    assert "hmi.tls_cert: cannot read /nowhere/pages.pem" in done.err


@pytest.mark.long
def test_a_plants_languages_reach_each_web_process_and_a_faulty_file_stops_no_bay(tmp_path: Path) -> None:
    """Complete ones are too long for a message between processes."""
    folder = tmp_path / "languages"
    folder.mkdir()
    for code, like in (("nl", "de"), ("pt", "es"), ("az", "tr")):
        (folder / f"{code}.json").write_text((SHIPPED / f"{like}.json").read_text())
    (folder / "de.json").write_text("{")
    config = tmp_path / "bay.toml"
    hmi = f'[hmi]\nenabled = true\nport = 0\nlanguages_folder = "{folder}"\n'
    config.write_text(f"instance = 'languages'\n[modbus]\nport = 0\n{hmi}")
    with Gateway("simulate", "--config", str(config), "--json") as gateway:
        url = address_of(gateway)
        texts = json.loads((SHIPPED / "tr.json").read_text())["texts"]
        for _ in range(2):  # a web process that was replaced has them, too
            assert json.loads(got(url, "/api/languages/az")[2])["texts"] == texts
            assert json.loads(got(url, "/api/languages/de")[2])["texts"]["Alarms"] == "Alarme"
            (process,) = web(gateway)
            process.kill()
            assert survivors([process]) == []
        assert f"hmi.languages_folder: {folder}/de.json: is not JSON" in gateway.stderr


@pytest.mark.long
def test_a_taken_port_keeps_no_bay_from_working_and_is_tried_again(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with Gateway("simulate", *QUICK, "--hmi-port", str(port)) as gateway:
            assert gateway.started()["hmi"] is None
            gateway.wait_for(lambda row: row["type"] == "state" and row["vision"] == "good")
            taken.close()
            url = f"http://127.0.0.1:{port}/"

            def served() -> bool:
                try:
                    return got(url, "/api/bays/bay1/picture")[0] == 200
                except OSError:
                    return False

            eventually(served, 60)
            assert "another program listens there" in gateway.stderr


async def watch(pages: AsyncExitStack, url: str, number: int, *, stalled: bool) -> list[int]:
    """One page: live view and pictures; a stalled one answers nothing."""
    host = urllib.parse.urlsplit(url).netloc
    page: ClientConnection = await pages.enter_async_context(
        connect(f"ws://{host}/api/live?bay=bay1", open_timeout=30, origin=f"http://{host}")  # type: ignore[arg-type]
    )
    views = [0]

    async def live() -> None:
        async for text in page:
            view = json.loads(text)
            assert view["bays"][0]["bay"] == "bay1"
            views[0] += 1
            await page.send("next")

    async def pictures() -> None:
        after = ""
        while True:
            status, headers, _ = await asyncio.to_thread(got, url, f"/api/bays/bay1/picture?width=480{after}")
            assert status in (200, 204)
            if status == 200:
                after = f"&after={headers['x-frame-id']}"

    if not stalled:
        group = await pages.enter_async_context(asyncio.TaskGroup())
        tasks = [group.create_task(live()), *([group.create_task(pictures())] if number < 8 else [])]
        pages.callback(lambda: [task.cancel() for task in tasks])
    return views


@pytest.mark.long
@pytest.mark.failure_mode("W4")
def test_twenty_viewers_some_of_them_stalled_do_not_hold_up_the_registers(gateway: Gateway) -> None:
    started = gateway.started()
    gateway.wait_for(lambda row: row["type"] == "state" and row["vision"] == "good")
    url = started["hmi"]

    async def crowd(plc: Plc) -> list[int]:
        async with AsyncExitStack() as pages:
            views = [await watch(pages, url, number, stalled=number >= 15) for number in range(20)]
            polls = await asyncio.to_thread(plc.wait_for_beats, 150, 60)
            await asyncio.to_thread(eventually, lambda: min(count[0] for count in views[:15]) >= 3, 60)
            assert [count[0] for count in views[15:]] == [0] * 5
            return [poll.image["reason"] for poll in polls]

    before = len(gateway.rows)
    with Plc(started["modbus_port"]) as plc:
        reasons = asyncio.run(crowd(plc))
    states = [row for row in gateway.rows[before:] if row["type"] == "state"]
    faults = [row for row in states if row["reason"] == "gateway_fault"]
    # A machine that stands still for a quarter of a second is one state; what holds up the ticks is many.
    assert len(faults) <= len(states) / 50
    assert reasons.count(Reason.GATEWAY_FAULT) <= len(reasons) / 50
