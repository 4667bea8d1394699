"""Every export is opened as its reader would open it, and agrees with the image of the gateway."""

import argparse
import csv
import io
import itertools
import json
import math
import re
import struct
import xml.etree.ElementTree as ET
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from gateway import registry
from gateway.cli import registers as verb
from gateway.core.plc import Control, Handshake, PlcLink
from gateway.core.shown import withdrawn
from gateway.core.state import Reason, StateVector
from gateway.errors import ConfigError
from gateway.modbus.exports import (
    kepware,
    l5x,
    logic,
    logix,
    node_red,
    node_red_function,
    openplc,
    scl,
    structured_text,
)
from gateway.modbus.exports.approach import APPROACH, SEQUENCE
from gateway.modbus.exports.diagnosis import CONTRADICTIONS, HEARTBEAT_TIMEOUT_MS, Diagnosis
from gateway.modbus.exports.fields import fields, measured
from gateway.modbus.exports.interface import INPUTS, OUTPUTS, FunctionBlock
from gateway.modbus.exports.registry import EXPORTS, SUMMARY, export
from gateway.modbus.exports.target import Target
from gateway.modbus.registers.register_map import BLOCK_WORDS, REGISTERS, decode, encode
from tests.node_function import Messages, run_each, run_function
from tests.permitted import permitted, standing
from tools import plc_integration

TARGET = Target(bay="bay-2", host="10.1.2.3", port=5020, unit_id=7)
LITTLE = replace(TARGET, word_order="little")
SECOND = Target(bay="bay-3", host="10.1.2.3", port=5020, unit_id=8)
IDENTITY = {"bay_2": 1227809674, "bay_3": 1042928412}  # CRC-32 of site1/gateway/bay-2, without its highest bit
BY_NAME = {register.name: register for register in REGISTERS}


def image(heartbeat: int = 7, order: Any = "big") -> list[int]:
    return list(encode(permitted(heartbeat), 1_763_640_000_123_456_789, order, TARGET.identity))


def empty(order: Any = "big") -> list[int]:
    """Every register that may hold no value holds none."""
    return list(encode(withdrawn(StateVector(""), 0), 0, order, TARGET.identity))


# What plants wire to spouts and lights: an output that is on while the truck may move is no condition for loading.
PROGRAMS = ("st", "plcopen", "codesys", "tcpou", "scl", "l5x", "openplc", "node-red")


@pytest.mark.parametrize("name", PROGRAMS)
def test_no_program_has_an_output_that_could_be_mistaken_for_the_wrong_one(name: str) -> None:
    text = "\n".join(export(name, (TARGET, SECOND)).values())
    assert re.search(r"\bMayMove\b|may_move", text)
    assert re.search(r"\bInPlace\b|in_place", text)
    text = re.sub(r"Enable (Input|Output) - System Defined Parameter", "", text)  # Rockwell's own
    assert not re.search(r"\bEnable\b|LoadingEnable|[Mm]ay_?[Ll]oad|[Ll]oading may", text)
    lines = [line.strip() for line in text.splitlines() if re.search(r"[Cc]ondition for loading", line)]
    assert lines
    assert [line for line in lines if not re.search(r"only condition for loading|[Nn]ever a condition", line)] == []


PYTHON = {"AND": "and", "OR": "or", "XOR": "!=", "=": "==", "<>": "!="}


@pytest.mark.parametrize("claim", CONTRADICTIONS)
def test_a_contradiction_is_the_same_to_the_programs_and_to_an_update(claim: str) -> None:
    names = sorted(set(re.findall(r"#Raw\.(\w+)", claim)))
    text = re.sub(r"<>|\bX?OR\b|\bAND\b|=", lambda found: PYTHON[found[0]], claim).replace("#Raw.", "")
    flags = {field.name for field in fields() if field.kind == "BOOL"}
    found = set()
    for values in itertools.product(*((False, True) if name in flags else (0, 1, 2) for name in names)):
        raw = dict(zip(names, values, strict=True))
        expected = bool(eval(text, {"__builtins__": {}}, raw))
        assert CONTRADICTIONS[claim](raw) == expected, raw
        found.add(expected)
    assert found == {False, True}


def unpack(words: list[int], letter: str) -> Any:
    return struct.unpack(f">{letter}", struct.pack(f">{len(words)}H", *words))[0]


# ---- Ignition


def ignition_tags(target: Target) -> list[dict[str, Any]]:
    (text,) = export("ignition", (target,)).values()
    provider = json.loads(text)
    assert provider["tagType"] == "Provider"
    (folder,) = provider["tags"]
    assert (folder["name"], folder["tagType"]) == (target.bay, "Folder")
    return list(folder["tags"])


EXPRESSION = re.compile(
    r"if\((?P<missing>.+?), qualifiedValue\(null, 'Bad', 524, 'no value'\),"
    r" \{\[\.\](?P<value>\S+?)\}( \* (?P<scale>\S+))?\)"
)


def ignition_reads(target: Target, words: list[int]) -> tuple[dict[str, Any], dict[str, bool]]:
    """Each opcItemPath followed by Ignition's rules (one-based, designator says the type), then the expressions."""
    letters = {"HRUS": ("H", 1), "HR": ("h", 1), "HRUI": ("I", 2), "HRUI_64": ("Q", 4), "HRF": ("f", 2)}
    read: dict[str, Any] = {}
    bits: dict[str, bool] = {}
    expressions = {}
    for tag in ignition_tags(target):
        for leaf in tag.get("tags", [tag]):
            path = f"raw/{leaf['name']}" if tag["name"] == "raw" else leaf["name"]
            assert leaf.get("readOnly", False) is not (path in BY_NAME and BY_NAME[path].writable)
            if leaf["valueSource"] == "expr":
                expressions[path] = leaf
                continue
            assert leaf["valueSource"] == "opc"
            unit = target.unit_id
            found = re.fullmatch(
                rf"ns=1;s=\[{target.bay}\]{unit}\.(HRUI_64|HRUI|HRUS|HRF|HR)(\d+)(?:\.(\d+))?", leaf["opcItemPath"]
            )
            assert found, leaf
            designator, address, bit = found[1], int(found[2]) - 1, found[3]
            if bit is not None:
                assert (designator, leaf["dataType"]) == ("HR", "Boolean")
                bits[leaf["name"]] = bool(words[address] >> int(bit) & 1)
                continue
            letter, size = letters[designator]
            read[path] = unpack(words[address : address + size], letter)
            assert "scaleMode" not in leaf
            assert "engUnit" not in leaf
    right = re.sub(r"\{\[\.\](\S+?)\}", r"read['\1']", expressions.pop("right_bay")["expression"])
    bits["right_bay"] = eval(right.replace(" = ", " == ").replace("&&", "and"), {"read": read})  # our own
    for name, leaf in expressions.items():
        found = EXPRESSION.fullmatch(leaf["expression"])
        assert found, leaf
        missing = re.sub(r"\{\[\.\](\S+?)\}", r"read['\1']", found["missing"]).replace(" = ", " == ")
        value = read[found["value"]] * float(found["scale"] or 1)
        read[name] = None if eval(missing, {"read": read}) else value  # our own arithmetic
        assert leaf.get("engUnit", "") == BY_NAME[name].unit
    return read, bits


