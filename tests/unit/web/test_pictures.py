"""Pictures: encoded only when somebody asks, once for all, with the reading of the very same frame."""

import asyncio

import cv2
import numpy as np
import pytest

from gateway.core.detection import Circle
from gateway.core.readings import Quality, VisionReading
from gateway.vision.pixels import Image
from gateway.web.server.pictures import WAIT_S, Pictures, encoded
from tests.unit.web.gateway_client import Plant, plant
from tests.virtual_time import AtOnce, in_virtual_time


def scenery(shade: int) -> Image:
    image = np.full((120, 160, 3), shade, np.uint8)
    cv2.circle(image, (80, 60), 30, (40, 40, 200), -1)
    return image


def shown(jpeg: bytes) -> Image:
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return np.asarray(image, np.uint8)


def film(made: Plant, seq: int, *, reading: bool = True) -> None:
    """The camera writes frame `seq`, and vision tells what it saw in it."""
    now_ns = made.client.clock.now_ns()
    made.rings["bay1"].write(scenery(seq % 256), seq, now_ns)
    if reading:
        made.controls["bay1"].on_reading(VisionReading(now_ns, Quality.GOOD, Circle(80, 60, float(seq)), frame_id=seq))


def of(made: Plant, width_px: int = 1280) -> Pictures:
    return Pictures(made.client, made.client.clock, max_hz=10, max_width_px=width_px, thread=AtOnce())


@in_virtual_time
async def test_nothing_is_encoded_without_a_request() -> None:
    async with plant() as made:
        pictures = of(made)
        for seq in range(1, 60):
            film(made, seq)
            await asyncio.sleep(0.033)
        assert pictures.encoded == 0


@in_virtual_time
async def test_twenty_viewers_get_the_newest_frame_with_its_own_reading_from_one_encoding() -> None:
    async with plant() as made:
        pictures = of(made)
        film(made, 7)
        got = await asyncio.gather(*(pictures.newer("bay1", None, 640) for _ in range(20)))
        assert {picture.seq for picture in got if picture is not None} == {7}
        assert all(p is not None and p.reading is not None and p.reading.circle == Circle(80, 60, 7) for p in got)
        assert pictures.encoded == 1
        first = got[0]
        assert first is not None
        assert (first.width_px, first.height_px) == (160, 120)
        assert np.abs(shown(first.jpeg)[5, 5].astype(int) - 7).max() <= 4


@in_virtual_time
async def test_a_page_gets_another_frame_or_none_at_all_but_never_the_same_again() -> None:
    async with plant() as made:
        pictures = of(made)
        film(made, 1)
        first = await pictures.newer("bay1", None, 640)
        assert first is not None
        begun_s = asyncio.get_running_loop().time()
        assert await pictures.newer("bay1", 1, 640) is None  # the camera has died
        assert asyncio.get_running_loop().time() - begun_s == pytest.approx(WAIT_S, abs=0.1)
        assert await pictures.newer("bay1", None, 640) is None  # nor is it shown to one who comes new

        async def later() -> None:
            await asyncio.sleep(1)
            film(made, 2)

        _, second = await asyncio.gather(later(), pictures.newer("bay1", 1, 640))
        assert second is not None
        assert second.seq == 2
        assert pictures.encoded == 2


@in_virtual_time
async def test_no_more_pictures_are_made_than_the_pace_allows_however_fast_they_are_asked_for() -> None:
    async with plant() as made:
        pictures = of(made)
        stop = asyncio.Event()

        async def camera() -> None:
            for seq in range(1, 100_000):
                if stop.is_set():
                    return
                film(made, seq)
                await asyncio.sleep(0.01)

        async def viewer() -> int:
            after: int | None = None
            count = 0
            while not stop.is_set():
                picture = await pictures.newer("bay1", after, 640)
                assert picture is not None
                assert after is None or picture.seq > after
                after, count = picture.seq, count + 1
            return count

        async def end() -> None:
            await asyncio.sleep(4)
            stop.set()

        _, _, *counts = await asyncio.gather(end(), camera(), *(viewer() for _ in range(5)))
        assert 32 <= pictures.encoded <= 42
        assert all(count is not None and 32 <= count <= 42 for count in counts)


@in_virtual_time
async def test_a_frame_that_was_written_over_is_replaced_by_the_newest_without_a_reading() -> None:
    async with plant() as made:
        pictures = of(made)
        film(made, 1)
        for seq in (2, 3, 4):  # vision is behind: its frame is gone
            await asyncio.sleep(0.01)
            film(made, seq, reading=False)
        await asyncio.sleep(0.01)
        film(made, 5, reading=False)
        picture = await pictures.newer("bay1", None, 640)
        assert picture is not None
        assert (picture.seq, picture.reading) == (5, None)


@pytest.mark.parametrize(("asked", "made"), [(640, 160), (80, 80), (16, 16)])
def test_a_picture_is_made_smaller_but_never_larger(asked: int, made: int) -> None:
    image = shown(encoded(scenery(100), asked))
    assert image.shape[:2] == (made * 120 // 160, made)


@in_virtual_time
async def test_widths_out_of_range_are_brought_into_it() -> None:
    async with plant() as made:
        pictures = of(made, 100)
        film(made, 1)
        large, small = await asyncio.gather(pictures.newer("bay1", None, 100_000), pictures.newer("bay1", None, -5))
        assert large is not None
        assert small is not None
        assert shown(large.jpeg).shape[1] == 100
        assert shown(small.jpeg).shape[1] == 16
