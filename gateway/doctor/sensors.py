"""A bay's camera and ranger, opened and measured for some seconds. IO; each may hang, which is a finding.

Where the gateway runs it has them, and its shared state vector is asked instead.
"""

import resource
import statistics
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

from gateway.clock import Clock
from gateway.config import BayConfig, RangerConfig
from gateway.core.readings import FRESH_FRAME, RANGE_FINE, AgeProof, Quality, RangeReading
from gateway.doctor import settings
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.errors import ConfigError, GatewayError, LinkError
from gateway.ranger.ranger_service import RangerService
from gateway.shared_state import SharedVector
from gateway.vision.detect import registry
from gateway.vision.process.vision_service import frame_rules
from gateway.vision.source.checks import FrameChecks
from gateway.vision.source.contract import Frame, Source
from gateway.vision.source.framing import Framing
from gateway.vision.source.specs import source_spec
from gateway.vision.transport.messages import DetectorSpec
from gateway.web.ipc.devices import Finding, Verdict

HANG_S = 5.0  # beyond its own deadlines: whatever was tried does not come back
HELLO_S = 6.0  # an Uno resets when its port is opened, and says who it is every 5 s
SEARCHED = 10  # frames, for the marker
SLOW_SHARE = 0.8  # of the frame rate that was asked for
LATE_MS = 200.0  # a reading that is older loses half of the usual deadline before anything is computed
NOISY_MM = 5.0  # standard deviation; an HC-SR04 on a flat wall has 1 to 3
DAMAGED_SHARE = 0.02
CORE_SHARE = 0.5  # of a core, for one bay's vision


def running(bay: BayConfig, vector: SharedVector, now_ns: int) -> Iterator[Finding]:
    """Both sensors of a bay as the running gateway sees them."""
    age_ms = (now_ns - vector.t_vision_ns) / NS_PER_MS
    seen = f"{vector.vision_quality.meaning}; frame {vector.frame_id}, {age_ms:.0f} ms old"
    if vector.vision_quality is Quality.GOOD:
        seen += f"; u {vector.u_px:.1f}, v {vector.v_px:.1f}, R {vector.radius_px:.1f} px"
    yield _running("camera", bay.name, seen, well=vector.vision_quality in FRESH_FRAME)
    age_ms = (now_ns - vector.t_range_ns) / NS_PER_MS
    heard = f"{vector.range_quality.meaning}; {age_ms:.0f} ms old"
    if vector.range_quality is Quality.GOOD:
        heard += f"; Z {vector.distance_mm:.0f} mm"
    well = vector.range_quality in RANGE_FINE or vector.range_quality in (Quality.NO_ECHO, Quality.TOO_FAR)
    yield _running("ranger", bay.name, heard, well=well)


def _running(part: str, bay: str, result: str, *, well: bool) -> Finding:
    remedy = "" if well else "look at the alarms of the running gateway, or stop it and ask again"
    verdict = Verdict.OK if well else Verdict.FAULT
    return Finding(part, bay, verdict, "ask the running gateway, which has it", result, remedy)


def in_time(work: Callable[[], None], timeout_s: float) -> bool:
    """False: `work` did not come back. Its thread is not waited for, and ends with the program."""
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(timeout_s)
    return not thread.is_alive()


@dataclass(slots=True)
class CameraLook:
    """What was seen of a camera. Times in ns."""

    error: str = ""
    opened_ns: int = 0
    first_ns: int = 0
    delivered_px: tuple[int, int] = (0, 0)
    arrived_ns: list[int] = field(default_factory=list)
    late_ns: list[int] = field(default_factory=list)  # from capture to arrival
    fresh: int = 0  # frames that have proved to be new
    read: int = 0
    damaged: int = 0  # frames beside these that could not be decoded
    age_proof: AgeProof = AgeProof.UNPROVEN  # of the newest frame
    radius_px: list[float] = field(default_factory=list)
    detector_s: list[float] = field(default_factory=list)  # processor time
    finite: bool = False

    @property
    def rate_hz(self) -> float:
        span_s = (self.arrived_ns[-1] - self.arrived_ns[0]) / NS_PER_S
        return (len(self.arrived_ns) - 1) / span_s if span_s else 0.0

    @property
    def late_ms(self) -> float:
        return statistics.median(self.late_ns) / NS_PER_MS


