"""The ring: what is written is what is seen, in place, and a slot that changes is noticed."""

import mmap
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gateway.errors import LinkError
from gateway.vision.source.freshness import TILES
from gateway.vision.transport import ring as shm
from gateway.vision.transport.ring import Ring, RingSpec


@pytest.fixture
def spec() -> Iterator[RingSpec]:
    spec = shm.create(slots=3, max_megapixels=0.02)
    yield spec
    os.close(spec.fd)


def picture(height: int, width: int, seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)


def test_a_frame_is_seen_in_place_by_another_mapping(spec: RingSpec) -> None:
    writer, reader = Ring(spec, writable=True), Ring(spec, writable=False)
    one, two = picture(100, 200), picture(7, 3, seed=1)

    generation = writer.write(0, one)
    other = writer.write(2, two)

    seen = reader.view(0, generation)
    assert seen is not None
    np.testing.assert_array_equal(one, seen)
    assert (seen.dtype.name, seen.flags.c_contiguous, seen.flags.writeable) == ("uint8", True, False)
    assert not seen.flags.owndata
    np.testing.assert_array_equal(two, reader.view(2, other))


def test_views_that_are_not_contiguous_are_copied_right(spec: RingSpec) -> None:
    ring = Ring(spec, writable=True)
    mirrored = picture(60, 80)[::-1, ::2]

    np.testing.assert_array_equal(mirrored, ring.view(1, ring.write(1, mirrored)))


def test_a_slot_written_again_is_noticed_before_and_after_the_work(spec: RingSpec) -> None:
    writer, reader = Ring(spec, writable=True), Ring(spec, writable=False)
    first = writer.write(0, picture(10, 10))
    assert reader.view(0, first) is not None
    assert reader.holds(0, first)

    second = writer.write(0, picture(10, 10, seed=1))

    assert second > first
    assert not reader.holds(0, first)
    assert reader.view(0, first) is None
    assert reader.holds(0, second)


def test_generations_are_even_when_whole_and_never_repeat(spec: RingSpec) -> None:
    ring = Ring(spec, writable=True)
    seen = [ring.write(0, picture(4, 4)) for _ in range(5)]

    assert all(generation % 2 == 0 for generation in seen)
    assert seen == sorted(set(seen))
    assert ring.view(0, 0) is None  # a slot never written would be generation 0
    assert ring.view(1, seen[-1]) is None