def test_ignition_reads_the_image_through_its_own_addresses() -> None:
    words = image()
    read, bits = ignition_reads(TARGET, words)
    expected = decode(words)
    assert {name for name in read if not name.startswith("raw/")} == set(expected)
    for name, value in expected.items():
        assert read[name] == (None if value is None else pytest.approx(value, abs=1e-3)), name
    assert (bits["may_move"], bits["stop"], bits["healthy"], bits["in_place"]) == (True, False, True, False)
    assert (bits["right_bay"], ignition_reads(SECOND, words)[1]["right_bay"]) == (True, False)


@pytest.mark.parametrize("order", ["big", "little"])
def test_ignition_shows_no_sentinel_as_a_value(order: Any) -> None:
    """6553.5 px was one."""
    read, _ = ignition_reads(Target(word_order=order), empty(order))
    none = [name for name, value in decode(empty("big")).items() if value is None]
    assert len(none) > 25
    assert [name for name in none if read[name] is not None] == []


def test_ignition_documents_codes() -> None:
    (reason,) = (tag for tag in ignition_tags(Target()) if tag["name"] == "reason")
    assert "\n1 target_reached: " in reason["documentation"]


# ---- Kepware


def kepware_reads(target: Target, words: list[int]) -> tuple[dict[str, Any], list[dict[str, str]]]:
    """Every tag by the driver's rules."""
    rows = list(csv.DictReader(io.StringIO(kepware.text(target), newline="")))
    assert tuple(rows[0]) == kepware.COLUMNS
    letters = {"Word": ("H", 1), "Short": ("h", 1), "DWord": ("I", 2), "Float": ("f", 2)}
    read: dict[str, Any] = {}
    for row in rows:
        found = re.fullmatch(r"4(\d{5})(?:\.(\d+))?", row["Address"])
        assert found, row
        address = int(found[1]) - 1
        if found[2] is not None:
            assert row["Data Type"] == "Boolean"
            read[row["Tag Name"]] = bool(words[address] >> int(found[2]) & 1)
            continue
        letter, size = letters[row["Data Type"]]
        read[row["Tag Name"]] = unpack(words[address : address + size], letter)
        assert len(row["Description"]) <= 255
    assert len(read) == len(rows)
    return read, rows


def test_kepware_reads_the_image_through_its_own_addresses() -> None:
    text = kepware.text(TARGET)
    assert text.endswith("\r\n")
    assert text.count("\r\n") == text.count("\n")
    words = image()
    read, rows = kepware_reads(TARGET, words)
    writable = {row["Tag Name"] for row in rows if row["Client Access"] == "R/W"}
    assert writable == {register.name for register in REGISTERS if register.writable}
    assert {row["Client Access"] for row in rows} == {"RO", "R/W"}
    for name, expected in decode(words).items():
        register = BY_NAME[name]
        if register.words == 4:
            assert read[f"{name}_high"] << 32 | read[f"{name}_low"] == expected
        elif measured(register) and not register.kind.is_float:
            assert name not in read
            assert expected is None or read[f"{name}_raw"] * register.scale == pytest.approx(expected, abs=1e-3), name
        elif expected is not None:
            assert read[name] == pytest.approx(expected, abs=1e-3), name
    assert (read["status_may_move"], read["status_stop"], read["in_place"]) == (True, False, 0)


def test_kepware_shows_no_sentinel_as_a_quantity() -> None:
    """What may hold no value is either a count without a unit, or a float that is then NaN."""
    read, rows = kepware_reads(Target(), empty())
    assert {row["Scaling"] for row in rows} == {""}
    with_unit = [row["Tag Name"] for row in rows if row["Eng Units"]]
    floats = ["u_f32", "v_f32", "radius_f32", "distance_f32", "z_vision_f32", "pose_x", "pose_y", "pose_z"]
    assert [name for name in with_unit if name != "speed_setpoint"] == floats
    assert all(math.isnan(read[name]) for name in floats)
    assert read["speed_setpoint"] == 0
    descriptions = {row["Tag Name"]: row["Description"] for row in rows}
    assert descriptions["radius_raw"] == "counts of 0.1 px; 65535: no value. marker radius R"
    assert descriptions["u_raw"].startswith("counts of 0.1 px; -32768: no value. ")


# ---- Siemens


def scl_bodies(siemens: str) -> list[str]:
    return re.findall(r"^BEGIN\n(.*?)^END_FUNCTION(?:_BLOCK)?$", siemens, re.MULTILINE | re.DOTALL)


