"""`refinement.refine_plain` in C: its tables, its memory, and the comparison with OpenCV's sampling. Pure."""

import ctypes
import struct

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Ellipse
from gateway.vision.compiled.sizes import COARSE_RAYS, FALL_RAYS, LEAST_RAYS, MOST_RAYS, PROFILE_STEPS, RAYS_STEP
from gateway.vision.detect.robust import normal_profiles, rim_coarse, rim_fine
from gateway.vision.detect.robust.conic import SupportEllipse, from_ellipse, to_ellipse
from gateway.vision.detect.robust.kernel import lab
from gateway.vision.detect.robust.rim_fine import Rim
from gateway.vision.pixels import Image

NONE, FOUND, NO_PROFILE = 0, 1, 2
_DIRECTIONS = MOST_RAYS // RAYS_STEP + 1
_PROFILES = 64  # kept

# Four neighbouring pixels, shares to the right and downwards, and what a processor gives that multiplies and adds at
# once; one that rounds in between gives another grey level each time.
_FUSED = (
    ((211, 13, 48, 253), "0x1.6ff78p-6", "0x1.ba8140p-1", 73),
    ((153, 114, 203, 49), "0x1.085134p-1", "0x1.929a58p-1", 126),
    ((10, 75, 98, 83), "0x1.87e604p-2", "0x1.4fb28ap-1", 73),
    ((46, 68, 242, 137), "0x1.643c20p-4", "0x1.d57524p-1", 217),
)

_Pointer, _Int, _Real = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double


class _Subsets(ctypes.Structure):
    _fields_ = (("rays", _Pointer), ("inverses", _Pointer), ("size", _Int), ("count", _Int))


class _Lab(ctypes.Structure):
    _fields_ = (("linear", _Pointer), ("root", _Pointer), ("x", _Int * 3), ("y", _Int * 3))


class _Tables(ctypes.Structure):
    _fields_ = (
        ("coarse", _Pointer),
        ("directions", _Pointer * _DIRECTIONS),
        ("filter", _Pointer),
        ("subsets", _Subsets * 2),
        ("lab", _Lab),
        ("fused", _Int),
    )


class _Task(ctypes.Structure):
    _fields_ = (
        *((name, _Int) for name in ("pixels", "stride", "height", "width")),
        *((name, _Real) for name in ("u", "v", "alpha", "beta", "gamma", "search_px", "sigma")),
        *((name, _Int) for name in ("opponent", "turn")),
        *((name, _Pointer) for name in ("profile_keys", "profiles")),
        ("profile_count", _Int),
        ("missing", _Int * 3),
        *((name, _Real) for name in ("rms_px", "contrast", "blur_px", "wave_px")),
        *((name, _Int) for name in ("inliers", "inside", "rays")),
    )


# Read and written at one stroke: field by field takes ten times as long where the caches are cold.
_ASKED, _OUTLINE, _RESULT = struct.Struct("=4q7d2q"), struct.Struct("=5d"), struct.Struct("=4d3q")


class Room:
    """What one call works in, and where it is."""

    def __init__(self, work_size: int) -> None:
        self._work = np.empty(work_size, np.uint8)
        self.keys = np.zeros((_PROFILES, 3), np.int64)
        self.profiles = np.zeros((_PROFILES, 5 * PROFILE_STEPS + 16))
        self.task = _Task(profile_keys=self.keys.ctypes.data, profiles=self.profiles.ctypes.data)
        self.task_at = ctypes.addressof(self.task)
        self.work_at = self._work.ctypes.data

    def add_profile(self, sigma_tenths: int, half_steps: int, step_hundredths: int) -> None:
        """The last place is taken by each that finds the table full."""
        made = normal_profiles.profile(sigma_tenths, half_steps, step_hundredths)
        at = min(self.task.profile_count, _PROFILES - 1)
        steps = len(made.offsets_px)
        self.keys[at] = sigma_tenths, half_steps, step_hundredths
        self.profiles[at, :steps] = made.offsets_px
        self.profiles[at, PROFILE_STEPS : PROFILE_STEPS + 4 * steps] = made.filters.ravel()
        self.profiles[at, 5 * PROFILE_STEPS :] = made.gram.ravel()
        self.task.profile_count = at + 1


