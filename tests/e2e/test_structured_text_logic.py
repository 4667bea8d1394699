"""The structured text opens in blark's parser, and its logic does what it says; no compiler stands behind this.

Here and not among the unit tests, which run on every interpreter: the parser takes seconds, once for all these tests.
"""

import random
import re
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.modbus.exports import node_red, openplc, structured_text
from gateway.modbus.exports.diagnosis import CHECKS, HEARTBEAT_TIMEOUT_MS, Diagnosis
from gateway.modbus.exports.fields import fields
from gateway.modbus.exports.target import Target
from gateway.modbus.registers import BLOCK_WORDS, REGISTERS, dead_image, decode, encode
from gateway.model import Circle, Quality, RangeReading, Reason, StateVector, VisionReading
from tests.node_function import run_function
from tests.permitted import permitted
from tests.structured_text import Instance, Program, RefusedError, parse

pytestmark = pytest.mark.xdist_group("structured text")  # building the parser takes seconds

pytestmark = pytest.mark.timeout(300)  # the parser takes its time on a busy machine

ADDRESS = {register.name: register.address for register in REGISTERS}
# Elementary types, keywords and standard functions of IEC 61131-3, SCL and Logix that a field must not be called.
RESERVED = """
action and array at begin bool by byte case configuration constant continue date dint do dt dword else elsif end exit
false for from function goto if in int jmp label ld le len limit lint lreal lt lword max min mod mux ne not of on or out
program read real repeat resource ret return sel set shl shr sin sint sqrt st step string struct task then time to tod
transition true type udint uint ulint until usint var while with word xor ton tof tp rs sr
"""


@pytest.fixture(scope="module")
def program() -> Program:
    return Program(structured_text.text(Target()))


def words(state: StateVector) -> list[int]:
    return list(encode(state, 1_763_640_000_123_456_789, "big"))


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
        assert self.block["Enable"] is (found is Diagnosis.ENABLED)
        return found

    def start(self) -> "Scan":
        """Polls a live gateway until it is enabled."""
        assert self.run(words(permitted(6))) is Diagnosis.HEARTBEAT
        assert self.run(words(permitted(7))) is Diagnosis.ENABLED
        return self


@pytest.fixture
def scan(program: Program) -> Scan:
    return Scan(program.instance(structured_text.FUNCTION_BLOCK))


def test_every_register_is_decoded_as_the_gateway_encodes_it(scan: Scan) -> None:
    scan.start()
    data, image = scan.block["Data"], words(permitted(7))
    for name, value in decode(image).items():
        if f"{name}_high" in data:
            assert data[f"{name}_high"] << 32 | data[f"{name}_low"] == value
            continue
        if f"{name}_valid" in data:
            assert data[f"{name}_valid"] is (value is not None), name
        assert data[name] == pytest.approx(0 if value is None else value, rel=2e-7), name
    assert data["u_f32"] == pytest.approx(640.28, rel=1e-7)
    assert data["v"] == pytest.approx(-3.2)
    assert data["distance"] == 812
    assert (data["status_may_move"], data["status_stop"], data["status_healthy"]) == (True, False, True)
    assert set(data) == {field.name for field in fields()}


@pytest.mark.parametrize("value", [1.0, -1.0, 123456.0, 0.0, 1e-30, 3.4e38, -299.625, 1.17549435e-38, 16777216.0])
def test_a_float_survives_the_arithmetic_exactly(scan: Scan, value: float) -> None:
    state = permitted(6, vision=VisionReading(0, Quality.GOOD, Circle(value, 0.0, 1.0)))
    expected = decode(words(state))["u_f32"]
    scan.run(words(state))
    scan.run(words(replace(state, heartbeat=7)))
    assert scan.block["Data"]["u_f32"] == expected


def test_enable_follows_permit(scan: Scan) -> None:
    scan.start()
    on_mark = permitted(8, d=True, stop=True, may_move=False, reason=Reason.TARGET_REACHED)
    assert scan.run(words(on_mark)) is Diagnosis.STOP
    assert (scan.block["MustStop"], scan.block["Alive"]) == (True, True)
    assert scan.block["Reason"] == int(Reason.TARGET_REACHED)
    assert scan.run(words(permitted(9))) is Diagnosis.ENABLED
    assert (scan.block["MustStop"], scan.block["Reason"]) == (False, 0)
    assert scan.run(words(permitted(10, may_move=False))) is Diagnosis.NO_PERMIT


