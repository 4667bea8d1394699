"""Files of every kind, whole and broken, as they lie on a disk."""

import os
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from gateway.errors import ConfigError
from gateway.vision.offline import inputs
from gateway.vision.offline.inputs import InputError, InputPicture, decode, expand, read
from tests.examples import examples

RED = (20, 20, 220)


def scene(u: int = 12, size: tuple[int, int] = (40, 60)) -> NDArray[np.uint8]:
    image = np.full((*size, 3), (40, 60, 50), np.uint8)
    cv2.circle(image, (u, 15), 8, RED, -1)
    return image


def png(width: int, height: int) -> bytes:
    """The smallest file that claims such a size."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


def encoded(suffix: str, image: NDArray[Any], *flags: int) -> bytes:
    done, data = cv2.imencode(suffix, image, list(flags))
    assert done
    return data.tobytes()


def the_picture(path: Path) -> NDArray[np.uint8]:
    (picture,) = read(path)
    assert picture.frame is None
    assert picture.image.dtype == np.uint8
    return picture.image


def wrong(path: Path) -> str:
    with pytest.raises(InputError) as error:
        list(read(path))
    return str(error.value)


@pytest.fixture
def put(tmp_path: Path) -> Callable[[str, bytes], Path]:
    def write(name: str, data: bytes) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        return path

    return write


Put = Callable[[str, bytes], Path]

# -- samples and channels ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tif", ".ppm", ".webp", ".jp2"])
def test_lossless_pictures_are_unchanged(put: Put, suffix: str) -> None:
    flags = (cv2.IMWRITE_WEBP_QUALITY, 101) if suffix == ".webp" else ()
    assert np.array_equal(scene(), the_picture(put(f"a{suffix}", encoded(suffix, scene(), *flags))))


def test_grey_is_repeated(put: Put) -> None:
    grey = scene()[:, :, 2]
    assert np.array_equal(np.dstack([grey] * 3), the_picture(put("a.png", encoded(".png", grey))))
    assert np.array_equal(np.dstack([grey] * 3), the_picture(put("a.pgm", encoded(".pgm", grey))))


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_16_bit_is_divided_by_257_and_rounded(put: Put, suffix: str) -> None:
    every = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    image = np.dstack([every, every[::-1], every.T])
    expected = (image.astype(np.uint32) + 128) // 257
    assert np.array_equal(expected, the_picture(put(f"a{suffix}", encoded(suffix, image))))
    assert np.array_equal(expected[..., :1].repeat(3, 2), the_picture(put(f"g{suffix}", encoded(suffix, every))))


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_alpha_is_dropped_and_transparent_colours_count(put: Put, suffix: str) -> None:
    alpha = np.tile(np.linspace(0, 255, 60).astype(np.uint8), (40, 1))
    rgba = np.dstack([scene(), alpha])
    assert np.array_equal(scene(), the_picture(put(f"a{suffix}", encoded(suffix, rgba))))
    rgba16 = rgba.astype(np.uint16) * 257
    assert np.array_equal(scene(), the_picture(put(f"b{suffix}", encoded(suffix, rgba16))))


def test_floating_point_is_refused(put: Put) -> None:
    data = encoded(".tif", scene().astype(np.float32))
    assert "float32 samples" in wrong(put("a.tif", data))


def test_exif_orientation_is_applied(put: Put) -> None:
    tags = b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 0x112, 3, 1, 6, 0, 0)  # 6: turn clockwise to view
    exif = b"Exif\0\0" + tags
    plain = encoded(".jpg", scene())
    turned = plain[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + plain[2:]
    image = the_picture(put("a.jpg", turned))
    assert image.shape == (60, 40, 3)
    assert np.abs(np.rot90(the_picture(put("b.jpg", plain)), -1).astype(int) - image).max() == 0


def with_exif(data: bytes, exif: bytes) -> bytes:
    """The WebP or PNG file with this chunk at its end, or before its pixels."""
    if data.startswith(b"\x89PNG"):
        chunk = b"eXIf" + exif
        return data[:33] + struct.pack(">I", len(exif)) + chunk + struct.pack(">I", zlib.crc32(chunk)) + data[33:]
    extended = data[12:16] == b"VP8X"
    size = data[24:30] if extended else struct.pack("<I", 63)[:3] + struct.pack("<I", 47)[:3]
    flags = bytes([(data[20] if extended else 0) | 8, 0, 0, 0])
    inner = data[30:] if extended else data[12:]
    body = b"VP8X" + struct.pack("<I", 10) + flags + size + inner
    body += b"EXIF" + struct.pack("<I", len(exif)) + exif + b"\0" * (len(exif) % 2)
    return b"RIFF" + struct.pack("<I", len(body) + 4) + b"WEBP" + body


@pytest.mark.parametrize(("order", "prefix"), [("<", b""), (">", b"Exif\0\0")])
@pytest.mark.parametrize("suffix", [".png", ".webp"])
@pytest.mark.parametrize("stated", range(1, 9))
def test_an_animation_is_turned_like_a_still_jpeg_of_the_same_orientation(
    put: Put, suffix: str, stated: int, order: str, prefix: bytes
) -> None:
    picture = np.zeros((48, 64, 3), np.uint8)
    picture[:24, :32] = RED
    picture[:24, 32:] = 90
    mark = b"II*\0" if order == "<" else b"MM\0*"
    exif = b"Exif\0\0" + mark + struct.pack(f"{order}IHHHIHHI", 8, 1, 0x112, 3, 1, stated, 0, 0)
    plain = encoded(".jpg", picture)
    still = the_picture(put("a.jpg", plain[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + plain[2:]))
    animation = cv2.Animation()
    animation.frames, animation.durations = [picture, picture // 2], np.array([100, 100])  # type: ignore[assignment]
    data = with_exif(cv2.imencodeanimation(suffix, animation)[1].tobytes(), prefix + exif[6:])
    first, second = inputs.read(put(f"b{suffix}", data))
    assert first.image.shape == still.shape
    assert np.abs(first.image.astype(int) - still).mean() < 8
    assert np.abs(second.image.astype(int) - still // 2).mean() < 8
    one = the_picture(put(f"c{suffix}", with_exif(encoded(suffix, picture), prefix + exif[6:])))
    if suffix == ".webp" or not prefix:  # "Exif" before it is no PNG that OpenCV turns, and none that anybody writes
        assert one.shape == still.shape
        assert np.abs(one.astype(int) - still).mean() < 8


# -- sizes -------------------------------------------------------------------------------------------------------------


def test_one_pixel(put: Put) -> None:
    assert the_picture(put("a.png", encoded(".png", np.array([[RED]], np.uint8)))).tolist() == [[list(RED)]]


@pytest.mark.parametrize(("width", "height"), [(40_000, 40_000), (1 << 19, 1 << 12)])
def test_a_claim_of_too_many_pixels_is_refused_before_any_memory_is_taken(put: Put, width: int, height: int) -> None:
    assert "too large: more than 268435456 pixels" in wrong(put("a.png", png(width, height)))


def test_more_pixels_than_the_gateway_takes(put: Put, monkeypatch: pytest.MonkeyPatch) -> None:
    path = put("a.png", encoded(".png", scene()))
    monkeypatch.setattr(inputs, "MAX_PIXELS", 2400)
    assert the_picture(path).shape == (40, 60, 3)
    monkeypatch.setattr(inputs, "MAX_PIXELS", 2399)
    assert wrong(path) == "60 x 40 px is more than 2399 pixels"


def test_a_larger_file_than_the_gateway_takes(put: Put, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inputs, "MAX_BYTES", 1 << 20)
    path = put("a.bmp", encoded(".bmp", scene()))
    os.truncate(path, (1 << 20) + 1)  # sparse
    assert wrong(path) == "a picture file of more than 1 MiB"


# -- what is broken ----------------------------------------------------------------------------------------------------


def test_things_that_are_no_picture(put: Put, tmp_path: Path) -> None:
    assert wrong(put("empty.png", b"")) == "the file is empty"
    assert wrong(put("text.png", b"hello")) == "damaged, cut short, or not a picture in a known format"
    assert wrong(put("text.txt", b"hello")) == "neither a picture nor a video that can be decoded"
    assert wrong(put("text.mp4", b"hello")) == "neither a picture nor a video that can be decoded"
    assert wrong(tmp_path / "nothing.png") == "no such file"
    assert wrong(tmp_path / "nothing*.png") == "matches no file"
    assert wrong(Path("a\0b.png")).startswith("cannot be read: ")
    assert wrong(Path("x" * 5000)) == "cannot be read: File name too long"
    assert wrong(Path("/dev/zero")) == "not a regular file"
    assert wrong(tmp_path) == "a folder without pictures or videos"
    os.mkfifo(tmp_path / "pipe.png")
    assert wrong(tmp_path / "pipe.png") == "not a regular file"


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".webp", ".bmp", ".gif", ".jp2", ".ppm"])
@pytest.mark.parametrize("share", [0.02, 0.5, 0.97])
def test_a_file_cut_short_is_an_error_and_never_half_a_picture(put: Put, suffix: str, share: float) -> None:
    noise = np.random.default_rng(4).integers(0, 256, (60, 80, 3), dtype=np.uint8)
    data = encoded(suffix, noise)
    path = put(f"cut{suffix}", data[: int(len(data) * share)])
    assert wrong(path) == "damaged, cut short, or not a picture in a known format"
    path = put("cut", data[: int(len(data) * share)])  # a video decoder would make something of half a JPEG
    assert "damaged" in wrong(path)


@settings(max_examples=examples(150), deadline=None)
@given(st.sampled_from([".png", ".jpg", ".gif", ".tif", ".bmp", ".webp"]), st.data())
def test_flipped_bytes_give_a_picture_or_an_error(suffix: str, data: st.DataObject) -> None:
    whole = bytearray(encoded(suffix, scene(size=(16, 24))))
    for _ in range(data.draw(st.integers(1, 4))):
        whole[data.draw(st.integers(0, len(whole) - 1))] ^= data.draw(st.integers(1, 255))
    try:
        image = decode(bytes(whole))
    except InputError:
        return
    assert image.dtype == np.uint8
    assert image.shape[2] == 3


@settings(max_examples=examples(100), deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_an_error(data: bytes) -> None:
    with pytest.raises(InputError):
        decode(data)


# -- several frames ----------------------------------------------------------------------------------------------------


def frames_of(path: Path) -> list[int]:
    """Checks that frames count from 0 and that the disc stands further right in each; returns their numbers."""
    pictures = list(read(path))
    for n, picture in enumerate(pictures):
        assert picture.image.shape == (40, 60, 3)
        red = (picture.image[15, :, 2] > 150) & (picture.image[15, :, 1] < 90)
        assert np.flatnonzero(red).mean() == pytest.approx(12 + 8 * n, abs=1)
    return [-1 if picture.frame is None else picture.frame for picture in pictures]


def animation(path: Path, count: int = 5) -> Path:
    film = cv2.Animation()
    film.frames = [scene(12 + 8 * n) for n in range(count)]
    film.durations = [100] * count
    assert cv2.imwriteanimation(str(path), film)
    return path


@pytest.mark.parametrize("suffix", [".gif", ".png", ".webp", ".avif"])
def test_animations_give_every_frame(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = animation(tmp_path / f"a{suffix}")
    for batch_px in (inputs._BATCH_PIXELS, 2 * 40 * 60, 1):
        monkeypatch.setattr(inputs, "_BATCH_PIXELS", batch_px)
        assert frames_of(path) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("suffix", [".gif", ".png", ".webp"])
def test_an_animation_cut_short_is_an_error(tmp_path: Path, suffix: str) -> None:
    path = animation(tmp_path / f"a{suffix}")
    path.write_bytes(path.read_bytes()[:-200])
    assert "cut short" in wrong(path)


def test_a_still_gif_and_a_single_page_are_plain_pictures(put: Put) -> None:
    assert the_picture(put("a.gif", encoded(".gif", scene()))).shape == (40, 60, 3)
    assert the_picture(put("a.tif", encoded(".tif", scene()))).shape == (40, 60, 3)


def test_pages_of_a_tiff(tmp_path: Path) -> None:
    assert cv2.imwritemulti(str(tmp_path / "a.tif"), [scene(12 + 8 * n) for n in range(3)])
    assert frames_of(tmp_path / "a.tif") == [0, 1, 2]


def video(path: Path, code: str, count: int) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), 10, (60, 40))
    assert writer.isOpened()
    for n in range(count):
        writer.write(scene(12 + 8 * n))
    writer.release()
    return path


@pytest.mark.parametrize(("code", "suffix"), [("FFV1", ".mkv"), ("MJPG", ".avi"), ("mp4v", ".mp4"), ("MJPG", ".film")])
def test_videos_by_name_or_by_trying(tmp_path: Path, code: str, suffix: str) -> None:
    made = video(tmp_path / f"a{'.avi' if suffix == '.film' else suffix}", code, 4)
    path = made.rename(made.with_suffix(suffix))
    assert frames_of(path) == [0, 1, 2, 3]


def test_a_video_is_read_frame_by_frame_and_may_be_left(tmp_path: Path) -> None:
    pictures = read(video(tmp_path / "a.avi", "MJPG", 3))
    first = next(iter(pictures))
    assert isinstance(first, InputPicture)
    assert first.frame == 0


def test_a_damaged_frame_of_a_video_is_skipped_and_the_others_keep_their_numbers(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = video(tmp_path / "a.avi", "MJPG", 8)
    data = path.read_bytes()
    third, fourth = [match.start() for match in re.finditer(rb"\xff\xd8\xff", data)][2:4]
    path.write_bytes(data[:third] + bytes(fourth - 8 - third) + data[fourth - 8 :])  # 8: the chunk's head

    assert [picture.frame for picture in read(path)] == [0, 1, 3, 4, 5, 6, 7]
    assert [record.getMessage() for record in caplog.records] == [
        f"{path}: 1 frames from 2 on can't be decoded; skipped"
    ]


# -- names -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ü 日本/ß ﷽.png", "a\nb\x1b[31m.png", "img_%03d.png", "[1].png", "-x.png"])
def test_odd_names(put: Put, name: str) -> None:
    path = put(name, encoded(".png", scene()))
    assert expand([str(path)]) == [path]
    assert np.array_equal(scene(), the_picture(path))


def test_names_that_are_not_utf_8(tmp_path: Path) -> None:
    """OpenCV's own file functions end the process on such a name."""
    name = os.fsencode(tmp_path) + b"/bad\xff"
    with open(name + b".png", "wb") as file:
        file.write(encoded(".png", scene()))
    with open(name + b".mp4", "wb") as file:
        file.write(b"something")
    assert np.array_equal(scene(), the_picture(Path(os.fsdecode(name + b".png"))))
    assert wrong(Path(os.fsdecode(name + b".mp4"))) == "the name of a video must be valid UTF-8"