def camera(bay: BayConfig, clock: Clock, seconds: float) -> Iterator[Finding]:
    config, look = bay.camera, CameraLook()
    try:
        spec = source_spec(config)
    except ConfigError as error:
        yield Finding("camera", bay.name, Verdict.FAULT, "camera.url", str(error), "correct the configuration")
        return
    tried = f"open {spec.label}, read it for {seconds:g} s"

    def work() -> None:
        try:
            look.opened_ns = clock.now_ns()
            source = spec.open(clock)
            try:
                _read(source, bay, spec.label, clock, seconds, look)
            finally:
                source.close()
        except GatewayError as error:
            look.error = str(error).removeprefix(f"{spec.label}: ")

    if not in_time(work, config.open_deadline_s + seconds + HANG_S):
        what = "it opened, then no frame came" if look.first_ns == 0 else "it stopped giving frames"
        yield Finding("camera", bay.name, Verdict.FAULT, tried, f"no answer: {what}", "check cable, power and address")
    elif (look.error and not (look.finite and look.fresh)) or not look.arrived_ns:  # a film may end
        result = look.error or "it gave no frame"
        yield Finding("camera", bay.name, Verdict.FAULT, tried, result, camera_remedy(result))
    else:
        yield from _judged(bay, look, tried)


def _processor_s() -> float:
    """Of this thread so far."""
    used = resource.getrusage(resource.RUSAGE_THREAD)
    return used.ru_utime + used.ru_stime


def _read(source: Source, bay: BayConfig, label: str, clock: Clock, seconds: float, look: CameraLook) -> None:
    """Frames as the vision process would check them; the last ones are searched afterwards, which takes its time."""
    newest: deque[Frame] = deque(maxlen=SEARCHED)
    try:
        read(source, bay, label, clock, seconds, look, newest.append)
    finally:
        _search(newest, bay, clock, look)


def read(
    source: Source,
    bay: BayConfig,
    label: str,
    clock: Clock,
    seconds: float,
    look: CameraLook,
    fresh: Callable[[Frame], None],
) -> None:
    """For this time after the first frame; `fresh` gets those that have proved to be new. Raises LinkError."""
    checks = FrameChecks(label, frame_rules(bay.camera, bay.vision), None, may_repeat=source.may_repeat)
    until_ns, look.finite = None, source.finite
    while until_ns is None or clock.now_ns() < until_ns:
        frame = source.read()
        now_ns = clock.now_ns()
        if until_ns is None:
            look.first_ns, until_ns = now_ns, now_ns + round(seconds * NS_PER_S)
            look.delivered_px = (frame.pixels.shape[1], frame.pixels.shape[0])
        look.arrived_ns.append(now_ns)
        look.read += 1
        look.damaged += frame.damaged
        look.age_proof = frame.age_proof
        look.late_ns.append(max(0, now_ns - frame.t_capture_ns))
        if (passed := checks.passed(frame)) is not None:
            look.fresh += 1
            fresh(passed.used)


def _search(frames: Iterable[Frame], bay: BayConfig, clock: Clock, look: CameraLook) -> None:
    detect = DetectorSpec(bay.vision).build(clock.now_ns)
    for frame in frames:
        begun_s = _processor_s()
        found = detect(registry.given(bay.vision, frame.pixels), frame.t_capture_ns)
        look.detector_s.append(_processor_s() - begun_s)
        if found.circle is not None:
            look.radius_px.append(found.circle.radius_px)


