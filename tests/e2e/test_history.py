"""What was recorded, asked of a real gateway over HTTP: the reader process, its rights, its end and its replacement."""

import http.client
import json
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import psutil
import pytest

from tests import recorded_bay
from tests.browser.plant import STANDING, Plant, plant
from tests.e2e.plc import Plc

READER = "gw-reader"
PATIENCE_S = 60.0
S = 10**9


class Site:
    """A simulated gateway that records, and its pages."""

    def __init__(self, running: Plant) -> None:
        self.gateway = running.gateway
        self.modbus_port = running.modbus_port
        self.host = running.url.removeprefix("http://")

    def get(self, path: str) -> tuple[int, bytes]:
        connection = http.client.HTTPConnection(self.host, timeout=130)
        try:
            connection.request("GET", f"/api/bays/bay1/{path}")
            answer = connection.getresponse()
            return answer.status, answer.read()
        finally:
            connection.close()

    def json(self, path: str) -> Any:
        status, body = self.get(path)
        assert status == 200, body
        return json.loads(body)

    def readers(self) -> list[psutil.Process]:
        return [process for process in self.gateway.family() if process.name() == READER]

    def reader(self) -> psutil.Process:
        """The one, once what it had forked for an answer has ended."""
        deadline = time.monotonic() + 20
        while len(found := self.readers()) > 1:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        return found[0]


def earlier(folder: Path) -> None:
    """40 s of a truck that waits, with one picture."""
    with TemporaryDirectory() as made:
        kept, _ = recorded_bay.recorded(Path(made), until_s=40)
        kept.picture(recorded_bay.T0_NS + 19 * S, 500, "operator_mark")
        shutil.copytree(kept.path, folder / "bay1")


AT_MS = recorded_bay.unix(recorded_bay.T0_NS + 20 * S) // 10**6


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with plant(tmp_path_factory.mktemp("history"), STANDING, records=earlier) as running:
        yield Site(running)


@pytest.mark.long
def test_why_is_answered_by_a_process_that_is_there_only_then(site: Site) -> None:
    view = site.json("records")
    assert (view["recorded"], view["pictures"]) == (True, "shown")
    assert site.readers() == []
    (picture,) = site.json(f"kept-pictures?since_ms={AT_MS - 5000}&until_ms={AT_MS + 5000}")["pictures"]
    assert (picture["frame_id"], picture["why"]) == (500, ["operator_mark"])
    with Plc(site.modbus_port) as plc:
        told = site.json(f"why?at_ms={AT_MS}")
        assert (told["silence"], told["outputs"]["may_move"]) == ("", "on")
        assert [each["frame_id"] for each in told["pictures"]] == [500]
        assert plc.wait_for(lambda image: image["heartbeat"] > 0, PATIENCE_S)
    status, page = site.get(f"why.html?at_ms={AT_MS}")
    assert (status, page[:15]) == (200, b"<!DOCTYPE html>")
    assert b"data:image" in page
    values = site.json(f"values?since_ms={AT_MS - 10_000}&until_ms={AT_MS - 2000}&points=16")
    assert values["bucket_ms"] == 500
    assert sum(bucket["recorded_s"] for bucket in values["buckets"]) == pytest.approx(8, abs=0.1)
    assert all(690 < bucket["z_mean"] < 710 for bucket in values["buckets"])
    status, jpeg = site.get(f"kept-pictures/{picture['file']}/{picture['place']}.jpg?width=320")
    assert (status, jpeg[:2]) == (200, b"\xff\xd8")
    assert site.get("why?at_ms=5")[0] == 200  # long before: its answer says that nothing is known


@pytest.mark.long
def test_it_has_few_rights_and_another_one_follows_it(site: Site) -> None:
    assert site.get(f"why?at_ms={AT_MS}")[0] == 200
    reader = site.reader()
    status = Path(f"/proc/{reader.pid}/status").read_text(encoding="ascii", errors="replace")
    rights = dict(line.split(":\t", 1) for line in status.splitlines() if ":\t" in line)
    assert (rights["Seccomp"], rights["NoNewPrivs"], rights["CapEff"].strip("0")) == ("2", "1", "")
    reader.kill()
    assert site.get(f"why?at_ms={AT_MS}")[0] == 200
    other = site.reader()
    assert other.pid != reader.pid


@pytest.mark.long
def test_who_goes_away_leaves_no_work_behind(site: Site) -> None:
    assert site.get(f"why?at_ms={AT_MS}")[0] == 200
    for _ in range(10):
        connection = http.client.HTTPConnection(site.host, timeout=30)
        connection.request("GET", f"/api/bays/bay1/why.html?at_ms={AT_MS}")
        time.sleep(0.05)
        connection.close()
    assert site.get(f"why?at_ms={AT_MS}")[0] in (200, 503)  # 503: those before are just being given up
    site.reader()
    assert site.get(f"why?at_ms={AT_MS}")[0] == 200
