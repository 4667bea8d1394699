"""The ring: what is written is what viewers copy, never half of a frame; it is written while somebody looks."""

import errno
import mmap
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gateway.vision.transport.progress import FrameProgress, ProgressPage
from gateway.vision.transport.ring import GENERATION, HEIGHT, WIDTH, Ring
from gateway.vision.transport.ring_spec import SLOTS, RingSpec

S = 1_000_000_000


@pytest.fixture
def spec() -> Iterator[RingSpec]:
    spec = RingSpec.create(max_megapixels=0.02)
    yield spec
    spec.close()


def picture(height: int, width: int, seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)


def shown(ring: Ring, seq: int | None = None) -> NDArray[np.uint8]:
    snapshot = ring.snapshot(seq)
    assert snapshot is not None
    return snapshot.image


def test_a_viewer_gets_a_copy_of_the_newest_frame_or_of_the_one_it_names(spec: RingSpec) -> None:
    writer, viewer = Ring(spec, writable=True), Ring(spec, writable=False)
    assert viewer.snapshot() is None
    frames = {seq: picture(8, 8 + seq, seed=seq) for seq in (1, 2, 3, 4)}
    for seq, frame in frames.items():
        writer.write(frame, seq, 1000 * seq)

    newest, third, gone = viewer.snapshot(), viewer.snapshot(3), viewer.snapshot(1)

    assert newest is not None
    assert (newest.seq, newest.t_capture_ns) == (4, 4000)
    np.testing.assert_array_equal(newest.image, frames[4])
    assert third is not None
    np.testing.assert_array_equal(third.image, frames[3])
    assert gone is None
    for seq in (5, 6, 7):
        writer.write(picture(8, 8), seq, 1000 * seq)
    np.testing.assert_array_equal(newest.image, frames[4])  # a copy: what comes later does not change it


def test_views_that_are_not_contiguous_are_copied_right(spec: RingSpec) -> None:
    ring = Ring(spec, writable=True)
    mirrored = picture(60, 80)[::-1, ::2]
    ring.write(mirrored, 1, 1)
    np.testing.assert_array_equal(mirrored, shown(ring))


def test_a_frame_that_is_written_over_during_the_copy_is_not_shown(spec: RingSpec) -> None:
    writer, viewer = Ring(spec, writable=True), Ring(spec, writable=False)
    writer.write(picture(10, 10), 1, 1)
    pixels = viewer._pixels

    def overtaken(slot: int, height: int, width: int) -> NDArray[np.uint8]:
        for seq in range(2, 2 + SLOTS):
            writer.write(picture(10, 10, seed=seq), seq, seq)
        return pixels(slot, height, width)

    viewer._pixels = overtaken  # type: ignore[method-assign]
    assert viewer.snapshot(1) is None


def test_generations_are_even_when_complete_and_never_repeat(spec: RingSpec) -> None:
    seen = []
    for _ in range(2):  # the second writer succeeds the first
        ring = Ring(spec, writable=True)
        for _ in range(3):
            ring.write(picture(4, 4), 1, 1)
            seen.append(int(ring._headers[0][GENERATION]))
    assert all(generation % 2 == 0 for generation in seen)
    assert seen == sorted(seen)
    assert len(set(seen)) == 2