def test_scl_is_the_structured_text_that_was_parsed_and_run() -> None:
    """Nothing here parses SCL. Its bodies are the ones of structured text, letter for letter, but for # and quotes."""
    siemens = scl.text((TARGET,))
    iec = structured_text.document((TARGET,))
    bodies = scl_bodies(siemens)
    assert len(bodies) == 7
    for body in bodies[:5]:
        assert logic.iec(body) in iec
    example = logic.iec(bodies[6]).rpartition("BEGIN\n")[2].replace("LoadingGateways_DB.", "")
    assert example in iec
    for body in bodies:
        declared = set(re.findall(r"^    (\w+)(?: \{.*?\})? : ", siemens, re.MULTILINE))
        used = set(re.findall(r"(?<!\w)#(\w+)", body))
        assert used - {"LG_UDInt", "LG_Real"} <= declared
    # every local is marked: no name of the interface stands without # outside of comments and formal parameters
    code = re.sub(r"\(\*.*?\*\)", "", bodies[2], flags=re.DOTALL)
    assert (
        re.findall(r"(?<![\w#.\"])(?:Raw|Data|Words|MayMove|InPlace|Diagnostic|PollOk|Beating|Seen|Stage)\b", code)
        == []
    )


def test_scl_declares_every_field_input_and_output() -> None:
    siemens = scl.text((TARGET,))
    assert siemens.isascii()
    declared = re.search(r'^TYPE "LoadingGateway_Data".*?^END_TYPE', siemens, re.MULTILINE | re.DOTALL)
    assert declared
    members = re.findall(r"^    (\w+) : (\w+);", declared[0], re.MULTILINE)
    assert [(name, kind.upper()) for name, kind in members] == [(field.name, field.kind) for field in fields()]
    block = siemens[siemens.index('FUNCTION_BLOCK "FB_LoadingGateway"') : siemens.index("DATA_BLOCK")]
    named = re.findall(r"^    (\w+)(?: \{.*?\})? : ", block, re.MULTILINE)
    assert {var.name for var in (*INPUTS, *OUTPUTS)} <= set(named)


def test_scl_calls_mb_client_for_every_bay_by_itself() -> None:
    """Reading and writing each have their call; the unit id, the address and the buffers are each bay's own."""
    siemens = scl.text((TARGET, SECOND))
    cycle = scl_bodies(siemens)[5]
    for number, (bay, unit) in enumerate((("bay_2", 7), ("bay_3", 8)), 1):
        calls = re.findall(rf"#{bay}_Client\((REQ.*?)\);", cycle, re.DOTALL)
        parameters = [dict(re.findall(r"(\w+) := ([^,)]+)", call)) for call in calls]
        assert [(p["MB_MODE"], p["MB_DATA_ADDR"], p["MB_DATA_LEN"]) for p in parameters] == [
            ("116", "80", "3"),
            ("103", "0", "123"),
        ]
        assert [p["MB_DATA_PTR"] for p in parameters] == [
            f'"LoadingGateway_IO".{bay}_Write',
            f'"LoadingGateway_IO".{bay}_Words',
        ]
        assert {p["CONNECT"] for p in parameters} == {f'"LoadingGateway_IO".{bay}_Connection'}
        assert f"#{bay}_Client.MB_Unit_ID := {unit};" in cycle
        assert f'#{bay}(PollOk := #{bay}_PollOk, Words := "LoadingGateway_IO".{bay}_Words,' in cycle
        assert f"UnitId := {unit}, BayIdentity := UDINT#{IDENTITY[bay]});" in cycle
        assert f"{bay}_Connection.ID := {number};" in siemens
        for n, octet in enumerate((10, 1, 2, 3), 1):
            assert f"{bay}_Connection.RemoteAddress.ADDR[{n}] := {octet};" in siemens
        assert f"{bay}_Connection.RemotePort := 5020;" in siemens
    buffers = siemens[
        siemens.index('DATA_BLOCK "LoadingGateway_IO"') : siemens.index('FUNCTION_BLOCK "LoadingGateways"')
    ]
    assert "S7_Optimized_Access := 'FALSE'" in buffers
    assert "NON_RETAIN" in buffers
    with pytest.raises(ConfigError, match=r"--host: 'plc\.plant': this format needs an IPv4 address"):
        scl.text((Target(host="plc.plant"),))


# ---- PLCopen XML, TwinCAT, CODESYS

NS = {"p": "http://www.plcopen.org/xml/tc6_0200", "x": "http://www.w3.org/1999/xhtml"}


@pytest.mark.parametrize("name", ["plcopen", "codesys"])
def test_plcopen_holds_the_same_units_as_the_structured_text(name: str) -> None:
    (text,) = export(name, (TARGET, SECOND)).values()
    assert text.isascii()
    root = ET.fromstring(text)
    assert [child.tag.split("}")[1] for child in root] == ["fileHeader", "contentHeader", "types", "instances"]
    assert [t.get("name") for t in root.iterfind(".//p:dataType", NS)] == ["LG_Block", "LG_Write", "ST_LoadingGateway"]
    members = root.findall(".//p:dataType[@name='ST_LoadingGateway']//p:struct/p:variable", NS)
    assert [member.get("name") for member in members] == [field.name for field in fields()]
    units = {unit.get("name"): unit for unit in root.iterfind(".//p:pou", NS)}
    assert [(n, unit.get("pouType")) for n, unit in units.items()] == [
        ("LG_UDInt", "function"),
        ("LG_Real", "function"),
        ("FB_LoadingGateway", "functionBlock"),
        ("FB_Approach", "functionBlock"),
        ("FB_LoadingSequence", "functionBlock"),
        ("LoadingGateways", "program"),
        ("LoadingBayExample", "program"),
    ]
    iec = structured_text.document((TARGET, SECOND))
    for unit in structured_text.library(TARGET):
        body = units[unit.name].find("p:body/p:ST/x:xhtml", NS)
        assert body is not None
        assert (body.text or "").endswith(unit.body)
        assert unit.body in iec
    block = units["FB_LoadingGateway"]
    for section, variables in (("inputVars", INPUTS), ("outputVars", OUTPUTS)):
        named = [v.get("name") for v in block.iterfind(f"p:interface/p:{section}/p:variable", NS)]
        assert named == [var.name for var in variables]
    start = block.find("p:interface/p:inputVars/p:variable[@name='HeartbeatTimeout']/p:initialValue/p:simpleValue", NS)
    assert start is not None
    assert start.get("value") == "T#500ms"