def _judged(bay: BayConfig, look: CameraLook, tried: str) -> Iterator[Finding]:
    frames, rate_hz, late_ms = len(look.arrived_ns), look.rate_hz, look.late_ms
    width_px, height_px = look.delivered_px
    used_px = Framing.of(bay.camera).size_px(look.delivered_px)
    first_s = (look.first_ns - look.opened_ns) / NS_PER_S
    used = "" if used_px == look.delivered_px else f" ({used_px[0]} x {used_px[1]} px after crop and rotation)"
    result = (
        f"{width_px} x {height_px} px{used}, {rate_hz:.1f} frames/s, the first after {first_s:.1f} s, "
        f"{late_ms:.0f} ms old when they arrive (by: {look.age_proof.meaning}); "
        f"{look.fresh} of {frames} proved to be new"
    )
    problem, remedy = frames_advice(look, bay.camera.fps)
    if not problem and look.age_proof is AgeProof.UNPROVEN:
        refused = "the bay stops" if bay.camera.refuses_unproven_age else "they are accepted"
        problem = f"nothing proves that age: {refused} (camera.unproven_age)"
        remedy = "the camera's RTSP address; else docs/vision-processes.md#what-every-frame-must-pass"
        if bay.camera.clock == "synchronised":
            remedy = 'set the camera\'s clock by NTP, or camera.clock = "free"; the log says what is wrong with it'
    verdict = Verdict.WARNING if problem else Verdict.OK
    yield Finding("camera", bay.name, verdict, tried, f"{result}; {problem}" if problem else result, remedy)
    for line in settings.of_picture(bay, *used_px):
        yield Finding("camera", bay.name, Verdict.WARNING, "compare picture and configuration", line, "edit it")
    yield from _marker(bay, look, rate_hz)


def frames_advice(look: CameraLook, asked_hz: float | None) -> tuple[str, str]:
    """What is wrong with the frames or their pace, and what to do; empty: nothing."""
    if look.damaged:
        of = look.read + look.damaged
        return f"{look.damaged} of {of} frames damaged", "check cable and connectors; no hub, another USB port"
    if len(look.arrived_ns) > 1 and not look.fresh:
        return "equal pictures", "the camera repeats one picture: check it, or its encoder"
    if asked_hz is not None and look.rate_hz < SLOW_SHARE * asked_hz:
        return f"camera.fps asks for {asked_hz:g}", "more light, a shorter exposure, another format"
    if look.late_ms > LATE_MS:
        return "late", "a camera or encoder with less delay; fewer key frames between; a wired network"
    return "", ""


def _marker(bay: BayConfig, look: CameraLook, rate_hz: float) -> Iterator[Finding]:
    if not look.detector_s:
        return
    usual_ms = 1000 * statistics.median(look.detector_s)  # the first one takes longer
    share = 100 * usual_ms / 1000 * rate_hz
    seen = f"in {len(look.radius_px)} of {len(look.detector_s)} frames"
    if look.radius_px:
        seen += f", R {statistics.median(look.radius_px):.1f} px"
        if len(look.radius_px) > 1:
            seen += f" ± {statistics.stdev(look.radius_px):.2f}"
    result = f"{seen}; {usual_ms:.1f} ms of processor time a frame, {share:.0f} % of a core"
    remedy = "a slower camera rate, a smaller picture, or a faster processor" if share > 100 * CORE_SHARE else ""
    verdict = Verdict.WARNING if remedy else Verdict.OK
    yield Finding("marker", bay.name, verdict, f'search for it, vision.method = "{bay.vision.method}"', result, remedy)


_REMEDIES = (  # the first whose words are in the result
    ("no such device", "plug it in, or correct camera.url; a name under /dev/v4l/by-id stays the same at each start"),
    ("no such file", "correct camera.url: a film, or a folder of pictures, must be there"),
    ("not a video stream", "is the camera on, are address, port, path, user and password those that it asks for?"),
    ("permission", "give this user the right to open it: group video"),
    ("another program", "end the program that has it (fuser -v /dev/video*), or correct camera.url"),
    ("cannot be opened", "is the address right, does another program have it, may this user open it?"),
    ("camera.controls", "set it to what the camera takes (line `controls`), or remove the key"),
    ("camera.crop", "make the crop fit the picture that the camera gives"),
    ("frames are", "set the size that the camera gives, or set the camera to the size that is configured"),
)


def camera_remedy(result: str) -> str:
    return next((remedy for words, remedy in _REMEDIES if words in result), "check cable, power and address")


@dataclass(slots=True)
class RangerLook:
    error: str = ""
    identity: str = ""
    readings: list[RangeReading] = field(default_factory=list)


