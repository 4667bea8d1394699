"""Any file, folder or pattern on the command line, turned into (H, W, 3) uint8 BGR pictures, or into one clear error.

Conversions of a picture, so that a number can be traced back to its pixel:
- grey is repeated into three channels, so it has no red in it; a palette is resolved;
- alpha is dropped: the stored colours count, as with `cv2.imread`, also where they are transparent;
- 16 bit per channel becomes round(value / 257), full scale to full scale: 12 bits stored in 16 stay dark; methods that
  use all 16 bits are given them (`InputPicture.pixels`);
- an EXIF orientation is applied, so that u and v are those of the picture as every viewer shows it;
- animations and multi-page files give every frame, counted from 0, like a video.

A file that breaks off is an error, except a video's: containers often announce a wrong number of frames, so a video
just ends where no more can be decoded. A frame within it that can't be is skipped with a warning, and keeps its number.
"""

import logging
import os
import re
import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from glob import glob
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.errors import ConfigError, GatewayError
from gateway.vision.offline.orientation import orientation, upright
from gateway.vision.pixels import PICTURE_SUFFIXES, AnyImage, Image, bgr, bgr8, natural_key
from gateway.vision.source import ffmpeg

log = logging.getLogger(__name__)

MAX_PIXELS = 1 << 28  # of one picture: some 3 GB while it is worked on
MAX_BYTES = (1 << 31) - 1  # of one file that is not a video
_BATCH_PIXELS = 1 << 26  # decoded at once of an animation, as complete frames, at least one

# fmt: off
VIDEO_SUFFIXES = frozenset((
    ".avi", ".flv", ".h264", ".h265", ".m2ts", ".m4v", ".mjpeg", ".mjpg", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg",
    ".ogv", ".ts", ".webm", ".wmv",
))
# fmt: on

_MAGIC = re.compile(
    rb"\x89PNG|\xff\xd8\xff|GIF8|BM|II\*\0|MM\0\*|RIFF....WEBP|....ftypavi[fs]|\0\0\0\x0cjP  |P[1-7]\s|#\?RADIANCE",
    re.DOTALL,
)
_FLAGS = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH


class InputError(GatewayError):
    """This input gives no picture, or no further one. The rest of a batch is processed."""


@dataclass(frozen=True, slots=True)
class InputPicture:
    """One decoded picture; `frame` counts from 0 in files that hold several, and is None in those that hold one."""

    pixels: AnyImage
    frame: int | None = None

    @property
    def image(self) -> Image:
        """In 8 bits; made anew of more of them."""
        return bgr8(self.pixels)


def expand(arguments: Sequence[str]) -> list[Path]:
    """Files, folders (their pictures and videos, not recursive) and patterns (`**` recursive), in natural order.

    What does not exist or matches nothing stays in the list as it is, for `read` to report it in its place; but where
    there is nothing else, raises ConfigError.
    """
    paths: list[Path] = []
    empty: list[str] = []
    for argument in arguments:
        path = Path(argument)
        matches = [path]
        if _is_pattern(argument) and not os.path.lexists(path):
            matches = sorted(map(Path, glob(argument, recursive=True)), key=natural_key)
        files = [file for match in matches for file in (_in_folder(match) if os.path.isdir(match) else [match])]
        if not files:
            empty.append(argument)
        paths += dict.fromkeys(files or [path])  # `**` finds a folder and what is in it
    if len(empty) == len(arguments):
        raise ConfigError(f"no picture or video in: {', '.join(empty)}" if empty else "no input named")
    return paths


