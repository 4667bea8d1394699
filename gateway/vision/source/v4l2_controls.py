"""`[camera.controls]` of a V4L2 camera: set when it opens, read back, and read again while it works.

A camera that does not have what the file says is a lost one, with the key, the value and what it takes: its pictures
are not those that the bay was set up with. A control that another program changes is noticed by the next look at it;
the camera is lost, opened again, and set again.
"""

import json
import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from gateway.config import ControlsConfig
from gateway.config.sections.camera_controls import AUTOMATIC
from gateway.durations import NS_PER_S
from gateway.errors import LinkError
from gateway.vision.source import v4l2_device as v4l2
from gateway.vision.source.v4l2_device import Range, V4l2Device, device_path

log = logging.getLogger(__name__)

LOOK_NS = 10 * NS_PER_S
CONTROLS = {
    "auto_exposure": v4l2.EXPOSURE_AUTO,
    "exposure_dynamic_framerate": v4l2.EXPOSURE_AUTO_PRIORITY,
    "exposure_time_absolute": v4l2.EXPOSURE_ABSOLUTE,
    "gain_automatic": v4l2.AUTOGAIN,
    "gain": v4l2.GAIN,
    "white_balance_automatic": v4l2.AUTO_WHITE_BALANCE,
    "white_balance_temperature": v4l2.WHITE_BALANCE_TEMPERATURE,
    "focus_automatic_continuous": v4l2.FOCUS_AUTO,
    "focus_absolute": v4l2.FOCUS_ABSOLUTE,
    "zoom_absolute": v4l2.ZOOM_ABSOLUTE,
    "power_line_frequency": v4l2.POWER_LINE_FREQUENCY,
    "brightness": v4l2.BRIGHTNESS,
    "contrast": v4l2.CONTRAST,
    "saturation": v4l2.SATURATION,
    "gamma": v4l2.GAMMA,
    "sharpness": v4l2.SHARPNESS,
    "backlight_compensation": v4l2.BACKLIGHT_COMPENSATION,
}
"""By key of `[camera.controls]`, in the order in which they are set: an automatic before what it would set."""
MENUS: dict[str, tuple[str, ...]] = {
    "auto_exposure": ("auto", "manual", "shutter_priority", "aperture_priority"),
    "power_line_frequency": ("disabled", "50hz", "60hz", "auto"),
}
"""The words for the values 0, 1, 2, ... of a control."""
FLAGS = frozenset(AUTOMATIC) - frozenset(MENUS) | {"exposure_dynamic_framerate"}
AUTOMATIC_OF = {value: automatic for automatic, value in AUTOMATIC.items()}
FREE_TIMES = (0, 3)  # of auto_exposure: those in which the camera sets the time
KEEPS = "the camera accepts it, and keeps"


@dataclass(frozen=True, slots=True)
class ControlSetting:
    """`implied`: the file does not say it; a camera without that control needs it not."""

    name: str
    value: int
    implied: bool = False


def settings_of(controls: ControlsConfig) -> tuple[ControlSetting, ...]:
    """What a camera is to be set to, in order."""
    given = {name: value for name in CONTROLS if (value := getattr(controls, name)) is not None}
    implied = {
        automatic: "manual" if automatic in MENUS else False
        for automatic, key in AUTOMATIC.items()
        if key in given and automatic not in given
    }
    both = given | implied
    return tuple(ControlSetting(name, _number(name, both[name]), name in implied) for name in CONTROLS if name in both)


def _number(name: str, value: int | str) -> int:
    return MENUS[name].index(value) if isinstance(value, str) else int(value)


def in_file(name: str, value: int) -> bool | int | str:
    """As the file has it."""
    if name in MENUS:
        return MENUS[name][value] if 0 <= value < len(MENUS[name]) else value
    return bool(value) if name in FLAGS else value


def shown(name: str, value: int) -> str:
    """The same as text of TOML."""
    return json.dumps(in_file(name, value))


class ControlDevice(Protocol):
    """`V4l2Device`, or what stands in for one. Every call may raise OSError."""

    def range_of(self, control: int) -> Range | None: ...

    def get(self, control: int) -> int: ...

    def set(self, control: int, value: int) -> int: ...

    def close(self) -> None: ...


@dataclass(frozen=True, slots=True)
class OfferedControl:
    """A control that the camera has. `fixed`: what the file sets; None: nothing."""

    name: str
    least: int
    most: int
    step: int
    default: int
    value: int
    fixed: int | None = None


