"""Every export is opened as its reader would open it, and agrees with the image of the gateway."""

import argparse
import csv
import io
import json
import re
import struct
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest

from gateway.cli import registers as verb
from gateway.errors import ConfigError
from gateway.modbus.exports import (
    kepware,
    l5x,
    logic,
    logix,
    node_red,
    openplc,
    reference,
    scl,
    structured_text,
)
from gateway.modbus.exports.diagnosis import HEARTBEAT_TIMEOUT_MS, Diagnosis
from gateway.modbus.exports.fields import fields
from gateway.modbus.exports.formats import FORMATS
from gateway.modbus.exports.names import SUMMARY
from gateway.modbus.exports.target import Target
from gateway.modbus.registers import BLOCK_WORDS, REGISTERS, decode, encode
from gateway.model import Reason
from tests.node_function import run_function
from tests.permitted import permitted

TARGET = Target(bay="bay-2", host="10.1.2.3", port=5020, unit_id=7)
LITTLE = Target(word_order="little")
BY_NAME = {register.name: register for register in REGISTERS}


def image(heartbeat: int = 7, order: Any = "big") -> list[int]:
    return list(encode(permitted(heartbeat), 1_763_640_000_123_456_789, order))


def unpack(words: list[int], letter: str) -> Any:
    return struct.unpack(f">{letter}", struct.pack(f">{len(words)}H", *words))[0]


# ---- Ignition


def ignition_tags(target: Target) -> list[dict[str, Any]]:
    (text,) = FORMATS["ignition"](target).values()
    whole = json.loads(text)
    assert whole["tagType"] == "Provider"
    (folder,) = whole["tags"]
    assert (folder["name"], folder["tagType"]) == (target.bay, "Folder")
    return list(folder["tags"])


def test_ignition_reads_the_image_through_its_own_addresses() -> None:
    """Each opcItemPath is followed by Ignition's rules: one-based, designator says the type, big words."""
    letters = {"HRUS": ("H", 1), "HR": ("h", 1), "HRUI": ("I", 2), "HRUI_64": ("Q", 4), "HRF": ("f", 2)}
    words, read, bits = image(), {}, {}
    for tag in ignition_tags(TARGET):
        for leaf in tag.get("tags", [tag]):
            assert leaf["valueSource"] == "opc"
            found = re.fullmatch(r"ns=1;s=\[bay-2\]7\.(HRUI_64|HRUI|HRUS|HRF|HR)(\d+)(?:\.(\d+))?", leaf["opcItemPath"])
            assert found, leaf
            designator, address, bit = found[1], int(found[2]) - 1, found[3]
            if bit is not None:
                assert (designator, leaf["dataType"]) == ("HR", "Boolean")
                bits[leaf["name"]] = bool(words[address] >> int(bit) & 1)
                continue
            letter, size = letters[designator]
            value = unpack(words[address : address + size], letter)
            if leaf.get("scaleMode") == "Linear":
                share = (value - leaf["rawLow"]) / (leaf["rawHigh"] - leaf["rawLow"])
                value = leaf["scaledLow"] + share * (leaf["scaledHigh"] - leaf["scaledLow"])
            read[leaf["name"]] = value
            assert leaf.get("engUnit", "") == BY_NAME[leaf["name"]].unit
            assert leaf.get("readOnly", False) is not BY_NAME[leaf["name"]].writable
    expected = decode(words)
    assert set(read) == set(expected)
    for name, value in expected.items():
        if value is not None:
            assert read[name] == pytest.approx(value, abs=1e-3), name
    assert (bits["may_move"], bits["stop"], bits["healthy"]) == (True, False, True)


def test_ignition_documents_codes() -> None:
    (reason,) = (tag for tag in ignition_tags(Target()) if tag["name"] == "reason")
    assert "\n1 target_reached: " in reason["documentation"]


# ---- Kepware


