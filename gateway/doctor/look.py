"""A camera or a ranger that no bay has yet, looked at while somebody sets it up: figures and pictures. IO, and blocks.

The measures and the advice are those of an examination (`sensors`), taken again and again over the newest frames or
distances. Nothing happens to a device but that it is opened, as a bay would.
"""

import statistics
from collections.abc import Callable
from contextlib import suppress

from gateway.clock import Clock
from gateway.config import BayConfig, CameraConfig, RangerConfig
from gateway.doctor import sensors
from gateway.doctor.sensors import CameraLook, RangerLook
from gateway.durations import NS_PER_S
from gateway.errors import ConfigError, GatewayError
from gateway.ranger import flashing
from gateway.vision.detect import registry
from gateway.vision.source.contract import Frame
from gateway.vision.source.specs import source_spec
from gateway.vision.transport.messages import DetectorSpec
from gateway.web.ipc.devices import CameraSeen, Finding, FlashSeen, RangerSeen, TriedParts, Verdict
from gateway.web.server.pictures import encoded

LOOK_S = 120.0  # then it ends, whoever still watches
PICTURE_S, FIGURES_S = 1.0, 0.5
PICTURE_PX = 640  # width of the picture
RECENT = 90  # frames that rate and lateness are of
READINGS = 30  # distances that rate and noise are of: two seconds of a healthy board

SendCamera = Callable[[CameraSeen | TriedParts], None]
SendRanger = Callable[[RangerSeen | TriedParts], None]


class _CameraFigures:
    """Sends a picture with its figures about once a second."""

    def __init__(self, bay: BayConfig, label: str, clock: Clock, send: SendCamera) -> None:
        self.look = CameraLook()
        self._bay, self._label, self._clock, self._send = bay, label, clock, send
        self._detect = DetectorSpec(bay.vision).build(clock.now_ns)
        self._due_ns = 0
        self._begun = False
        self._forgotten = 0  # frames that the figures are no longer of

    def fresh(self, frame: Frame) -> None:
        now_ns = self._clock.now_ns()
        if now_ns < self._due_ns:
            return
        self._send(self._seen(frame))
        self._due_ns = self._clock.now_ns() + round(PICTURE_S * NS_PER_S)
        kept = RECENT if self._begun else 0  # the first search takes longer, and frames are missed meanwhile
        self._begun = True
        if (more := len(self.look.arrived_ns) - kept) > 0:
            self._forgotten += more
            del self.look.arrived_ns[:more], self.look.late_ns[:more]

    def _seen(self, frame: Frame) -> CameraSeen:
        look, vision = self.look, self._bay.vision
        found = self._detect(registry.given(vision, frame.pixels), frame.t_capture_ns).circle
        height_px, width_px = frame.pixels.shape[:2]
        problem, remedy = sensors.frames_advice(look, self._bay.camera.fps) if len(look.arrived_ns) > 1 else ("", "")
        verdict = Verdict.WARNING if problem else Verdict.OK
        return CameraSeen(
            line=Finding("camera", "", verdict, f"open {self._label}, read it", problem or "it gives pictures", remedy),
            width_px=width_px,
            height_px=height_px,
            rate_hz=look.rate_hz,
            late_ms=look.late_ms,
            frames=self._forgotten + len(look.arrived_ns),
            fresh=look.fresh,
            marker=None if found is None else (found.u_px, found.v_px, found.radius_px),
            jpeg=encoded(frame.image, PICTURE_PX),
        )


def camera(config: CameraConfig, clock: Clock, send: SendCamera, seconds: float = LOOK_S) -> None:
    """Returns after `seconds`, or with the camera's fault sent."""
    label, figures = "the camera", None
    try:
        spec = source_spec(config)
        label = spec.label
        bay = BayConfig(camera=config)
        source = spec.open(clock)
        try:
            figures = _CameraFigures(bay, label, clock, send)
            sensors.read(source, bay, label, clock, seconds, figures.look, figures.fresh)
        finally:
            source.close()
    except GatewayError as error:
        result = str(error).removeprefix(f"{label}: ")
        if figures is not None and figures.look.finite and figures.look.fresh:
            send(
                TriedParts((Finding("camera", "", Verdict.OK, f"look at {label}", "the film has ended", "look again"),))
            )
            return
        remedy = "correct it" if isinstance(error, ConfigError) else sensors.camera_remedy(result)
        send(TriedParts((Finding("camera", "", Verdict.FAULT, f"open {label}, read it", result, remedy),)))
    else:
        send(_ended("camera", label, seconds))


