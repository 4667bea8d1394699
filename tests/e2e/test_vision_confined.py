"""What a fault of a decoder is good for in a vision process: tried from inside, by a detection method."""

import asyncio
import errno
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gateway.core.readings import Quality
from tests.e2e.test_vision_pool import STAND_INS, Bay
from tests.e2e.vision_stand_ins import DeviceSpec
from tests.unit.vision.test_streams import MULTIPART, jpeg, part, served

TRIED = ("write a file", "make a file", "remove a file", "run a program", "reach the gateway", "trace")
REFUSED = dict.fromkeys((*TRIED, "open a connection", "take connections"), errno.EPERM)
DONE = {"read a file": 0}


def film(folder: Path) -> str:
    path = str(folder / "film.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (64, 48))
    for level in range(40):
        writer.write(np.full((48, 64, 3), 5 * level, np.uint8))
    writer.release()
    return path


def tried(source: Any, **camera: Any) -> dict[str, int]:
    async def scene() -> dict[str, int]:
        async with Bay(source, detector=f"{STAND_INS}:intruder", **camera) as bay:
            found = await bay.quality(Quality.NO_TARGET)
            later = await bay.quality(Quality.NO_TARGET, found + 3)
            return dict(bay.readings[later].stage_ns)

    return asyncio.run(scene())


def test_beside_a_film_nothing_but_reading_is_left(tmp_path: Path) -> None:
    assert tried(film(tmp_path), loop=True) == REFUSED | DONE


def test_a_device_is_written_to_once_it_is_open_and_no_other_file(tmp_path: Path) -> None:
    device = tmp_path / "video0"
    device.touch()
    assert tried(DeviceSpec(str(device))) == REFUSED | DONE
    assert device.read_bytes().startswith(b"setsetset")


def test_beside_a_stream_connections_are_opened_and_none_is_taken() -> None:
    pictures = [part(jpeg(level)) for level in range(1, 250)]
    with served(MULTIPART, *pictures) as url:
        assert tried(url, frozen_s=0.0, unproven_age="accept") == REFUSED | DONE | {"open a connection": 0}


def test_a_driver_that_needs_more_keeps_its_rights_where_the_configuration_says_so(
    tmp_path: Path,
) -> None:
    found = tried(film(tmp_path), loop=True, confined=False)
    assert found == dict.fromkeys((*REFUSED, *DONE), 0) | {"trace": errno.ESRCH}
