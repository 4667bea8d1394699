"""What the doctor says of the machine, for each answer that the machine may give."""

import shutil
from collections import namedtuple
from pathlib import Path

import pytest

from gateway.config import GatewayConfig
from gateway.doctor import machine
from gateway.doctor.finding import Finding, Verdict

OK, WARNING, FAULT = Verdict.OK, Verdict.WARNING, Verdict.FAULT
Usage = namedtuple("Usage", "total used free")


def refused() -> int:
    raise OSError(1, "Operation not permitted")


@pytest.mark.parametrize(
    ("status", "verdict", "result"),
    [
        (lambda: 0, OK, "synchronised"),
        (lambda: 0x2001, OK, "synchronised"),
        (lambda: 0x40, WARNING, "it is not synchronised"),
        (refused, WARNING, "Operation not permitted"),
    ],
)
def test_the_clock(status: object, verdict: Verdict, result: str) -> None:
    found = machine.clock(status)  # type: ignore[arg-type]
    assert (found.verdict, found.result) == (verdict, result)
    assert bool(found.remedy) == (result == "it is not synchronised")


def test_the_kernel_answers() -> None:
    assert machine.kernel_status() & ~0xFFFF == 0  # STA_ flags, none other than those of 16 bits


@pytest.mark.parametrize(("load", "verdict"), [(2.8, OK), (2.81, WARNING)])
def test_the_load_of_four_processors(load: float, verdict: Verdict) -> None:
    found = machine.processors(load, 4)
    assert (found.verdict, found.result) == (verdict, f"load average {load:.1f} on 4 processors")


def folders(folder: Path, **records: object) -> list[Finding]:
    return list(machine.folders(GatewayConfig.model_validate({"state_dir": str(folder), "records": records})))


@pytest.mark.parametrize(
    ("free_gb", "verdicts"), [(100, [OK, OK]), (9.1, [OK, OK]), (8.9, [OK, WARNING]), (0.001, [WARNING, WARNING])]
)
def test_room_for_what_is_to_be_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free_gb: float, verdicts: list[Verdict]
) -> None:
    """4 GB of recordings, beside a twentieth of 100 GB that must stay free."""
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(100e9, 0, free_gb * 1e9))
    found = folders(tmp_path / "state", max_mb=4000, min_free_percent=5)
    assert [f.verdict for f in found if f.name in ("state", "records")] == verdicts
    assert not (tmp_path / "state").exists()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_file(**_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(machine, "TemporaryFile", no_file)
    found = folders(tmp_path)
    assert {(f.verdict, f.result) for f in found if f.name in ("state", "records")} == {(FAULT, "Permission denied")}
    assert "the right to write there" in found[0].remedy


def test_nothing_is_kept() -> None:
    assert [f.verdict for f in machine.folders(GatewayConfig(state_dir=""))] == [WARNING]


def test_versions_name_what_counts() -> None:
    assert "gateway 0." in machine.versions().result
    assert "opencv" in machine.versions().result
