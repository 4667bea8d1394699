"""The table as other programs and people get it, and the page in docs/ that must not drift from it."""

import argparse
import csv
import io
import json
import struct
from pathlib import Path
from typing import Any

import pytest

from gateway.cli import registers as verb
from gateway.core.detection import Circle
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Reason, StateVector
from gateway.modbus.exports import tables
from gateway.modbus.exports.target import Target
from gateway.modbus.registers.register_map import REGISTERS, RESERVED, encode

PAGE = Path(__file__).parents[3] / "docs" / "registers.md"


def run(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    parser = argparse.ArgumentParser()
    verb.configure(parser)
    assert verb.main(parser.parse_args(argv)) == 0
    return capsys.readouterr().out


def test_json_rows(capsys: pytest.CaptureFixture[str]) -> None:
    rows: list[dict[str, Any]] = json.loads(run(capsys, "--json"))
    assert [row["name"] for row in rows] == [register.name for register in REGISTERS]
    by_name = {row["name"]: row for row in rows}
    assert by_name["radius"] == {
        "name": "radius",
        "address": 12,
        "words": 1,
        "type": "uint16",
        "scale": 0.1,
        "unit": "px",
        "meaning": "marker radius R; 0xFFFF: no value; limited to 0..6553.4",
    }
    assert (by_name["u"]["type"], by_name["u"]["words"]) == ("int16", 1)
    assert by_name["timestamp"]["words"] == 4
    for row in rows:
        assert tuple(row)[:7] == tables.COLUMNS
        assert set(row) - set(tables.COLUMNS) <= {"codes", "bits"}
        assert row["words"] == {"uint16": 1, "int16": 1, "uint32": 2, "float32": 2, "uint64": 4}[row["type"]]
        assert row["meaning"]
    assert {c["code"]: c["meaning"] for c in by_name["reason"]["codes"]} == Reason.meanings()
    for name in ("vision_quality", "range_quality"):
        assert {c["code"]: c["meaning"] for c in by_name[name]["codes"]} == Quality.meanings()
    bits = "stop may_move d d_unknowable vision_good range_good healthy starting fault vision_fault range_fault"
    bits += " disagree gateway_fault shutdown clamped vision_age_unproven"
    assert {b["bit"]: b["name"] for b in by_name["status"]["bits"]} == dict(enumerate(bits.split()))


def test_an_image_can_be_decoded_with_the_json_alone() -> None:
    """Decodes an image by nothing but the exported rows, as an importer of tags would."""
    state = StateVector(
        "b",
        vision=VisionReading(0, Quality.GOOD, Circle(12.34, -5.0, 181.26), frame_id=70_000),
        range=RangeReading(0, Quality.GOOD, 299.6),
    )
    image = encode(state, 1_763_640_000_123_456_789, "big")
    formats = {"uint16": ">H", "int16": ">h", "uint32": ">I", "uint64": ">Q", "float32": ">f"}
    read = {}
    for row in tables.rows():
        words = image[row["address"] : row["address"] + row["words"]]
        packed = struct.pack(f">{len(words)}H", *words)
        read[row["name"]] = struct.unpack(formats[row["type"]], packed)[0] * row["scale"]
    assert read["u"] == pytest.approx(12.3)
    assert read["v"] == pytest.approx(-5.0)
    assert read["radius"] == pytest.approx(181.3)
    assert read["distance"] == 300
    assert read["radius_f32"] == pytest.approx(181.26, abs=1e-4)
    assert read["frame_id"] == 70_000
    assert read["timestamp"] == 1_763_640_000_123
    assert read["known_f32"] == 123456.0


def test_csv_has_the_same_rows(capsys: pytest.CaptureFixture[str]) -> None:
    lines = list(csv.DictReader(io.StringIO(run(capsys, "--csv"))))
    assert tuple(lines[0]) == tables.COLUMNS
    rows = [{column: str(row[column]) for column in tables.COLUMNS} for row in tables.rows((Target(),))]
    assert lines == rows


def test_text_and_markdown_show_every_register_code_and_reserved_place(capsys: pytest.CaptureFixture[str]) -> None:
    for shown in (run(capsys), run(capsys, "--markdown")):
        for row in tables.rows():
            assert row["name"] in shown
            assert row["meaning"] in shown
        assert all(f"reserved, reads 0: {place.purpose}" in shown for place in RESERVED)
        for meaning in (*Reason.meanings().values(), *Quality.meanings().values()):
            assert meaning in shown
        assert max(len(line) for line in shown.splitlines()) < 160
    assert "| 12 | radius | uint16 | 0.1 px |" in run(capsys, "--markdown")