def test_kepware_reads_the_image_through_its_own_addresses() -> None:
    text = kepware.text(TARGET)
    assert text.endswith("\r\n")
    assert text.count("\r\n") == text.count("\n")
    rows = list(csv.DictReader(io.StringIO(text, newline="")))
    assert tuple(rows[0]) == kepware.COLUMNS
    letters = {"Word": ("H", 1), "Short": ("h", 1), "DWord": ("I", 2), "Float": ("f", 2)}
    words, read = image(), {}
    for row in rows:
        found = re.fullmatch(r"4(\d{5})(?:\.(\d+))?", row["Address"])
        assert found, row
        address = int(found[1]) - 1
        if found[2] is not None:
            assert row["Data Type"] == "Boolean"
            read[row["Tag Name"]] = bool(words[address] >> int(found[2]) & 1)
            continue
        letter, size = letters[row["Data Type"]]
        value = unpack(words[address : address + size], letter)
        if row["Scaling"] == "Linear":
            low, high = float(row["Raw Low"]), float(row["Raw High"])
            scaled_low, scaled_high = float(row["Scaled Low"]), float(row["Scaled High"])
            value = scaled_low + (value - low) / (high - low) * (scaled_high - scaled_low)
        read[row["Tag Name"]] = value
        assert len(row["Description"]) <= 255
    assert len(read) == len(rows)
    writable = {row["Tag Name"] for row in rows if row["Client Access"] == "R/W"}
    assert writable == {register.name for register in REGISTERS if register.writable}
    assert {row["Client Access"] for row in rows} == {"RO", "R/W"}
    for name, expected in decode(words).items():
        if BY_NAME[name].words == 4:
            assert read[f"{name}_high"] << 32 | read[f"{name}_low"] == expected
        elif expected is not None:
            assert read[name] == pytest.approx(expected, abs=1e-3), name
    assert (read["status_may_move"], read["status_stop"]) == (True, False)


# ---- Siemens


def test_scl_is_the_structured_text_that_was_parsed_and_run() -> None:
    """Nothing here parses SCL. Its bodies are the ones of structured text, letter for letter, but for # and quotes."""
    siemens = scl.text(TARGET)
    iec = structured_text.text(TARGET)
    bodies = re.findall(r"^BEGIN\n(.*?)^END_FUNCTION(?:_BLOCK)?$", siemens, re.MULTILINE | re.DOTALL)
    assert len(bodies) == 3
    for body in bodies:
        assert logic.iec(body) in iec
    locals_declared = set(re.findall(r"^    (\w+)(?: \{.*?\})? : ", siemens, re.MULTILINE))
    used = set(re.findall(r"(?<!\w)#(\w+)", "".join(bodies)))
    assert used - {"LG_UDInt", "LG_Real"} <= locals_declared
    # every local is marked: no name of the interface stands without # outside of comments and formal parameters
    code = re.sub(r"\(\*.*?\*\)", "", bodies[2], flags=re.DOTALL)
    assert re.findall(r"(?<![\w#.\"])(?:Raw|Data|Words|Enable|Diagnostic|PollOk|Beating|Seen)\b", code) == []


def test_scl_declares_every_field_and_tells_how_to_poll() -> None:
    siemens = scl.text(TARGET)
    assert siemens.isascii()
    declared = re.search(r'^TYPE "LoadingGateway_Data".*?^END_TYPE', siemens, re.MULTILINE | re.DOTALL)
    assert declared
    members = re.findall(r"^    (\w+) : (\w+);", declared[0], re.MULTILINE)
    assert [(name, kind.upper()) for name, kind in members] == [(field.name, field.kind) for field in fields()]
    for line in ("MB_MODE := 103", "MB_DATA_LEN := 100", "MB_Unit_ID := 7 ", "RemotePort := 5020;"):
        assert line in siemens
    assert [f"ADDR[{n}] := {octet};" in siemens for n, octet in enumerate((10, 1, 2, 3), 1)] == [True] * 4


# ---- Rockwell


def l5x_root(target: Target) -> ET.Element:
    return ET.fromstring(l5x.text(target))