def test_codesys_polls_and_writes_every_bay_by_itself() -> None:
    (text,) = export("codesys", (TARGET, SECOND)).values()
    root = ET.fromstring(text)
    body = root.find(".//p:pou[@name='LoadingGateways']/p:body/p:ST/x:xhtml", NS)
    assert body is not None
    code = body.text or ""
    for bay, unit in (("bay_2", 7), ("bay_3", 8)):
        assert (
            f"{bay}_Read(rClient := {bay}_Client, xExecute := {bay}_Stage = 2, uiUnitId := {unit}, uiStartItem := 0,"
            in code
        )
        assert (
            f"{bay}_Send(rClient := {bay}_Client, xExecute := {bay}_Stage = 4, uiUnitId := {unit}, uiStartItem := 80,"
            in code
        )
        known = f"UnitId := {unit}, BayIdentity := UDINT#{IDENTITY[bay]}"
        assert f"{bay}(PollOk := {bay}_PollOk, Words := {bay}_Words,\n  {known});" in code
        address = root.find(f".//p:variable[@name='{bay}_Address']/p:initialValue/p:arrayValue", NS)
        assert address is not None
        assert [v.get("value") for v in address.iterfind("p:value/p:simpleValue", NS)] == ["10", "1", "2", "3"]


def test_twincat_has_one_file_an_object_with_the_text_that_was_parsed_and_run() -> None:
    files = export("tcpou", (TARGET, SECOND))
    assert list(files) == [
        *("LG_Block.TcDUT", "LG_Write.TcDUT", "ST_LoadingGateway.TcDUT"),
        *("LG_UDInt.TcPOU", "LG_Real.TcPOU", "FB_LoadingGateway.TcPOU"),
        *("FB_Approach.TcPOU", "FB_LoadingSequence.TcPOU", "LoadingGateways.TcPOU", "LoadingBayExample.TcPOU"),
    ]
    iec = structured_text.document((TARGET,))
    ids = set()
    for file, text in files.items():
        root = ET.fromstring(text)
        assert (root.tag, root.get("Version")) == ("TcPlcObject", "1.1.0.1")
        (unit,) = root
        assert file == f"{unit.get('Name')}.Tc{unit.tag}"
        ids.add(unit.get("Id"))
        declared = unit.findtext("Declaration") or ""
        if file not in ("LoadingGateways.TcPOU", "LoadingBayExample.TcPOU"):
            assert declared in iec
            assert (unit.findtext("Implementation/ST") or "") in iec
    assert len(ids) == len(files)
    assert all(re.fullmatch(r"\{[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}\}", str(one)) for one in ids)
    code = ET.fromstring(files["LoadingGateways.TcPOU"]).findtext("POU/Implementation/ST") or ""
    for bay, unit_id in (("bay_2", 7), ("bay_3", 8)):
        where = f"sIPAddr := '10.1.2.3', nTCPPort := 5020, nUnitID := {unit_id}"
        assert f"{bay}_Read({where}, nQuantity := 123, nMBAddr := 0," in code
        assert f"{bay}_Send({where}, nQuantity := 3, nMBAddr := 80," in code
        known = f"UnitId := {unit_id}, BayIdentity := UDINT#{IDENTITY[bay]}"
        assert f"{bay}(PollOk := {bay}_PollOk, Words := {bay}_Words,\n  {known});" in code


@pytest.mark.parametrize("name", ["plcopen", "codesys", "tcpou"])
def test_the_example_uses_the_instance_that_is_polled(name: str) -> None:
    """In structured text it has its own; elsewhere it is the same program on that of LoadingGateways."""
    text = "\n".join(export(name, (TARGET,)).values())
    own = structured_text.example(TARGET, polled=False)
    body = own.body[own.body.index("bay_2_Sequence(") :]
    for member in ("Data", "Alive", "MayMove", "InPlace", "LoadPermit", "TruckPresent", "SpoutUp", "Start", "Release"):
        body = re.sub(rf"\bbay_2\.{member}\b", f"LoadingGateways.bay_2.{member}", body)
    assert body in text


# ---- Rockwell


def l5x_root(target: Target, file: str = "bay_2-loading-gateway.L5X") -> ET.Element:
    return ET.fromstring(l5x.files((replace(target, bay="bay-2"),))[file])