def test_folders_and_patterns_in_natural_order(put: Put, tmp_path: Path) -> None:
    for name in ("frame10.png", "Frame9.JPG", "frame1.png", "run.mp4", "sub/deep.png", "notes.txt", ".hid.png"):
        put(f"f/{name}", b"x")
    (tmp_path / "f/folder.png").mkdir()
    os.chdir(tmp_path)

    def shown(*arguments: str) -> list[str]:
        return [str(path) for path in expand(arguments)]

    in_folder = ["f/frame1.png", "f/Frame9.JPG", "f/frame10.png", "f/run.mp4"]
    assert shown("f") == in_folder
    assert shown("f/frame*") == ["f/frame1.png", "f/frame10.png"]
    assert shown("f/*.txt", "f") == ["f/notes.txt", *in_folder]
    assert shown("f/frame[1]*.png", "f/frame1.png") == ["f/frame1.png", "f/frame10.png", "f/frame1.png"]
    assert sorted(shown("f/**")) == sorted([*in_folder, "f/sub/deep.png", "f/notes.txt"])
    assert shown("f/**/deep.*") == ["f/sub/deep.png"]


@pytest.fixture(autouse=True)
def _stay_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(Path.cwd())  # puts the working directory back after the test


def test_what_matches_nothing_is_reported_in_its_place(put: Put, tmp_path: Path) -> None:
    path = put("a.png", b"x")
    hollow = str(tmp_path / "none*.png")
    (tmp_path / "dry").mkdir()
    assert expand([hollow, str(path), "gone.png"]) == [Path(hollow), path, Path("gone.png")]
    assert expand(["gone.png"]) == [Path("gone.png")]
    with pytest.raises(ConfigError, match=r"no picture or video in: .*none\*\.png, .*dry"):
        expand([hollow, str(tmp_path / "dry")])
    with pytest.raises(ConfigError, match="no input named"):
        expand([])


def test_a_name_with_brackets_that_exists_is_no_pattern(put: Put) -> None:
    path = put("shot[1].png", b"x")
    put("shot1.png", b"x")
    assert expand([str(path)]) == [path]
