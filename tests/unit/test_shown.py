"""Every output says the same of a bay at every moment: all ask one rule, and nothing else asks the hub."""

import ast
import asyncio
import json
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import gateway
from gateway import shared_state
from gateway.bay import BayControl
from gateway.config import GatewayConfig, MqttConfig, SparkplugConfig, parse
from gateway.core.detection import Circle
from gateway.core.plc import Control, PlcWrite, Writer
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.shown import shown
from gateway.core.state import FunctionCheck, Reason, StateVector, Tick
from gateway.modbus.registers.bay_unit import image_of
from gateway.modbus.registers.register_map import decode
from gateway.shared_state import SharedStateReader, SharedStateWriter
from gateway.sinks.mqtt.publisher import MqttPublisher
from gateway.sinks.sparkplug import metrics
from gateway.sinks.sparkplug.publisher import SparkplugPublisher
from gateway.web.ipc.messages import StateRequest
from gateway.web.server import views
from tests.examples import examples
from tests.sink_context import sink_context
from tests.unit.web.gateway_client import Plant, plant
from tests.virtual_time import LoopClock, run

MS = 1_000_000
PLC = Writer("10.0.0.9")
CONFIG: GatewayConfig = parse(
    {
        "instance": "shown",
        "modbus": {"writes": True, "plc_addresses": [PLC.address], "handshake": {"heartbeat_required": False}},
        "visit": {"settle_s": 0.3},
        "fusion": {"recovery_s": 0.2},
    }
)
TOLD = ("stop", "may_move", "in_place", "moved", "reason")


@pytest.fixture(autouse=True)
def default_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_state, "folder", lambda: tmp_path)


class Outputs:
    """What each output says of the bay now, as (stop, may_move, in_place, moved, reason)."""

    def __init__(self, made: Plant, reader: SharedStateReader) -> None:
        clock = LoopClock()
        config = MqttConfig(url="mqtt://broker", sparkplug=SparkplugConfig())
        self._made = made
        self._reader = reader
        self._image = image_of(made.controls["bay1"].state, "big", clock)
        self._mqtt = MqttPublisher(sink_context(config, made.hub, clock))
        self._sparkplug = SparkplugPublisher(sink_context(config, made.hub, clock))
        self._asked = 0

    def now(self) -> dict[str, tuple[Any, ...]]:
        return {"modbus": self._modbus(), "mqtt": self._json(), "sparkplug": self._metrics()} | {
            "shared memory": self._vector(), "web": self._web(), "web registers": self._web_image()
        }  # fmt: skip

    def _modbus(self) -> tuple[Any, ...]:
        return _of_registers(decode(self._image()))

    def _json(self) -> tuple[Any, ...]:
        said = json.loads(self._mqtt._state_messages(self._mqtt._shown("bay1"))[0].payload)
        return said["stop"], said["may_move"], said["in_place"], said["moved"], said["reason"]["name"]

    def _metrics(self) -> tuple[Any, ...]:
        state = self._sparkplug._states()["bay1"]
        if state is None:  # DDEATH: the device is dead, which a host must take for stop
            return True, False, False, None, Reason.GATEWAY_FAULT.name
        read = {name: value for name, (value, _) in metrics.readings(state).items()}
        return read["Stop"], read["May Move"], read["In Place"], read["Moved"], read["Reason/Name"]

    def _vector(self) -> tuple[Any, ...]:
        found = self._reader.read()
        return found.stop, found.may_move, found.in_place, found.moved.name, found.reason.name

    def _web(self) -> tuple[Any, ...]:
        self._asked += 1
        self._made.client._take(self._made.handler.answer(StateRequest(self._asked, ("bay1",), 0, False)))
        view = views.bay_view(self._made.client, CONFIG.bays[0]).state
        assert view is not None
        return view.stop, view.may_move, view.in_place, view.moved, view.reason.name

    def _web_image(self) -> tuple[Any, ...]:
        seen = self._made.client.report("bay1")
        assert seen is not None
        return _of_registers(decode(seen.now.image))


def _of_registers(read: dict[str, Any]) -> tuple[Any, ...]:
    moved = ("NO", "DISTANCE", "MARKER")[int(read["moved"])]
    facts = bool(read["stop"]), bool(read["may_move"]), bool(read["in_place"])
    bits = int(read["position_status"])
    assert facts[1:] == (bool(bits & 1), bool(bits & 2)), "the bits say what the registers say"
    return *facts, moved, Reason(int(read["reason"])).name


def _dead(control: BayControl) -> None:
    """The control task has crashed, and is not begun again yet; the sensors still speak."""
    step = control._step
    control._step = lambda seen, *more, **named: None if isinstance(seen, Tick) else step(seen, *more, **named)  # type: ignore[method-assign]


SEEN = st.tuples(st.just("see"), st.sampled_from(list(Quality)), st.sampled_from([20.0, 100.0, 190.0, 200.0]))
HEARD = st.tuples(st.just("hear"), st.sampled_from(list(Quality)), st.sampled_from([270.0, 285.0, 900.0, 2000.0]))
STANDS = st.tuples(st.just("stand"), st.integers(1, 30))
OTHERS = st.sampled_from(
    [("write", 0), ("write", 1 << Control.RELEASE), ("check", FunctionCheck.MAY_MOVE_OFF), ("check", FunctionCheck.OFF),
     ("check", FunctionCheck.MAY_MOVE_KEPT), ("die",), ("shut_down",)]
)  # fmt: skip
WAIT = st.tuples(st.just("wait"), st.sampled_from([1, 30, 260, 450, 5000]))