@pytest.mark.parametrize(
    ("file", "name", "block"),
    [("approach", "LoadingGateway_Approach", APPROACH), ("sequence", "LoadingGateway_Sequence", SEQUENCE)],
)
def test_l5x_has_an_instruction_for_the_approach_and_one_for_the_example(
    file: str, name: str, block: FunctionBlock
) -> None:
    root = l5x_root(TARGET, f"bay_2-loading-gateway-{file}.L5X")
    instruction = root.find("Controller/AddOnInstructionDefinitions/AddOnInstructionDefinition")
    assert instruction is not None
    assert instruction.get("Name") == root.get("TargetName") == name
    parameters = {p.get("Name"): p for p in instruction.iterfind("Parameters/Parameter")}
    named = {f"{var.name}Ms" if var.kind == "TIME" else var.name for var in (*block.inputs, *block.outputs)}
    assert set(parameters) == {"EnableIn", "EnableOut"} | named
    kinds = {"BOOL": "BOOL", "UINT": "DINT", "INT": "DINT", "REAL": "REAL", "TIME": "DINT", "DATA": l5x.DATA}
    for var in (*block.inputs, *block.outputs):
        parameter = parameters[f"{var.name}Ms" if var.kind == "TIME" else var.name]
        assert parameter.get("DataType") == kinds[var.kind]
        start = parameter.find("DefaultData/DataValue")
        if start is not None and var.start:
            assert start.get("Value") == (var.start[2:-2] if var.kind == "TIME" else var.start)
    routines = {
        routine.get("Name"): "\n".join((line.text or "").strip() for line in routine.iterfind("STContent/Line"))
        for routine in instruction.iterfind("Routines/Routine")
    }
    assert not re.search(r"\b(TRUE|FALSE)\b|#|\.Q\b|\bIN :=|_TO_", re.sub(r"\(\*.*?\*\)", "", routines["Logic"]))
    assigned = dict(re.findall(r"^(\w+) := (\d+);$", routines["Prescan"], re.MULTILINE))
    assert routines["EnableInFalse"] == routines["Prescan"]
    assert {var.name for var in block.outputs} <= set(assigned)
    assert {n for n, value in assigned.items() if value != "0"} == {"StartWas"}
    example = instruction.findtext("AdditionalHelpText") or ""
    assert "bay_2_Approach.DriveReady := bay_2_Sequence.DriveReady;\n" in example
    assert "LoadingGateway_Approach(bay_2_Approach, bay_2_Data);\n" in example


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
    assert {var.name for var in OUTPUTS} | set(openplc.INPUTS) <= set(parameters)
    assert {"Trigger", "Acknowledge", "Recipe", "HeartbeatTimeoutMs"} <= set(parameters)
    assert parameters["Words"].get("Dimensions") == "123"
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
    for line in source[: source.index("(* The first check")].splitlines():
        if found := re.fullmatch(r"Raw\.(\w+) := (.+);", line):
            expression = found[2].replace("AND", "&").replace("<>", "!=")
            raw[found[1]] = eval(expression, {"Words": words})  # our own arithmetic
        elif found := re.fullmatch(r"Pair\[(\d)\] := Words\[(\d+)\];", line):
            pair[int(found[1])] = words[int(found[2])]
        elif found := re.fullmatch(r"COP\(Pair\[0\], Raw\.(\w+), 1\);", line):
            raw[found[1]] = struct.unpack("<f", struct.pack("<2h", *pair))[0]
        else:
            assert re.fullmatch(r"\(\*.*|IF NOT Raw\.\w+ THEN|  Raw\.\w+ := (0|1\.0E\+38);|END_IF;|", line), line
    assert set(raw) == {field.name for field in fields()}
    for name, value in decode(image()).items():
        if BY_NAME[name].words == 4:
            assert (raw[f"{name}_high"] & 0xFFFF_FFFF) << 32 | raw[f"{name}_low"] & 0xFFFF_FFFF == value
            continue
        assert raw.get(f"{name}_valid", True) is (value is not None), name
        if value is not None:
            assert raw[name] == pytest.approx(value, abs=1e-3), name
    assert (raw["status_may_move"], raw["status_stop"]) == (True, False)


def test_logix_does_what_structured_text_does() -> None:
    """All that comes after the decoding is the common logic, statement by statement."""
    body = logix.body(Target())
    common = logic.iec(logic.logic(Target()))
    assert common in structured_text.document((Target(),))
    mine = body[body.index("(* The first check") :]
    code = re.sub(r"\(\*.*?\*\)|//[^\n]*", "", mine, flags=re.DOTALL)
    assert not re.search(r"\b(TRUE|FALSE)\b|#|\.Q\b|\bIN :=", code)  # Logix knows none of these
    back = re.sub(r"COP\((\w+), Data, 1\);", r"Data := \1;", mine).replace(".DN", ".Q")
    back = re.sub(r"(\w+)\.PRE := (\w+);\n\1\.TimerEnable := (.+);\nTONR\(\1\);", r"\1(IN := \3, PT := \2);", back)
    back = back.replace("HeartbeatTimeoutMs", "HeartbeatTimeout").replace("PT := 3000", "PT := T#3000ms")
    assert re.sub(r"\bTRUE\b", "1", re.sub(r"\bFALSE\b", "0", common)) == back


def test_logix_reads_as_dead_while_its_rung_is_false_and_when_the_controller_starts() -> None:
    """Both routines run in place of the logic; what they leave out would stand as it was."""
    root = l5x_root(TARGET)
    routines = {
        routine.get("Name"): "\n".join((line.text or "").strip() for line in routine.iterfind("STContent/Line"))
        for routine in root.iterfind(".//Routines/Routine")
    }
    assert routines["EnableInFalse"] == routines["Prescan"]
    assigned = dict(re.findall(r"^(\w+(?:\.\w+)?) := (\d+);$", routines["Prescan"], re.MULTILINE))
    names = {var.name for var in OUTPUTS} - {"Data", "PlcHeartbeat", "PlcControl", "RecipeSelect"}
    assert names <= set(assigned)
    assert {name: assigned[name] for name in ("MayMove", "InPlace", "Alive", "MustStop", "Diagnostic", "Reason")} == {
        "MayMove": "0", "InPlace": "0", "Alive": "0", "MustStop": "1", "Diagnostic": "1", "Reason": "40",
    }  # fmt: skip
    assert {"Sound", "Seen", "Changes", "Beating", "Stage", "TriggerBit"} <= set(assigned)
    # Data: nothing, and then whatever is not 0 in the image of a gateway that has stopped deciding
    assert routines["Prescan"].splitlines()[0] == "COP(Nothing, Data, 1);"
    dead = decode(empty())
    for field in fields():
        if field.part == "value" and (field.register.codes or field.name == "stop"):
            value = dead[field.name]
            assert int(assigned.get(f"Data.{field.name}", 0)) == (0 if value is None else value), field.name
    assert f"PlcControl := PlcControl AND {1 << Control.TRUCK_PRESENT};" in routines["Prescan"]


# ---- OpenPLC


def openplc_entries(files: dict[str, str]) -> dict[str, str]:
    lines = [line for line in files[openplc.DEVICES].splitlines() if not line.startswith("#")]
    entries = {found[1]: found[2] for line in lines if (found := re.fullmatch(r'(\S+) = "(.*)"', line))}
    assert len(entries) == len(lines)
    return entries