def test_a_writer_that_dies_half_way_leaves_no_whole_frame_and_its_successor_goes_on(
    spec: RingSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    class DeadError(Exception):
        pass

    def die(*_: object) -> None:
        raise DeadError

    reader = Ring(spec, writable=False)
    writer = Ring(spec, writable=True)
    first = writer.write(0, picture(100, 200))
    with monkeypatch.context() as patch:
        patch.setattr(np, "copyto", die)
        with pytest.raises(DeadError):
            writer.write(0, picture(100, 200, seed=1))

    assert not any(reader.view(0, generation) is not None for generation in range(0, first + 10, 2))
    whole = picture(50, 60, seed=2)
    successor = Ring(spec, writable=True).write(0, whole)
    assert successor % 2 == 0
    np.testing.assert_array_equal(whole, reader.view(0, successor))


def test_the_largest_frame_fits_and_one_pixel_more_is_refused_in_words(spec: RingSpec) -> None:
    ring = Ring(spec, writable=True)
    full = picture(100, 200)
    for slot in range(3):  # no slot runs into the next
        ring.write(slot, full if slot == 1 else picture(100, 200, seed=slot))
    np.testing.assert_array_equal(full, ring.view(1, int(ring._header(1)[0])))

    with pytest.raises(LinkError, match=r"201 x 100 = 0\.0 megapixels, more than camera\.max_megapixels = 0\.02"):
        ring.write(0, picture(100, 201))


def test_no_such_slot(spec: RingSpec) -> None:
    ring = Ring(spec, writable=True)
    for slot in (-1, 3):
        with pytest.raises(IndexError):
            ring.write(slot, picture(1, 1))


def test_the_memory_has_no_name_is_sparse_and_cannot_be_resized() -> None:
    spec = shm.create(slots=18, max_megapixels=100)
    try:
        assert spec.size_bytes > 18 * 300_000_000
        assert spec.slot_bytes % mmap.PAGESIZE == 0
        ring = Ring(spec, writable=True)
        ring.write(17, picture(100, 100))
        assert os.fstat(spec.fd).st_blocks * 512 <= 16 * mmap.PAGESIZE  # 30 kB of pixels and a header
        assert "memfd:gateway-frames" in os.readlink(f"/proc/self/fd/{spec.fd}")
        assert not [entry for entry in Path("/dev/shm").iterdir() if "gateway-frames" in entry.name]
        with pytest.raises(PermissionError):
            os.ftruncate(spec.fd, 0)
        assert not os.get_inheritable(spec.fd)
    finally:
        os.close(spec.fd)


def test_a_reader_cannot_write(spec: RingSpec) -> None:
    writer, reader = Ring(spec, writable=True), Ring(spec, writable=False)
    seen = reader.view(0, writer.write(0, picture(4, 4)))
    assert seen is not None
    with pytest.raises(ValueError, match="read-only"):
        seen[0, 0, 0] = 1
    with pytest.raises(ValueError, match="read-only"):
        reader.write(0, picture(4, 4))


def test_a_reader_s_descriptor_shows_the_frames_and_cannot_be_mapped_for_writing(spec: RingSpec) -> None:
    one = picture(10, 10)
    generation = Ring(spec, writable=True).write(0, one)
    reader = shm.reader(spec)
    try:
        np.testing.assert_array_equal(one, Ring(reader, writable=False).view(0, generation))
        assert not os.get_inheritable(reader.fd)
        assert os.fstat(spec.fd).st_mode & 0o777 == 0o400  # opened anew for writing by no one else
        with pytest.raises(PermissionError):
            Ring(reader, writable=True)
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.pwrite(reader.fd, b"x", 0)
    finally:
        os.close(reader.fd)


def test_a_viewer_gets_a_copy_of_the_newest_frame_or_of_the_one_it_names(spec: RingSpec) -> None:
    writer, viewer = Ring(spec, writable=True), Ring(spec, writable=False)
    assert viewer.snapshot() is None
    frames = {seq: picture(8, 8 + seq, seed=seq) for seq in (1, 2, 3, 4)}
    for seq, slot in ((1, 2), (2, 0), (3, 1), (4, 2)):
        writer.write(slot, frames[seq], seq, 1000 * seq)

    newest, third, gone = viewer.snapshot(), viewer.snapshot(3), viewer.snapshot(1)

    assert newest is not None
    assert (newest.seq, newest.t_capture_ns) == (4, 4000)
    np.testing.assert_array_equal(newest.image, frames[4])
    assert third is not None
    np.testing.assert_array_equal(third.image, frames[3])
    assert gone is None
    writer.write(2, picture(8, 8), 5, 5000)
    np.testing.assert_array_equal(newest.image, frames[4])  # a copy: what comes later does not change it


def test_when_each_tile_changed_travels_with_the_frame(spec: RingSpec) -> None:
    writer, reader = Ring(spec, writable=True), Ring(spec, writable=False)
    changed_ns = np.arange(TILES[0] * TILES[1], dtype=np.int64).reshape(TILES)
    generation = writer.write(1, picture(10, 12), 7, 500, changed_ns)
    np.testing.assert_array_equal(reader.changed_ns(1), changed_ns)
    view = reader.view(1, generation)
    assert view is not None
    np.testing.assert_array_equal(view, picture(10, 12))

    writer.write(1, picture(10, 12), 8, 600)
    assert set(reader.changed_ns(1).ravel()) == {600}


def test_the_next_writer_learns_the_size_of_the_newest_whole_frame(spec: RingSpec) -> None:
    ring = Ring(spec, writable=True)
    assert ring.newest_px() is None
    ring.write(2, picture(10, 20), 5, 900)
    ring.write(0, picture(30, 40), 6, 100)
    ring.write(1, picture(50, 60), 4, 950)
    assert Ring(spec, writable=True).newest_px() == (40, 30)
    ring._headers[0][shm.GENERATION] += 1  # a writer that died half way
    assert Ring(spec, writable=True).newest_px() == (20, 10)