def test_l5x_has_the_shape_that_studio_5000_imports() -> None:
    root = l5x_root(TARGET)
    assert (root.tag, root.get("TargetType")) == ("RSLogix5000Content", "AddOnInstructionDefinition")
    instruction = root.find("Controller/AddOnInstructionDefinitions/AddOnInstructionDefinition")
    assert instruction is not None
    assert instruction.get("Name") == root.get("TargetName")
    assert [child.tag for child in instruction] == [
        *("Description", "AdditionalHelpText", "Parameters", "LocalTags", "Routines", "Dependencies")
    ]
    parameters = {p.get("Name"): p for p in instruction.iterfind("Parameters/Parameter")}
    assert list(parameters)[:2] == ["EnableIn", "EnableOut"]
    assert parameters["Words"].get("Dimensions") == "100"
    assert {name for name, p in parameters.items() if p.get("Usage") == "InOut"} == {"Words", "Data"}
    routines = [r.get("Name") for r in instruction.iterfind("Routines/Routine")]
    assert routines == ["EnableInFalse", "Logic", "Prescan"]
    lines = [int(line.get("Number", "-1")) for line in instruction.iterfind("Routines/Routine[2]/STContent/Line")]
    assert lines == list(range(len(logix.body(TARGET).splitlines())))
    start = parameters["MustStop"].find("DefaultData/DataValue")
    assert start is not None
    assert start.get("Value") == "1"


def test_l5x_flags_have_each_a_bit_of_their_own_in_a_hidden_member() -> None:
    members = list(l5x_root(TARGET).iterfind("Controller/DataTypes/DataType/Members/Member"))
    hidden = [m.get("Name") for m in members if m.get("Hidden") == "true"]
    assert len(set(hidden)) == len(hidden)
    assert max(len(str(m.get("Name"))) for m in members) <= 40
    bits = [(m.get("Target"), m.get("BitNumber")) for m in members if m.get("DataType") == "BIT"]
    assert len(set(bits)) == len(bits) == sum(field.kind == "BOOL" for field in fields())
    assert {target for target, _ in bits} == set(hidden)
    assert {m.get("Name") for m in members if m.get("Hidden") == "false"} == {field.name for field in fields()}


@pytest.mark.parametrize("target", [Target(), LITTLE], ids=["big", "little"])
def test_logix_decodes_the_image(target: Target) -> None:
    """The routine's decoding lines, done here as Logix would: signed INTs, masks, COP bit by bit."""
    words = [w - 0x10000 if w > 0x7FFF else w for w in image(order=target.word_order)]
    raw: dict[str, Any] = {}
    pair = [0, 0]
    source = logix.body(target)
    for line in source[: source.index("// A heartbeat")].splitlines():
        if found := re.fullmatch(r"Raw\.(\w+) := (.+);", line):
            expression = found[2].replace("AND", "&").replace("<>", "!=")
            raw[found[1]] = eval(expression, {"Words": words})  # our own arithmetic
        elif found := re.fullmatch(r"Pair\[(\d)\] := Words\[(\d+)\];", line):
            pair[int(found[1])] = words[int(found[2])]
        elif found := re.fullmatch(r"COP\(Pair\[0\], Raw\.(\w+), 1\);", line):
            raw[found[1]] = struct.unpack("<f", struct.pack("<2h", *pair))[0]
        else:
            assert re.fullmatch(r"//.*|IF NOT Raw\.\w+ THEN|  Raw\.\w+ := 0;|END_IF;|", line), line
    assert set(raw) == {field.name for field in fields()}
    for name, value in decode(image()).items():
        if BY_NAME[name].words == 4:
            assert (raw[f"{name}_high"] & 0xFFFF_FFFF) << 32 | raw[f"{name}_low"] & 0xFFFF_FFFF == value
            continue
        assert raw.get(f"{name}_valid", True) is (value is not None), name
        if value is not None:
            assert raw[name] == pytest.approx(value, abs=1e-3), name
    assert (raw["status_may_move"], raw["status_stop"]) == (True, False)


def test_logix_checks_what_structured_text_checks() -> None:
    body = logix.body(Target())
    assert logic.iec(logic.checks()) in body
    assert logic.iec(logic.checks()) in structured_text.text(Target())
    code = re.sub(r"\(\*.*?\*\)|//[^\n]*", "", body, flags=re.DOTALL)
    assert not re.search(r"\b(TRUE|FALSE)\b|#", code)  # Logix knows neither


# ---- OpenPLC