def test_a_writer_that_dies_half_way_leaves_no_complete_frame_and_its_successor_continues(
    spec: RingSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    class DeadError(Exception):
        pass

    def die(*_: object) -> None:
        raise DeadError

    viewer = Ring(spec, writable=False)
    with monkeypatch.context() as patch:
        patch.setattr(np, "copyto", die)
        with pytest.raises(DeadError):
            Ring(spec, writable=True).write(picture(100, 200), 1, 1)
    assert viewer.snapshot() is None

    complete = picture(50, 60, seed=2)
    Ring(spec, writable=True).write(complete, 2, 2)
    np.testing.assert_array_equal(complete, shown(viewer))


def test_the_largest_frames_fit_beside_each_other(spec: RingSpec) -> None:
    ring = Ring(spec, writable=True)
    for seq in range(SLOTS):
        ring.write(picture(100, 200, seed=seq), seq, seq)
    for seq in range(SLOTS):  # no slot runs into the next
        np.testing.assert_array_equal(picture(100, 200, seed=seq), shown(ring, seq))


def test_the_memory_has_no_name_is_sparse_and_cannot_be_resized() -> None:
    spec = RingSpec.create(max_megapixels=100)
    try:
        assert spec.size_bytes > SLOTS * 300_000_000
        assert spec.slot_bytes % mmap.PAGESIZE == 0
        ring = Ring(spec, writable=True)
        ring.write(picture(100, 100), 1, 1)
        assert os.fstat(spec.fd).st_blocks * 512 <= 16 * mmap.PAGESIZE  # 30 kB of pixels and a header
        assert "memfd:gateway-frames" in os.readlink(f"/proc/self/fd/{spec.fd}")
        assert not [entry for entry in Path("/dev/shm").iterdir() if "gateway-frames" in entry.name]
        with pytest.raises(PermissionError):
            os.ftruncate(spec.fd, 0)
        assert not any(map(os.get_inheritable, spec.fds))
    finally:
        spec.close()


def test_a_reader_s_descriptor_shows_the_frames_and_cannot_be_mapped_for_writing(spec: RingSpec) -> None:
    one = picture(10, 10)
    Ring(spec, writable=True).write(one, 1, 1)
    reader = spec.reader()
    try:
        viewer = Ring(reader, writable=False)
        np.testing.assert_array_equal(one, shown(viewer))
        with pytest.raises(ValueError, match="read-only"):
            viewer.write(one, 2, 2)
        assert not os.get_inheritable(reader.fd)
        assert os.fstat(spec.fd).st_mode & 0o777 == 0o400  # opened anew for writing by no one else
        with pytest.raises(PermissionError):
            Ring(reader, writable=True)
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.pwrite(reader.fd, b"x", 0)
    finally:
        os.close(reader.fd)


def test_frames_are_written_while_somebody_looks_and_else_one_a_second(spec: RingSpec) -> None:
    writer, viewer = Ring(spec, writable=True), Ring(spec, writable=False)

    def written(begin_ns: int, seconds: int) -> list[int]:
        """When, of ten frames a second."""
        times = [begin_ns + n * S // 10 for n in range(10 * seconds)]
        due = []
        for now_ns in times:
            if writer.due(now_ns):
                writer.write(picture(4, 4), 1, now_ns, now_ns)
                due.append(now_ns)
        return due

    assert written(0, 3) == [0, S, 2 * S]
    viewer.snapshot()
    viewer.snapshot()
    assert written(10 * S, 5) == [10 * S + n * S // 10 for n in range(30)] + [10 * S + n * S // 10 for n in (39, 49)]
    viewer.snapshot()
    assert len(written(20 * S, 1)) == 10


@pytest.mark.parametrize("size", [(-4, -5), (4, -5), (0, 0), (-1, 1), (1 << 40, 1 << 40), (1 << 62, 4)])
def test_a_header_that_cannot_be_shows_nothing(spec: RingSpec, size: tuple[int, int]) -> None:
    """A vision process that somebody has taken over writes what it likes: the viewer goes on with other frames."""
    writer, viewer = Ring(spec, writable=True), Ring(spec, writable=False)
    writer.write(picture(4, 5), 1, 1)
    writer.write(picture(4, 5), 2, 2)
    writer._headers[1][HEIGHT], writer._headers[1][WIDTH] = size
    assert viewer.snapshot(2) is None
    np.testing.assert_array_equal(picture(4, 5), shown(viewer))


@pytest.mark.timeout(20)
def test_a_viewer_cannot_make_the_vision_process_wait(spec: RingSpec) -> None:
    """Both have one file description: whoever has got hold of a web process can make it a blocking one."""
    writer = Ring(spec, writable=True)
    os.set_blocking(spec.request_fd, True)
    assert [writer.due(0), writer.due(1)] == [True, True]
    writer.write(picture(4, 4), 1, 1, 1)
    assert not writer.due(2)
    Ring(spec, writable=False).snapshot()
    assert writer.due(3)


def test_on_an_older_kernel_every_frame_is_written(spec: RingSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    def unsupported(*_: object) -> int:
        raise OSError(errno.EOPNOTSUPP, "Operation not supported")

    monkeypatch.setattr(os, "preadv", unsupported)
    writer = Ring(spec, writable=True)
    writer.write(picture(4, 4), 1, 1, 1)
    assert writer.due(2)


# What the vision process notes of its progress, in the first page of the same memory.


def test_progress_is_read_as_it_was_noted_and_ends_with_its_process(spec: RingSpec) -> None:
    page, reader = ProgressPage(spec, writable=True), ProgressPage(spec, writable=False)
    assert reader.read() == FrameProgress()
    page.begin(7, 100)
    assert reader.read() == FrameProgress(7, detector_ns=100)
    page.captured(3, 200)
    page.work_begins(3, 190, 210)
    assert reader.read() == FrameProgress(7, 3, 200, 3, 190, 210, 100)
    page.work_ends(250)
    page.captured(4, 260)
    page.detector_runs(300)
    assert reader.read() == FrameProgress(7, 4, 260, 3, 190, 0, 300)
    page.begin(8, 400)
    assert reader.read() == FrameProgress(8, detector_ns=400)
    with pytest.raises(TypeError, match="read-only"):
        reader.captured(1, 1)


def test_the_next_process_learns_the_size_of_the_frames_so_far(spec: RingSpec) -> None:
    page = ProgressPage(spec, writable=True)
    page.begin(1, 0)
    assert page.size_px() is None
    page.set_size_px(40, 30)
    page.begin(2, 0)
    assert ProgressPage(spec, writable=True).size_px() == (40, 30)


def test_progress_and_frames_do_not_touch_each_other(spec: RingSpec) -> None:
    page, ring = ProgressPage(spec, writable=True), Ring(spec, writable=True)
    ring.write(picture(100, 200), 1, 1)
    page.begin(1, 2)
    page.set_size_px(5, 6)
    np.testing.assert_array_equal(picture(100, 200), shown(ring))
    for seq in range(SLOTS):
        ring.write(picture(100, 200), seq, seq)
    assert (page.read(), page.size_px()) == (FrameProgress(1, detector_ns=2), (5, 6))