@pytest.mark.one_interpreter
@given(history=st.lists(st.one_of(SEEN, HEARD, STANDS, WAIT, OTHERS), max_size=25))
@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_two_outputs_ever_disagree(history: list[tuple[Any, ...]]) -> None:
    run(_played(history))


@pytest.mark.failure_mode("G1")
def test_a_dead_control_task_beside_live_sensors() -> None:
    """Every observation makes a new state, and none of them may be shown."""
    said = run(_played([("stand", 30), ("die",), *[("wait", 30), ("see", Quality.GOOD, 100.0)] * 12]))
    assert {told[:3] for told in said[-1].values()} == {(True, False, False)}
    assert {told[4] for told in said[-1].values()} == {"GATEWAY_FAULT"}


def test_a_truck_in_place_is_in_place_on_every_output() -> None:
    said = run(_played([("stand", 30)]))
    assert set(said[-1].values()) == {(True, False, True, "NO", "TARGET_REACHED")}


async def _played(history: list[tuple[Any, ...]]) -> list[dict[str, tuple[Any, ...]]]:
    """Every output after every step."""
    said: list[dict[str, tuple[Any, ...]]] = []
    clock = LoopClock()
    async with plant(keep=False, config=CONFIG) as made:
        control = made.controls["bay1"]
        with SharedStateWriter("shown", "bay1", clock) as writer, SharedStateReader("shown", "bay1", clock) as reader:
            control._mirrors = (writer.write,)
            writer.write(made.hub.state("bay1"))
            outputs = Outputs(made, reader)
            for act in history:
                await _do(control, clock, act)
                told = outputs.now()
                assert len({t[:3] for t in told.values()}) == 1, (act, told)
                assert len({t[4] for t in told.values()}) == 1, (act, told)
                assert len({t[3] for t in told.values()} - {None}) == 1, (act, told)
                stop, may_move, in_place, *_ = told["modbus"]
                assert not (may_move and (stop or in_place)), told
                said.append(told)
    return said


async def _do(control: BayControl, clock: LoopClock, act: tuple[Any, ...]) -> None:
    match act:
        case ("see", quality, radius_px):
            circle = Circle(320.0, 240.0, radius_px) if quality is Quality.GOOD else None
            control.on_reading(VisionReading(clock.now_ns(), quality, circle))
        case ("hear", quality, distance_mm):
            z = distance_mm if quality is Quality.GOOD else None
            control.on_reading(RangeReading(clock.now_ns(), quality, z))
        case ("stand", times):
            for _ in range(times):
                control.on_reading(VisionReading(clock.now_ns(), Quality.GOOD, Circle(320.0, 240.0, 190.0)))
                control.on_reading(RangeReading(clock.now_ns(), Quality.GOOD, 285.0))
                await asyncio.sleep(0.06)
        case ("wait", ms):
            await asyncio.sleep(ms / 1000)
        case ("write", bits):
            control.on_write(PlcWrite(PLC, control=bits))
        case ("check", mode):
            control.check_function(mode)
        case ("die",):
            _dead(control)
        case ("shut_down",):
            control.shut_down()


# The rule itself.


def test_a_state_is_shown_until_it_is_no_longer_valid() -> None:
    state = StateVector("bay1", t_ns=5, valid_until_ns=100, stop=False, may_move=True, d=False, reason=Reason.NONE)
    assert shown(state, 100) is state
    dead = shown(state, 101)
    assert (dead.stop, dead.may_move, dead.in_place, dead.d, dead.reason) == (
        True,
        False,
        False,
        None,
        Reason.GATEWAY_FAULT,
    )


def test_what_nobody_has_computed_is_not_shown() -> None:
    assert shown(StateVector("bay1"), 1).reason is Reason.GATEWAY_FAULT


def test_the_final_state_of_a_gateway_stays() -> None:
    last = StateVector("bay1", reason=Reason.SHUTDOWN)
    assert shown(last, 10**18) is last


# Nothing else reads the hub's state.


def _files_with(attribute: str, of: str = ".*") -> set[str]:
    """Which modules of the package read an attribute of that name, of an owner whose name fits."""
    root = Path(gateway.__file__).parent
    found = set()
    for path in root.rglob("*.py"):
        if f".{attribute}" not in (text := path.read_text()):
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Attribute) and node.attr == attribute:
                owner = getattr(node.value, "attr", getattr(node.value, "id", ""))
                if re.fullmatch(of, owner):
                    found.add(str(path.relative_to(root)))
    return found


@pytest.mark.one_interpreter
def test_only_the_control_task_reads_the_hub_s_state() -> None:
    assert _files_with("state", of="_*hub_*") == {"bay.py"}


def test_only_two_places_withdraw_a_state() -> None:
    """The rule, and the final state."""
    assert _files_with("forced_stop") == {"bay.py", "core/shown.py", "sinks/mqtt/payloads.py"}