class RimKernel:
    """The compiled refinement. May be called from any thread: each call has memory of its own."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._call = library.gateway_rim
        self._call.argtypes = [_Pointer, _Pointer, _Pointer]
        self._call.restype = ctypes.c_int
        self._fall = library.gateway_fall
        self._fall.argtypes = [_Pointer, _Pointer, _Pointer]
        self._fall.restype = _Real
        library.gateway_rim_work.restype = _Int
        self.work_size = int(library.gateway_rim_work())
        self._rooms: list[Room] = []
        self._kept: list[NDArray[np.generic]] = []  # what the tables point to
        self.tables = self._made()
        self._tables_at = ctypes.addressof(self.tables)

    def refine(self, image: Image, seed: Ellipse, search_px: float, opponent: bool) -> Rim | None:
        """As `refinement.refine_plain`, for a picture whose pixels lie side by side (`pixels.adjacent`)."""
        room = self._room()
        found = self.run(room, image, seed, search_px, opponent)
        rim = _rim_of(room.task) if found else None
        self._rooms.append(room)
        return rim

    def fall(self, image: Image, rim: Ellipse, share: float) -> float:
        """As `refinement.fall_plain`, for a picture whose pixels lie side by side."""
        room = self._room()
        set_task(room.task, image, rim, share * rim.semi_minor_px, True)
        found = float(self._fall(room.task_at, self._tables_at, room.work_at))
        self._rooms.append(room)
        return found

    def run(self, room: Room, image: Image, seed: Ellipse, search_px: float, opponent: bool) -> bool:
        """Whether there is a rim; it is in the room's task then."""
        set_task(room.task, image, seed, search_px, opponent)
        while (result := self._call(room.task_at, self._tables_at, room.work_at)) == NO_PROFILE:
            room.add_profile(*room.task.missing)
        return bool(result == FOUND)

    def _room(self) -> Room:
        try:
            return self._rooms.pop()
        except IndexError:
            return Room(self.work_size)

    def _made(self) -> _Tables:
        tables = _Tables()
        tables.coarse = self._at(directions_of(COARSE_RAYS))
        for count in (FALL_RAYS, *range(LEAST_RAYS, MOST_RAYS + 1, RAYS_STEP)):
            tables.directions[count // RAYS_STEP] = self._at(directions_of(count))
        tables.filter = self._at(rim_coarse.edge_filter())
        for n, (rays, inverses) in enumerate(rim_coarse.subsets()):
            place = self._at(rays.astype(np.int32)), self._at(inverses)
            tables.subsets[n] = _Subsets(*place, rays.shape[1], len(rays))
        x, y = ((_Int * 3)(*row) for row in lab.weights().tolist())
        tables.lab = _Lab(self._at(lab.linear()), self._at(lab.root()), x, y)
        tables.fused = opencv_fuses()
        return tables

    def _at(self, values: NDArray[np.generic]) -> int:
        """The address of a copy that lies side by side, or of the array itself, which stays."""
        lasting = np.ascontiguousarray(values)
        self._kept.append(lasting)
        return lasting.ctypes.data


def set_task(task: _Task, image: Image, seed: Ellipse, search_px: float, opponent: bool) -> None:
    _ASKED.pack_into(
        task,  # a Structure is a buffer
        0,
        image.__array_interface__["data"][0],
        image.strides[0],
        *image.shape[:2],
        *from_ellipse(seed),
        search_px,
        0.0,  # no guess at the blur yet
        opponent,
        0,
    )


def opencv_fuses() -> bool:
    """Whether OpenCV's bilinear sampling multiplies and adds at once here."""
    for corners, right, down, level in _FUSED:
        picture = np.repeat(np.array(corners, np.uint8).reshape(2, 2, 1), 3, axis=2)
        columns, rows = (np.full((1, 64), float.fromhex(share), np.float32) for share in (right, down))
        taken = cv2.remap(picture, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        if np.asarray(taken)[0, 0, 0] != level:
            return False
    return True


def directions_of(count: int) -> NDArray[np.float64]:
    """(4 + SMOOTH_ROWS, count): cosine, sine, of the angle and of its double, and the smoothing."""
    at = normal_profiles.directions(count)
    return np.concatenate([at.normal, at.waves[1:], rim_fine.neighbours(count).T])


def _rim_of(task: _Task) -> Rim:
    outline = SupportEllipse(*_OUTLINE.unpack_from(task, _Task.u.offset))
    rms_px, contrast, blur_px, wave_px, inliers, inside, rays = _RESULT.unpack_from(task, _Task.rms_px.offset)
    support, visible = inliers / max(inside, 1), inliers / rays
    return Rim(to_ellipse(outline), rms_px, support, visible, contrast, inliers, blur_px, wave_px)
