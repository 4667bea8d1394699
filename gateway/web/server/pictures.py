"""Pictures of a bay's camera for the pages: encoded on request, once for all viewers. IO.

A frame is shown with its own reading: as soon as the newest reading is known, its own frame is copied out of the
ring, by number. Where it was overwritten meanwhile, the newest frame is shown without a reading rather than with a
wrong one.
"""

import asyncio
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field

import cv2

from gateway.clock import Clock
from gateway.core.readings import VisionReading
from gateway.durations import NS_PER_S
from gateway.errors import GatewayError
from gateway.vision.pixels import Image
from gateway.vision.transport.ring import Snapshot
from gateway.web.server.gateway_client import GatewayClient

WAIT_S = 5.0  # for a newer frame; then the answer is 204, and the page requests again
JPEG_QUALITY = 80
PAUSE_S = 0.01
MIN_WIDTH_PX = 16


class UnencodableError(GatewayError):
    """OpenCV could not make a picture file of a frame."""


@dataclass(frozen=True, slots=True)
class Picture:
    """One frame as JPEG. `reading`: what was seen in this very frame; None: not known."""

    jpeg: bytes
    seq: int
    t_capture_ns: int
    width_px: int  # of the frame, not of the JPEG
    height_px: int
    reading: VisionReading | None


@dataclass(slots=True)
class _CachedFrame:
    """The newest frame that was copied, and the JPEGs made of it, by width."""

    frame: Snapshot
    reading: VisionReading | None
    copied_ns: int
    jpegs: dict[int, bytes] = field(default_factory=dict)


class Pictures:
    """Encodes on one separate thread; every size of a frame is encoded once. `pace` is real time."""

    def __init__(
        self, client: GatewayClient, pace: Clock, *, max_hz: float, max_width_px: int, thread: Executor | None = None
    ) -> None:
        self._client = client
        self._pace = pace
        self._min_ns = round(NS_PER_S / max_hz)
        self._max_width_px = max_width_px
        self._thread = thread or ThreadPoolExecutor(1, thread_name_prefix="pictures")
        self._turns = {bay: asyncio.Lock() for bay in client.bays}
        self._cached: dict[str, _CachedFrame] = {}
        self.encoded = 0

    async def newer(self, bay: str, after: int | None, width_px: int) -> Picture | None:
        """The newest frame, if it is another than `after`; waits for one. None: none arrived in time.

        A frame is shown as long as it is the newest one copied within the pace; never one from before a silence.
        """
        width_px = max(MIN_WIDTH_PX, min(width_px, self._max_width_px))
        try:
            async with asyncio.timeout(WAIT_S):
                with self._client.watching(bay):
                    async with self._turns[bay]:
                        cached = await self._fresh(bay, after)
                        return await self._picture(cached, width_px)
        except TimeoutError:
            return None

    async def _fresh(self, bay: str, after: int | None) -> _CachedFrame:
        number = self._client.answers  # earlier data is of no use: its frame was overwritten
        while True:
            cached = self._cached.get(bay)
            young = cached is not None and self._pace.now_ns() - cached.copied_ns < self._min_ns
            if cached is not None and young and cached.frame.seq != after:
                return cached
            if young or (report := await self._client.newer(bay, number, WAIT_S)) is None:
                await asyncio.sleep(PAUSE_S)
                continue
            number = report.number
            reading: VisionReading | None = report.now.state.vision
            frame = self._client.snapshot(bay, report.now.state.vision.frame_id)
            if frame is None:
                frame, reading = self._client.snapshot(bay), None
            if frame is not None and (cached is None or frame.seq != cached.frame.seq):
                self._cached[bay] = _CachedFrame(frame, reading, self._pace.now_ns())

    async def _picture(self, cached: _CachedFrame, width_px: int) -> Picture:
        frame = cached.frame
        if (jpeg := cached.jpegs.get(width_px)) is None:
            loop = asyncio.get_running_loop()
            jpeg = await loop.run_in_executor(self._thread, encoded, frame.image, width_px)
            cached.jpegs[width_px] = jpeg
            self.encoded += 1
        height, width = frame.image.shape[:2]
        return Picture(jpeg, frame.seq, frame.t_capture_ns, width, height, cached.reading)


def encoded(image: Image, width_px: int) -> bytes:
    """JPEG, made smaller to `width_px` where it is wider. Raises UnencodableError."""
    height, width = image.shape[:2]
    if width > width_px:
        size = (width_px, max(1, round(height * width_px / width)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
    return picture_file(image, "jpg", cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY)


def picture_file(image: Image, ending: str, *options: int) -> bytes:
    """Raises UnencodableError."""
    done, data = cv2.imencode(f".{ending}", image, options)
    if not done:
        raise UnencodableError(f"this frame can't be made a {ending.upper()}")
    return data.tobytes()
