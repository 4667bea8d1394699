"""What a V4L2 camera offers of exposure time, gain and other controls, beside what the configuration asks for. IO; sets
nothing.

The controls are the device's: they can be read beside a gateway that has the camera.
"""

from collections.abc import Iterator, Sequence
from contextlib import closing

from gateway.config import BayConfig, CameraConfig
from gateway.errors import ConfigError
from gateway.vision.source.specs import CameraSpec, source_spec
from gateway.vision.source.v4l2_controls import ControlSetting, offered_by, problem, range_text, shown
from gateway.vision.source.v4l2_device import (
    EXPOSURE_ABSOLUTE,
    EXPOSURE_AUTO,
    GAIN,
    MANUAL,
    Range,
    V4l2Device,
    device_path,
)
from gateway.vision.source.v4l2_exposure import UNIT_US
from gateway.web.ipc.devices import Finding, Verdict

UNIT_MS = UNIT_US / 1000


def exposure(bay: BayConfig) -> Iterator[Finding]:
    """Of exposure, and of `[camera.controls]`. Nothing for another source, and for a device that can't be opened: that
    is the camera's finding."""
    try:
        spec = source_spec(bay.camera)
    except ConfigError:
        return
    if not isinstance(spec, CameraSpec):
        return
    path = device_path(spec.device)
    tried = f"ask {path} for its controls"
    try:
        device = V4l2Device(path)
    except OSError:
        return
    with closing(device):
        try:
            offered, time, gain = _offered(device)
            unfit, remedy = _compared(bay.camera, time, gain)
            result = f"{offered}; {unfit}" if unfit else offered
            yield Finding("exposure", bay.name, Verdict.WARNING if unfit else Verdict.OK, tried, result, remedy)
            yield _controls(bay.name, device, spec.controls, tried)
        except OSError as error:
            remedy = "unplug the camera, and plug it in again"
            yield Finding("exposure", bay.name, Verdict.WARNING, tried, f"it refuses: {error.strerror}", remedy)


def _controls(bay: str, device: V4l2Device, settings: Sequence[ControlSetting], tried: str) -> Finding:
    """All that `[camera.controls]` may set of this camera; a fault where the file says what it can't do. Raises
    OSError."""
    said = [f"{name} {range_text(name, offered)}, now {shown(name, now)}" for name, offered, now in offered_by(device)]
    wrong = [
        f"camera.controls.{one.name} = {shown(one.name, one.value)}: {why}"
        for one in settings
        if (why := problem(device, one))
    ]
    if not wrong:
        return Finding("controls", bay, Verdict.OK, tried, "; ".join(said) or "it has none that can be set")
    remedy = "set it to what the camera takes, or remove the key: until then the camera counts as lost"
    return Finding("controls", bay, Verdict.FAULT, tried, "; ".join(wrong), remedy)


def _offered(device: V4l2Device) -> tuple[str, Range | None, Range | None]:
    """In words, and the ranges of time and gain; None: none that can be set. Raises OSError."""
    time, gain = device.range_of(EXPOSURE_ABSOLUTE), device.range_of(GAIN)
    if gain is not None and gain.least == gain.most:
        gain = None
    said = ["no exposure time that can be set"]
    if time is not None:
        said = [f"exposure time {_least_ms(time):g} to {UNIT_MS * time.most:g} ms"]
        automatic = device.range_of(EXPOSURE_AUTO) is not None and device.get(EXPOSURE_AUTO) != MANUAL
        said += ["the camera sets it" if automatic else f"set to {UNIT_MS * device.get(EXPOSURE_ABSOLUTE):g} ms"]
    said += ["no gain that can be set" if gain is None else f"gain {gain.least} to {gain.most}, now {device.get(GAIN)}"]
    return ", ".join(said), time, gain


def _compared(camera: CameraConfig, time: Range | None, gain: Range | None) -> tuple[str, str]:
    """What does not fit, and what to do; empty: it does."""
    if camera.exposure != "marker":
        return "", ""
    if time is None:
        return (
            'camera.exposure = "marker" has nothing to set',
            'set camera.exposure = "camera", and the camera up for a short time by its own means',
        )
    if _least_ms(time) > camera.exposure_max_ms:
        return (
            f"its shortest is longer than camera.exposure_max_ms = {camera.exposure_max_ms:g}",
            "raise camera.exposure_max_ms, or take another camera",
        )
    if camera.gain_range_db is not None and gain is None:
        return "camera.gain_range_db has nothing to set", "remove camera.gain_range_db"
    return "", ""


def _least_ms(time: Range) -> float:
    return UNIT_MS * max(1, time.least)