def test_nothing_is_enabled_before_the_heartbeat_was_seen_to_move(scan: Scan) -> None:
    assert scan.block["MustStop"] is True
    assert scan.block["Enable"] is False
    assert scan.run(words(permitted()), cycles=30) is Diagnosis.HEARTBEAT


def test_a_heartbeat_that_stands_still_takes_the_enable_away_within_its_time(scan: Scan) -> None:
    scan.start()
    image = words(permitted(7))
    assert scan.run(image, cycles=HEARTBEAT_TIMEOUT_MS // 10 - 1) is Diagnosis.ENABLED
    assert scan.run(image, cycles=2) is Diagnosis.HEARTBEAT
    assert scan.block["MustStop"] is True
    assert scan.run(words(permitted(8))) is Diagnosis.ENABLED


def test_a_heartbeat_wraps(scan: Scan) -> None:
    scan.run(words(permitted(0xFFFF)))
    assert scan.run(words(permitted(0x10000))) is Diagnosis.ENABLED


def test_a_failed_poll_takes_the_enable_away_at_once_and_two_good_ones_give_it_back(scan: Scan) -> None:
    scan.start()
    assert scan.run(words(permitted(7)), ok=False, cycles=60) is Diagnosis.POLL_FAILED
    assert scan.run(words(permitted(99))) is Diagnosis.HEARTBEAT  # it differs, but was not seen to move
    assert scan.run(words(permitted(100))) is Diagnosis.ENABLED


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"seq_end": 3}, Diagnosis.TORN),
        ({"map_version": 0}, Diagnosis.OLD_MAP),
        ({"known_u32": 1}, Diagnosis.FOREIGN),
        ({"known_f32": 1}, Diagnosis.WORD_ORDER),
        ({"stop": 1}, Diagnosis.CONTRADICTION),
        ({"stop": 2}, Diagnosis.CONTRADICTION),
        ({"may_move": 2}, Diagnosis.CONTRADICTION),
        ({"may_move": 0}, Diagnosis.CONTRADICTION),
        ({"reason": 10}, Diagnosis.CONTRADICTION),
        ({"status": 0}, Diagnosis.CONTRADICTION),
        ({"vision_quality": 1}, Diagnosis.VISION),
        ({"range_quality": 1}, Diagnosis.RANGER),
    ],
)
def test_each_doubt_has_its_diagnosis(scan: Scan, changes: dict[str, int], found: Diagnosis) -> None:
    scan.start()
    image = words(permitted(8))
    for name, word in changes.items():
        image[ADDRESS[name]] = word
    assert scan.run(image) is found


def test_the_checks_stand_in_the_order_of_their_numbers() -> None:
    assert [check.diagnosis for check in CHECKS] == [d for d in Diagnosis if d]


def test_the_plcs_own_heartbeat_beats_whatever_comes_and_wraps(scan: Scan) -> None:
    scan.run([0] * BLOCK_WORDS, ok=False, cycles=3)
    assert scan.block["PlcHeartbeat"] == 3
    scan.block.values["PlcHeartbeat"] = 0xFFFE
    assert [scan.run(words(permitted())) and scan.block["PlcHeartbeat"] for _ in range(3)] == [0xFFFF, 0, 1]


def test_swapped_words_are_called_so(scan: Scan) -> None:
    for heartbeat in (6, 7):
        found = scan.run(encode(permitted(heartbeat), 0, "little"))
    assert found is Diagnosis.WORD_ORDER


def test_the_export_for_the_other_word_order_differs_in_the_words_places_alone() -> None:
    """Compared as text: the parser is slow, and what the places mean is computed in the tests of the other formats."""
    big, little = (structured_text.text(Target(word_order=order)) for order in ("big", "little"))
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
    assert scan.run(dead_image(permitted(8), 6_000_000_000, 0, "big")) is Diagnosis.STOP
    assert scan.block["Reason"] == int(Reason.GATEWAY_FAULT)
    scan.run(words(permitted(9)))
    assert scan.run([0] * BLOCK_WORDS) is Diagnosis.FOREIGN
    data = scan.block["Data"]
    assert (scan.block["MustStop"], scan.block["Alive"], scan.block["Reason"]) == (True, False, 40)
    assert (data["stop"], data["may_move"], data["status_gateway_fault"]) == (1, 0, True)
    assert Quality.GOOD not in (data["vision_quality"], data["range_quality"])
    assert [name for name, value in data.items() if name.endswith("_valid") and value] == []


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
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(state=states)
def test_no_state_but_a_whole_permit_enables(program: Program, state: StateVector) -> None:
    scan = Scan(program.instance(structured_text.FUNCTION_BLOCK)).start()
    found = scan.run(words(state))
    whole = (
        state.may_move
        and not state.stop
        and state.reason is Reason.NONE
        and state.vision.quality is Quality.GOOD
        and state.range.quality is Quality.GOOD
    )
    assert (found is Diagnosis.ENABLED) is whole
    assert scan.block["MustStop"] is (state.stop or not scan.block["Alive"])


