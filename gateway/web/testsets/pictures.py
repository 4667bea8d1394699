"""Pictures of test sets on the thread of the trials: decoded, shown, searched for the proposal of a label. asyncio."""

import asyncio
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import cv2

from gateway.config import VisionConfig
from gateway.core.detection import Circle
from gateway.vision.detect import registry
from gateway.vision.pixels import Image
from gateway.web.server.pictures import encoded, picture_file
from gateway.web.tuning import trial, uploads
from gateway.web.tuning.trial_thread import TrialThread
from gateway.web.tuning.uploads import MAX_FILE_BYTES

QUALITY = 98  # of a frame whose PNG would be too large
_NUMBERS = itertools.count(1)

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class CircleProposal:
    """`circle` None: no marker that the robust method is sure of."""

    width_px: int
    height_px: int
    circle: Circle | None
    confidence: float | None


async def uploaded(thread: TrialThread, text: str) -> bytes:
    """The picture's file, which can be decoded. Raises UploadError, TrialsBusyError."""

    def work(_: Callable[[], bool]) -> bytes:
        data = uploads.contents(text)
        uploads.image_of(data)
        return data

    return await _worked(thread, work)


async def file_of(thread: TrialThread, image: Image) -> bytes:
    """A frame as a file: every pixel as it is, where that is not too large. Raises TrialsBusyError."""

    def work(_: Callable[[], bool]) -> bytes:
        data = picture_file(image, "png", cv2.IMWRITE_PNG_COMPRESSION, 3)
        return data if len(data) <= MAX_FILE_BYTES else picture_file(image, "jpg", cv2.IMWRITE_JPEG_QUALITY, QUALITY)

    return await _worked(thread, work)


class ShownPictures:
    """One at a time, so that a page full of them leaves room for trials."""

    def __init__(self, thread: TrialThread) -> None:
        self._thread = thread
        self._turn = asyncio.Lock()

    async def jpeg(self, data: bytes, width_px: int) -> bytes:
        """Raises UploadError, TrialsBusyError."""
        async with self._turn:
            return await _worked(self._thread, lambda _: encoded(uploads.image_of(data), width_px))

    async def proposal(self, data: bytes, lens: VisionConfig) -> CircleProposal:
        """`lens`: whose intrinsics count. Raises UploadError, TrialsBusyError."""

        def work(_: Callable[[], bool]) -> CircleProposal:
            image = uploads.image_of(data)
            found = registry.once(trial.shipped(lens))(image)
            return CircleProposal(image.shape[1], image.shape[0], found.circle, found.confidence)

        async with self._turn:
            return await _worked(self._thread, work)


async def _worked(thread: TrialThread, work: Callable[[Callable[[], bool]], T]) -> T:
    return await thread.work(f"picture of a test set {next(_NUMBERS)}", work)
