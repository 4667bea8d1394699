"""One layout for every picture, one conversion into it, one order of files; and no OpenCV where it is not wanted."""

import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gateway.vision.pixels import PICTURE_SUFFIXES, bgr8, natural_key


@pytest.mark.parametrize(
    ("picture", "pixel"),
    [
        (np.full((2, 3), 7, "u1"), (7, 7, 7)),
        (np.full((2, 3, 1), 7, "u1"), (7, 7, 7)),
        (np.full((2, 3), 0xABCD, "u2"), (0xAB, 0xAB, 0xAB)),
        (np.full((2, 3, 1), 0xFFFF, "u2"), (255, 255, 255)),
        (np.full((2, 3, 3), (1, 2, 3), "u1"), (1, 2, 3)),
        (np.full((2, 3, 3), (0x0180, 0x0181, 0xFFFF), "u2"), (1, 1, 255)),
        (np.full((2, 3, 3), (0x0182, 0x017F, 128), "u2"), (2, 1, 0)),
        (np.full((2, 3, 4), (1, 2, 3, 99), "u1"), (1, 2, 3)),
        (np.full((2, 3, 4), (257, 514, 771, 9), "u2"), (1, 2, 3)),
    ],
)
def test_everything_becomes_bgr_of_8_bits(picture: NDArray[Any], pixel: tuple[int, int, int]) -> None:
    bgr = bgr8(picture)

    assert (bgr.shape, bgr.dtype.name, bgr.flags.c_contiguous) == ((2, 3, 3), "uint8", True)
    np.testing.assert_array_equal(np.broadcast_to(np.array(pixel), (2, 3, 3)), bgr)


def test_each_of_the_65536_values_is_rounded_to_the_nearest() -> None:
    every = np.arange(65536, dtype=np.uint16).reshape(128, 512)
    nearest = [round(Fraction(v, 257)) for v in range(65536)]
    assert bgr8(every)[:, :, 1].ravel().tolist() == nearest


def test_large_and_strided_pictures_keep_every_pixel_in_its_place() -> None:
    """More samples than one strip of the conversion, an odd number of them, mirrored and thinned out."""
    noise = np.random.default_rng(3).integers(0, 65536, (211, 307, 4), np.uint16)
    expected = (noise.astype(np.uint32) + 128) // 257
    for view, wanted in (
        (noise, expected[:, :, :3]),
        (noise[::-1, ::3], expected[::-1, ::3, :3]),
        (noise[:, :, 1:], expected[:, :, 1:]),
        (noise[:, :, 2], expected[:, :, [2, 2, 2]]),
    ):
        np.testing.assert_array_equal(wanted, bgr8(view))
    assert noise[0, 0].tolist() == np.random.default_rng(3).integers(0, 65536, (211, 307, 4), np.uint16)[0, 0].tolist()


def test_a_picture_that_is_right_already_is_not_copied() -> None:
    image = np.zeros((4, 4, 3), np.uint8)
    assert bgr8(image) is image
    assert np.shares_memory(bgr8(image[::-1]), image)


@pytest.mark.parametrize(
    ("picture", "words"),
    [
        (np.zeros((2, 3), "f4"), "float32 samples: there is no agreed white; store 8 or 16 bit per channel"),
        (np.zeros((2, 3, 3), "i2"), "int16 samples"),
        (np.zeros((2, 3, 2), "u1"), "2 channels: only grey, BGR and BGR with alpha are understood"),
        (np.zeros((2, 3, 5), "f4"), "5 channels"),
        (np.zeros((0, 3, 3), "u1"), r"shape \(0, 3, 3\) is no picture"),
        (np.zeros(3, "u1"), "is no picture"),
        (np.zeros((1, 2, 3, 4), "u1"), "is no picture"),
    ],
)
def test_what_is_no_picture_is_refused(picture: NDArray[Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        bgr8(picture)


def test_natural_order() -> None:
    names = ["f10.png", "F2.png", "f1b.png", "f1.png", "10.png", "9.png", "x.png", "f02.png", "F10.PNG"]
    wanted = "9.png 10.png f1.png f1b.png F2.png f02.png F10.PNG f10.png x.png"
    assert [p.name for p in sorted(map(Path, names), key=natural_key)] == wanted.split()


def test_the_order_of_a_folder_does_not_depend_on_the_order_it_was_listed_in() -> None:
    paths = [Path(f"/data/run{run}/{name}") for run in (2, 10) for name in ("a1.png", "A1.png", "a01.png")]
    wanted = sorted(paths, key=natural_key)
    assert [path.parent.name for path in wanted] == ["run2"] * 3 + ["run10"] * 3
    paths.reverse()
    assert sorted(paths, key=natural_key) == wanted


def test_suffixes_are_such_as_the_callers_compare() -> None:
    assert all(suffix.startswith(".") and suffix == suffix.lower() for suffix in PICTURE_SUFFIXES)


@pytest.mark.long
@pytest.mark.one_interpreter
@pytest.mark.parametrize(
    ("modules", "names"),
    [
        (
            "gateway.app",
            ("cv2", "numpy", "paho", "aiomqtt", "websockets", "sqlite3", "cryptography", "psutil", "starlette"),
        ),
        ("gateway.vision.process.template, gateway.records.process", ("asyncio", "ssl", "psutil", "cryptography")),
    ],
    ids=["main", "template and recorder"],
)
def test_a_process_loads_nothing_large_that_it_does_not_need(modules: str, names: tuple[str, ...]) -> None:
    """Each would be in memory once more."""
    program = f"import sys, {modules}; print([name for name in {names} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "[]\n"
