"""One bay of the gateway in virtual time, with everything around it that can fail.

The gateway's own code: the ranger's session behind the simulated board's bytes, the monitor of the vision process, the
bay's control with fusion, interlock and handshake, the hub, `shown`, the register image, the Modbus server's request
handler. Simulated around it: the truck, what the camera's detector finds, the vision process, the wire, the machine's
clocks, and a PLC that follows docs/registers.md, "Use it only while it is alive".

Time advances in steps of STEP_MS; within a step, the parts run in an order drawn by chance.
"""

import math
import pickle
import random
import struct
from collections import deque
from collections.abc import Callable, Coroutine, Generator
from functools import cache
from typing import Any

from gateway.bay import BayControl
from gateway.core.detection import Circle, Detection
from gateway.core.readings import AgeProof, Quality
from gateway.core.retained import RetainedState
from gateway.core.state import FunctionCheck, StateVector
from gateway.durations import NS_PER_S
from gateway.hub import Hub
from gateway.modbus.protocol.answers import Peer
from gateway.modbus.protocol.request_handler import RequestHandler, RequestStats
from gateway.modbus.registers.bay_unit import unit_of
from gateway.ranger.hcsr04.session import Hcsr04Session
from gateway.sim.hcsr04 import SensorErrors
from gateway.sim.ranger import faults_of
from gateway.sim.ranger_board import POWER_ON, RangerBoard, RangerFault
from gateway.sim.scenario import FaultKind, Scenario
from gateway.sim.world import Truth, World
from gateway.vision.process import monitor
from gateway.vision.process.monitor import ProcessMonitor
from gateway.vision.transport.messages import FrameResult
from gateway.vision.transport.progress import FrameProgress
from tests.fault_schedules import (
    OTHER_PLC,
    PLC,
    SETTINGS,
    WARM_S,
    Failure,
    Fault,
    Schedule,
    scenario_of,
    warm_scenario,
)
from tests.visit_bench import MarkerSight

STEP_MS = 20
MS = 1_000_000
ORIGIN_NS = 1000 * NS_PER_S
WALL_NS = 1_700_000_000 * NS_PER_S
FPS = 12
WORDS = 123  # registers that the PLC reads
BUILD_MS = 60  # a vision process needs this long until its first frame
REAP_MS = 20
ENABLE, RESET, RELEASE = 1 << 0, 1 << 2, 1 << 5  # of plc_control: docs/handshake.md
HEARTBEAT_S = 0.5  # the PLC's time for the gateway's heartbeat: docs/registers.md


class _Wait:
    """What a task that sleeps gives to the one who runs it: for how long, s."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    def __await__(self) -> Generator[float, None, None]:
        yield self._seconds


class VirtualClock:
    """The gateway's clock: what the bay sets."""

    def __init__(self) -> None:
        self.now = ORIGIN_NS
        self.wall_error_ns = 0

    def now_ns(self) -> int:
        return self.now

    def wall_ns(self) -> int:
        return WALL_NS + self.now + self.wall_error_ns

    async def sleep(self, seconds: float) -> None:
        await _Wait(seconds)

    def block(self, seconds: float) -> None:
        raise AssertionError("nothing may block")

    def timeout(self, seconds: float) -> Any:
        raise AssertionError("the bay's steps are the clock")


class Plc:
    """A program that polls, and what its block of docs/registers.md makes of the answers."""

    def __init__(self, *, writes: bool) -> None:
        self.writes = writes
        self.bits = 0
        self.bits_written: int | None = None  # since its ownership began
        self.beat = 0
        self.words: tuple[int, ...] | None = None  # of the newest answer; None: it failed
        self._heartbeat: int | None = None
        self._changed_s: float | None = None  # since the heartbeat changed, by the PLC's own clock

    def heard(self, words: tuple[int, ...] | None, t_s: float) -> None:
        self.words = words
        if words is None:
            return
        if self._heartbeat is not None and words[2] != self._heartbeat:
            self._changed_s = t_s
        self._heartbeat = words[2]

    def permits(self, t_s: float) -> tuple[bool, bool]:
        """may_move and may_load, as the program's outputs are at this scan."""
        words = self.words
        if words is None or words[1] < 3 or words[0] != words[99]:
            return False, False
        if self._changed_s is None or t_s - self._changed_s > HEARTBEAT_S:
            return False, False
        stop, may_move, in_place = words[4], words[5], words[36]
        return may_move == 1 and stop == 0, in_place == 1 and stop == 1 and may_move == 0

    def drives(self, t_s: float) -> float:
        """The drive's setpoint at this scan, mm/s: only with the permit."""
        words = self.words
        if words is None or not self.permits(t_s)[0] or not words[110]:
            return 0.0
        return float(words[112])


