"""The structured text opens in blark's parser, and its logic does what it says; no compiler stands behind this.

Here and not among the unit tests, which run on every interpreter: the parser takes seconds, once for all these tests.
"""

import random
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.core.detection import Circle
from gateway.core.plc import Handshake, PlcLink, TriggerPhase
from gateway.core.readings import FRESH_FRAME, Quality, RangeReading, VisionReading
from gateway.core.shown import withdrawn
from gateway.core.state import (
    Guidance,
    GuidanceCode,
    Moved,
    Reason,
    ReferencePosition,
    StateVector,
    Visit,
    VisitPhase,
)
from gateway.modbus.exports import node_red_function, openplc, structured_text
from gateway.modbus.exports.approach import APPROACH, SEQUENCE
from gateway.modbus.exports.diagnosis import CHECKS, HEARTBEAT_TIMEOUT_MS, SOUND, VALUES, Diagnosis
from gateway.modbus.exports.fields import fields
from gateway.modbus.exports.interface import INPUTS, OUTPUTS
from gateway.modbus.exports.structured_text import FUNCTION_BLOCK
from gateway.modbus.exports.target import Target
from gateway.modbus.registers.bay_identity import BayIdentity
from gateway.modbus.registers.register_map import BLOCK_WORDS, REGISTERS, decode, encode
from tests.long import mostly_long
from tests.node_function import run_function
from tests.permitted import permitted, standing
from tests.plc_images import ADDRESS, BAY, answered, block_of, doubtful, torn, words
from tests.structured_text import Instance, Program, parse

pytestmark = [pytest.mark.xdist_group("structured text"), pytest.mark.timeout(300)]  # the parser takes its time

# Elementary types, keywords and standard functions of IEC 61131-3, SCL and Logix that a field must not be called.
RESERVED = """
action and array at begin bool by byte case configuration constant continue date dint do dt dword else elsif end exit
false for from function goto if in int jmp label ld le len limit lint lreal lt lword max min mod mux ne not of on or out
program read real repeat resource ret return sel set shl shr sin sint sqrt st step string struct task then time to tod
transition true type udint uint ulint until usint var while with word xor ton tof tp rs sr
"""


@pytest.fixture(scope="module")
def program() -> Program:
    return Program(structured_text.declarations((Target(),)))


class Scan:
    """A PLC's cycles in virtual time: 10 ms each."""

    def __init__(self, block: Instance) -> None:
        self.block = block
        self.now_ms = 0

    def run(self, image: list[int] | tuple[int, ...], ok: bool = True, cycles: int = 1) -> Diagnosis:
        for _ in range(cycles):
            self.now_ms += 10
            self.block.call(self.now_ms, PollOk=ok, Words=list(image))
        found = Diagnosis(self.block["Diagnostic"])
        assert (self.may_move or self.in_place) is (found is Diagnosis.OK)
        assert not (self.may_move and self.in_place)
        assert self.block["MustStop"] is not self.may_move or found > Diagnosis.STOP
        return found

    @property
    def may_move(self) -> bool:
        return bool(self.block["MayMove"])

    @property
    def in_place(self) -> bool:
        return bool(self.block["InPlace"])

    def start(self) -> "Scan":
        """Polls a live gateway until the truck may move, whatever came before."""
        self.run([0] * BLOCK_WORDS, ok=False)
        for heartbeat in (5, 6):
            assert self.run(words(permitted(heartbeat))) is Diagnosis.HEARTBEAT
        assert self.run(words(permitted(7))) is Diagnosis.OK
        assert self.may_move
        return self


@pytest.fixture
def scan(program: Program) -> Scan:
    return Scan(block_of(program))


def test_every_register_is_decoded_as_the_gateway_encodes_it(scan: Scan) -> None:
    scan.start()
    data, image = scan.block["Data"], words(permitted(7))
    for name, value in decode(image).items():
        if f"{name}_high" in data:
            assert data[f"{name}_high"] << 32 | data[f"{name}_low"] == value
            continue
        if f"{name}_valid" in data:
            assert data[f"{name}_valid"] is (value is not None), name
        none = 1e38 if isinstance(data[name], float) else 0
        assert data[name] == pytest.approx(none if value is None else value, rel=2e-7), name
    assert data["u_f32"] == pytest.approx(640.28, rel=1e-7)
    assert data["v"] == pytest.approx(-3.2)
    assert data["distance"] == 812
    assert (data["status_may_move"], data["status_stop"], data["status_healthy"]) == (True, False, True)
    assert set(data) == {field.name for field in fields()}


@pytest.mark.parametrize("value", [1.0, -1.0, 123456.0, 0.0, 1e-30, 3.4e38, -299.625, 1.17549435e-38, 16777216.0])
def test_a_float_survives_the_arithmetic_exactly(scan: Scan, value: float) -> None:
    state = permitted(6, vision=VisionReading(0, Quality.GOOD, Circle(value, 0.0, 1.0)))
    expected = decode(words(state))["u_f32"]
    for heartbeat in (6, 7, 8):
        scan.run(words(replace(state, heartbeat=heartbeat)))
    assert scan.block["Data"]["u_f32"] == expected


