"""The exported function block and the gateway's own decision, in a closed loop in virtual time.

What the block writes goes into gateway/core/interlock.py, what that makes comes back as the image; a scan every 20 ms,
a poll every 100 ms. No sockets: those are tried in test_structured_text.py and test_handshake.py.
"""

from collections.abc import Callable
from dataclasses import replace

import pytest

from gateway.config import parse
from gateway.core import interlock
from gateway.core.fusion import Observation
from gateway.core.interlock import Rules
from gateway.core.plc import PlcWrite, TriggerOutcome, Writer
from gateway.core.readings import Quality
from gateway.core.shown import shown
from gateway.core.state import GuidanceCode, Tick
from gateway.modbus.exports import node_red_function, structured_text
from gateway.modbus.exports.target import Target
from gateway.modbus.registers.lamps import Lamp
from gateway.modbus.registers.register_map import BLOCK_WORDS
from tests.node_function import Messages, run_each
from tests.plc_images import ADDRESS, block_of, words
from tests.structured_text import Program
from tests.visit_stories import play
from tools.situations import EMPTY, Scene

pytestmark = [pytest.mark.xdist_group("structured text"), pytest.mark.timeout(300)]  # the parser takes its time

MS = 1_000_000
PLC = Writer("10.0.0.9")
RECIPE = {"id": 7, "name": "half way", "fusion": {"distance_threshold_mm": 150.0}}
CONFIG = parse({"modbus": {"writes": True, "plc_addresses": [PLC.address]}, "recipes": [RECIPE]})
RULES = Rules.of(CONFIG.bays[0], CONFIG)


class Loop:
    """A bay, and a PLC that runs the exported block."""

    def __init__(self) -> None:
        self.program = Program(structured_text.declarations((Target(),)))
        self.block = block_of(self.program)
        self.state = interlock.initial("bay1", 0, RULES)
        self.words = [0] * BLOCK_WORDS
        self.now_ms = 0
        self.written: list[int] = []  # every control word that the gateway got

    def put(self, **inputs: bool | int) -> None:
        self.block.values |= inputs

    def play(
        self, scene: Scene, until: Callable[[], bool] | None = None, every: Callable[[], object] = lambda: None
    ) -> None:
        """The whole scene, or until something is so; then it must be so before the scene ends. `every`: each cycle."""
        for at_ms in range(0, scene.for_ms, 20):
            seen: list[Observation] = [Tick()]
            if self.now_ms % 60 == 0:
                seen.extend(scene.readings(at_ms, self.now_ms * MS))
            if self.now_ms % 100 == 0:
                control, recipe = self.block["PlcControl"], self.block["RecipeSelect"]
                seen.append(PlcWrite(PLC, heartbeat=self.block["PlcHeartbeat"], control=control, recipe=recipe))
                self.written.append(control)
            for observation in seen:
                self.state = interlock.step(self.state, observation, self.now_ms * MS, RULES)
            if self.now_ms % 100 == 0:
                self.words = words(self.state)
            self.block.call(self.now_ms, PollOk=True, Words=self.words)
            assert not (self.block["MayMove"] and self.block["InPlace"])
            self.now_ms += 20
            every()
            if until is not None and until():
                return
        assert until is None, "not before the scene ended"

    def outputs(self) -> tuple[bool, bool, bool]:
        return self.block["MayMove"], self.block["InPlace"], self.block["Held"]


FAR = Scene(3000, z_mm=900.0)
DRIVING = Scene(3000, z_mm=900.0, to_mm=280.0)
STANDING = Scene(3000, z_mm=280.0)
COVERED = Scene(3000, z_mm=280.0, vision=Quality.NO_TARGET)
LEAVING = Scene(3000, z_mm=280.0, to_mm=900.0)


@pytest.fixture
def loop() -> Loop:
    return Loop()


def test_one_visit_is_worked_to_its_end(loop: Loop) -> None:
    loop.play(FAR)
    assert loop.outputs() == (True, False, False)
    loop.play(DRIVING)
    loop.play(Scene(300, z_mm=280.0))  # just come to rest
    assert loop.outputs() == (False, False, False)
    loop.play(STANDING)
    assert loop.outputs() == (False, True, False)
    loop.play(COVERED)
    assert loop.outputs() == (False, True, True)
    loop.put(Release=True, SpoutUp=True)
    loop.play(STANDING, until=lambda: bool(loop.block["MayMove"]))
    assert loop.block["MustStop"] is False
    loop.play(LEAVING)
    assert loop.outputs() == (True, False, False)
    assert loop.block["Moved"] is False


def lights(image: list[int]) -> bool:
    """Is green or amber shown to the driver?"""
    return bool(image[ADDRESS["signal_lamps"]] & (1 << Lamp.GREEN | 1 << Lamp.AMBER))