class _RangerFigures:
    """Sends the newest distance with its figures twice a second."""

    def __init__(self, port: str, clock: Clock, send: SendRanger) -> None:
        self.look = RangerLook()
        self._port, self._clock, self._send = port, clock, send
        self._begun_ns = self._due_ns = clock.now_ns()

    def heard(self) -> None:
        now_ns = self._clock.now_ns()
        if now_ns < self._due_ns or not self.look.readings:
            return
        self._due_ns = now_ns + round(FIGURES_S * NS_PER_S)
        del self.look.readings[:-READINGS]
        self._send(self._seen((now_ns - self._begun_ns) / NS_PER_S))

    def _seen(self, after_s: float) -> RangerSeen:
        look = self.look
        line = sensors.ranger_judged("", look, f"open {self._port}, listen", max(after_s, FIGURES_S))
        if not look.identity and after_s < sensors.HELLO_S:
            text = (
                f"nothing yet; a board starts when its port is opened, and says who it is within {sensors.HELLO_S:g} s"
            )
            line = Finding(line.part, "", Verdict.WAITING, line.tried, text)
        last, good = look.readings[-1], [r for r in look.readings if r.distance_mm is not None]
        distances_mm = [r.distance_mm for r in good if r.distance_mm is not None]
        span_s = (good[-1].t_ns - good[0].t_ns) / NS_PER_S if len(good) > 1 else 0.0
        return RangerSeen(
            line=line,
            identity=look.identity,
            distance_mm=last.distance_mm,
            noise_mm=statistics.stdev(distances_mm) if len(distances_mm) > 1 else None,
            rate_hz=(len(good) - 1) / span_s if span_s > 0 else 0.0,
            lines_hz=last.stats.lines / max(after_s, FIGURES_S),
            damaged=last.stats.damaged,
        )


def ranger(config: RangerConfig, clock: Clock, send: SendRanger, seconds: float = LOOK_S) -> None:
    """Returns after `seconds`, or with the port's fault sent."""
    figures = _RangerFigures(config.port, clock, send)
    try:
        sensors.listen(config, clock, seconds, figures.look, figures.heard)
    except GatewayError as error:
        result = str(error).removeprefix(f"ranger port {config.port}: ")
        remedy = "correct it" if isinstance(error, ConfigError) else sensors.port_remedy(result)
        send(TriedParts((Finding("ranger", "", Verdict.FAULT, f"open {config.port}, listen", result, remedy),)))
    else:
        send(_ended("ranger", config.port, seconds))


def flash(port: str, clock: Clock, send: Callable[[FlashSeen | TriedParts], None]) -> None:
    """Writes the gateway's firmware, whether or not anybody watches. Returns with its result sent."""
    tried = f"write the gateway's firmware to {port}"

    def tell(piece: FlashSeen | TriedParts) -> None:
        with suppress(OSError):
            send(piece)

    def progress(done: float) -> None:
        doing = "writes" if done < 0.5 else "reads it back"
        tell(FlashSeen(Finding("firmware", "", Verdict.WAITING, tried, doing), done))

    line = Finding("firmware", "", Verdict.OK, tried, "written, and read back equal", "look at the board")
    try:
        flashing.flash(port, flashing.image(), clock, progress)
    except GatewayError as error:
        result = str(error).removeprefix(f"ranger port {port}: ")
        line = Finding("firmware", "", Verdict.FAULT, tried, result, sensors.port_remedy(result))
    tell(TriedParts((line,)))


def _ended(part: str, what: str, seconds: float) -> TriedParts:
    return TriedParts((Finding(part, "", Verdict.OK, f"look at {what}", f"ended after {seconds:g} s", "look again"),))
