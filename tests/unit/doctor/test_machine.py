"""What the doctor says of the machine, for each answer that the machine may give."""

import errno
import os
import resource
import shutil
import subprocess
from collections import namedtuple
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gateway.config import GatewayConfig
from gateway.doctor import machine
from gateway.web.ipc.devices import Finding, Verdict

OK, WARNING, FAULT = Verdict.OK, Verdict.WARNING, Verdict.FAULT
Usage = namedtuple("Usage", "total used free")


def refused() -> int:
    raise OSError(1, "Operation not permitted")


def silent() -> bool:
    raise FileNotFoundError(2, "No such file or directory")


@pytest.mark.parametrize(
    ("status", "service", "verdict", "result"),
    [
        (lambda: 0, silent, OK, "synchronised"),
        (lambda: 0x2001, silent, OK, "synchronised"),
        (lambda: 0x40, silent, WARNING, "it is not synchronised"),
        (refused, lambda: True, OK, "synchronised"),
        (refused, lambda: False, WARNING, "it is not synchronised"),
        (refused, silent, WARNING, "No such file or directory"),
    ],
)
def test_the_clock(status: Callable[[], int], service: Callable[[], bool], verdict: Verdict, result: str) -> None:
    found = machine.clock(status, service)
    assert (found.verdict, found.result) == (verdict, result)
    assert bool(found.remedy) == (verdict is WARNING)


@pytest.mark.parametrize(
    ("script", "answer"),
    [
        ("echo yes", "yes"),
        ("echo no", "no"),
        ("echo Failed to connect to bus >&2; exit 1", "timedatectl: Failed to connect to bus"),
        ("exit 1", "timedatectl: no answer"),
        ("exec sleep 60", "timedatectl does not answer"),
    ],
)
def test_what_timedatectl_may_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str, answer: str) -> None:
    program = tmp_path / "timedatectl"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setattr(machine, "TIMEDATECTL_S", 0.2 if "sleep" in script else 20)
    if answer in ("yes", "no"):
        assert machine.service_manager_status() == (answer == "yes")
        return
    with pytest.raises(OSError, match=answer):
        machine.service_manager_status()


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


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.EACCES, "give this user ("),
        (errno.ENOSPC, "free some space"),
        (errno.EROFS, "the disk takes no writes: look at what the kernel says of it (dmesg)"),
    ],
)
def test_a_folder_that_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, remedy: str
) -> None:
    def no_file(**_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(machine, "TemporaryFile", no_file)
    found = [f for f in folders(tmp_path) if f.name in ("state", "records")]
    assert {(f.verdict, f.result) for f in found} == {(FAULT, os.strerror(number))}
    assert found[0].remedy.startswith(remedy)


def test_a_folder_that_this_user_may_not_see_and_a_file_that_goes_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both were tracebacks."""
    kept = tmp_path / "state"
    kept.mkdir()
    (kept / "gone").symlink_to(tmp_path / "nowhere")
    (kept / "file").write_bytes(b"x" * 1000)
    real = os.stat

    def stat(path: Any, **kwargs: Any) -> os.stat_result:
        if str(path).endswith("/file"):
            raise FileNotFoundError(2, "No such file or directory")
        if "/forbidden/" in str(path):
            raise PermissionError(13, "Permission denied")
        return real(path, **kwargs)

    monkeypatch.setattr(os, "stat", stat)
    assert [f.verdict for f in folders(kept) if f.name == "state"] == [OK]
    (tmp_path / "forbidden").mkdir()
    assert [f.tried for f in folders(tmp_path / "forbidden" / "x") if f.name == "state"] == [
        f"write a file to {tmp_path / 'forbidden'}"
    ]


@pytest.mark.parametrize(
    ("kind", "life", "found"),
    [
        (
            "SD",
            None,
            (WARNING, "ask mmcblk0 (SD) how worn it is", "it does not say; recording writes up to 0.8 GB a day"),
        ),
        ("MMC", None, (OK, "ask mmcblk0 (MMC) how worn it is", "it does not say; recording writes up to 0.8 GB a day")),
        ("MMC", "0x02 0x03", (OK, "ask mmcblk0 (MMC) how worn it is", "up to 30 % of its life")),
        ("MMC", "0x08 0x03", (WARNING, "ask mmcblk0 (MMC) how worn it is", "up to 80 % of its life")),
        ("0", None, None),  # a disk at SATA has a number there
        ("", None, None),
    ],
)
@pytest.mark.parametrize("partition", [False, True])
def test_how_worn_a_card_is(
    tmp_path: Path, kind: str, life: str | None, found: tuple[Verdict, str, str] | None, partition: bool
) -> None:
    number = tmp_path.stat().st_dev
    disk = tmp_path / "devices/mmcblk0"
    (disk / "device").mkdir(parents=True)
    place = disk / "mmcblk0p2" if partition else disk
    place.mkdir(exist_ok=True)
    if kind:
        (disk / "device/type").write_text(f"{kind}\n")
    if life is not None:
        (disk / "device/life_time").write_text(f"{life}\n")
    (tmp_path / "dev/block").mkdir(parents=True)
    (tmp_path / f"dev/block/{os.major(number)}:{os.minor(number)}").symlink_to(place)
    answers = [(f.verdict, f.tried, f.result) for f in machine._wear(tmp_path, 2, tmp_path)]
    assert answers == ([] if found is None else [found])


@pytest.mark.parametrize(
    ("policy", "verdict", "result"),
    [
        (os.SCHED_OTHER, WARNING, "ordinary: other programs may delay it"),
        (os.SCHED_FIFO, OK, "real-time"),
        (os.SCHED_RR | os.SCHED_RESET_ON_FORK, OK, "real-time"),
    ],
)
def test_the_priority_of_a_running_gateway(
    monkeypatch: pytest.MonkeyPatch, policy: int, verdict: Verdict, result: str
) -> None:
    """Not that of who asks: systemd gives the service its priority, and no right to have it."""
    monkeypatch.setattr(os, "sched_getscheduler", {4711: policy}.__getitem__)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (0, 0))
    found = machine.priority(4711)
    assert (found.verdict, found.result) == (verdict, result)


@pytest.mark.parametrize(("limit", "uid", "verdict"), [(0, 1000, WARNING), (10, 1000, OK), (0, 0, OK)])
def test_the_right_to_priority_where_no_gateway_runs(
    monkeypatch: pytest.MonkeyPatch, limit: int, uid: int, verdict: Verdict
) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (limit, limit))
    monkeypatch.setattr(os, "geteuid", lambda: uid)
    assert machine.priority().verdict is verdict


def test_a_gateway_that_has_just_ended_has_no_priority() -> None:
    done = subprocess.Popen(["true"])
    done.wait()
    assert machine.priority(done.pid).result == "No such process"


def test_nothing_is_kept() -> None:
    assert [f.verdict for f in machine.folders(GatewayConfig(state_dir=""))] == [WARNING]


def test_versions_name_what_counts() -> None:
    assert "gateway 0." in machine.versions().result
    assert "opencv" in machine.versions().result
