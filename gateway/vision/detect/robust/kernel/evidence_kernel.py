"""`evidence.gather_plain` and `of_ellipses_plain` in C: tables, memory, and what is made of the result. Pure."""

import ctypes
import math
import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Ellipse
from gateway.vision.detect.robust import ellipses, evidence, radial_sampling, redness, rings
from gateway.vision.detect.robust.candidates import Seed
from gateway.vision.detect.robust.evidence import Evidence
from gateway.vision.detect.robust.kernel.rim_kernel import opencv_fuses
from gateway.vision.detect.robust.redness import PyramidLevel
from gateway.vision.pixels import adjacent

_Pointer, _Int = ctypes.c_void_p, ctypes.c_int64
_LEVEL = struct.Struct("=5q")
_SHAPE = struct.Struct("=6d")
_ROW = struct.Struct("=21d")
RIMS, SEEDS, ENDS = range(3)  # what is asked
_FIELDS = ("cos", "sin", "log", "wide", "close", "rings", "outwards", "triples")
_COUNTS = ("wide_count", "close_count", "triple_count", "outwards_count", "core", "disc", "inside", "fused")


class _Tables(ctypes.Structure):
    _fields_ = (
        *((name, _Pointer) for name in _FIELDS),
        *((name, _Int) for name in _COUNTS),
        ("gain", ctypes.c_double),
    )


class EvidenceKernel:
    """The compiled evidence. May be called from any thread: each call has memory of its own."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._call = library.gateway_evidence
        self._call.argtypes = [_Pointer, _Int, _Pointer, _Int, _Int, _Pointer, _Pointer]
        self._call.restype = None
        library.gateway_evidence_work.restype = _Int
        self._work_size = int(library.gateway_evidence_work())
        self._rooms: list[NDArray[np.uint8]] = []
        self.kept: list[NDArray[np.generic]] = []  # what the tables point to
        self.tables = self._made()
        self._of_gain = {1.0: self.tables}

    def gather(self, levels: Sequence[PyramidLevel], seeds: Sequence[Seed]) -> list[Evidence | None]:
        """As `evidence.gather_plain`, for levels whose pixels lie side by side (`possible`)."""
        shapes = [(seed.u_px, seed.v_px, seed.radius_px, seed.radius_px, 1.0, 0.0) for seed in seeds]
        rows = self.run(levels, shapes, SEEDS)
        return [_evidence_of(row, math.atan2(row[5], row[4]) % math.pi, levels[0]) if row[6] else None for row in rows]

    def of_ellipses(self, levels: Sequence[PyramidLevel], rims: Sequence[Ellipse]) -> list[Evidence | None]:
        """As `evidence.of_ellipses_plain`."""
        rows = self.run(levels, [_shape_of(rim) for rim in rims], RIMS)
        return [
            _evidence_of(row, rim.angle_rad, levels[0]) if row[6] else None for row, rim in zip(rows, rims, strict=True)
        ]

    def red_ends(self, levels: Sequence[PyramidLevel], rim: Ellipse) -> bool:
        """As `rings.red_ends_plain`."""
        return bool(self.run(levels, [_shape_of(rim)], ENDS)[0][6])

    def run(
        self, levels: Sequence[PyramidLevel], shapes: Sequence[tuple[float, ...]], kind: int
    ) -> list[tuple[float, ...]]:
        """`EvidenceRow` of each shape: u, v, two semi-axes (px of the full frame), cosine and sine of its angle."""
        described = bytearray(_LEVEL.size * len(levels))
        for n, level in enumerate(levels):
            picture = level.bgr
            at = picture.__array_interface__["data"][0]
            _LEVEL.pack_into(described, n * _LEVEL.size, at, picture.strides[0], *picture.shape[:2], level.factor)
        rows = bytearray(_ROW.size * len(shapes))
        for n, shape in enumerate(shapes):
            _SHAPE.pack_into(rows, n * _ROW.size, *shape)
        room = self._rooms.pop() if self._rooms else np.empty(self._work_size, np.uint8)
        pictures = (ctypes.c_char * len(described)).from_buffer(described)
        results = (ctypes.c_char * len(rows)).from_buffer(rows)
        self._call(
            ctypes.addressof(pictures), len(levels), ctypes.addressof(results), len(shapes), kind,
            ctypes.addressof(self._tables(levels[0].gain)), room.ctypes.data,
        )  # fmt: skip
        self._rooms.append(room)
        return list(_ROW.iter_unpack(rows))

    def _tables(self, gain: float) -> _Tables:
        """All but a logarithm of its own is shared. There are few: `veil` rounds the gain."""
        tables = self._of_gain.get(gain)
        if tables is None:
            tables = _Tables.from_buffer_copy(self.tables)
            log = redness.log_table(gain)
            tables.log, tables.gain = log.ctypes.data, gain
            self.kept.append(log)
            self._of_gain[gain] = tables
        return tables

    def _made(self) -> _Tables:
        triples = ellipses.triples(radial_sampling.RAYS).astype(np.int32)
        tables = _Tables(
            wide_count=evidence.WIDE.size,
            close_count=evidence.CLOSE.size,
            triple_count=len(triples),
            outwards_count=rings.OUTWARDS.size,
            core=rings.CORE.size,
            disc=evidence.DISC.size,
            inside=evidence.INSIDE.size,
            fused=opencv_fuses(),
            gain=1.0,
        )
        shares = (evidence.WIDE, evidence.CLOSE, evidence.RINGS, rings.OUTWARDS)
        shared = (radial_sampling.COS, radial_sampling.SIN, redness.LOG, *shares, triples)
        for name, values in zip(_FIELDS, shared, strict=True):
            lasting = np.ascontiguousarray(values)
            self.kept.append(lasting)
            setattr(tables, name, lasting.ctypes.data)
        return tables


def _shape_of(rim: Ellipse) -> tuple[float, ...]:
    c, s = math.cos(rim.angle_rad), math.sin(rim.angle_rad)
    return rim.u_px, rim.v_px, rim.semi_major_px, rim.semi_minor_px, c, s


def possible(levels: Sequence[PyramidLevel]) -> bool:
    """Whether all are 8-bit pictures, the pixels of each row side by side."""
    return all(adjacent(level.bgr) for level in levels)


def _evidence_of(row: tuple[float, ...], angle_rad: float, level: PyramidLevel) -> Evidence:
    u, v, major, minor, _, _, _, coverage, leak, covered, visible, contrast, rise, noise, *rest = row
    fill, hollow, redness_, haze, blue, green, red = rest
    return Evidence(
        ellipse=Ellipse(u, v, major, minor, angle_rad), coverage=coverage, leak=leak, covered=covered,
        visible=visible, contrast=contrast, rise=rise, noise=noise, fill=fill, hollow=hollow, redness=redness_,
        veil=level.veil_at(u, v), haze=haze, colour=(blue, green, red),
    )  # fmt: skip
