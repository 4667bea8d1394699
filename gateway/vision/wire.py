"""The bytes of the messages that a frame's way consists of: a tag and a fixed record. Pure.

A frame waits for each of them, in processes that have done nothing for a frame's time and whose caches are cold:
pickling and unpickling took longer there than the kernel's part. All else (jobs, first and last words) is pickled; a
pickle begins with 0x80, which is no tag. Both ends are the same program on the same machine.
"""

import pickle
from collections.abc import Callable
from enum import IntEnum
from functools import lru_cache
from struct import Struct
from typing import Any

from gateway.children.link import Codec
from gateway.model import Circle, Detection, Ellipse, Tracking
from gateway.vision.jobs import Captured, FrameRef, GiveBack, Handed, Look, Looked, Straight


class Tag(IntEnum):
    LOOK = 1
    GIVE_BACK = 2
    STRAIGHT = 3
    CAPTURED = 4
    HANDED = 5
    LOOKED = 6
    NOT_LOOKED = 7


class Has(IntEnum):
    """Which of a detection's optional fields are there."""

    CIRCLE = 1
    X_N = 2
    Y_N = 4
    ELLIPSE = 8
    CONFIDENCE = 16
    VISIBLE = 32
    PREDICTED = 64


_LOOK = Struct("=Biqqq")  # slot, generation, seq, t_capture_ns
_NUMBER = Struct("=Bq")
_CAPTURED = Struct("=Biqqqq")  # frame, skipped
_HANDED = Struct("=Biqqqqqq")  # frame, skipped, worker, then_ns
_LOOKED = Struct("=BBBBqq18d")  # has, tracking, number of stages, seq, candidates; the names' bytes follow the times
_TIMES = tuple(Struct(f"={n}q") for n in range(256))
_TRACKING = tuple(Tracking)
_NOTHING = 0.0


def packed(message: object) -> bytes:
    pack = _PACK.get(type(message))
    return pickle.dumps(message, pickle.HIGHEST_PROTOCOL) if pack is None else pack(message)


def unpacked(data: bytes) -> Any:
    unpack = _UNPACK.get(data[0])
    return pickle.loads(data) if unpack is None else unpack(data)


CODEC = Codec(packed, unpacked)


def _frame(message: Look) -> bytes:
    frame = message.frame
    return _LOOK.pack(Tag.LOOK, frame.slot, frame.generation, frame.seq, frame.t_capture_ns)


def _captured(message: Captured) -> bytes:
    frame = message.frame
    return _CAPTURED.pack(
        Tag.CAPTURED, frame.slot, frame.generation, frame.seq, frame.t_capture_ns, message.skipped
    )  # fmt: skip


def _handed(message: Handed) -> bytes:
    frame = message.frame
    return _HANDED.pack(
        Tag.HANDED, frame.slot, frame.generation, frame.seq, frame.t_capture_ns, message.skipped, message.worker,
        message.then_ns,
    )  # fmt: skip