def test_openplc_reads_the_block_and_puts_each_word_in_its_place() -> None:
    """Devices come one after the other: the second bay's words begin where those of the first end."""
    files = export("openplc", (TARGET, SECOND))
    assert set(files) == {openplc.PROGRAM, openplc.DEVICES}
    entries = openplc_entries(files)
    assert entries["Num_Devices"] == "2"
    program = files[openplc.PROGRAM]
    for n, (bay, unit) in enumerate((("bay_2", "7"), ("bay_3", "8"))):
        assert (entries[f"device{n}.address"], entries[f"device{n}.IP_Port"]) == ("10.1.2.3", "5020")
        assert (entries[f"device{n}.slave_id"], entries[f"device{n}.protocol"]) == (unit, "TCP")
        assert entries[f"device{n}.Holding_Registers_Read_Start"] == "0"
        assert entries[f"device{n}.Holding_Registers_Read_Size"] == str(BLOCK_WORDS)
        inputs = dict(re.findall(rf"^  {bay}_(w\d+) AT %IW(\d+) : WORD;", program, re.MULTILINE))
        copies = re.findall(rf"^{bay}_Words\[(\d+)\] := {bay}_(w\d+);", program, re.MULTILINE)
        assert [int(place) for place, _ in copies] == list(range(BLOCK_WORDS))
        assert [int(inputs[name]) - 100 - 123 * n for _, name in copies] == list(range(BLOCK_WORDS))
        outputs = dict(re.findall(rf"^  {bay}_(\w+) AT %QX{n}\.(\d) : BOOL;", program, re.MULTILINE))
        assert outputs == dict(zip(openplc.OUTPUTS, "1234567", strict=True))
        assert list(outputs) == ["MustStop", "Alive", "MayMove", "InPlace", "Moved", "Held", "Rolling"]
        assert f"{bay}_LoadPermit AT %QX{n + 4}.0 : BOOL;" in program
        inputs = dict(re.findall(rf"^  {bay}_(\w+) AT %IX{n}\.(\d) : BOOL;", program, re.MULTILINE))
        assert list(inputs)[:6] == ["EnableRequest", "TruckPresent", "Reset", "Release", "Trigger", "Acknowledge"]
        assert (inputs["SpoutUp"], inputs["Start"]) == ("6", "7")
    assert "%QX0.0" not in program  # it was on while the truck may move: nothing may take its place
    located = re.findall(r" AT (%\w+(?:\.\d)?) :", program)
    assert len(set(located)) == len(located)
    assert program.startswith(structured_text.declarations((TARGET, SECOND)))


@pytest.mark.parametrize("writes", [True, False])
def test_openplc_writes_where_the_gateway_accepts_it(writes: bool) -> None:
    """A refused write makes OpenPLC close the connection at every poll."""
    targets = (Target(writes=writes), Target(bay="bay2", unit_id=2, writes=writes))
    files = export("openplc", targets)
    entries = openplc_entries(files)
    for n in range(2):
        asked = (entries[f"device{n}.Holding_Registers_Start"], entries[f"device{n}.Holding_Registers_Size"])
        assert asked == (("80", "3") if writes else ("0", "0"))
    written = re.findall(r"^  (\w+) AT %QW(10\d) : UINT;", files[openplc.PROGRAM], re.MULTILINE)
    names = ["PlcHeartbeat", "PlcControl", "RecipeSelect"]
    expected = [(f"bay{n + 1}_{name}", str(100 + 3 * n + place)) for n in range(2) for place, name in enumerate(names)]
    assert written == expected


def test_openplc_has_room_for_three_bays() -> None:
    bays = tuple(Target(bay=f"bay{n}", unit_id=n) for n in range(1, 5))
    assert export("openplc", bays[:3])
    with pytest.raises(ConfigError, match=r"OpenPLC has room for 3 bays, not for 4"):
        export("openplc", bays)


# ---- Node-RED


def function_nodes(runs: list[Messages], target: Target = TARGET) -> list[list[Any]]:
    """Runs the flow's function node: for each run [(ms later, words | "tick" | "")] -> [[outputs, status]]."""
    return run_each(node_red_function.code(target), runs)


def function_node(messages: Messages, target: Target = TARGET) -> list[Any]:
    return function_nodes([messages], target)[0]


def test_node_red_nodes_are_wired_to_each_other_and_to_the_bay() -> None:
    flow = json.loads(node_red.text(TARGET))
    ids = [node["id"] for node in flow]
    assert len(set(ids)) == len(ids)
    for node in flow:
        assert {target for wire in node.get("wires", []) for target in wire} <= set(ids)
    by_type = {node["type"]: node for node in flow}
    assert (by_type["modbus-client"]["tcpHost"], by_type["modbus-client"]["tcpPort"]) == ("10.1.2.3", "5020")
    assert by_type["function"]["func"] == node_red_function.code(TARGET)
    read = by_type["modbus-read"]
    assert (read["unitid"], read["dataType"], read["adr"], read["quantity"]) == ("7", "HoldingRegister", "0", "123")
    assert (read["server"], read["wires"][0]) == (by_type["modbus-client"]["id"], [by_type["function"]["id"]])
    other = {node["id"] for node in json.loads(node_red.text(Target(bay="bay-3")))}
    assert not other & set(ids)  # two bays fit into one Node-RED


def test_node_red_decodes_and_reports_may_move_or_in_place() -> None:
    first, second, third, fourth = function_node([(0, image(5)), (100, image(6)), (100, image(7)), (100, placed(8))])
    off = [{"topic": name, "payload": False} for name in ("may_move", "in_place", "rolling")]
    assert first == [[*off[:2], None, first[0][3], None, off[2]], "heartbeat"]
    assert second == [[None] * 6, "heartbeat"]
    (may_move, in_place, data, diagnosis, write, rolling), status = third
    assert (may_move["payload"], in_place, diagnosis["payload"]["code"], status) == (True, None, 0, "may move")
    assert write is rolling is None  # this gateway takes no writes
    for name, value in decode(image(7)).items():
        assert data["payload"][name] == (None if value is None else pytest.approx(value, abs=1e-3)), name
    assert data["payload"]["status_may_move"] is True
    (may_move, in_place, _, diagnosis, *_), status = fourth
    assert (may_move["payload"], in_place["payload"], diagnosis, status) == (False, True, None, "in place")


def placed(heartbeat: int, **changes: Any) -> list[int]:
    return list(encode(standing(heartbeat, **changes), 1_763_640_000_123_456_789, "big", TARGET.identity))


def test_node_red_shows_no_sentinel_as_a_value() -> None:
    code = node_red_function.code(Target())
    decoded = code[: code.index("const now = Date.now();")] + "return [decode(msg.payload)];"
    ((data,), _), *_ = run_function(decoded, [(0, empty())])
    expected = decode(empty())
    assert [name for name, value in expected.items() if value is None and data[name] is not None] == []