def test_openplc_asks_for_the_block_and_puts_each_word_in_its_place() -> None:
    files = FORMATS["openplc"](TARGET)
    assert set(files) == {openplc.PROGRAM, openplc.DEVICES}
    lines = [line for line in files[openplc.DEVICES].splitlines() if not line.startswith("#")]
    entries = {found[1]: found[2] for line in lines if (found := re.fullmatch(r'(\S+) = "(.*)"', line))}
    assert len(entries) == len(lines)
    assert entries["Num_Devices"] == "1"
    assert (entries["device0.address"], entries["device0.IP_Port"]) == ("10.1.2.3", "5020")
    assert (entries["device0.slave_id"], entries["device0.protocol"]) == ("7", "TCP")
    assert entries["device0.Holding_Registers_Read_Start"] == "0"
    assert entries["device0.Holding_Registers_Read_Size"] == str(BLOCK_WORDS)
    sizes = {key: value for key, value in entries.items() if key.endswith("_Size") and "Read" not in key}
    assert set(sizes.values()) == {"0"}  # else the holding registers would not begin at %IW100
    program = files[openplc.PROGRAM]
    inputs = dict(re.findall(r"^  (w\d+) AT %IW(\d+) : WORD;", program, re.MULTILINE))
    copies = re.findall(r"^Words\[(\d+)\] := (w\d+);", program, re.MULTILINE)
    assert [int(place) for place, _ in copies] == list(range(BLOCK_WORDS))
    assert [int(inputs[name]) - 100 for _, name in copies] == list(range(BLOCK_WORDS))
    assert program.startswith(structured_text.text(TARGET))


# ---- Node-RED


def function_node(messages: list[tuple[int, Any]], target: Target = TARGET) -> list[Any]:
    """Runs the flow's function node: [(ms later, words | "tick" | "")] -> [[outputs, status]]."""
    (judge,) = (node for node in json.loads(node_red.text(target)) if node["type"] == "function")
    return run_function(judge["func"], messages)


def test_node_red_nodes_are_wired_to_each_other_and_to_the_bay() -> None:
    flow = json.loads(node_red.text(TARGET))
    ids = [node["id"] for node in flow]
    assert len(set(ids)) == len(ids)
    for node in flow:
        assert {target for wire in node.get("wires", []) for target in wire} <= set(ids)
    by_type = {node["type"]: node for node in flow}
    assert (by_type["modbus-client"]["tcpHost"], by_type["modbus-client"]["tcpPort"]) == ("10.1.2.3", "5020")
    read = by_type["modbus-read"]
    assert (read["unitid"], read["dataType"], read["adr"], read["quantity"]) == ("7", "HoldingRegister", "0", "100")
    assert (read["server"], read["wires"][0]) == (by_type["modbus-client"]["id"], [by_type["function"]["id"]])
    other = {node["id"] for node in json.loads(node_red.text(Target(bay="bay-3")))}
    assert not other & set(ids)  # two bays fit into one Node-RED


def test_node_red_decodes_and_enables() -> None:
    first, second = function_node([(0, image(6)), (100, image(7))])
    assert first == [[{"topic": "enable", "payload": False}, None, first[0][2]], "heartbeat"]
    (enable, data, diagnosis), status = second
    assert (enable["payload"], diagnosis["payload"]["code"], status) == (True, 0, "enabled")
    for name, value in decode(image(7)).items():
        if value is None:
            assert data["payload"][name] is None
        else:
            assert data["payload"][name] == pytest.approx(value, abs=1e-3), name
    assert data["payload"]["status_may_move"] is True


def test_node_red_takes_the_other_word_order_only_when_told() -> None:
    messages = [(0, image(6, "little")), (100, image(7, "little"))]
    assert [status for _, status in function_node(messages)] == ["word_order", "word_order"]
    told = function_node(messages, LITTLE)
    assert told[1][1] == "enabled"
    assert told[1][0][1]["payload"]["timestamp"] == 1_763_640_000_123


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"seq_end": 3}, Diagnosis.TORN),
        ({"map_version": 0}, Diagnosis.OLD_MAP),
        ({"known_u32": 1}, Diagnosis.FOREIGN),
        ({"stop": 1}, Diagnosis.CONTRADICTION),
        ({"may_move": 0}, Diagnosis.CONTRADICTION),
        ({"reason": 10}, Diagnosis.CONTRADICTION),
        ({"vision_quality": 1}, Diagnosis.VISION),
        ({"range_quality": 1}, Diagnosis.RANGER),
    ],
)
def test_node_red_finds_what_structured_text_finds(changes: dict[str, int], found: Diagnosis) -> None:
    doubtful = image(8)
    for name, word in changes.items():
        doubtful[BY_NAME[name].address] = word
    *_, (outputs, status) = function_node([(0, image(6)), (100, image(7)), (100, doubtful)])
    assert status == found.name.lower()
    assert outputs[0] == {"topic": "enable", "payload": False}
    assert (outputs[1] is None) is (found < Diagnosis.STOP)