@pytest.mark.long
def test_may_move_is_that_of_the_register_and_the_lamps_in_every_cycle_of_a_visit(loop: Loop) -> None:
    """Also beyond the ranger's range, on the way in and out, and released while the spout still covers the marker."""
    beyond = Scene(2000, z_mm=4900.0, range=Quality.TOO_FAR)
    scenes = (EMPTY, beyond, replace(beyond, range=Quality.NO_ECHO), FAR, DRIVING, STANDING, COVERED)
    out = (COVERED, LEAVING, Scene(500, z_mm=1000.0, to_mm=3400.0), beyond, EMPTY)
    driven = []
    loop.play(EMPTY)
    for n, scene in enumerate(scenes + out):
        loop.put(Release=n >= len(scenes), SpoutUp=True)
        cycles: list[bool] = []

        def compared(cycles: list[bool] = cycles) -> None:
            assert loop.block["MayMove"] is bool(loop.words[ADDRESS["may_move"]])
            # Red comes earlier: the driver is told to stop while D is 0 still.
            early = loop.words[ADDRESS["guidance"]] == GuidanceCode.STOP
            assert lights(loop.words) is (loop.block["MayMove"] and not early)
            cycles.append(loop.block["MayMove"])

        loop.play(scene, every=compared)
        driven.append(sum(cycles) / len(cycles))
    assert [share > 0.7 for share in driven[:10]] == [False, *[True] * 4, False, False, *[True] * 3]


@pytest.mark.long
def test_may_move_is_that_of_the_register_whatever_happens() -> None:
    """Visits made up by chance, with dying sensors and a PLC that does as it likes; in Node-RED, which is quick."""
    runs: list[Messages] = []
    for seed in range(8):
        bench = play(seed)
        states = [moment.state for moment in bench.moments[::5]]
        runs.append([(100, words(shown(state, state.t_ns))) for state in states])
    exceptions = 0
    for run, ran in zip(runs, run_each(node_red_function.code(Target()), runs), strict=True):
        moves = False
        for n, ((_, image), (outputs, status)) in enumerate(zip(run, ran, strict=True)):
            moves = outputs[0]["payload"] if outputs[0] else moves
            if n > 2 and status not in ("heartbeat", "torn"):
                assert moves is bool(image[ADDRESS["may_move"]]), (n, status)
                assert moves or not lights(image)
            good = image[ADDRESS["vision_quality"]] == image[ADDRESS["range_quality"]] == Quality.GOOD
            exceptions += moves and not good
    assert exceptions > 0


def test_a_block_that_begins_anew_while_a_result_is_held_measures_again(loop: Loop) -> None:
    """A download or a restart of the PLC: the gateway would wait for an acknowledgement, and the block for nothing."""
    loop.play(FAR)
    loop.put(Trigger=True)
    loop.play(FAR, until=lambda: bool(loop.block["ResultReady"]))
    loop.block = block_of(loop.program)
    loop.play(FAR, until=lambda: bool(loop.block["TriggerReady"]))
    loop.put(Trigger=True)
    loop.play(FAR, until=lambda: bool(loop.block["ResultReady"]))
    assert loop.block["Data"]["result_id"] == 2


def test_each_trigger_brings_its_own_result(loop: Loop) -> None:
    """Twice: while the truck is on its way, read and acknowledged by hand; then in place, acknowledged by itself."""
    loop.play(FAR)
    assert loop.block["TriggerReady"]
    loop.put(Trigger=True)
    loop.play(FAR, until=lambda: bool(loop.block["ResultReady"]))
    data = loop.block["Data"]
    assert (data["result_outcome"], data["result_distance"], data["result_id"]) == (TriggerOutcome.NOT_IN_PLACE, 900, 1)
    loop.play(DRIVING)
    assert loop.block["ResultReady"]
    assert loop.block["Data"]["result_distance"] == 900  # held, though the truck has moved
    loop.put(Acknowledge=True, Trigger=False)
    loop.play(STANDING, until=lambda: bool(loop.block["TriggerReady"]))
    loop.put(Trigger=True)
    results: list[tuple[int, int]] = []

    def read() -> bool:
        if loop.block["ResultReady"]:
            results.append((loop.block["Data"]["result_outcome"], loop.block["Data"]["result_id"]))
        return bool(results) and bool(loop.block["TriggerReady"])

    loop.play(STANDING, until=read)
    assert set(results) == {(TriggerOutcome.IN_PLACE, 2)}
    assert loop.block["TriggerFailed"] is False
    edges = [now for before, now in zip(loop.written, loop.written[1:], strict=False) if now & ~before & 24]
    assert edges == [8, 16, 8, 16]  # asked once, acknowledged once, for each


def test_a_recipe_is_chosen(loop: Loop) -> None:
    loop.put(Recipe=7)
    loop.play(FAR, until=lambda: loop.block["Data"]["recipe_active"] == 7)
    assert loop.block["RecipeSelect"] == 7