def test_the_outputs_follow_the_gateway(scan: Scan) -> None:
    """Approach, at the mark, in place, held, moved; each image names one output at most."""
    scan.start()
    assert (scan.may_move, scan.in_place, scan.block["MustStop"]) == (True, False, False)
    at_mark = permitted(8, d=True, stop=True, may_move=False, reason=Reason.TARGET_REACHED)
    assert scan.run(words(at_mark)) is Diagnosis.STOP
    assert (scan.may_move, scan.in_place, scan.block["MustStop"], scan.block["Alive"]) == (False, False, True, True)
    assert scan.block["Reason"] == int(Reason.TARGET_REACHED)
    assert scan.run(words(standing(9))) is Diagnosis.OK
    assert (scan.may_move, scan.in_place, scan.block["MustStop"], scan.block["Held"]) == (False, True, True, False)
    assert scan.run(words(standing(10, covered=True))) is Diagnosis.OK
    assert (scan.in_place, scan.block["Held"], scan.block["Data"]["held_time"]) == (True, True, 3)
    rolled = standing(11, visit=Visit(VisitPhase.AT_MARK, moved=Moved.DISTANCE))
    assert scan.run(words(rolled)) is Diagnosis.STOP
    assert (scan.in_place, scan.block["Moved"], scan.block["MustStop"]) == (False, True, True)
    assert scan.run(words(permitted(12))) is Diagnosis.OK
    assert (scan.may_move, scan.block["MustStop"], scan.block["Reason"]) == (True, False, 0)
    assert scan.run(words(permitted(13, may_move=False))) is Diagnosis.NO_MAY_MOVE


@pytest.mark.parametrize("quality", Quality)
def test_a_covered_marker_keeps_in_place_and_a_dead_camera_ends_it(scan: Scan, quality: Quality) -> None:
    scan.start()
    found = scan.run(words(standing(8, covered=True, vision=VisionReading(0, quality))))
    assert scan.in_place is (quality in FRESH_FRAME)
    assert (found is Diagnosis.CAMERA) is (quality not in FRESH_FRAME)


@pytest.mark.parametrize("quality", [quality for quality in Quality if quality is not Quality.GOOD])
def test_without_a_good_distance_neither_output_is_on(scan: Scan, quality: Quality) -> None:
    for state in (permitted, standing):
        scan.start()
        assert scan.run(words(state(8, range=RangeReading(0, quality)))) is Diagnosis.RANGER


def test_nothing_is_on_before_the_first_call(scan: Scan) -> None:
    assert (scan.may_move, scan.in_place, scan.block["Alive"]) == (False, False, False)
    assert (scan.block["MustStop"], scan.block["Diagnostic"], scan.block["Reason"]) == (True, 1, 40)


LAMPS = ("red", "amber", "green", "forward", "back", "left", "right", "flash")


def lamps(scan: Scan) -> set[str]:
    return {name for name in LAMPS if scan.block["Data"][f"signal_lamps_{name}"]}