def test_node_red_falls_on_silence_on_a_still_heartbeat_and_on_a_clock_set_back() -> None:
    live = [(0, image(6)), (100, image(7))]
    limit = HEARTBEAT_TIMEOUT_MS

    def last(more: list[tuple[int, Any]]) -> str:
        return str(function_node([*live, *more])[-1][1])

    assert last([(limit - 1, "tick")]) == "enabled"
    assert last([(limit, "tick")]) == "poll_failed"
    assert last([(limit - 1, image(7))]) == "enabled"
    assert last([(limit, image(7))]) == "heartbeat"
    assert last([(100, image(7)), (limit - 100, "tick")]) == "heartbeat"
    assert last([(100, "")]) == "poll_failed"
    assert last([(100, ""), (limit, image(9))]) == "heartbeat"  # another number, but not seen to move
    assert last([(100, ""), (limit, image(9)), (100, image(10))]) == "enabled"
    assert last([(-5000, image(7))]) == "heartbeat"
    assert last([(100, "tick"), (100, image(8))]) == "enabled"


# ---- the command


def run(*argv: str) -> int:
    parser = argparse.ArgumentParser()
    verb.configure(parser)
    return verb.main(parser.parse_args(argv))


@pytest.mark.parametrize("name", FORMATS)
def test_each_format_comes_out_of_the_command(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new"
    argv = ["--bay", "bay-2", "--host", "10.1.2.3", "--port", "5020", "--unit-id", "7"]
    assert run("--format", name, *argv, "--out", f"{folder}/") == 0
    files = FORMATS[name](TARGET)
    written = {path.name: path.read_bytes().decode() for path in folder.iterdir()}
    assert written == files
    assert capsys.readouterr().err.split() == [str(folder / file) for file in files]
    if len(files) == 1:
        assert run("--format", name, *argv) == 0
        assert capsys.readouterr().out.encode() == next(iter(files.values())).encode()
        assert run("--format", name, *argv, "--out", str(tmp_path / "one")) == 0
        assert (tmp_path / "one").is_file()


def test_two_files_need_a_folder() -> None:
    with pytest.raises(ConfigError, match=r"openplc makes 2 files \(loading_bay.st, mbconfig.cfg\): give --out DIR"):
        run("--format", "openplc")


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (("--bay", "a b"), "--bay: 'a b'"),
        (("--host", "x/y"), "--host: 'x/y'"),
        (("--port", "0"), "--port: 0: 1 to 65535"),
        (("--unit-id", "248"), "--unit-id: 248: 1 to 247"),
        (("--out", "/dev/null/x"), "--out /dev/null/x: Not a directory"),
    ],
)
def test_bad_arguments_are_named(argv: tuple[str, str], said: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(said)):
        run("--format", "st", *argv)


@pytest.mark.parametrize(("bay", "name"), [("bay-2", "bay_2"), ("7", "bay_7"), ("North--gate_", "North_gate")])
def test_a_bay_has_a_name_that_plc_languages_take(bay: str, name: str) -> None:
    assert Target(bay=bay).identifier == name


# ---- the page


def test_every_reason_and_diagnosis_says_what_to_do() -> None:
    assert set(reference.REMEDY) == set(Reason)
    assert all(reference.REMEDY.values())
    shown = reference.diagnoses()
    assert [int(n) for n in re.findall(r"^\| (\d+) \|", shown, re.MULTILINE)] == list(Diagnosis)
    assert list(SUMMARY) == list(FORMATS)
    for name in FORMATS:
        assert f"| `{name}` |" in reference.formats()