def test_node_red_accepts_the_other_word_order_only_where_configured() -> None:
    messages = [(100, image(n, "little")) for n in (5, 6, 7)]
    assert [status for _, status in function_node(messages)] == ["word_order"] * 3
    configured = function_node(messages, LITTLE)
    assert configured[2][1] == "may move"
    assert configured[2][0][2]["payload"]["timestamp"] == 1_763_640_000_123


def test_node_red_turns_off_on_silence_on_a_frozen_heartbeat_and_on_a_clock_set_back() -> None:
    live: Messages = [(0, placed(5)), (100, placed(6)), (100, placed(7))]
    limit = HEARTBEAT_TIMEOUT_MS
    cases: list[tuple[Messages, str]] = [
        ([(limit - 1, "tick")], "in place"),
        ([(limit, "tick")], "poll_failed"),
        ([(limit - 1, placed(7))], "in place"),
        ([(limit, placed(7))], "heartbeat"),
        ([(100, placed(7)), (limit - 100, "tick")], "heartbeat"),
        ([(100, "")], "poll_failed"),
        ([(100, ""), (limit, placed(9))], "heartbeat"),  # another number, but no change was seen
        ([(100, ""), (limit, placed(9)), (100, placed(10))], "heartbeat"),
        ([(100, ""), (limit, placed(9)), (100, placed(10)), (100, placed(11))], "in place"),
        ([(-5000, placed(7))], "heartbeat"),
        ([(100, "tick"), (100, placed(8))], "in place"),
    ]
    for (more, status), ran in zip(cases, function_nodes([live + more for more, _ in cases]), strict=True):
        assert ran[-1][1] == status, more


def test_node_red_gives_no_output_for_a_frozen_image() -> None:
    zeros = [0] * BLOCK_WORDS
    befores = [[], [zeros], [image(3)], [placed(3)], [zeros, image(3)]]
    runs: list[Messages] = [
        [(100, words) for words in before] + [(100, frozen)] * 12
        for frozen in (image(7), placed(7))
        for before in befores
    ]
    for ran in function_nodes(runs):
        assert [out["payload"] for outputs, _ in ran for out in outputs[:2] if out] == [False, False]


@pytest.mark.one_interpreter
def test_node_red_writes_what_is_requested_from_the_first_command_on_and_wants_an_answer() -> None:
    def alive(n: int, echo: int) -> list[int]:
        return placed(n, plc=Handshake(PlcLink.ALIVE, heartbeat=echo))

    command: dict[str, Any] = {
        "topic": "command",
        "payload": {"truck_present": True, "release": True, "spout_up": True, "recipe": 7},
    }
    less: dict[str, Any] = {"topic": "command", "payload": {"release": False, "unheard_of": True}}
    reading: Messages = [(100, alive(n, 77)) for n in (5, 6, 7)]  # beside a PLC that writes
    commanding = [(10, command), (100, alive(8, 77)), (10, less), (100, alive(9, 1)), (100, alive(10, 2))]
    ran = function_node([*reading, *commanding, *((100, alive(11 + n, 77)) for n in range(6))])
    assert [outputs[4] for outputs, _ in ran[:3]] == [None] * 3
    assert ran[2][1] == "in place"
    assert ran[3][0] is None
    written = [outputs[4]["payload"] for outputs, _ in ran[4:] if outputs is not None]
    there = 1 << Control.TRUCK_PRESENT | 1 << Control.SPOUT_UP
    assert written == [[1, there | 1 << Control.RELEASE, 7], *([n, there, 7] for n in range(2, 10))]
    # Once it writes, its own numbers must return: the PLC's 77 is no answer.
    assert [status for _, status in ran[4:]] == ["no_echo"] * 3 + ["in place"] * 5 + ["no_echo"] * 2
    raised: dict[str, Any] = {"topic": "command", "payload": {"spout_up": True}}
    early: dict[str, Any] = {"topic": "command", "payload": {"release": True}}
    *_, (outputs, _) = function_node([*reading, (10, early), (10, raised), (100, alive(8, 77))])
    assert outputs[4]["payload"] == [1, 1 << Control.SPOUT_UP, 0], "a spout that goes up releases no truck"
    *_, (outputs, _) = function_node([(10, command), *reading, (100, placed(8))])
    assert outputs[4] is None


# ---- the command


def run(*argv: str) -> int:
    parser = argparse.ArgumentParser()
    verb.configure(parser)
    return verb.main(parser.parse_args(argv))