def ranger(bay: str, config: RangerConfig, clock: Clock, seconds: float) -> Iterator[Finding]:
    look = RangerLook()
    tried = f"open {config.port}, listen for {seconds:g} s"

    def work() -> None:
        try:
            listen(config, clock, seconds, look)
        except GatewayError as error:
            look.error = str(error).removeprefix(f"ranger port {config.port}: ")

    if not in_time(work, seconds + 2 * HANG_S):
        yield Finding("ranger", bay, Verdict.FAULT, tried, "no answer", "check cable, power and address")
    elif look.error:
        yield Finding("ranger", bay, Verdict.FAULT, tried, look.error, port_remedy(look.error))
    else:
        yield ranger_judged(bay, look, tried, seconds)


def port_remedy(error: str) -> str:
    if "permission" in error:
        return "add this user to the port's group, often dialout: usermod -aG dialout USER, then log in anew"
    return "is it plugged in, is the port right (ls -l /dev/serial/by-id), does another program have it?"


def listen(
    config: RangerConfig,
    clock: Clock,
    seconds: float,
    look: RangerLook,
    heard: Callable[[], None] = lambda: None,
) -> None:
    """`heard` is called after every read, ten times a second or more. Raises LinkError, ConfigError."""
    service = RangerService(config, clock, lambda reading: None)
    session, connection = service.session, service.connect()
    try:
        look.readings += session.opened(clock.now_ns())
        until_ns = clock.now_ns() + round(seconds * NS_PER_S)
        while clock.now_ns() < until_ns:
            if request := session.request(clock.now_ns()):
                connection.write(request)
            data = connection.read()
            now_ns = clock.now_ns()
            look.readings += session.feed(data, now_ns) + session.tick(now_ns)
            look.identity = session.identity
            heard()
    finally:
        connection.close()
    if not look.readings:
        raise LinkError("nothing was measured")


def ranger_judged(bay: str, look: RangerLook, tried: str, seconds: float) -> Finding:
    last = look.readings[-1]
    good = [reading.distance_mm for reading in look.readings if reading.distance_mm is not None]
    noise_mm = statistics.stdev(good) if len(good) > 1 else 0.0
    result = f"{look.identity or 'it does not say what it is'}; {last.stats.lines / seconds:.1f} lines/s"
    result += f", {last.stats.damaged} damaged, {len(good)} distances"
    if good:
        result += f", Z {statistics.median(good):.0f} mm ± {noise_mm:.1f}"
    if last.air_c is not None:
        result += f", air {last.air_c:.1f} °C"
    if last.relay is not None and not last.relay.fault:
        result += "; its relay is off, by its pins"
    verdict, remedy = Verdict.FAULT, ""
    if not look.identity:
        remedy = "is the firmware on the board (docs/firmware.md), is ranger.baud right, is this the right port?"
    elif last.quality is Quality.WRONG_VERSION:
        remedy = "put this version's firmware on the board (docs/firmware.md)"
    elif last.quality in (Quality.STUCK, Quality.STALE, Quality.WAITING):
        remedy = "check the sensor's four wires (docs/wiring.md)"
    elif last.relay is not None and last.relay.fault:
        result += "; its relay is not reported, or a pin is high that is commanded off"
        remedy = "put this version's firmware on the board (docs/firmware.md), check D4 and D5 (docs/wiring.md)"
    elif last.temperature_lost:
        result += ", no temperature"
        verdict, remedy = Verdict.WARNING, "check the temperature sensor and its three wires (docs/wiring.md)"
    else:
        verdict, remedy = Verdict.WARNING, _ranger_advice(last, good, noise_mm)
    if not remedy:
        return Finding("ranger", bay, Verdict.OK, tried, result)
    if last.quality is not Quality.GOOD:
        result += f"; {last.quality.meaning}" + (f" ({last.detail})" if last.detail else "")
    return Finding("ranger", bay, verdict, tried, result, remedy)


def _ranger_advice(last: RangeReading, good: list[float], noise_mm: float) -> str:
    if last.stats.damaged > DAMAGED_SHARE * last.stats.lines:
        return "check baud rate, cable length and shielding"
    if not good:
        return "normal with nothing within its range; else point it at something flat"
    if noise_mm > NOISY_MM:
        return "something moves, or the sensor is loose or looks at a slope; with all still it has 1 to 3 mm"
    return ""