@pytest.mark.parametrize("doubt", ["poll failed", "torn", "frozen", "contradiction"])
def test_the_lamps_are_red_without_a_live_gateway(scan: Scan, doubt: str) -> None:
    """From the first call on; and a program that copies the bits of Data needs no more."""
    forward = Guidance(GuidanceCode.FORWARD)
    scan.run([0] * BLOCK_WORDS, ok=False)
    assert lamps(scan) == {"red"}
    for heartbeat in (5, 6, 7):
        scan.run(words(permitted(heartbeat, guidance=forward)))
    assert lamps(scan) == {"green", "forward"}
    image = words(permitted(8, guidance=forward))
    if doubt == "poll failed":
        scan.run(image, ok=False)
    elif doubt == "torn":
        scan.run(torn(permitted(8, guidance=forward), 1))
    elif doubt == "frozen":
        scan.run(image, cycles=2 + HEARTBEAT_TIMEOUT_MS // 10)
    else:
        scan.run([*image[:4], 1, *image[5:]])  # stop, beside green
    assert lamps(scan) == {"red"}


# What may stand in the words before the first poll, while the input says that the poll was good.
BEFORE_THE_FIRST_POLL = {
    "nothing": [],
    "zeros": [[0] * BLOCK_WORDS],
    "left over from before": [words(permitted(3))],
    "left over, in place": [words(standing(3))],
    "zeros, then left over": [[0] * BLOCK_WORDS, words(permitted(3))],
    "torn": [torn(permitted(3), 5)],
    "another device": [[1] * BLOCK_WORDS],
}


@pytest.mark.parametrize("before", BEFORE_THE_FIRST_POLL.values(), ids=BEFORE_THE_FIRST_POLL)
@pytest.mark.parametrize("good", [True, False], ids=["poll good", "poll bad"])
@pytest.mark.parametrize("state", [permitted, standing])
@pytest.mark.failure_mode("P3")
def test_a_frozen_image_never_gives_an_output(
    program: Program, before: list[list[int]], good: bool, state: Callable[[int], StateVector]
) -> None:
    """Whatever stood in the words before the first poll, and whatever the input says of it."""
    scan = Scan(block_of(program))
    for image in before:
        assert scan.run(image, ok=good, cycles=3) is not Diagnosis.OK
    for _ in range(100):
        assert scan.run(words(state(7))) is Diagnosis.HEARTBEAT


def test_a_frozen_image_between_failed_polls_never_gives_an_output(scan: Scan) -> None:
    scan.start()
    scan.run(words(permitted(7)), ok=False)
    for n in range(60):
        assert scan.run(words(standing(30)), ok=n % 3 != 2) is not Diagnosis.OK


@pytest.mark.failure_mode("P1")
def test_a_heartbeat_that_stands_still_takes_both_outputs_away_within_its_time(scan: Scan) -> None:
    for state in (permitted, standing):
        for heartbeat in (5, 6, 7):
            scan.run(words(state(heartbeat)))
        image = words(state(7))
        assert scan.run(image, cycles=HEARTBEAT_TIMEOUT_MS // 10 - 1) is Diagnosis.OK
        assert scan.run(image, cycles=2) is Diagnosis.HEARTBEAT
        assert (scan.block["MustStop"], scan.block["Alive"]) == (True, False)


def test_a_heartbeat_wraps(scan: Scan) -> None:
    for heartbeat in (0xFFFE, 0xFFFF):
        scan.run(words(permitted(heartbeat)))
    assert scan.run(words(permitted(0x10000))) is Diagnosis.OK


def test_an_unsound_image_takes_the_outputs_away_at_once_and_three_sound_ones_give_them_back(scan: Scan) -> None:
    scan.start()
    assert scan.run(words(permitted(7)), ok=False) is Diagnosis.POLL_FAILED
    assert scan.run(words(permitted(99))) is Diagnosis.HEARTBEAT  # it differs, but was not seen to move
    assert scan.run(words(permitted(100))) is Diagnosis.HEARTBEAT
    assert scan.run(words(permitted(101))) is Diagnosis.OK
    assert scan.run(torn(permitted(102), 1)) is Diagnosis.TORN
    assert scan.run(words(permitted(103))) is Diagnosis.HEARTBEAT


# Each doubt: what a word becomes, what is found in the image of a truck that may move, and in that of one in place.
DOUBTS: dict[str, tuple[dict[str, int], Diagnosis, Diagnosis]] = {
    "torn": ({"seq_end": 3}, Diagnosis.TORN, Diagnosis.TORN),
    "another unit": ({"unit_id": 2}, Diagnosis.WRONG_BAY, Diagnosis.WRONG_BAY),
    "another gateway": ({"bay_identity": 1}, Diagnosis.WRONG_BAY, Diagnosis.WRONG_BAY),
    "old": ({"map_version": 3}, Diagnosis.OLD_MAP, Diagnosis.OLD_MAP),
    "foreign": ({"known_u32": 1}, Diagnosis.FOREIGN, Diagnosis.FOREIGN),
    "swapped float": ({"known_f32": 1}, Diagnosis.WORD_ORDER, Diagnosis.WORD_ORDER),
    "stop on": ({"stop": 1}, Diagnosis.CONTRADICTION, Diagnosis.OK),
    "stop off": ({"stop": 0}, Diagnosis.OK, Diagnosis.CONTRADICTION),
    "stop 2": ({"stop": 2}, Diagnosis.CONTRADICTION, Diagnosis.CONTRADICTION),
    "may_move on": ({"may_move": 1}, Diagnosis.OK, Diagnosis.CONTRADICTION),
    "may_move off": ({"may_move": 0}, Diagnosis.CONTRADICTION, Diagnosis.OK),
    "may_move 2": ({"may_move": 2}, Diagnosis.CONTRADICTION, Diagnosis.CONTRADICTION),
    "in_place on": ({"in_place": 1}, Diagnosis.CONTRADICTION, Diagnosis.OK),
    "in_place off": ({"in_place": 0}, Diagnosis.OK, Diagnosis.CONTRADICTION),
    "in_place 2": ({"in_place": 2}, Diagnosis.CONTRADICTION, Diagnosis.CONTRADICTION),
    "in_place with its bit": ({"in_place": 1, "position_status": 3}, Diagnosis.CONTRADICTION, Diagnosis.CONTRADICTION),
    "in_place on, may_move bit off": (
        {"in_place": 1, "position_status": 2}, Diagnosis.CONTRADICTION, Diagnosis.OK,
    ),
    "reason": ({"reason": 10}, Diagnosis.CONTRADICTION, Diagnosis.OK),
    "status empty": ({"status": 0}, Diagnosis.CONTRADICTION, Diagnosis.CONTRADICTION),
    "position_status empty": ({"position_status": 0}, Diagnosis.CONTRADICTION, Diagnosis.CONTRADICTION),
    "moved without its bit": ({"moved": 1}, Diagnosis.CONTRADICTION, Diagnosis.CONTRADICTION),
    "moved and in place": ({"moved": 1, "position_status": 10}, Diagnosis.CONTRADICTION, Diagnosis.CONTRADICTION),
    "green without may_move": (
        {"may_move": 0, "status": 0x70, "position_status": 0, "signal_lamps": 4}, Diagnosis.CONTRADICTION,
        Diagnosis.CONTRADICTION,
    ),
    "amber without may_move": (
        {"may_move": 0, "status": 0x70, "position_status": 0, "signal_lamps": 2}, Diagnosis.CONTRADICTION,
        Diagnosis.CONTRADICTION,
    ),
    "green in place": ({"signal_lamps": 4}, Diagnosis.OK, Diagnosis.CONTRADICTION),
    "held bit": ({"position_status": 5}, Diagnosis.CONTRADICTION, Diagnosis.CONTRADICTION),
    "D is 0": ({"d": 0}, Diagnosis.OK, Diagnosis.CONTRADICTION),
    "D is not known": ({"d": 0xFFFF}, Diagnosis.OK, Diagnosis.OK),
    "vision waiting": ({"vision_quality": 1}, Diagnosis.VISION, Diagnosis.CAMERA),
    "vision stale": ({"vision_quality": 2}, Diagnosis.VISION, Diagnosis.CAMERA),
    "no target": ({"vision_quality": 4}, Diagnosis.VISION, Diagnosis.OK),
    "coasted": ({"vision_quality": 12}, Diagnosis.VISION, Diagnosis.OK),
    "range": ({"range_quality": 6}, Diagnosis.RANGER, Diagnosis.RANGER),
}  # fmt: skip


@pytest.mark.parametrize(("changes", "moving", "placed"), DOUBTS.values(), ids=DOUBTS)
def test_each_doubt_has_its_diagnosis(
    scan: Scan, changes: dict[str, int], moving: Diagnosis, placed: Diagnosis
) -> None:
    for state, found in ((permitted(8), moving), (standing(8), placed)):
        scan.start()
        image = words(state)
        for name, word in changes.items():
            image[ADDRESS[name]] = word
        assert scan.run(image) is found


PLACE = standing().visit
# Whole images, every word of which fits the others but for the two facts that can't both be true.
CONTRADICTORY = {
    "in place without stop": standing(8, stop=False, reason=Reason.NONE),
    "in place, may move": standing(8, stop=False, may_move=True, reason=Reason.NONE),
    "in place, may move, stop": standing(8, may_move=True),
    "may move, in place": permitted(8, visit=PLACE),
    "in place though D is 0": standing(8, d=False),
    "in place though it moved": standing(8, visit=replace(PLACE, moved=Moved.MARKER)),
    "may move, stop": permitted(8, stop=True),
    "may move with a reason": permitted(8, reason=Reason.STARTING),
}


@pytest.mark.parametrize("state", CONTRADICTORY.values(), ids=CONTRADICTORY)
def test_a_whole_image_that_contradicts_itself_is_not_believed(scan: Scan, state: StateVector) -> None:
    scan.start()
    assert scan.run(words(state)) is Diagnosis.CONTRADICTION
    assert (scan.block["Alive"], scan.block["MustStop"]) == (False, True)


def test_node_red_finds_the_same_in_each_doubt() -> None:
    messages: list[tuple[int, object]] = []
    expected: list[str] = []
    for contradictory in CONTRADICTORY.values():
        messages += [(100, ""), *((100, words(permitted(n))) for n in (5, 6, 7)), (100, words(contradictory))]
        expected.append("contradiction")
    for changes, moving, placed in DOUBTS.values():
        for state, found in ((permitted, moving), (standing, placed)):
            image = words(state(8))
            for name, word in changes.items():
                image[ADDRESS[name]] = word
            messages += [(100, ""), *((100, words(state(n))) for n in (5, 6, 7)), (100, image)]
            expected.append("ok" if found is Diagnosis.OK else found.name.lower())
    ran = run_function(node_red_function.code(Target()), messages)[4::5]
    assert [{"may move": "ok", "in place": "ok"}.get(status, status) for _, status in ran] == expected
    live = {"ok", *(check.diagnosis.name.lower() for check in VALUES)}
    assert [outputs[2] is not None for outputs, _ in ran] == [name in live for name in expected]


def test_node_red_wants_the_heartbeat_anew_after_an_unsound_image() -> None:
    live = [words(permitted(n)) for n in (5, 6, 7)]
    half = torn(permitted(8), 1)
    ran = run_function(node_red_function.code(Target()), [(100, image) for image in [*live, half, *[live[0]] * 3]])
    assert [status for _, status in ran[2:]] == ["may move", "torn", "heartbeat", "heartbeat", "heartbeat"]


def test_every_diagnosis_has_its_check_and_no_check_counts_a_heartbeat_of_an_unsound_image() -> None:
    assert sorted(check.diagnosis for check in CHECKS) == [d for d in Diagnosis if d]
    assert Diagnosis.HEARTBEAT not in [check.diagnosis for check in SOUND]
    text = structured_text.declarations((Target(),))
    assert text.index("Sound := Diagnostic = 0;") < text.index("IF Sound THEN") < text.index("LastHeartbeat := Raw")


# ---- Which bay, and whose answer


def writable(heartbeat: int, echo: int) -> list[int]:
    """A truck in place, at a gateway with writes on, which has `echo` in plc_heartbeat."""
    return words(standing(heartbeat, plc=Handshake(PlcLink.ALIVE, heartbeat=echo & 0xFFFF)))


@pytest.mark.failure_mode("P11")
@pytest.mark.failure_mode("P12")
@pytest.mark.parametrize("other", [BayIdentity(2, BAY.number), BayIdentity(1, BAY.number + 1)], ids=["unit", "gateway"])
def test_another_bay_gives_no_output_and_gets_no_request(scan: Scan, other: BayIdentity) -> None:
    """A unit id or an address mixed up: that truck is in place, but not under this spout."""
    scan.block.values |= {"Release": True, "Recipe": 7}
    for n in range(20):
        state = standing(n, plc=Handshake(PlcLink.ALIVE))
        assert scan.run(encode(state, 0, "big", other)) is Diagnosis.WRONG_BAY
    written = [scan.block[name] for name in ("MayWrite", "PlcHeartbeat", "PlcControl", "RecipeSelect")]
    assert written == [False, 0, 0, 0]
    assert (scan.block["Alive"], scan.block["MustStop"], scan.block["Data"]["in_place"]) == (False, True, 0)


def test_a_program_that_was_not_told_its_bay_accepts_none(program: Program) -> None:
    scan = Scan(program.instance(FUNCTION_BLOCK))
    assert [scan.run(encode(standing(n), 0, "big")) for n in (5, 6, 7)] == [
        Diagnosis.HEARTBEAT, Diagnosis.HEARTBEAT, Diagnosis.OK,
    ]  # fmt: skip
    assert scan.run(words(standing(8))) is Diagnosis.WRONG_BAY


@pytest.mark.parametrize("writes", [True, False], ids=["writes on", "writes off"])
@pytest.mark.failure_mode("P14")
def test_two_recorded_images_in_turn_give_no_output(scan: Scan, writes: bool) -> None:
    images = [writable(n, 3) if writes else words(standing(n)) for n in (6, 7)]
    found = [scan.run(images[n % 2]) for n in range(600)]
    assert found.count(Diagnosis.OK) == 0


@pytest.mark.failure_mode("P14")
def test_a_recording_that_goes_on_gives_no_output_where_the_gateway_accepts_writes(scan: Scan) -> None:
    for n in range(300):
        assert scan.run(writable(n, 5000 + n)) in (Diagnosis.HEARTBEAT, Diagnosis.NO_ECHO)
    assert not scan.block["Alive"]


def test_outputs_need_two_answers_to_what_this_block_has_written(scan: Scan) -> None:
    """From the start on, over a restart of the gateway, and until nothing that was written arrives any more."""
    assert scan.run(writable(5, 0)) is Diagnosis.HEARTBEAT
    assert scan.block["MayWrite"], "it must write before it is answered"
    written = scan.block["PlcHeartbeat"]
    assert scan.run(writable(6, written)) is Diagnosis.HEARTBEAT
    assert scan.run(writable(7, written)) is Diagnosis.NO_ECHO, "the same one again is no second answer"
    assert scan.run(writable(8, scan.block["PlcHeartbeat"] + 1)) is Diagnosis.NO_ECHO, "it is not written yet"
    for n in range(40):
        late = scan.block["PlcHeartbeat"] - 5  # as many cycles lie between the write and the poll that returns it
        found = scan.run(writable(9 + n, late))
        assert (found is Diagnosis.OK) is (n >= 3), n
    answered = scan.now_ms - 30  # every sixth cycle
    last = scan.block["PlcHeartbeat"]
    while scan.run(writable(scan.now_ms, last - 5)) is Diagnosis.OK:
        assert scan.now_ms - answered <= HEARTBEAT_TIMEOUT_MS + 60
    assert scan.now_ms - answered > HEARTBEAT_TIMEOUT_MS - 60
    assert scan.block["MayWrite"], "and it goes on writing: that is the way back"
    for _ in range(3):
        found = scan.run(writable(scan.now_ms, scan.block["PlcHeartbeat"]))
    assert found is Diagnosis.OK


def test_the_answer_wraps_with_the_number(scan: Scan) -> None:
    scan.block.values |= {"PlcHeartbeat": 0xFFF0, "Challenge": 0xFFF0}
    found = [scan.run(writable(n, scan.block["PlcHeartbeat"])) for n in range(40)]
    assert found == [Diagnosis.HEARTBEAT] * 2 + [Diagnosis.OK] * 38


def test_a_program_that_only_reads_needs_no_answer(scan: Scan) -> None:
    scan.block.values["Writes"] = False
    assert [scan.run(writable(n, 77)) for n in (5, 6, 7)][-1] is Diagnosis.OK
    assert not scan.block["MayWrite"]


def test_the_plcs_own_heartbeat_beats_whatever_comes_and_wraps(scan: Scan) -> None:
    scan.run([0] * BLOCK_WORDS, ok=False, cycles=3)
    assert scan.block["PlcHeartbeat"] == 3
    scan.block.values["PlcHeartbeat"] = 0xFFFE
    assert [scan.run(words(permitted())) and scan.block["PlcHeartbeat"] for _ in range(3)] == [0xFFFF, 0, 1]


@pytest.mark.failure_mode("P4")
def test_swapped_words_are_called_so(scan: Scan) -> None:
    for heartbeat in (5, 6, 7):
        found = scan.run(encode(permitted(heartbeat), 0, "little", BAY))
    assert found is Diagnosis.WORD_ORDER


def test_the_export_for_the_other_word_order_differs_in_the_words_places_alone() -> None:
    """Compared as text: the parser is slow, and what the places mean is computed in the tests of the other formats."""
    big, little = (structured_text.declarations((Target(word_order=order),)) for order in ("big", "little"))
    for register in REGISTERS:
        first, last = register.address, register.address + register.words - 1
        if register.words == 2:
            assert f"Raw.{register.name} := LG_" in little
            big = big.replace(
                f"(High := Words[{first}], Low := Words[{last}])", f"(High := Words[{last}], Low := Words[{first}])"
            )
            big = big.replace(f"(Words[{first}] AND 16#7F80)", f"(Words[{last}] AND 16#7F80)")
        if register.words == 4:
            for half, high in (("high", last), ("low", first + 1)):
                line = f"Raw.{register.name}_{half} := LG_UDInt(High := Words[{high}], Low := Words[{high - 1}]);"
                assert line in little
                was = (
                    f"Raw.{register.name}_{half} := LG_UDInt(High := Words[{first if half == 'high' else first + 2}], "
                )
                start = big.index(was)
                big = big[:start] + line + big[big.index(";", start) + 1 :]
    assert big.replace('word order "big"', 'word order "little"') == little


def test_a_dead_gateway_and_a_doubtful_image_leave_no_good_looking_value(scan: Scan) -> None:
    scan.start()
    assert scan.run(encode(withdrawn(permitted(8), 6_000_000_000), 0, "big", BAY)) is Diagnosis.STOP
    assert scan.block["Reason"] == int(Reason.GATEWAY_FAULT)
    scan.run(words(permitted(9)))
    assert scan.run([0] * BLOCK_WORDS) is Diagnosis.FOREIGN
    data = scan.block["Data"]
    assert (scan.block["MustStop"], scan.block["Alive"], scan.block["Reason"]) == (True, False, 40)
    assert (data["stop"], data["may_move"], data["status_gateway_fault"]) == (1, 0, True)
    assert Quality.GOOD not in (data["vision_quality"], data["range_quality"])
    assert [name for name, value in data.items() if name.endswith("_valid") and value] == []
    reals = [data[field.register.name] for field in fields() if field.part == "valid"]
    assert min(value for value in reals if isinstance(value, float)) > 9e37, "0.0 would touch the sensor"


visits = st.builds(
    Visit,
    phase=st.sampled_from(VisitPhase),
    in_place=st.booleans(),
    moved=st.sampled_from(Moved),
    covered_since_ns=st.sampled_from([None, 0]),
    released=st.booleans(),
)
states = st.builds(
    StateVector,
    bay=st.just("b"),
    heartbeat=st.integers(0, 2**20),
    seq=st.integers(0, 2**20),
    d=st.sampled_from([None, False, True]),
    stop=st.booleans(),
    may_move=st.booleans(),
    reason=st.sampled_from(Reason),
    vision=st.builds(VisionReading, t_ns=st.just(0), quality=st.sampled_from(Quality)),
    range=st.builds(RangeReading, t_ns=st.just(0), quality=st.sampled_from(Quality)),
    visit=visits,
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(state=states)
def test_each_output_is_on_for_what_it_says_and_for_nothing_else(program: Program, state: StateVector) -> None:
    """Any state at all, also such as no gateway makes."""
    scan = Scan(block_of(program)).start()
    scan.run(words(state))
    one = not (state.may_move and state.in_place)
    good = state.range.quality is Quality.GOOD and one
    seen = state.vision.quality is Quality.GOOD
    covered = state.visit.released and state.vision.quality in FRESH_FRAME
    beyond = (
        (seen and state.d is False and state.range.quality in (Quality.NO_ECHO, Quality.TOO_FAR))
        and state.visit.phase in (VisitPhase.ARRIVING, VisitPhase.LEAVING)
        and one
    )
    moves = state.may_move and not state.stop and state.reason is Reason.NONE
    stands = state.in_place and state.stop and state.d is not False and state.visit.moved is Moved.NO
    assert scan.may_move is (moves and ((good and (seen or covered)) or beyond))
    assert scan.in_place is (good and stands and state.vision.quality in FRESH_FRAME)
    assert scan.block["MustStop"] is (state.stop or not scan.block["Alive"])


def test_noise_never_gives_an_output_and_never_stops_the_program(scan: Scan) -> None:
    """Every word at random, and every word at its edges; the program ends each cycle, without a number too large."""
    chance = random.Random(3)
    scan.start()
    for choices in (range(0x10000), (0, 1, 0x7F7F, 0x7F80, 0x8000, 0xFF7F, 0xFFFF)):
        for _ in range(40):
            assert scan.run(chance.choices(choices, k=BLOCK_WORDS)) is Diagnosis.FOREIGN


def test_node_red_gives_the_same_verdicts(scan: Scan) -> None:
    """400 images of a live bay with up to three words changed, 10 ms apart; silence is Node-RED's own affair."""
    scan.block.values["Writes"] = False  # as the flow before its first command
    images = doubtful(400)
    ran = run_function(node_red_function.code(Target()), [(10, image) for image in images])
    verdicts, mine, on, mine_on = [], [], [False, False], []
    for (outputs, status), image in zip(ran, images, strict=True):
        mine.append(scan.run(image).name.lower())
        mine_on.append([scan.may_move, scan.in_place])
        for place in (0, 1):
            on[place] = outputs[place]["payload"] if outputs[place] else on[place]
        verdicts.append(({"may move": "ok", "in place": "ok"}.get(status, status), list(on)))
    assert list(zip(mine, mine_on, strict=True)) == verdicts
    assert len(set(mine)) >= 10
    assert [True, False] in mine_on
    assert [False, True] in mine_on


def test_names_are_plain_distinct_and_no_keyword() -> None:
    names = [field.name.lower() for field in fields()]
    others = [var.name.lower() for var in (*INPUTS, *OUTPUTS)]
    for block in (APPROACH, SEQUENCE):
        others += [var.name.lower() for var in (*block.inputs, *block.outputs, *block.memory)]
    assert not set(RESERVED.split()) & set(others)
    assert "enable" not in others
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", name) for name in names)
    assert not set(RESERVED.split()) & set(names)
    assert max(map(len, names)) <= 40  # what Logix takes


def test_the_openplc_program_around_the_block_is_structured_text_too() -> None:
    """All but its CONFIGURATION, which TwinCAT and so this parser do not have."""
    text = openplc.files((Target(),))[openplc.PROGRAM]
    whole = text[text.index("PROGRAM loading_bay") : text.index("CONFIGURATION")]
    (made,) = parse(whole).items
    assert str(made.name) == "loading_bay"
    assert (
        len(made.body.statements) == BLOCK_WORDS + 14
    )  # the copies, the call, eight outputs, two codes, three to write


def test_the_program_of_several_bays_is_structured_text_too() -> None:
    targets = (Target(), Target(bay="bay-2", unit_id=2))
    text = structured_text.document(targets)
    made, example = parse(text[text.index("PROGRAM LoadingGateways") :]).items
    assert len(made.body.statements) == 2 * 4  # the call, three to write
    assert len(example.body.statements) == 4 + 2 + 4  # the same of one bay, two calls, four inputs


def test_the_text_is_plain_ascii_and_names_its_target() -> None:
    text = structured_text.document((Target(bay="bay-2", host="10.1.2.3", port=5020, unit_id=7),))
    assert text.isascii()
    assert "bay-2: 10.1.2.3, port 5020, unit id 7" in text
    assert max(len(line) for line in text.splitlines()) < 300
    assert "Enable " not in text.replace("Enabled ", "")
    assert not re.search(r"\bEnable\b", text)


# ---- What is asked of the gateway, and a triggered measurement


TRIGGER, ACK = 8, 16


def test_each_request_has_its_bit_and_the_recipe_its_register(scan: Scan) -> None:
    bits = {"EnableRequest": 1, "TruckPresent": 2, "Reset": 4, "SpoutUp": 64}
    for name, bit in bits.items():
        scan.block.values[name] = True
        scan.run(words(permitted()), ok=False)  # whether the gateway answers or not
        assert scan.block["PlcControl"] == bit
        scan.block.values[name] = False
    scan.block.values |= dict.fromkeys(bits, True) | {"Recipe": 7}
    scan.run(words(permitted()))
    assert (scan.block["PlcControl"], scan.block["RecipeSelect"]) == (71, 7)


def test_a_release_is_sent_from_its_own_edge_on_while_the_spout_is_up(scan: Scan) -> None:
    def sent(**inputs: bool) -> bool:
        scan.block.values |= inputs
        scan.run(words(permitted()), ok=False)
        return bool(scan.block["PlcControl"] & 32)

    assert not sent(Release=True, SpoutUp=True), "on since before the start"
    assert not sent(Release=False)
    assert sent(Release=True)
    assert sent()
    assert not sent(SpoutUp=False)
    assert not sent(SpoutUp=True), "a spout that goes up releases no truck"
    assert not sent(Release=False, SpoutUp=False)
    assert not sent(Release=True)
    assert not sent(SpoutUp=True)


def test_loading_is_permitted_from_a_start_in_place_until_the_first_loss(scan: Scan) -> None:
    heartbeat = 7

    def permit(state: Callable[..., StateVector] = standing, *, start: bool, ok: bool = True, **more: Any) -> bool:
        nonlocal heartbeat
        heartbeat += 1
        scan.block.values["Start"] = start
        scan.run(words(state(heartbeat, **more)), ok=ok)
        return bool(scan.block["LoadPermit"])

    scan.block.values["Start"] = True
    scan.start()
    assert not permit(permitted, start=True)
    assert not permit(start=True), "a start from before"
    assert not permit(start=False)
    assert permit(start=True)
    assert permit(start=False)
    assert permit(start=False, covered=True)
    rolling = replace(standing().visit, reference=ReferencePosition(rolling_since_ns=0))
    assert not permit(start=False, visit=rolling)
    assert (scan.in_place, scan.block["Rolling"], scan.block["Moved"]) == (True, True, False)
    assert not permit(start=False), "it does not go on by itself"
    assert permit(start=True)
    for ok in (False, True, True, True, True):
        assert not permit(start=True, ok=ok)
    assert scan.in_place
    assert not permit(start=False)
    assert permit(start=True)
    assert not permit(permitted, start=True)


class Measurement:
    """The function block opposite to a gateway that is told, image by image, how its handshake stands."""

    def __init__(self, scan: Scan, phase: TriggerPhase = TriggerPhase.READY) -> None:
        self.scan, self.heartbeat = scan, 0
        for _ in range(3):
            self.see(phase)

    def see(self, phase: TriggerPhase = TriggerPhase.READY, **how: object) -> tuple[int, bool, bool, bool]:
        """(bits 3 and 4 of PlcControl, Measuring, ResultReady, TriggerFailed) after that image."""
        self.heartbeat += 1
        echo = self.scan.block["PlcHeartbeat"]  # written in the cycle before
        self.scan.run(answered(self.heartbeat, phase, echo=echo, **how))  # type: ignore[arg-type]
        block = self.scan.block
        return block["PlcControl"] & 24, block["Measuring"], block["ResultReady"], block["TriggerFailed"]

    def put(self, **inputs: bool) -> None:
        self.scan.block.values |= inputs


def test_a_trigger_is_asked_taken_read_and_acknowledged(scan: Scan) -> None:
    plc = Measurement(scan)
    assert scan.block["TriggerReady"]
    plc.put(Trigger=True)
    assert plc.see() == (TRIGGER, True, False, False)
    assert plc.see(control=TRIGGER) == (TRIGGER, True, False, False)  # until it is acknowledged
    assert plc.see(TriggerPhase.ACQUIRING, number=1, ack=True, control=TRIGGER) == (0, True, False, False)
    assert plc.see(TriggerPhase.ACQUIRING, number=1) == (0, True, False, False)
    assert plc.see(TriggerPhase.VALID, number=1) == (0, False, True, False)
    assert scan.block["Data"]["result_distance"] == 281
    assert plc.see(TriggerPhase.VALID, number=1) == (0, False, True, False)  # held until it is acknowledged
    plc.put(Acknowledge=True)
    assert plc.see(TriggerPhase.VALID, number=1) == (ACK, False, False, False)
    assert plc.see(TriggerPhase.CLEARING, number=1, control=ACK) == (0, False, False, False)
    assert not scan.block["TriggerReady"]
    assert plc.see(number=1) == (0, False, False, False)  # Trigger still stands: no new edge
    plc.put(Trigger=False)
    plc.see(number=1)
    plc.put(Trigger=True)
    assert plc.see(number=1) == (TRIGGER, True, False, False)


def test_the_trigger_waits_until_the_gateway_was_seen_to_have_its_bit_off(scan: Scan) -> None:
    plc = Measurement(scan)
    plc.put(Trigger=True)
    assert plc.see(control=TRIGGER)[0] == 0
    assert plc.see(TriggerPhase.CLEARING)[0] == 0
    assert plc.see()[0] == TRIGGER


def test_a_measurement_without_a_result_fails_and_the_next_one_goes(scan: Scan) -> None:
    plc = Measurement(scan)
    plc.put(Trigger=True)
    plc.see()
    plc.see(TriggerPhase.ACQUIRING, number=1, ack=True, control=TRIGGER)
    assert plc.see(number=1, timed_out=True) == (0, False, False, True)
    plc.put(Trigger=False)
    assert plc.see(number=1, timed_out=True)[3] is True
    plc.put(Trigger=True)
    assert plc.see(number=1, timed_out=True) == (TRIGGER, True, False, False)


def test_a_result_that_is_held_from_before_the_start_is_acknowledged(scan: Scan) -> None:
    """Else no trigger would be accepted for ever: the gateway waits for results_ack, and this block for nothing."""
    scan.run([0] * BLOCK_WORDS, ok=False)
    plc = Measurement(scan, TriggerPhase.VALID)
    assert plc.see(TriggerPhase.VALID, number=1) == (ACK, False, False, False)
    assert plc.see(TriggerPhase.VALID, number=1) == (ACK, False, False, False)  # until it is seen
    # The bit was on when the gateway began: no edge, so that it must go off first.
    assert plc.see(TriggerPhase.VALID, number=1, control=ACK)[0] == 0
    assert plc.see(TriggerPhase.VALID, number=1)[0] == ACK
    plc.put(Trigger=True)
    assert plc.see(TriggerPhase.VALID, number=1)[:2] == (ACK, True), "also where a trigger waits for it"
    assert plc.see(TriggerPhase.CLEARING, number=1, control=ACK)[0] == 0
    assert plc.see(number=1) == (TRIGGER, True, False, False)
    assert plc.see(TriggerPhase.VALID, number=2, ack=True, control=TRIGGER) == (0, True, False, False)
    assert plc.see(TriggerPhase.VALID, number=2) == (0, False, True, False), "its own result is held"


@pytest.mark.parametrize("writes_off", mostly_long([False, True]))
def test_a_gateway_that_does_not_take_the_trigger_fails_it_in_time(scan: Scan, writes_off: bool) -> None:
    plc = Measurement(scan)
    plc.put(Trigger=True)
    for n in range(Target().step_timeout_ms // 10 + 2):
        image = (
            words(permitted(100 + n))
            if writes_off
            else answered(100 + n, control=TRIGGER * (n > 0), echo=scan.block["PlcHeartbeat"])
        )
        scan.run(image)
    assert (scan.block["TriggerFailed"], scan.block["Measuring"], scan.block["PlcControl"]) == (True, False, 0)


def test_a_result_that_is_gone_is_not_ready(scan: Scan) -> None:
    """The gateway was restarted, or has lost the PLC for a while."""
    plc = Measurement(scan)
    plc.put(Trigger=True)
    plc.see()
    plc.see(TriggerPhase.ACQUIRING, number=1, ack=True)
    assert plc.see(TriggerPhase.VALID, number=1)[2] is True
    scan.run(answered(99, TriggerPhase.VALID, number=1), ok=False)
    assert not scan.block["ResultReady"]
    for _ in range(3):
        plc.see(TriggerPhase.VALID, number=1)
    assert scan.block["ResultReady"]
    assert plc.see() == (0, False, False, True)
