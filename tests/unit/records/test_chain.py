"""Each situation of docs/visit.md: the first cause named is the right one, and the chain begins where it did."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from gateway.core.fusion import forced_stop
from gateway.core.readings import Quality
from gateway.core.retained import RetainedState, RetainedTruck
from gateway.core.state import FunctionCheck, Reason, StateVector, Tick
from gateway.records import chain
from gateway.records.chain import Link
from gateway.records.collector import Collector
from gateway.records.factors import Cause, Factor, causes
from gateway.records.record import array_of, unpacked
from gateway.records.recording import Item, MissingItem, Place
from gateway.records.replay import Replay, Step
from gateway.records.segment import Head
from tests.visit_bench import Bench, Levels, gateway, truck
from tools.situations import SITUATIONS

IN = {"distance_cm": 28, "speed_cm_s": 30, "hold_s": 60}
NEAR = {"distance_cm": 70, "speed_cm_s": 50, "hold_s": 60}
S = 1_000_000_000


def during(kind: str, at_s: float = 8.0, for_s: float = 60.0) -> dict[str, Any]:
    return {"kind": kind, "at_s": at_s, "for_s": for_s}


class Story:
    """A bench that is recorded, and what is found in the recording."""

    def __init__(self, *legs: dict[str, Any], faults: tuple[dict[str, Any], ...] = (), **handshake: Any) -> None:
        self._kept = Collector(lambda: 0)
        modbus = {"writes": True, "plc_addresses": ["10.0.0.9"], "handshake": handshake}
        config = gateway(modbus=modbus) if handshake else gateway()
        self.bench = Bench(truck(*legs, faults=faults), config, record=self._kept)
        self.plc = Levels(self.bench)
        self.late_s = 0.0
        self._steps: list[Step] = []

    def run(self, until_s: float) -> "Story":
        self.bench.run(until_s)
        return self

    def until(self, wanted: Callable[[StateVector], bool]) -> "Story":
        self.bench.run_until(wanted)
        return self

    def end(self) -> "Story":
        self._kept(None, forced_stop(self.bench.state, Reason.SHUTDOWN, self.bench.now_ns), [])
        return self

    @property
    def steps(self) -> list[Step]:
        head = Head(
            bay="bay1", number=1, boot="a", site="s", instance="g", gateway_version="1", python_version="3",
            t_ns=0, unix_ns=0, config="",
        )  # fmt: skip
        items: list[Item | MissingItem] = []
        while (chunk := self._kept.take()) is not None:
            items += [(Place(Path("x.seg"), head, 0), record) for record in unpacked(array_of(chunk.records))]
        replay = Replay(lambda _: (self.bench.rules, "big"))
        self._steps += [found for found in replay.run(items) if isinstance(found, Step)]
        return self._steps

    @property
    def causes(self) -> tuple[Cause, ...]:
        state = self.steps[-1].state
        return causes(state, self.bench.rules, state.t_ns + round(self.late_s * S))

    @property
    def links(self) -> list[Link]:
        return list(chain.links(self.steps, lambda _: self.bench.rules))

    def at_s(self, t_s: float) -> int:
        """Unix ns of a world time."""
        return self.bench.now_ns + round((t_s - self.bench.t_s) * S)


def empty() -> Story:
    story = Story(NEAR)
    story.bench.vision_fault, story.bench.range_fault = Quality.NO_TARGET, Quality.NO_ECHO
    return story.run(2)


def placed(*faults: dict[str, Any], legs: tuple[dict[str, Any], ...] = (IN,)) -> Story:
    return Story(*legs, faults=faults).until(lambda state: state.in_place)


def held(*faults: dict[str, Any], legs: tuple[dict[str, Any], ...] = (IN,)) -> Story:
    story = placed(during("spout_down", 6.5), *faults, legs=legs)
    return story.until(lambda state: state.visit.held and state.vision.quality is Quality.NO_TARGET)


def released() -> Story:
    legs = ({**IN, "hold_s": 8}, {"distance_cm": 150, "speed_cm_s": 30, "hold_s": 5})
    story = placed(during("spout_down", 6.5, 4), legs=legs).until(lambda state: state.visit.held)
    story.plc.release()
    return story.until(lambda state: state.may_move)


def plc_lost() -> Story:
    story = Story(NEAR, heartbeat_required=True, heartbeat_deadline_s=1.0).until(lambda state: state.may_move)
    story.plc.alive = False
    return story.until(lambda state: state.stop)


def still() -> Story:
    story = placed().run(8)
    story.late_s = 0.6
    return story


ROLLS = ({**IN, "hold_s": 6}, {"distance_cm": 38, "speed_cm_s": 5, "hold_s": 60})
DRIVES = ({**IN, "hold_s": 8}, {"distance_cm": 120, "speed_cm_s": 40, "hold_s": 60})


@dataclass(frozen=True)
class Expected:
    """`text`: in the first cause. `led`: in a link that led to the newest change."""

    story: Callable[[], Story]
    factor: Factor
    text: str
    reason: Reason
    led: str = ""


EXPECTED = {
    "empty bay": Expected(empty, Factor.NO_TRUCK, "no truck", Reason.NO_ECHO),
    "arriving, beyond the ranger's range": Expected(
        lambda: Story({"distance_cm": 480, "speed_cm_s": 200, "hold_s": 60}).run(6),
        Factor.CLEAR, "D = 0, R 1", Reason.NONE,
    ),
    "approaching": Expected(
        lambda: Story(NEAR).run(3), Factor.CLEAR, "D = 0, R 7", Reason.NONE, "the last cause ended"
    ),
    "at the mark, still rolling": Expected(
        lambda: Story(IN).until(lambda state: state.d is True),
        Factor.TARGET, ">= R_th 180, Z ", Reason.TARGET_REACHED, "was at ",
    ),
    "in place, seen by both": Expected(
        placed, Factor.TARGET, ">= R_th 180, Z ", Reason.TARGET_REACHED, "R was at least R_th from here on"
    ),
    "loading: the marker is covered, held by the ranger": Expected(
        held, Factor.IN_PLACE, "and the ranger holds it: Z 28", Reason.NO_TARGET, "in place: Z 28"
    ),
    "released by the PLC (`release`)": Expected(
        released, Factor.RELEASED, "it may leave although D is 1 or unknown", Reason.NONE, "in place: Z 28"
    ),
    "leaving": Expected(
        lambda: released().until(lambda state: state.visit.off_mark),
        Factor.RELEASED, "it has left the mark", Reason.NONE, "in place: Z 28",
    ),
    "approaching, marker hidden": Expected(
        lambda: Story(NEAR, faults=(during("marker_hidden", 3),)).run(5),
        Factor.CAMERA, "camera: the frame is fine, but no marker is in it", Reason.NO_TARGET, "the last frame with the",
    ),
    "approaching, camera dead": Expected(
        lambda: Story(NEAR, faults=(during("camera_freeze", 3),)).run(5),
        Factor.CAMERA, "s old; fusion.vision_deadline_s is 0.3 s", Reason.VISION_STALE, "the newest frame, number",
    ),
    "approaching, ranger dead": Expected(
        lambda: Story(NEAR, faults=(during("ranger_silent", 3),)).run(6),
        Factor.RANGER, "(nothing received for 3 s)", Reason.RANGE_STALE, "the last distance: Z 70",
    ),
    "approaching, PLC's heartbeat lost (writes on)": Expected(
        plc_lost, Factor.PLC_LOST, "heartbeat_deadline_s is 1 s", Reason.PLC_LOST, "the last change of plc_heartbeat"
    ),
    "in place, the truck rolls back": Expected(
        lambda: placed(legs=ROLLS).until(lambda state: state.reason is Reason.MOVED),
        Factor.MOVED, "the distance left its band; it was in place at Z 28", Reason.MOVED, "in place: Z 28",
    ),
    "held, the truck rolls back": Expected(
        lambda: held(legs=ROLLS).until(lambda state: bool(state.visit.moved)),
        Factor.MOVED, "the distance left its band", Reason.NO_TARGET, "the marker was covered from here on",
    ),
    "held, drives off without release": Expected(
        lambda: held(legs=DRIVES).until(lambda state: bool(state.visit.moved)),
        Factor.MOVED, "the distance left its band", Reason.NO_TARGET, "in place: Z 28",
    ),
    "held, something else red is taken for the marker": Expected(
        lambda: held(during("red_lamp", 8)).until(lambda state: state.memory.disagree and not state.in_place),
        Factor.CONTRADICTION, "each other: R 19.6 px, Z 280 mm", Reason.SENSORS_DISAGREE, "the last that fitted: R 1",
    ),
    "held, camera dead": Expected(
        lambda: held(during("camera_freeze", 8)).run(10),
        Factor.CAMERA, "s old; fusion.vision_deadline_s is 0.3 s", Reason.VISION_STALE, "the newest frame",
    ),
    "held, ranger dead": Expected(
        lambda: held(during("ranger_silent", 8)).run(11),
        Factor.RANGER, "(nothing received for 3 s)", Reason.RANGE_STALE, "the last distance: Z 28",
    ),
    "held, no echo": Expected(
        lambda: held(during("ranger_no_echo", 8)).run(9.3),
        Factor.RANGER, "ranger: the ranger heard no echo", Reason.NO_ECHO, "the last distance: Z 28",
    ),
    "in place, the gateway's decision stands still": Expected(
        still, Factor.GATEWAY, "its last step was 0.60 s earlier", Reason.TARGET_REACHED
    ),
    "in place, the gateway shuts down": Expected(
        lambda: placed().run(8).end(), Factor.SHUTDOWN, "the gateway was stopped", Reason.SHUTDOWN
    ),
}  # fmt: skip


def test_every_situation_of_the_visit_is_here() -> None:
    assert list(EXPECTED) == list(SITUATIONS)


@pytest.mark.mostly_long(short=6)
@pytest.mark.one_interpreter
@pytest.mark.parametrize("name", EXPECTED)
def test_the_first_cause_is_the_right_one(name: str) -> None:
    expected = EXPECTED[name]
    story = expected.story()
    first = story.causes[0]
    assert (first.factor, story.steps[-1].state.reason) == (expected.factor, expected.reason)
    assert expected.text in first.text
    if not expected.led:
        return
    led = [link.why for link in story.links if not link.what and link.factor is expected.factor]
    assert any(expected.led in why for why in led), led


@pytest.mark.long
@pytest.mark.one_interpreter
def test_a_chain_goes_from_the_camera_s_last_frame_to_stop() -> None:
    story = Story(NEAR, faults=(during("camera_freeze", 3, 2),)).run(9)
    links = story.links
    n = next(n for n, link in enumerate(links) if "none -> vision_stale" in link.what)
    stopped = links[n]
    assert stopped.what == "stop 0 -> 1, may_move 1 -> 0, reason none -> vision_stale"
    assert stopped.by == "tick"
    assert stopped.unix_ns == pytest.approx(story.at_s(3.28), abs=0.05 * S)
    assert stopped.why.startswith("the newest frame was 0.3")
    assert links[n - 1].why.startswith("the newest frame, number ")
    assert stopped.unix_ns - links[n - 1].unix_ns == pytest.approx(0.31 * S, abs=0.02 * S)
    gone = next(link for link in links[n:] if link.what == "stop 1 -> 0, may_move 0 -> 1, reason clearing -> none")
    assert gone.unix_ns > story.at_s(5)
    assert "nothing stops the truck: D = 0" in gone.why


def test_both_thresholds_have_their_times() -> None:
    story = Story(IN).until(lambda state: state.d is True)
    links = story.links
    led = {link.why: link.unix_ns for link in links if not link.what and link.factor is Factor.TARGET}
    assert set(led) == {"R was at least R_th from here on", "Z was at most Z_th from here on"}
    assert max(led.values()) == links[-1].unix_ns


@pytest.mark.long
@pytest.mark.one_interpreter
def test_a_write_is_named_with_its_writer_and_bits() -> None:
    links = released().links
    (link,) = (link for link in links if link.factor is Factor.RELEASED and link.what)
    assert link.by == "write of 10.0.0.9: plc_control 0 -> 32"
    assert "in_place 1 -> 0" in link.what


@pytest.mark.parametrize(
    ("required", "factor"),
    [("enable_required", Factor.ENABLE), ("truck_required", Factor.TRUCK_PRESENT), ("", Factor.FUNCTION_CHECK)],
)
def test_what_withholds_may_move_alone(required: str, factor: Factor) -> None:
    asked: dict[str, Any] = {required: True} if required else {}
    story = Story(NEAR, heartbeat_required=True, **asked).run(3)
    if not required:
        story.bench.check_function(FunctionCheck.MAY_MOVE_OFF)
    state = story.bench.state
    assert (state.stop, state.may_move) == (False, False)
    assert [cause.factor for cause in story.causes] == [factor]


@pytest.mark.one_interpreter
def test_a_stop_that_is_about_to_end_says_for_how_long_yet() -> None:
    story = Story(NEAR, faults=(during("marker_hidden", 3, 1.5),)).run(4)
    story.until(lambda state: state.d is False)
    assert [cause.factor for cause in story.causes] == [Factor.HOLD]
    assert "clear_hold_s is" in story.causes[0].text


@pytest.mark.one_interpreter
def test_a_sensor_that_recovers_is_named_with_how_long() -> None:
    story = Story(NEAR, faults=(during("camera_freeze", 3, 1),)).run(4.2)
    assert story.causes[0].factor is Factor.CAMERA
    assert "has been good again for 0." in story.causes[0].text


@pytest.mark.long
@pytest.mark.one_interpreter
def test_a_latched_stop_names_when_d_was_1() -> None:
    legs = (IN | {"hold_s": 0.0}, {"distance_cm": 60, "speed_cm_s": 30, "hold_s": 60})
    config = gateway(fusion={"latch_stop": True})
    story = Story(*legs)
    story.bench.rules = Bench(truck(), config).rules
    story.run(10)
    assert story.causes[0].factor is Factor.LATCH
    assert any(link.why == "D became 1" for link in story.links)


@pytest.mark.long
@pytest.mark.one_interpreter
def test_causes_are_never_empty_and_tell_a_stop_from_none() -> None:
    story = Story(IN, faults=(during("spout_down", 6.5, 3), during("camera_freeze", 11, 1))).run(14)
    for step in story.steps:
        factors = {cause.factor for cause in causes(step.state, story.bench.rules)}
        assert factors
        free = bool(factors & {Factor.CLEAR, Factor.RELEASED})
        assert free == step.state.may_move


@pytest.mark.long
@pytest.mark.one_interpreter
def test_a_truck_from_before_the_start() -> None:
    story = Story(NEAR).run(3)
    story.bench.power_on(RetainedState(truck=RetainedTruck(place=None)))
    story.run(8)
    assert (story.bench.state.stop, story.bench.state.reason) == (True, Reason.STOP_LATCHED)
    assert [cause.factor for cause in story.causes] == [Factor.RESTORED]


def test_a_stop_without_a_known_cause_is_not_said_to_be_none() -> None:
    story = Story(NEAR).run(3)
    state = replace(story.bench.state, stop=True, may_move=False, reason=Reason.VISION_FAULT)
    (cause,) = causes(state, story.bench.rules)
    assert (cause.factor, cause.text) == (Factor.OTHER, "the vision process died, hung or failed")


def test_a_tick_is_a_tick() -> None:
    assert chain.entered(Tick(), None, StateVector("bay1")) == "tick"
    assert chain.entered(None, None, StateVector("bay1")) == "a new beginning of the recording"


@pytest.mark.parametrize(("since_ns", "told"), [(9, ["the last cause ended: it stood"]), (20, []), (None, [])])
def test_the_last_cause_is_that_of_this_stop(since_ns: int | None, told: list[str]) -> None:
    """One that ends in the step itself is not that of an earlier stop."""
    state = Story(NEAR).run(1).bench.state
    now = replace(state, memory=replace(state.memory, no_cause_since_ns=since_ns))
    past = chain._Past(ended=(9, "it stood"))
    for factor in (Factor.HOLD, Factor.CLEAR):
        assert [text for _, text in past._of(factor, now, now)] == told
