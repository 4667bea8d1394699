"""A web process in strange hands: what it may say to the main process, and what becomes of that."""

import socket
from pathlib import Path

import pytest

from gateway.alarms.records import MAX_NOTE, OperatorAction
from gateway.alarms.states import AlarmEvent
from gateway.clock import SystemClock
from gateway.config import GatewayConfig, Intrinsics, VisionConfig
from gateway.config.sections.hmi import HmiConfig
from gateway.core.events import MAX_DETAIL_CHARS, EventKind
from gateway.core.plc import Writer
from gateway.core.state import FunctionCheck
from gateway.errors import LinkError, ProtocolError
from gateway.net.rate_limit import BURST
from gateway.processes.channel import Failed
from gateway.processes.codec import Codec
from gateway.web.host.request_handler import MAX_NAME
from gateway.web.host.web_process_service import WebProcessService
from gateway.web.ipc.messages import (
    FROM_WEB,
    ApplySettings,
    Command,
    MarkMoment,
    SetFunctionCheck,
    StateRequest,
    WebSetup,
)
from tests.unit.web.gateway_client import Plant, plant
from tests.virtual_time import in_virtual_time

ANNA = Writer("127.0.0.1", "anna", "technician")


def event_details(made: Plant, kind: EventKind) -> list[str]:
    return [row.event.detail for row in made.handler.answer(StateRequest(1, ())).events if row.event.kind is kind]


def test_every_message_of_an_honest_web_process_is_decoded() -> None:
    intrinsics = Intrinsics(fx=600.0, fy=600.0, cx=320.0, cy=240.0, distortion=(0.1, 0.0, 0.0, 0.0))
    for word in (
        StateRequest(3, ("bay1",), 7, links=False),
        Command(1, ANNA, SetFunctionCheck("bay1", FunctionCheck.MAY_MOVE_OFF)),
        Command(2, ANNA, ApplySettings("bay1", VisionConfig(method="paper", intrinsics=intrinsics))),
        Command(3, ANNA, OperatorAction("bay1.camera", AlarmEvent.SHELVE, "anna", "why", 5.0, 2)),
        Failed("no", config=True),
    ):
        assert FROM_WEB.unpacked(Codec.packed(word)) == word


@in_virtual_time
async def test_settings_go_live_as_they_were_sent_and_forged_ones_are_no_message() -> None:
    async with plant() as made:
        made.handler.execute(Command(1, ANNA, SetFunctionCheck("bay1", FunctionCheck.MAY_MOVE_KEPT)))
        forged = VisionConfig.model_construct(_fields_set={"deadline_s"}, deadline_s=1e9)
        with pytest.raises(ProtocolError, match="a VisionConfig out of its range"):
            FROM_WEB.unpacked(Codec.packed(Command(2, ANNA, ApplySettings("bay1", forged))))
        wished = VisionConfig(coast_s=0.5, red_low_1=(0, 50, 50))
        assert made.handler.execute(Command(3, ANNA, ApplySettings("bay1", wished))).why == ""
        assert made.vision["bay1"].settings == wished


@in_virtual_time
@pytest.mark.failure_mode("W3")
async def test_orders_that_come_faster_than_people_give_them_are_refused_and_change_nothing() -> None:
    async with plant() as made:
        modes = (FunctionCheck.MAY_MOVE_OFF, FunctionCheck.OFF)
        whys = [
            made.handler.execute(Command(n, ANNA, SetFunctionCheck("bay1", modes[n % 2]))).why for n in range(3 * BURST)
        ]
        assert whys[:BURST] == [""] * BURST
        assert all("too many" in why for why in whys[BURST:])
        assert made.handler.answer(StateRequest(1, ())).newest_event <= BURST + 1  # and the start


@in_virtual_time
async def test_long_names_are_clipped_where_they_are_kept() -> None:
    async with plant() as made:
        long = "x" * 60_000
        who = Writer(long, long, long)
        made.handler.execute(Command(1, who, SetFunctionCheck("bay1", FunctionCheck.MAY_MOVE_KEPT)))
        made.handler.execute(Command(2, who, ApplySettings("bay1", VisionConfig(method="paper"))))
        made.handler.execute(Command(5, who, MarkMoment("bay1", long)))
        made.handler.execute(Command(3, who, OperatorAction("bay1.camera", AlarmEvent.SHELVE, long, "", 5)))
        assert len(made.handler.execute(Command(4, who, SetFunctionCheck(long, FunctionCheck.OFF))).why) < 2 * MAX_NAME
        kinds = (EventKind.FUNCTION_CHECK_BEGUN, EventKind.SETTINGS_CHANGED, EventKind.OPERATOR_MARK)
        details = [detail for kind in kinds for detail in event_details(made, kind)]
        assert len(details) == 3
        assert max(map(len, details)) < 4 * MAX_NAME + MAX_DETAIL_CHARS
        assert all(len(alarm.who) <= MAX_NOTE for alarm in made.monitor.summary(100).alarms)


@in_virtual_time
async def test_what_only_people_can_mend_in_the_pages_does_not_end_the_gateway() -> None:
    """A ConfigError would: the supervisor takes it for the end. No page is worth a bay."""
    async with plant() as made:
        host = f"{'x' * 70}.example"  # no name can have a label this long; nobody is asked
        named = HmiConfig(host="localhost").model_copy(update={"host": host})
        about = WebSetup(GatewayConfig(hmi=named), SystemClock(), {})
        with pytest.raises(LinkError, match=r"hmi\.host"):
            await WebProcessService(made.handler, about, ()).run()


@in_virtual_time
async def test_a_connection_that_cannot_be_served_is_closed(tmp_path: Path) -> None:
    """The certificate has gone since the start: the web process would not come up."""
    async with plant(keep=False) as made:
        gone = HmiConfig(tls_cert=str(tmp_path / "gone.pem"), tls_key=str(tmp_path / "gone.key"))
        about = WebSetup(GatewayConfig(hmi=gone), SystemClock(), {})
        with (
            socket.create_server(("127.0.0.1", 0)) as door,
            socket.create_connection(door.getsockname()) as caller,
        ):
            door.setblocking(False)
            with pytest.raises(LinkError, match=r"hmi\.tls_cert: cannot read .*gone\.pem"):
                await WebProcessService(made.handler, about, (door,)).run()
            caller.settimeout(5)
            assert caller.recv(1) == b""