class CameraControls:
    """Of one opened camera. For one thread."""

    def __init__(self, device: ControlDevice, label: str, settings: Iterable[ControlSetting]) -> None:
        self._device = device
        self._label = label
        self._settings = tuple(settings)
        self._looked_ns = 0
        self._tried = False
        self._found: dict[str, int] = {}  # what is tried, and what it was before

    def apply(self, now_ns: int) -> None:
        """What differs is set, then all is read back. Raises LinkError."""
        for setting in self._settings:
            if wrong := self._set(setting):
                raise self._lost(setting, wrong)
        self._look(now_ns, KEEPS)

    def look(self, now_ns: int) -> None:
        """To be called often: every ten seconds it is read again, unless something is tried. Raises LinkError."""
        if now_ns - self._looked_ns >= LOOK_NS and not self._tried:
            self._look(now_ns, "it was changed from outside, to")

    def try_(self, tried: Sequence[ControlSetting], found: Mapping[str, int]) -> tuple[dict[str, int], str]:
        """Set these over those of the file. What was tried before and is not any more is put back to the file's value,
        or what it was. `found`: what an earlier process had found of them.

        Returns what there is to be put back later, and what the camera refuses now; empty: nothing.
        """
        self._found |= found
        self._tried = bool(tried)
        names = {one.name for one in tried}
        self._put_back([name for name in CONTROLS if name in self._found and name not in names])
        wrong: list[str] = []
        for one in self._settings:  # that was tried, or that an automatic which was tried has moved
            if not {one.name, AUTOMATIC_OF.get(one.name)} & names:
                self._set(one)
        for one in tried:
            before = self._now(one.name)
            if before is not None:
                self._found.setdefault(one.name, before)
            why = self._set(one)
            now = self._now(one.name)
            if not why and now not in (None, one.value):
                why = f"{KEEPS} {shown(one.name, now or 0)}"
            if why:
                wrong.append(f"{one.name} = {shown(one.name, one.value)}: {why}")
        return dict(self._found), "; ".join(wrong)

    def offered(self) -> tuple[OfferedControl, ...]:
        """Raises OSError."""
        fixed = {one.name: one.value for one in self._settings if not one.implied}
        return tuple(
            OfferedControl(name, it.least, it.most, it.step, it.default, value, fixed.get(name))
            for name, it, value in offered_by(self._device)
        )

    def close(self) -> None:
        """As it is set: the next opening needs the same."""
        self._device.close()

    def _set(self, setting: ControlSetting) -> str:
        """Set it, where it differs. What prevents it; empty: nothing, or it is implied and the camera has it not."""
        control = CONTROLS[setting.name]
        if (wrong := problem(self._device, setting)) or self._device.range_of(control) is None:
            return wrong
        try:
            if self._device.get(control) != setting.value:
                self._device.set(control, setting.value)
        except OSError as error:
            return f"the camera refuses: {error.strerror}"
        return ""

    def _put_back(self, names: Sequence[str]) -> None:
        """The values before their automatics, and again after them: an automatic that is on has its value's way, and
        takes none."""
        for name in (*reversed(names), *names):
            if name in AUTOMATIC_OF and self._is_on(AUTOMATIC_OF[name]):
                continue
            if wrong := self._set(ControlSetting(name, self._found[name])):
                log.warning("%s: %s = %s: %s", self._label, name, shown(name, self._found[name]), wrong)
        for name in names:
            del self._found[name]

    def _is_on(self, automatic: str) -> bool:
        value = self._now(automatic)
        return value is not None and (value in FREE_TIMES if automatic == "auto_exposure" else bool(value))

    def _now(self, name: str) -> int | None:
        """None: the camera has it not, or does not say."""
        try:
            return None if self._device.range_of(CONTROLS[name]) is None else self._device.get(CONTROLS[name])
        except OSError:
            return None

    def _look(self, now_ns: int, otherwise: str) -> None:
        self._looked_ns = now_ns
        for setting in self._settings:
            control = CONTROLS[setting.name]
            if setting.implied and self._device.range_of(control) is None:
                continue
            try:
                if (now := self._device.get(control)) != setting.value:
                    raise self._lost(setting, f"{otherwise} {shown(setting.name, now)}")
            except OSError as error:
                raise self._lost(setting, f"it can't be read: {error.strerror}") from error

    def _lost(self, setting: ControlSetting, why: str) -> LinkError:
        what = f"camera.controls.{setting.name} = {shown(setting.name, setting.value)}"
        return LinkError(f"{self._label}: {what}: {why}")


def opened(
    device: int | str, label: str, settings: Iterable[ControlSetting], handle: V4l2Device | None = None
) -> CameraControls:
    """`handle`: of the device, where there is one already. Raises LinkError where the device can't be opened."""
    try:
        return CameraControls(handle.again() if handle else V4l2Device(device_path(device)), label, settings)
    except OSError as error:
        raise LinkError(f"{label}: camera.controls: {error.strerror}") from error


def problem(device: ControlDevice, setting: ControlSetting) -> str:
    """Why a camera can't be set so, by what it says of itself; empty: it can. Nothing is set."""
    offered = device.range_of(CONTROLS[setting.name])
    if offered is None:
        return "" if setting.implied else "the camera has no such control that can be set"
    return "" if allowed(offered, setting.value) else f"the camera takes {range_text(setting.name, offered)}"


def allowed(offered: Range, value: int) -> bool:
    return offered.least <= value <= offered.most and (value - offered.least) % offered.step == 0


def range_text(name: str, offered: Range) -> str:
    steps = f" in steps of {offered.step}" if offered.step > 1 else ""
    return f"{shown(name, offered.least)} to {shown(name, offered.most)}{steps}"


def offered_by(device: ControlDevice) -> Iterator[tuple[str, Range, int]]:
    """Name, range and present value of each control of the table that the camera has. Raises OSError."""
    for name, control in CONTROLS.items():
        if (offered := device.range_of(control)) is not None:
            yield name, offered, device.get(control)
