"""Which uploaded pictures are taken: by their header, before they are decoded."""

import base64
import struct

import cv2
import numpy as np
import pytest

from gateway.web.tuning.uploads import MAX_FILE_BYTES, UploadError, decoded, size_of


def encoded(suffix: str, height: int = 30, width: int = 50, *options: int) -> bytes:
    image = np.full((height, width, 3), (40, 36, 190), np.uint8)
    done, data = cv2.imencode(suffix, image, options)
    assert done
    return data.tobytes()


PNG = encoded(".png")
JPEG = encoded(".jpg")


def text(data: bytes) -> str:
    return base64.b64encode(data).decode()


@pytest.mark.parametrize("data", [PNG, JPEG, encoded(".jpg", 30, 50, cv2.IMWRITE_JPEG_PROGRESSIVE, 1)])
def test_a_picture_is_decoded(data: bytes) -> None:
    assert size_of(data) == (50, 30)
    image = decoded(text(data))
    assert image.shape == (30, 50, 3)
    assert np.abs(image[15, 25].astype(int) - (40, 36, 190)).max() <= 3


def test_before_a_jpegs_size_come_segments_fill_bytes_and_lone_markers() -> None:
    exif = b"\xff\xe1\x00\x08\xff\xc0\x00\x0b\x00\x01"  # what looks like a size inside it is none
    assert size_of(JPEG[:2] + exif + b"\xff" + b"\xff\x01" + JPEG[2:]) == (50, 30)


def png(width: int, height: int) -> bytes:
    return PNG[:16] + struct.pack(">II", width, height) + PNG[24:]


@pytest.mark.one_interpreter
@pytest.mark.parametrize(
    ("data", "why"),
    [
        (png(100_000, 100_000), "a picture of 100000 x 100000 px: at least 16 px each way, at most 16000000 px"),
        (png(0, 30), "a picture of 0 x 30 px"),
        (encoded(".bmp"), "not a JPEG or PNG"),
        (b"<svg/>", "not a JPEG or PNG"),
        (PNG[:20], "not a JPEG or PNG"),
        (b"\xff\xd8\xff", "not a JPEG or PNG"),
        (b"\xff\xd8" + b"\xff\xe1\x00\x00" * 1000, "not a JPEG or PNG"),
        (PNG[:40], "damaged"),
        (PNG + b"\0" * MAX_FILE_BYTES, f"bytes: at most {MAX_FILE_BYTES}"),
    ],
)
def test_anything_else_is_refused_with_the_reason(data: bytes, why: str) -> None:
    with pytest.raises(UploadError, match=why):
        decoded(text(data))


def test_base64_is_strict() -> None:
    for wrong in ("no base64!", "AAA", "\xe4AAA"):
        with pytest.raises(UploadError, match="not base64"):
            decoded(wrong)