def read(path: Path) -> Iterator[InputPicture]:
    """Every picture in one file, in order, decoded one after the other. Raises InputError, perhaps after some."""
    try:
        info = path.stat()
        if not stat.S_ISREG(info.st_mode):
            raise InputError("a folder without pictures or videos" if os.path.isdir(path) else "not a regular file")
        if info.st_size == 0:
            raise InputError("the file is empty")
        suffix = path.suffix.lower()
        with path.open("rb") as file:
            known = suffix in PICTURE_SUFFIXES or _MAGIC.match(file.read(16)) is not None
            if known and suffix not in VIDEO_SUFFIXES:
                if info.st_size > MAX_BYTES:
                    raise InputError(f"a picture file of more than {MAX_BYTES >> 20} MiB")
                file.seek(0)
                data = file.read(MAX_BYTES)
    except FileNotFoundError as error:
        raise InputError("matches no file" if _is_pattern(str(path)) else "no such file") from error
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise InputError(f"cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if suffix in VIDEO_SUFFIXES or not known:
        yield from _video(path)
    elif _holds_several(data):
        yield from _frames(data)
    else:
        yield InputPicture(_colours(_decoded(data)))


def decode(data: bytes) -> Image:
    """The (first) picture in a file's bytes, by the rules of the module. Raises InputError."""
    return bgr8(_colours(_decoded(data)))


def _decoded(data: bytes) -> NDArray[Any]:
    """The same as it is stored."""
    webp = data[8:12] == b"WEBP"
    flags = _FLAGS | (cv2.IMREAD_IGNORE_ORIENTATION if webp else 0)
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data else None
    except cv2.error as error:
        raise InputError(_reason(error)) from error
    if picture is None:
        raise InputError("damaged, cut short, or not a picture in a known format")
    return upright(picture, orientation(data)) if webp else picture


def _colours(picture: NDArray[Any]) -> AnyImage:
    height, width = picture.shape[:2]
    if height * width > MAX_PIXELS:
        raise InputError(f"{width} x {height} px is more than {MAX_PIXELS} pixels")
    try:
        return bgr(picture)
    except ValueError as error:
        raise InputError(str(error)) from error


def _holds_several(data: bytes) -> bool:
    """Whether a picture file may hold more than one frame, by its header."""
    if data.startswith(b"\x89PNG"):
        return 0 <= data.find(b"acTL") < data.find(b"IDAT")
    if data[8:16] == b"WEBPVP8X":
        return bool(data[20] & 2)
    return data.startswith((b"GIF8", b"II*\0", b"MM\0*")) or data[4:12] == b"ftypavis"


def _frames(data: bytes) -> Iterator[InputPicture]:
    """Every frame of an animation or page of a TIFF, some at a time; a single one is a plain picture."""
    first = _decoded(data)
    batch = max(1, _BATCH_PIXELS // (first.shape[0] * first.shape[1]))
    if not _decode_batch(data, 1, 1):
        yield InputPicture(_colours(first))
        return
    start, stated = 0, orientation(data)
    while frames := _decode_batch(data, start, batch):
        yield from (InputPicture(_colours(upright(frame, stated)), start + i) for i, frame in enumerate(frames))
        start += len(frames)


def _decode_batch(data: bytes, start: int, count: int) -> Sequence[NDArray[Any]]:
    """Up to `count` frames from `start` on; none behind the last."""
    buffer = np.frombuffer(data, np.uint8)
    try:
        if data.startswith((b"II*\0", b"MM\0*")):
            # Pages one by one: a range that runs over the end is an error in some versions of the decoder.
            return cv2.imdecodemulti(buffer, _FLAGS, range=(start, start + 1))[1]
        done, animation = cv2.imdecodeanimation(buffer, start, count)
    except cv2.error as error:
        raise InputError(_reason(error)) from error
    if not done:
        raise InputError(f"damaged or cut short at frame {start} or behind it")
    return animation.frames


def open_video(path: Path) -> cv2.VideoCapture:
    """A file through FFmpeg; it may not have opened. Raises InputError for a name that would crash the process."""
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise InputError("the name of a video must be valid UTF-8") from error
    # An absolute path cannot be taken for a URL; FFmpeg by name, as OpenCV may else look for img_01.x, img_02.x, ...
    return ffmpeg.opened(str(path.absolute()), ffmpeg.FILE)


def _video(path: Path) -> Iterator[InputPicture]:
    capture = open_video(path)
    try:
        frame = 0
        while True:
            image, damaged = ffmpeg.read(capture)
            if image is None:
                break
            if damaged:
                log.warning("%s: %d frames from %d on can't be decoded; skipped", path, damaged, frame)
            frame += damaged
            yield InputPicture(_colours(image), frame)
            frame += 1
    except cv2.error as error:
        raise InputError(_reason(error)) from error
    finally:
        capture.release()
    if not frame:
        raise InputError("neither a picture nor a video that can be decoded")


def _reason(error: cv2.error) -> str:
    text = str(error)
    if "CV_IO_MAX_IMAGE" in text:
        return f"too large: more than {MAX_PIXELS} pixels, or a side of more than {1 << 20}"
    if error.code == cv2.Error.StsNoMem:
        return "not enough memory for a picture of this size"
    return f"cannot be decoded: {' '.join(text.split())}"


def _in_folder(folder: Path) -> list[Path]:
    try:
        entries = list(folder.iterdir())
    except OSError:
        return []
    known = PICTURE_SUFFIXES | VIDEO_SUFFIXES
    shown = [path for path in entries if path.suffix.lower() in known and not path.name.startswith(".")]
    return sorted((path for path in shown if not os.path.isdir(path)), key=natural_key)


def _is_pattern(argument: str) -> bool:
    return any(sign in argument for sign in "*?[")
