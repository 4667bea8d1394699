"""The byte stream: frames are complete and in order, wherever it is cut, and faults are found at their place."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.modbus.protocol.adu import MAX_FRAME_BYTES, FrameFault, Framer, frame_bytes

CALM = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])  # a busy machine is no finding

PDUS = st.binary(min_size=1, max_size=253)
FRAMES = st.builds(frame_bytes, st.integers(0, 65535), st.integers(0, 255), PDUS)
FOREIGN = st.builds(
    lambda frame, protocol: frame[:2] + protocol.to_bytes(2, "big") + frame[4:], FRAMES, st.integers(1, 65535)
)


def out_of(framer: Framer, data: bytes) -> list[bytes | FrameFault]:
    framer.feed(data)
    found: list[bytes | FrameFault] = []
    while (frame := framer.next()) is not None:
        found.append(frame)
        if frame is FrameFault.BAD_LENGTH:
            break
    return found


def test_a_frame_byte_by_byte() -> None:
    assert frame_bytes(0x1234, 7, b"\x03\x00\x01\x00\x02").hex() == "123400000006070300010002"


@pytest.mark.long
@pytest.mark.one_interpreter
@CALM
@given(st.lists(FRAMES | FOREIGN, max_size=8), st.data())
def test_any_cut_gives_the_same_frames(frames: list[bytes], data: st.DataObject) -> None:
    stream = b"".join(frames)
    expected = [frame if frame[2:4] == b"\0\0" else FrameFault.BAD_PROTOCOL for frame in frames]
    framer = Framer()
    found: list[bytes | FrameFault] = []
    at = 0
    while at < len(stream):
        size = data.draw(st.integers(1, len(stream) - at))
        found += out_of(framer, stream[at : at + size])
        at += size
    assert found == expected
    assert framer.held == 0
    assert not framer.complete


@CALM
@given(st.lists(FRAMES, max_size=3), st.integers(0, 65535), st.sampled_from([0, 1, 255, 256, 65535]), PDUS)
def test_an_impossible_length_ends_it_with_the_frames_before_it(
    frames: list[bytes], transaction: int, length: int, rest: bytes
) -> None:
    bad = transaction.to_bytes(2, "big") + b"\0\0" + length.to_bytes(2, "big") + rest
    framer = Framer()
    assert out_of(framer, b"".join(frames) + bad) == [*frames, FrameFault.BAD_LENGTH]
    assert framer.held == 0


def test_an_impossible_length_is_detected_before_the_frame_is_complete() -> None:
    framer = Framer()
    framer.feed(b"\0\1\0\0\xff")
    assert (framer.next(), framer.complete) == (None, False)
    framer.feed(b"\xff")
    assert framer.complete
    assert framer.next() is FrameFault.BAD_LENGTH


def test_the_limits_of_length() -> None:
    for length, fine in [(1, False), (2, True), (254, True), (255, False)]:
        framer = Framer()
        found = out_of(framer, b"\0\1\0\0" + length.to_bytes(2, "big") + bytes(length))
        assert (found != [FrameFault.BAD_LENGTH]) == fine
    assert len(frame_bytes(0, 0, bytes(253))) == MAX_FRAME_BYTES


@CALM
@given(st.binary(max_size=2000))
def test_random_bytes_are_frames_or_faults_and_nothing_is_kept_for_ever(data: bytes) -> None:
    framer = Framer()
    found = out_of(framer, data)
    if FrameFault.BAD_LENGTH in found:
        assert framer.held == 0
    else:
        assert framer.held < MAX_FRAME_BYTES
        assert b"".join(f for f in found if isinstance(f, bytes)) in data or FrameFault.BAD_PROTOCOL in found