class VisionProcess:
    """The child process as its monitor sees it: frames and messages, and notes that outlive it."""

    def __init__(self) -> None:
        self.token = 0
        self.alive = False
        self.ready_ns: int | None = None  # it will have its first frame then
        self.seq = 0
        self.progress = FrameProgress()
        self.gone: list[tuple[int, int, bool]] = []  # due, token, crashed
        self.results: deque[tuple[int, int, FrameResult]] = deque()  # due, token, message
        self.opened: list[int] = []  # tokens whose source has given a frame
        self.lost: list[int] = []  # tokens whose source is lost

    def start(self, token: int, first_seq: int, now_ns: int) -> None:
        self.token, self.alive, self.ready_ns, self.seq = token, True, now_ns + BUILD_MS * MS, first_seq - 1
        self.progress = FrameProgress(token)

    def end(self, token: int, now_ns: int, *, crashed: bool) -> None:
        if self.alive and token == self.token:
            self.alive, self.ready_ns = False, None
            self.gone.append((now_ns + REAP_MS * MS, token, crashed))


class Bay:
    """Runs one schedule. World time is the schedule's plus WARM_S; `t_s` is the schedule's."""

    def __init__(self, settings: str, scenario: Scenario) -> None:
        self.settings = settings
        self.config = SETTINGS[settings]
        self.clock = VirtualClock()
        self.world = World(scenario)
        self.scenario = scenario
        self.world_zero_ns = 0  # real time at which world time is 0
        self._truth: Truth | None = None  # the newest that was asked for
        self.steps = 0
        self.real_ns = 0  # since the bay was made; no fault touches it
        self.t_s = -WARM_S
        self.failures: tuple[Failure, ...] = ()
        self.chance = random.Random(f"{settings} warm")
        self.plc = Plc(writes=self.config.modbus.writes)
        self.other = Plc(writes=True)
        self.cycle_steps = 5
        self.rose_s = -math.inf  # a writer's release bit last rose
        self.reset_s = -math.inf
        self.beat_s = -math.inf  # a heartbeat that counts was last accepted: a changed number, or a new writer
        self._beaten = ("", -1)  # its writer, its number
        self.errors: list[str] = []
        sensor = scenario.ranger
        self.board = RangerBoard(
            self._distance_mm, seed=1, errors=SensorErrors(sensor.jitter_mm, sensor.step_mm, sensor.dropout)
        )
        self.board.boot(self.clock.now, POWER_ON)
        self.sight = MarkerSight(scenario, self.chance)
        self.frame = 0
        self.process = VisionProcess()
        self.backlog = b""
        self.down = False
        self.check = FunctionCheck.OFF  # as the technician has set it
        self.watch: Callable[[Bay], None] | None = None  # called after each step
        self.control: BayControl
        self.started_s = 0.0
        self.power_on(None)

    # -- time ------------------------------------------------------------------------------------------------------

    def world_s(self, real_ns: int | None = None) -> float:
        return ((self.real_ns if real_ns is None else real_ns) - self.world_zero_ns) / NS_PER_S

    def _distance_mm(self, clock_ns: int) -> float:
        """For the board, which runs in the gateway's time: the echo of the truck then."""
        return self.world.distance_mm(self.world_s(clock_ns - ORIGIN_NS))

    def truth(self) -> Truth:
        t_s = self.world_s()
        if self._truth is None or self._truth.t_s != t_s:  # asked for several times in a step
            self._truth = self.world.truth(t_s, image_speed=False)
        return self._truth

    def show(self, world: World) -> None:
        """Another world from now on, with its time at 0, and no fault any more."""
        self.world, self.scenario, self.world_zero_ns, self._truth = world, world.scenario, self.real_ns, None
        self.sight.scenario = world.scenario
        self.failures = ()

    # -- the gateway's processes -----------------------------------------------------------------------------------

    def power_on(self, retained: RetainedState | None) -> None:
        bay = self.config.bays[0]
        self.hub = Hub([bay.name])
        self.control = BayControl(bay, self.hub, self.clock, (), self.config, retained)
        self.session = Hcsr04Session(bay.ranger)
        self.unplugged = False
        self.monitor = ProcessMonitor("simulated camera", bay.camera, bay.vision, self.chance)
        self.process = VisionProcess()
        self.task: Coroutine[float, None, None] | None = None  # of the control; begun with its first tick
        self.tick_ns = self.clock.now
        for reading in self.session.opened(self.clock.now):
            self.control.on_reading(reading)
        self._serve()
        self.started_s = self.t_s

    def _serve(self) -> None:
        """The Modbus server's part that answers complete frames."""
        unit = unit_of(self.control, self.config, self.clock)
        self.handler = RequestHandler({1: unit}, RequestStats(), lambda error: self.errors.append(repr(error)))

    def __getstate__(self) -> dict[str, Any]:
        left_out = ("handler", "world", "scenario", "sight", "config", "task")
        return {name: value for name, value in self.__dict__.items() if name not in left_out}

    def begin(self, made: Schedule) -> None:
        """From a warm bay into a schedule."""
        self.config = SETTINGS[self.settings]
        self.scenario = scenario_of(made)
        self.world, self._truth = World(self.scenario), None
        self.chance = random.Random(f"bay {made.seed}")
        self.sight = MarkerSight(self.scenario, self.chance)
        self.sight.unseen = 100 if made.phase == "held" else 0
        self.failures = made.failures
        self.cycle_steps = max(1, made.cycle_ms // STEP_MS)
        self.task = None
        self._serve()

    @property
    def state(self) -> StateVector:
        """What any output of the gateway may show now."""
        return self.control.state()

    # -- one step --------------------------------------------------------------------------------------------------

    def step(self) -> None:
        """STEP_MS of time."""
        self._step()
        if self.watch is not None:
            self.watch(self)

    def _step(self) -> None:
        self.steps += 1
        self.real_ns = self.steps * STEP_MS * MS
        self.t_s = t_s = self.real_ns / NS_PER_S - WARM_S
        active = {failure.fault: failure for failure in self.failures if failure.at_s <= t_s < failure.end_s}
        if Fault.SUSPENDED in active:
            self.plc_cycle(active, answering=False)
            return
        self.clock.now = ORIGIN_NS + self.real_ns
        self.clock.wall_error_ns = round(active[Fault.WALL_JUMP].amount * NS_PER_S) if Fault.WALL_JUMP in active else 0
        if Fault.RESTARTED in active:
            if not self.down:
                self.retained = RetainedState.of(self.hub.state(self.control.name))  # as the bay file has it
                self.down = True
            self.board.advance(self.clock.now)
            self._frames(active)
            self.plc_cycle(active, answering=False)
            return
        if self.down:
            self.down = False
            self.power_on(self.retained)
        parts = [self.ranger, self.camera, self.control_task, self.plc_cycle]
        self.chance.shuffle(parts)
        if Fault.LOOP_BLOCKED in active:
            self._frames(active)
            self.plc_cycle(active, answering=False)
            return
        for part in parts:
            part(active)

    def control_task(self, active: dict[Fault, Failure]) -> None:
        if (Fault.FUNCTION_CHECK in active) != (self.check is not FunctionCheck.OFF):
            kinds = (FunctionCheck.MAY_MOVE_OFF, FunctionCheck.MAY_MOVE_KEPT)
            self.check = self.chance.choice(kinds) if self.check is FunctionCheck.OFF else FunctionCheck.OFF
            self.control.check_function(self.check)
        if Fault.CONTROL_DEAD in active:
            return
        if self.clock.now >= self.tick_ns:
            if self.task is None:
                self.task = self.control.run()
            self.tick_ns = self.clock.now + round(self.task.send(None) * NS_PER_S)

    # -- the ranger ------------------------------------------------------------------------------------------------

    def ranger(self, active: dict[Fault, Failure]) -> None:
        now_ns, control = self.clock.now, self.control
        faults = faults_of(self.scenario, self.world_s())
        self.board.faults = faults
        if RangerFault.UNPLUGGED in faults:
            if not self.unplugged or self.steps % 5 == 0:
                control.on_reading(self.session.lost(now_ns, "unplugged"))
            self.unplugged = True
            return
        if self.unplugged:
            self.unplugged = False
            self.backlog = b""
            self.board.boot(now_ns, POWER_ON)
            for reading in self.session.opened(now_ns):
                control.on_reading(reading)
        if request := self.session.request(now_ns):
            self.board.hear(request, now_ns)
        data = self.backlog + self.board.advance(now_ns)
        self.backlog = b""
        if Fault.RANGER_BACKLOG in active:
            self.backlog, data = data, b""
        readings = self.session.feed(data, now_ns) if data else []
        for reading in [*readings, *self.session.tick(now_ns)]:
            control.on_reading(reading)

    # -- the camera and its process --------------------------------------------------------------------------------

    def camera(self, active: dict[Fault, Failure]) -> None:
        self._frames(active)
        now_ns, process = self.clock.now, self.process
        deadline_ns = self.monitor.next_deadline_ns()
        news = process.opened or process.lost or process.gone or (process.results and process.results[0][0] <= now_ns)
        if not news and (deadline_ns is None or now_ns < deadline_ns):
            return
        for token in process.opened:
            self.monitor.ready(token, now_ns)
            self.monitor.opened(token, now_ns, lossless=False, finite=False)
        process.opened.clear()
        while process.results and process.results[0][0] <= now_ns:
            _, token, result = process.results.popleft()
            self.monitor.result(token, result, now_ns)
        self.monitor.progress(process.progress, now_ns)
        for token in process.lost:
            self.monitor.source_lost(token, "the camera is lost", now_ns)
        process.lost.clear()
        for due_ns, token, crashed in process.gone[:]:
            if due_ns <= now_ns:
                process.gone.remove((due_ns, token, crashed))
                self.monitor.gone(token, "died", now_ns, crashed=crashed)
        for action in self.monitor.settle(now_ns):
            match action:
                case monitor.Emit(reading):
                    self.control.on_reading(reading)
                case monitor.Start(token, first_seq, _):
                    process.start(token, first_seq, now_ns)
                case monitor.Kill(token, _):
                    process.end(token, now_ns, crashed=False)
                case monitor.GiveUp(why):
                    self.errors.append(why)

    def _frames(self, active: dict[Fault, Failure]) -> None:
        """What the process does by itself: it runs beside the main process."""
        now_ns, process = self.clock.now, self.process
        if Fault.VISION_KILLED in active and process.alive:
            process.end(process.token, now_ns, crashed=True)
        lost = self.scenario.active(FaultKind.CAMERA_LOST, self.world_s())
        if process.alive and process.ready_ns is not None and now_ns >= process.ready_ns:
            process.ready_ns = None
            (process.lost if lost else process.opened).append(process.token)
        while ORIGIN_NS + self.frame * NS_PER_S // FPS <= now_ns:
            taken_ns = ORIGIN_NS + self.frame * NS_PER_S // FPS
            self.frame += 1
            if process.alive and process.ready_ns is None and now_ns - taken_ns < NS_PER_S // FPS:
                self._frame(taken_ns, active, lost=lost)

    def _frame(self, taken_ns: int, active: dict[Fault, Failure], *, lost: bool) -> None:
        process, t_s = self.process, self.world_s(taken_ns - ORIGIN_NS)
        if lost:
            process.lost.append(process.token)
            return
        if self.scenario.active(FaultKind.CAMERA_FREEZE, t_s):
            return
        hangs = process.progress.work_began_ns > 0
        process.seq += 1
        if hangs or Fault.VISION_HUNG in active:
            old, began_ns = process.progress, process.progress.work_began_ns or taken_ns
            seq = old.work_seq if hangs else process.seq
            process.progress = FrameProgress(
                process.token, process.seq, taken_ns, seq, taken_ns, began_ns, old.detector_ns
            )
            return
        stuck_s = self.scenario.since_s(FaultKind.CAMERA_STUCK, t_s)
        truth = self.world.truth(t_s if stuck_s is None else stuck_s, image_speed=False)
        since_ns = taken_ns if stuck_s is None else taken_ns - round((t_s - stuck_s) * NS_PER_S)
        quality, circle = self.sight.frame(truth)
        predicted = Circle(320.0, 240.0, 150.0) if quality is Quality.COASTED else None
        due_ns = taken_ns + round(self.chance.uniform(0.015, 0.05) * NS_PER_S)
        if (slow := active.get(Fault.VISION_SLOW)) is not None:
            due_ns += round(slow.amount * NS_PER_S)
        if (ahead := active.get(Fault.VISION_FUTURE)) is not None:
            taken_ns += round(ahead.amount * NS_PER_S)
        if process.results:
            due_ns = max(due_ns, process.results[-1][0])
        found = Detection(circle, predicted=predicted)
        result = FrameResult(process.seq, taken_ns, found, since_ns, age_proof=AgeProof.DEVICE_TIME)
        process.results.append((due_ns, process.token, result))
        process.progress = FrameProgress(
            process.token, process.seq, min(taken_ns, self.clock.now), 0, 0, 0, self.clock.now
        )

    # -- the PLC ---------------------------------------------------------------------------------------------------

    def plc_cycle(self, active: dict[Fault, Failure], *, answering: bool = True) -> None:
        if self.steps % self.cycle_steps:
            return
        cycle = self.steps // self.cycle_steps
        bits = ENABLE | self.plc.bits
        if Fault.PLC_RELEASES in active:
            bits |= RELEASE
        if Fault.PLC_RESETS in active and cycle % 4 < 2:
            bits |= RESET
        if Fault.PLC_BITS in active:
            bits = self.chance.randrange(64)
        if Fault.PLC_RESTARTED in active:
            bits = 0
        cut = Fault.PLC_CUT in active or (Fault.PLC_SLOW in active and cycle % 4 > 0)
        beat = Fault.PLC_STOPPED not in active
        self._request(self.plc, PLC, bits, answering=answering and not cut, beat=beat)
        if Fault.OTHER_MASTER in active and cycle % 2:
            self._request(self.other, OTHER_PLC, RELEASE if cycle % 8 > 3 else 0, answering=answering, beat=True)
        if Fault.DAMAGED_FRAMES in active and answering:
            self._damaged()

    def _request(self, plc: Plc, address: str, bits: int, *, answering: bool, beat: bool) -> None:
        """One FC 23 a cycle, or FC 3 where nothing can be written; or FC 3 after a write that was refused."""
        plc.beat = (plc.beat + beat) & 0xFFFF
        if not answering:
            plc.heard(None, self.t_s)
            return
        peer = Peer(address)
        read = b"\x83"
        if plc.writes:
            pdu = struct.pack(">BHHHHBHH", 23, 0, WORDS, 80, 2, 4, plc.beat, bits)
            answer = self.answered(pdu, peer)
            if answer[0] == 23:
                read = answer
                if self._beaten != (address, plc.beat):
                    self._beaten, self.beat_s = (address, plc.beat), self.t_s
                rose = bits & ~plc.bits_written if plc.bits_written is not None else 0
                if rose & RELEASE:
                    self.rose_s = self.t_s
                if rose & RESET:
                    self.reset_s = self.t_s
                plc.bits_written = bits
        if read[0] != 23:
            read = self.answered(struct.pack(">BHH", 3, 0, WORDS), peer)
        plc.heard(struct.unpack(f">{WORDS}H", read[2:]) if read[0] in (3, 23) else None, self.t_s)

    def answered(self, pdu: bytes, peer: Peer) -> bytes:
        """The PDU of the answer to one frame."""
        frame = struct.pack(">HHHB", 1, 0, len(pdu) + 1, 1) + pdu
        return self.handler.answer(frame, peer)[7:]

    def _damaged(self) -> None:
        chance = self.chance
        function = chance.choice((1, 2, 3, 4, 5, 6, 15, 16, 17, 22, 23, 43, chance.randrange(256)))
        pdu = bytes([function]) + chance.randbytes(chance.randrange(0, 20))
        if self.answered(pdu, Peer("10.0.0.7"))[0] & 0x7F != function & 0x7F:
            self.errors.append(f"an answer of another function to {pdu.hex()}")


@cache
def warm(settings: str, phase: str) -> bytes:
    """A bay in that phase, as it was WARM_S after power on. Made once a process."""
    bay = Bay(settings, warm_scenario(phase))
    while bay.t_s < 0:
        if phase == "released" and bay.t_s > -0.4:
            bay.plc.bits = RELEASE
        bay.step()
    return pickle.dumps(bay)


def bay_of(made: Schedule) -> Bay:
    """A bay at the begin of a schedule."""
    bay: Bay = pickle.loads(warm(made.settings, made.phase))
    bay.begin(made)
    return bay