def _looked(message: Looked) -> bytes:
    """All but `rejected`: candidates that were not taken stay in the vision process, nobody asks for them here."""
    found = message.detection
    if found is None:
        return _NUMBER.pack(Tag.NOT_LOOKED, message.seq)
    has = 0
    u = v = radius = x_n = y_n = confidence = visible = p_u = p_v = p_radius = e_u = e_v = e_a = e_b = angle = _NOTHING
    if (circle := found.circle) is not None:
        has |= Has.CIRCLE
        u, v, radius = circle.u_px, circle.v_px, circle.radius_px
    if found.x_n is not None:
        has |= Has.X_N
        x_n = found.x_n
    if found.y_n is not None:
        has |= Has.Y_N
        y_n = found.y_n
    if (ellipse := found.ellipse) is not None:
        has |= Has.ELLIPSE
        e_u, e_v, e_a, e_b = ellipse.u_px, ellipse.v_px, ellipse.semi_major_px, ellipse.semi_minor_px
        angle = ellipse.angle_rad
    if found.confidence is not None:
        has |= Has.CONFIDENCE
        confidence = found.confidence
    if found.visible is not None:
        has |= Has.VISIBLE
        visible = found.visible
    if (predicted := found.predicted) is not None:
        has |= Has.PREDICTED
        p_u, p_v, p_radius = predicted.u_px, predicted.v_px, predicted.radius_px
    stages = found.stage_ns
    head = _LOOKED.pack(
        Tag.LOOKED, has, found.tracking, len(stages), message.seq, found.candidates, u, v, radius, found.area_px2,
        found.circularity, found.fill, x_n, y_n, confidence, visible, p_u, p_v, p_radius, e_u, e_v, e_a, e_b, angle,
    )  # fmt: skip
    times = _TIMES[len(stages)].pack(*[ns for _, ns in stages])
    return head + times + "\n".join([name for name, _ in stages]).encode()


def _unpack_looked(data: bytes) -> Looked:
    (
        _, has, tracking, count, seq, candidates, u, v, radius, area_px2, circularity, fill, x_n, y_n, confidence,
        visible, p_u, p_v, p_radius, e_u, e_v, e_a, e_b, angle,
    ) = _LOOKED.unpack_from(data)  # fmt: skip
    times = _TIMES[count]
    names = _names(data[_LOOKED.size + times.size :]) if count else ()
    return Looked(
        seq,
        Detection(
            Circle(u, v, radius) if has & Has.CIRCLE else None,
            area_px2,
            circularity,
            fill,
            candidates,
            x_n if has & Has.X_N else None,
            y_n if has & Has.Y_N else None,
            tuple(zip(names, times.unpack_from(data, _LOOKED.size), strict=True)),
            Ellipse(e_u, e_v, e_a, e_b, angle) if has & Has.ELLIPSE else None,
            confidence if has & Has.CONFIDENCE else None,
            visible if has & Has.VISIBLE else None,
            (),
            _TRACKING[tracking],
            Circle(p_u, p_v, p_radius) if has & Has.PREDICTED else None,
        ),
    )


@lru_cache(maxsize=64)
def _names(joined: bytes) -> tuple[str, ...]:
    """A method has a few sequences of stages."""
    return tuple(joined.decode().split("\n"))


def _unpack_captured(data: bytes) -> Captured:
    _, slot, generation, seq, t_capture_ns, skipped = _CAPTURED.unpack(data)
    return Captured(FrameRef(slot, generation, seq, t_capture_ns), skipped)


def _unpack_handed(data: bytes) -> Handed:
    _, slot, generation, seq, t_capture_ns, skipped, worker, then_ns = _HANDED.unpack(data)
    return Handed(FrameRef(slot, generation, seq, t_capture_ns), skipped, worker, then_ns)


_PACK: dict[type, Callable[[Any], bytes]] = {
    Look: _frame,
    GiveBack: lambda message: _NUMBER.pack(Tag.GIVE_BACK, message.slot),
    Straight: lambda message: _NUMBER.pack(Tag.STRAIGHT, message.worker),
    Captured: _captured,
    Handed: _handed,
    Looked: _looked,
}
_UNPACK: dict[int, Callable[[bytes], object]] = {
    Tag.LOOK: lambda data: Look(FrameRef(*_LOOK.unpack(data)[1:])),
    Tag.GIVE_BACK: lambda data: GiveBack(_NUMBER.unpack(data)[1]),
    Tag.STRAIGHT: lambda data: Straight(_NUMBER.unpack(data)[1]),
    Tag.CAPTURED: _unpack_captured,
    Tag.HANDED: _unpack_handed,
    Tag.LOOKED: _unpack_looked,
    Tag.NOT_LOOKED: lambda data: Looked(_NUMBER.unpack(data)[1], None),
}
