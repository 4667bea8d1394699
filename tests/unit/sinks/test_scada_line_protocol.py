"""The jq program of docs/scada.md, by the real jq on real payloads, and the script round it."""

import json
import os
import subprocess
import threading
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar

import pytest

from gateway.core.events import Event, EventKind
from gateway.core.readings import Quality
from gateway.sinks.mqtt import payloads
from gateway.sinks.mqtt.topics import Gateway, Topics
from tests.permitted import permitted

PROGRAM = Path(__file__).parents[3] / "docs" / "scada" / "line-protocol.jq"
GATEWAY = Gateway(Topics("loading", "site1", "gw"), ("bay1",), "1", "9f86d081884c7d65")
OFFSET_NS = 1_795_000_000_123_000_000 - 5_000_000_000


def lines(*documents: bytes) -> list[str]:
    command = ["jq", "-r", "-f", str(PROGRAM)]
    done = subprocess.run(command, input=b"\n".join(documents), capture_output=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (0, b"")
    return done.stdout.decode().splitlines()


def state(**changes: Any) -> bytes:
    return payloads.encode(payloads.state_payload(permitted(**changes), GATEWAY, OFFSET_NS, 1000))


def event(kind: EventKind, number: int, detail: str = "") -> bytes:
    happened = Event(kind, "bay1", 5_000_000_000, permitted(), detail=detail)
    return payloads.encode(payloads.event_payload(happened, number, GATEWAY, OFFSET_NS))


def test_a_state_without_what_is_not_known() -> None:
    blind = permitted().vision
    known, unknown = lines(state(), state(vision=replace(blind, quality=Quality.STALE)))
    head = 'state,site=site1,bay=bay1 stop=false,may_move=true,in_place=false,reason="NONE",ne107='
    assert known == f'{head}"GOOD",u=640.28,v=-3.21,radius_px=120.04,distance_mm=812.4 1795000000123000000'
    assert unknown.startswith(head)
    assert unknown.endswith(",distance_mm=812.4 1795000000123000000")
    assert "radius_px" not in unknown


@pytest.mark.parametrize(("number", "digits"), [(1, "000001"), (999_999, "999999"), (1_234_567, "234567")])
def test_an_event_s_time_has_its_number(number: int, digits: str) -> None:
    (line,) = lines(event(EventKind.STOP_RAISED, number))
    assert line == (
        f'event,site=site1,bay=bay1,kind=stop_raised id="9f86d081884c7d65-{number}",reason="NONE",stop=false,detail=""'
        f" 1795000000123{digits}"
    )


def test_texts_stay_one_line_and_one_value() -> None:
    detail = 'a "quote", C:\\new,\nnext=line\r\t µ'
    (line,) = lines(event(EventKind.MOVED, 1, detail))
    assert 'detail="a \\"quote\\", C:\\\\new, next=line   µ"' in line
    named = json.loads(state()) | {"site": "a b,c=d"}
    (line,) = lines(json.dumps(named).encode())
    assert line.startswith("state,site=a\\ b\\,c\\=d,bay=bay1 stop=")


class Database(BaseHTTPRequestHandler):
    """Refuses one line for good, and another one for a while."""

    written: ClassVar[list[str]] = []
    asked: ClassVar[list[str]] = []

    def do_POST(self) -> None:
        line = self.rfile.read(int(self.headers["Content-Length"])).decode()
        self.asked.append(line)
        code = 400 if "bay=bad" in line else 503 if "bay=later" in line and self.asked.count(line) == 1 else 204
        if code == 204:
            self.written.append(line)
        self.send_response(code)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        pass


def test_a_line_that_the_database_refuses_for_good_does_not_hold_up_those_behind_it(tmp_path: Path) -> None:
    bays = ["first", "bad", "later", "last"]
    payload = b"\n".join(json.dumps(json.loads(state()) | {"bay": bay}).encode() for bay in bays)
    (tmp_path / "payload").write_bytes(payload)
    stand_in = tmp_path / "mosquitto_sub"
    stand_in.write_text(f'#!/bin/sh\necho "$@" > {tmp_path}/asked\nexec cat {tmp_path}/payload\n')
    stand_in.chmod(0o755)
    with ThreadingHTTPServer(("127.0.0.1", 0), Database) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        done = subprocess.run(
            [
                "/bin/sh",
                str(PROGRAM.with_name("mqtt-to-influx.sh")),
                "broker",
                "1883",
                f"http://127.0.0.1:{server.server_port}",
            ],
            env=os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}", "no_proxy": "*"},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        server.shutdown()
    assert [line.split()[0].rpartition("bay=")[2] for line in Database.written] == ["first", "later", "last"]
    assert (done.returncode, done.stderr.count("skipped, refused with 400: state,site=site1,bay=bad ")) == (0, 1)
    asked = (tmp_path / "asked").read_text().split()
    for place in (".", "hall2/line1"):  # without area and line, and with them
        wanted = Path("loading/site1") / place / "bay1"
        for kind in ("state", "event"):
            assert sum((wanted / kind).match(topic.replace("+", "*")) for topic in asked if "+" in topic) == 1