def test_noise_never_enables_and_never_stops_the_program(scan: Scan) -> None:
    """Every word at random, and every word at its edges; the program ends each cycle, without a number too large."""
    chance = random.Random(3)
    scan.start()
    for choices in (range(0x10000), (0, 1, 0x7F7F, 0x7F80, 0x8000, 0xFF7F, 0xFFFF)):
        for _ in range(40):
            assert scan.run(chance.choices(choices, k=BLOCK_WORDS)) is Diagnosis.FOREIGN


def test_node_red_gives_the_same_verdicts(scan: Scan) -> None:
    """300 images of a live bay with up to three words changed, 10 ms apart; silence is Node-RED's own affair."""
    chance = random.Random(61131)
    watched = ["seq_begin", "map_version", "heartbeat", "status", "stop", "may_move", "reason", "vision_quality"]
    addresses = [ADDRESS[name] for name in (*watched, "range_quality", "known_u32", "known_f32", "seq_end")]
    images = [words(permitted(6)), words(permitted(7))]
    for n in range(300):
        image = words(permitted(8 + n // 3))
        for _ in range(chance.choice((0, 0, 1, 1, 2, 3))):
            image[chance.choice(addresses)] = chance.choice((0, 1, 2, 10, 0x1234, 0x5678, 0xFFFF))
        images.append(image)
    verdicts = [status for _, status in run_function(node_red.code(Target()), [(10, image) for image in images])]
    mine = [scan.run(image).name.lower() for image in images]
    assert mine == verdicts
    assert len(set(mine)) >= 9


def test_names_are_plain_distinct_and_no_keyword() -> None:
    names = [field.name.lower() for field in fields()]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", name) for name in names)
    assert not set(RESERVED.split()) & set(names)
    assert max(map(len, names)) <= 40  # what Logix takes


def test_the_openplc_program_around_the_block_is_structured_text_too() -> None:
    """All but its CONFIGURATION, which TwinCAT and so this parser do not have."""
    text = openplc.files(Target())[openplc.PROGRAM]
    whole = text[text.index("PROGRAM loading_bay") : text.index("CONFIGURATION")]
    (made,) = parse(whole).items
    assert str(made.name) == "loading_bay"
    assert len(made.body.statements) == BLOCK_WORDS + 6  # the copies, the call, five outputs


def test_the_text_is_plain_ascii_and_names_its_target() -> None:
    text = structured_text.text(Target(bay="bay-2", host="10.1.2.3", port=5020, unit_id=7))
    assert text.isascii()
    assert "10.1.2.3, port 5020, unit id 7" in text
    assert max(len(line) for line in text.splitlines()) < 300


@pytest.mark.parametrize(
    "line",
    ["Enable := 1;", "Reason := Words[0];", "Reason := 70000;", "Enable := Words[100] = 0;", "Enable := Nowhere;",
     "Reason := WORD_TO_UINT(Words[0]) + LG_UDInt(High := Words[0], Low := Words[1]);", "Enable := Seen = Beating;"],
)  # fmt: skip
def test_the_runner_of_these_tests_refuses_what_the_standard_refuses(line: str) -> None:
    source = f"""TYPE LG_Block : ARRAY [0..99] OF WORD; END_TYPE
FUNCTION LG_UDInt : UDINT VAR_INPUT High : WORD; Low : WORD; END_VAR LG_UDInt := 0; END_FUNCTION
FUNCTION_BLOCK F
VAR_INPUT Words : LG_Block; END_VAR
VAR Enable : BOOL; Reason : UINT; Seen : BOOL; Beating : BOOL; END_VAR
{line}
END_FUNCTION_BLOCK"""
    with pytest.raises(RefusedError):
        Program(source).instance("F").call(0)
