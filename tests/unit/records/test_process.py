"""What the recorder process keeps of incidents, and what it says of those it could not keep."""

import errno
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from gateway.config import RecordsConfig
from gateway.records import recording
from gateway.records.incident import Incident
from gateway.records.messages import BayJob, Job, PicturesNotKept
from gateway.records.process import Recorder
from gateway.records.store import Store
from gateway.vision.transport.ring import Snapshot
from tests.unit.records.test_segment import HEAD
from tests.virtual_time import LoopClock, in_virtual_time

NOISE = np.random.default_rng(1).integers(0, 255, (120, 160, 3), np.uint8)  # 58 kB, also as PNG


class Sent(list[Any]):
    """Instead of the channel to the main process."""

    send = list.append

    @property
    def not_kept(self) -> list[PicturesNotKept]:
        return [message for message in self if isinstance(message, PicturesNotKept)]


def recorder(folder: Path, sent: Sent) -> Recorder:
    """A megabyte a day: a quarter at once, half of that for routine stops."""
    job = Job(str(folder), RecordsConfig(picture_mb_per_day=1, min_free_percent=0), LoopClock(), (BayJob(HEAD, None),))  # type: ignore[arg-type]
    return Recorder(cast(Any, sent), job)


def keep(process: Recorder, *why: str, number: int = 3) -> None:
    now_ns = LoopClock().now_ns()
    pictures = tuple(Snapshot(NOISE, n, now_ns + n) for n in range(number))
    process._keep(process._bays["bay1"], Incident(now_ns, why, pictures), now_ns)


def kept(folder: Path) -> int:
    return sum(1 for path in recording.pictures_in(folder / "bay1") for _ in recording.pictures(path))


@in_virtual_time
async def test_what_is_not_kept_is_told_and_a_restart_refills_nothing(tmp_path: Path) -> None:
    sent = Sent()
    numbers = []
    for why in ("stop_raised", "stop_raised", "stop_raised", "moved"):
        keep(recorder(tmp_path, sent), why)  # a new process each time
        numbers.append(kept(tmp_path))
    assert numbers == [1, 2, 2, 3]
    assert [(message.number, message.matters) for message in sent.not_kept] == [
        (2, False), (2, False), (3, False), (2, True),
    ]  # fmt: skip
    assert sent.not_kept[-1].detail == "2 of 3 pictures of moved: picture_mb_per_day is used up"


@in_virtual_time
async def test_an_incident_that_matters_without_any_picture_is_told_but_no_alarm(tmp_path: Path) -> None:
    sent = Sent()
    keep(recorder(tmp_path, sent), "moved", number=0)
    keep(recorder(tmp_path, sent), "stop_raised", number=0)
    assert sent.not_kept == [PicturesNotKept("bay1", 0, "0 of 0 pictures of moved: none was there", False)]


@in_virtual_time
async def test_what_the_disk_refuses_is_told_whatever_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(Store, "pictures", refused)
    sent = Sent()
    keep(recorder(tmp_path, sent), "moved")
    assert sent.not_kept == [PicturesNotKept("bay1", 3, "3 of 3 pictures of moved: Input/output error", True)]