@pytest.mark.parametrize("name", SUMMARY)
def test_the_command_writes_each_format(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new"
    argv = ["--bay", "bay-2", "--host", "10.1.2.3", "--port", "5020", "--unit-id", "7"]
    assert run("--format", name, *argv, "--out", f"{folder}/") == 0
    files = export(name, (TARGET,))
    written = {path.name: path.read_bytes().decode() for path in folder.iterdir()}
    assert written == files
    assert capsys.readouterr().err.split() == [str(folder / file) for file in files]
    if len(files) == 1:
        assert run("--format", name, *argv) == 0
        assert capsys.readouterr().out.encode() == next(iter(files.values())).encode()
        assert run("--format", name, *argv, "--out", str(tmp_path / "one")) == 0
        assert (tmp_path / "one").is_file()


def test_without_a_format_it_is_text(capsys: pytest.CaptureFixture[str]) -> None:
    assert run() == 0
    assert capsys.readouterr().out == export("text", (Target(),))["registers.txt"]


def test_two_files_need_a_folder() -> None:
    with pytest.raises(ConfigError, match=r"openplc makes 2 files \(loading_bay.st, mbconfig.cfg\): give --out DIR"):
        run("--format", "openplc")


def test_several_bays_are_given_by_name_and_unit_id(tmp_path: Path) -> None:
    argv = ["--host", "10.1.2.3", "--port", "5020", "--bay", "bay-2:7", "--bay", "bay-3:8", "--out", f"{tmp_path}/"]
    for name in ("st", "kepware", "openplc"):
        assert run("--format", name, *argv) == 0
        for file, text in export(name, (TARGET, SECOND)).items():
            assert (tmp_path / file).read_bytes().decode() == text
    assert (tmp_path / "bay_3-kepware-tags.csv").is_file()
    assert run("--format", "openplc", *argv, "--writes") == 0
    assert '"80"' in (tmp_path / openplc.DEVICES).read_text()


def test_the_configuration_says_which_bays_there_are_and_who_they_are(tmp_path: Path) -> None:
    config = tmp_path / "plant.toml"
    config.write_text(
        'site = "north"\ninstance = "gw2"\n[modbus]\nport = 5020\nword_order = "little"\nwrites = true\n'
        'plc_addresses = ["10.1.2.9"]\n[modbus.handshake]\ntrigger_timeout_s = 4.0\n'
        '[[bays]]\nname = "a"\nunit_id = 3\n[[bays]]\nname = "b"\nunit_id = 4\n'
    )
    a = Target("a", "10.1.2.3", 5020, 3, "little", writes=True, site="north", gateway="gw2", trigger_timeout_s=4.0)
    argv = ["--format", "openplc", "--config", str(config), "--host", "10.1.2.3", "--out", f"{tmp_path}/"]
    for more, targets in (((), (a, replace(a, bay="b", unit_id=4))), (("--bay", "a"), (a,))):
        assert run(*argv, *more) == 0
        for file, text in export("openplc", targets).items():
            assert (tmp_path / file).read_text() == text
    text = "".join(export("st", (replace(a, trigger_timeout_s=20.0),)).values())
    assert "PT := T#22000ms" in text
    assert "WaitTimeout : TIME := T#10000ms;" in text
    others = replace(a, bay="x"), replace(a, site="x"), replace(a, gateway="x")
    assert len({target.identity.number for target in (a, *others)}) == 4, "each name counts"


@pytest.mark.parametrize(("name", "found"), [("st", "T#17000ms"), ("scl", "T#17000ms"), ("l5x", "[17000]")])
def test_an_approach_waits_longer_than_any_bay_takes_to_be_in_place(tmp_path: Path, name: str, found: str) -> None:
    """Of the second: it runs out in 2 s of delay and 0.5 s of brake, stands for as long, is in place after 9.5 s."""
    config = tmp_path / "plant.toml"
    config.write_text(
        "[fusion.cross_check]\nfocal_px = 600.0\nmarker_radius_mm = 90.0\n"
        '[[bays]]\nname = "a"\nunit_id = 3\n[bays.drive]\n'
        '[[bays]]\nname = "b"\nunit_id = 4\n[bays.visit]\nsettle_s = 9.5\n'
        "[bays.drive]\nlag_s = 1.5\nlatency_s = 0.5\nbrake_mm_s2 = 40.0\ncreep_speed_mm_s = 20.0\n"
    )
    assert run("--format", name, "--config", str(config), "--host", "10.1.2.3", "--out", f"{tmp_path}/") == 0
    text = "".join(path.read_text() for path in tmp_path.iterdir() if path.suffix in (".st", ".scl", ".L5X"))
    (line,) = (line for line in text.splitlines() if re.search(r"\bWaitTimeout(Ms)?\b.*:=|Name=.WaitTimeoutMs.", line))
    assert found in text[text.index(line) :][:400]


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (("--bay", "a b"), "--bay: 'a b'"),
        (("--host", "x/y"), "--host: 'x/y'"),
        (("--port", "0"), "--port: 0: 1 to 65535"),
        (("--unit-id", "248"), "--unit-id: 248: 1 to 247"),
        (("--bay", "bay1:x"), "--bay: 'bay1:x': NAME or NAME:UNIT"),
        (("--bay", "bay1:0"), "--unit-id: 0: 1 to 247"),
        (("--bay", "bay1:1", "--bay", "bay2:1"), "--bay: two bays have the same unit id: 1, 1"),
        (("--bay", "bay-1:1", "--bay", "bay_1:2"), "--bay: two bays have the same name: bay_1, bay_1"),
        (("--config", "config/simulate.toml", "--bay", "bay7"), "--bay: 'bay7': config/simulate.toml has bay1"),
        (("--out", "/dev/null/x"), "--out /dev/null/x: Not a directory"),
    ],
)
def test_bad_arguments_are_named(argv: tuple[str, str], message: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(message)):
        run("--format", "st", *argv)


def loxone(targets: tuple[Target, ...]) -> dict[str, str]:
    """A format from outside the package."""
    return {"loxone.txt": "".join(f"{target.host}/{target.unit_id}: {len(REGISTERS)}\n" for target in targets)}


def test_a_format_of_another_distribution_is_found_by_its_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    here = EntryPoint("loxone", f"{__name__}:loxone", EXPORTS.group)
    monkeypatch.setattr(registry, "entry_points", lambda group: [here] if group == "gateway.plc_exports" else [])
    assert run("--format", "loxone", "--host", "10.1.2.3", "--bay", "bay-2:7") == 0
    assert capsys.readouterr().out == f"10.1.2.3/7: {len(REGISTERS)}\n"
    with pytest.raises(ConfigError, match=r"no export format is called 'step7'; there is: ignition, .*, loxone"):
        run("--format", "step7")


@pytest.mark.parametrize(("bay", "name"), [("bay-2", "bay_2"), ("7", "bay_7"), ("North--gate_", "North_gate")])
def test_a_bay_has_a_name_that_plc_languages_take(bay: str, name: str) -> None:
    assert Target(bay=bay).identifier == name
    assert Target(bay=bay).instance == (name if name.startswith("bay") else f"bay_{name}")


# ---- the page


def test_every_reason_and_diagnosis_has_a_remedy() -> None:
    assert set(plc_integration.REMEDY) == set(Reason)
    assert all(plc_integration.REMEDY.values())
    shown = plc_integration.diagnoses()
    assert sorted(int(n) for n in re.findall(r"^\|[^|]*\| (\d+) \|", shown, re.MULTILINE)) == list(Diagnosis)
    assert EXPORTS.names() == tuple(SUMMARY)
    formats = plc_integration.formats()
    for name in SUMMARY:
        assert f"| `{name}` |" in formats
