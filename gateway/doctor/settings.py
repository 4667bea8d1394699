"""What is legal in a configuration, and makes no sense in a plant. Pure.

One line each, with the key to edit: `gateway check` and `gateway doctor` print them. What can never work is a fault of
the file (`gateway.config`, `config_check.check`), and is not repeated here.
"""

from collections.abc import Iterator
from urllib.parse import urlsplit

from gateway.config import BayConfig, GatewayConfig
from gateway.config.sections.common import is_loopback
from gateway.vision.source.freshness import PROOFS
from gateway.vision.source.specs import names_file

USUAL_FPS = 30.0  # of a camera whose rate nobody has set
FOCAL_SHARE = 0.1  # two focal lengths of one camera that differ more are not both right


def warnings(config: GatewayConfig) -> list[str]:
    found = [f"bay {bay.name}: {line}" for bay in config.bays for line in _of_bay(bay)]
    if not config.state_dir:
        found.append(
            'state_dir = "": a truck in place, a function check and the learned R x Z are forgotten by a restart'
        )
    if config.mqtt is not None and config.mqtt.password_file is not None:
        plain = [url for url in config.mqtt.brokers if url.startswith("mqtt://")]
        if any(not is_loopback(urlsplit(url).hostname or "") for url in plain):
            found.append('mqtt.url: the password travels unencrypted; use "mqtts://..."')
    return found


def _of_bay(bay: BayConfig) -> Iterator[str]:
    yield from _geometry(bay)
    yield from _deadlines(bay)
    yield from _frozen_number(bay)
    fusion = bay.fusion
    if not fusion.fail_safe:
        yield "fusion.fail_safe = false: a blind gateway does not report stop; the PLC must watch the quality registers"
    if fusion.cross_check is None and (fusion.decision == "plain" or not fusion.scale_tolerance):
        key = 'decision = "plain"' if fusion.decision == "plain" else "scale_tolerance = 0"
        yield f"fusion.{key} without [fusion.cross_check]: sensors that contradict each other go unnoticed"
    if names_file(bay.camera) and not bay.camera.loop:
        yield f"camera.url = {bay.camera.url}: a film or a folder, which ends as a lost camera, unless loop = true"
    if not bay.camera.frozen_s:
        yield "camera.frozen_s = 0: a camera that repeats one picture for ever goes unnoticed"


def _geometry(bay: BayConfig) -> Iterator[str]:
    lens, check = bay.vision.intrinsics, bay.fusion.cross_check
    if lens is not None and check is not None and abs(check.focal_px / lens.fx - 1) > FOCAL_SHARE:
        yield (
            f"fusion.cross_check.focal_px = {check.focal_px:g} and vision.intrinsics.fx = {lens.fx:g} are the same "
            "camera's focal length, and differ by more than a tenth"
        )
    if lens is not None and lens.width_px is None and (bay.camera.crop is not None or bay.camera.rotation_deg):
        yield (
            "vision.intrinsics without width_px and height_px: nothing shows that they hold for the picture after "
            "camera.crop and camera.rotation_deg"
        )
    width_px, height_px = bay.camera.picture_px
    width_px = width_px or (None if lens is None else lens.width_px)
    height_px = height_px or (None if lens is None else lens.height_px)
    if width_px is None or height_px is None:
        return
    yield from of_picture(bay, width_px, height_px)


def of_picture(bay: BayConfig, width_px: int, height_px: int) -> Iterator[str]:
    """What does not fit a picture of that size."""
    size, radius_px = f"a picture of {width_px} x {height_px} px", bay.fusion.radius_threshold_px
    if 2 * radius_px > min(width_px, height_px):
        yield f"fusion.radius_threshold_px = {radius_px:g}: a circle of that radius does not fit into {size}"
    elif bay.vision.method == "robust":
        largest_px = bay.vision.max_radius_share * (width_px**2 + height_px**2) ** 0.5
        if radius_px > largest_px:
            yield (
                f"fusion.radius_threshold_px = {radius_px:g}: the search takes no circle above {largest_px:.0f} px "
                f"(vision.max_radius_share = {bay.vision.max_radius_share:g}), so D is never 1"
            )
    for key, value_px, side_px in (
        ("aim_u_px", bay.guidance.aim_u_px, width_px),
        ("aim_v_px", bay.guidance.aim_v_px, height_px),
    ):
        if value_px is None:
            continue
        if not 0 <= value_px < side_px:
            yield f"guidance.{key} = {value_px:g}: outside {size}"
        elif 2 * radius_px <= side_px and not radius_px <= value_px <= side_px - radius_px:
            yield f"guidance.{key} = {value_px:g}: a marker of R_th = {radius_px:g} px there is cut off by {size}"


def _frozen_number(bay: BayConfig) -> Iterator[str]:
    for sensor in bay.ranger.sensors:
        number = sensor.number
        faults = number.unchanged_s or number.fault_below is not None or number.fault_above is not None
        faults = faults or (sensor.type == "modbus" and sensor.modbus.status_mask)
        if sensor.type not in ("modbus", "ascii") or faults:
            continue
        yield (
            "ranger.number: unchanged_s, fault_below and fault_above are not set: what goes on sending the last number "
            "of a sensor that is gone looks like a truck that stands"
        )


def _deadlines(bay: BayConfig) -> Iterator[str]:
    camera, fusion = bay.camera, bay.fusion
    fps = camera.fps or USUAL_FPS
    if fusion.vision_deadline_s < 2 / fps:
        rate = f"camera.fps = {fps:g}" if camera.fps else f"the usual {fps:g} frames/s (camera.fps is not set)"
        yield (
            f"fusion.vision_deadline_s = {fusion.vision_deadline_s:g}: at {rate} a frame comes every "
            f"{1 / fps:.3g} s, so that one lost frame is a stop; at least {2 / fps:.3g}"
        )
    if camera.open_deadline_s <= PROOFS / fps and camera.frozen_s and not names_file(camera):
        yield (
            f"camera.open_deadline_s = {camera.open_deadline_s:g}: at camera.fps = {fps:g} the {PROOFS} new frames "
            f"that a source must show before it is believed take {PROOFS / fps:.3g} s, so that it is opened again for "
            "ever; set it higher"
        )
    cycle_s = bay.ranger.period_s
    if cycle_s is not None:
        # The median's middle reading is as old as half of the others; the next one is a period later.
        least_s = (bay.ranger.median // 2 + 2) * cycle_s
        if fusion.range_deadline_s < least_s:
            yield (
                f"fusion.range_deadline_s = {fusion.range_deadline_s:g}: the ranger measures every "
                f"{1000 * cycle_s:g} ms, and the median of {bay.ranger.median} makes a reading older; "
                f"at least {least_s:g}"
            )
