"""The parts of a gateway, without the pages: sensors, outputs and bays, each made complete by one builder."""

import logging
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial

from gateway.alarms.monitor import AlarmMonitor
from gateway.alarms.records import AlarmChange
from gateway.bay import BayControl
from gateway.bay_file import BayFiles
from gateway.clock import SystemClock
from gateway.config import BayConfig, GatewayConfig
from gateway.core.interlock import Rules
from gateway.core.readings import RangeReading, VisionReading
from gateway.core.relay import decided
from gateway.core.state import StateVector
from gateway.durations import NS_PER_S
from gateway.hub import Hub
from gateway.marker_history import MarkerHistory, marker_path_of
from gateway.modbus.protocol.answers import Unit
from gateway.modbus.registers.bay_unit import unit_of
from gateway.processes.template import ProcessTemplate
from gateway.ranger.contract import RelaySession
from gateway.ranger.ranger_service import RangerService
from gateway.ranger.vote import Voter
from gateway.records.recorder_service import RecorderService
from gateway.reload import InForce
from gateway.shared_state import SharedStateWriter
from gateway.sinks import registry as sink_registry
from gateway.sinks.contract import AlarmStep, Sink
from gateway.supervisor import Task
from gateway.values.gateway_values import GatewayFacts
from gateway.vision.process.vision_service import VisionService, vision_template
from gateway.vision.source.contract import SourceSpec
from gateway.vision.source.specs import check_exposure, source_spec
from gateway.vision.transport.ring_spec import RingSpec
from gateway.web.host.request_handler import EventHistory
from gateway.web.host.shown_alarms import ShownAlarms, step_of

log = logging.getLogger("gateway.app")  # the name that operators filter by


@dataclass(frozen=True, slots=True)
class Ports:
    """The sources of each bay's frames and distances, by bay name."""

    camera: Mapping[str, SourceSpec]
    ranger: Mapping[str, Sequence[str]]  # pyserial URLs, of each of its rangers

    @staticmethod
    def of(config: GatewayConfig) -> "Ports":
        """The real ports that the configuration names. Raises ConfigError for a camera that could never work."""
        for bay in config.bays:
            check_exposure(bay.camera)
        return Ports(
            camera={bay.name: source_spec(bay.camera) for bay in config.bays},
            ranger={bay.name: [one.port for one in bay.ranger.sensors] for bay in config.bays},
        )


@dataclass(frozen=True, slots=True)
class Shared:
    """What every builder needs. `boot`: a random number of this start, in the events' ids; `resources`: closed at the
    end."""

    config: GatewayConfig
    hub: Hub
    clock: SystemClock
    boot: str
    resources: ExitStack


@dataclass(frozen=True, slots=True)
class Sensors:
    """The sensors of all bays, by bay name: their readings go to the hub. `frames`: to be read only."""

    frames: dict[str, RingSpec]
    template: ProcessTemplate
    visions: Mapping[str, VisionService]
    rangers: Mapping[str, Sequence[RangerService]]


@dataclass(frozen=True, slots=True)
class BayOutputs:
    """What the bays' states and events go to, but for Modbus and the pages. `history`: for these; `vectors`: by bay
    name."""

    history: EventHistory
    sinks: Sequence[Sink]
    recorder: RecorderService
    alarms: AlarmMonitor
    vectors: Mapping[str, SharedStateWriter]
    files: BayFiles


@dataclass(frozen=True, slots=True)
class BayTasks:
    """The control tasks by bay name, the PLC's view of them by unit id, and the rows of the task table."""

    controls: Mapping[str, BayControl]
    units: Mapping[int, Unit]
    tasks: Sequence[Task]


def build_sensors(shared: Shared, ports: Ports) -> Sensors:
    """Nothing of it runs yet. Raises ConfigError."""
    config, hub, clock = shared.config, shared.hub, shared.clock
    rings, frames = _rings(config, shared.resources)
    template = vision_template(ports.camera.values(), (bay.vision for bay in config.bays))
    visions = {
        bay.name: VisionService(
            bay.name,
            ports.camera[bay.name],
            bay.camera,
            bay.vision,
            clock,
            partial(hub.offer, bay.name),
            ring=rings[bay.name],
            template=template,
        )
        for bay in config.bays
    }
    rangers = {
        bay.name: build_rangers(bay, clock, partial(hub.offer, bay.name), ports.ranger[bay.name]) for bay in config.bays
    }
    return Sensors(frames, template, visions, rangers)


def build_rangers(
    bay: BayConfig, clock: SystemClock, emit: Callable[[RangeReading], None], ports: Sequence[str]
) -> list[RangerService]:
    """Of several, `emit` gets what they agree on."""
    takes = [emit]
    if len(bay.ranger.sensors) > 1:
        voter = Voter(bay, clock.now_ns())
        takes = [partial(_vote, voter, clock, emit, n) for n in range(len(ports))]
    return [
        RangerService(sensor, clock, take, port=port)
        for sensor, take, port in zip(bay.ranger.sensors, takes, ports, strict=True)
    ]


def _vote(
    voter: Voter, clock: SystemClock, emit: Callable[[RangeReading], None], n: int, reading: RangeReading
) -> None:
    emit(voter.take(n, reading, clock.now_ns()))


def build_outputs(shared: Shared, sensors: Sensors, in_force: InForce, facts: Callable[[], GatewayFacts]) -> BayOutputs:
    """`facts`: of the gateway itself. Raises ConfigError."""
    config, hub, clock = shared.config, shared.hub, shared.clock
    history = EventHistory(hub)
    recorder = RecorderService(config, clock, sensors.frames, shared.boot, sensors.template)
    listeners: list[Callable[[AlarmStep], None]] = []
    alarms = AlarmMonitor(
        {bay.name: bay for bay in config.bays},
        lambda bay: hub.shown(bay, clock.now_ns()),
        clock,
        partial(_on_alarm, recorder, listeners),
    )
    shown, listen = ShownAlarms(alarms), listeners.append
    sinks = sink_registry.opened(config, hub, clock, shared.boot, shared.resources, shown, listen, facts)
    vectors = {
        bay.name: shared.resources.enter_context(SharedStateWriter(config.instance, bay.name)) for bay in config.bays
    }
    # Read now: with the vectors in hand, no earlier gateway of this name can still write to them.
    files = BayFiles.read(config, clock, in_force.deciding)
    return BayOutputs(history, sinks, recorder, alarms, vectors, files)


def build_bays(shared: Shared, sensors: Sensors, outputs: BayOutputs, ticked: Callable[[str], None]) -> BayTasks:
    """Publishes the first state of each bay. `ticked`: called with the bay's name after each control tick."""
    config, hub, files = shared.config, shared.hub, outputs.files
    controls: dict[str, BayControl] = {}
    now_s = shared.clock.wall_ns() // NS_PER_S
    tasks = [Task("vision-template", sensors.template.run)]
    for bay in config.bays:
        vision = sensors.visions[bay.name]
        control = controls[bay.name] = BayControl(
            bay,
            hub,
            shared.clock,
            (outputs.vectors[bay.name].write, files.note, *_relay(bay, config, sensors.rangers[bay.name][0])),
            config,
            files.retained(bay.name),
            files.untried(bay.name),
            outputs.recorder.of_bay(bay.name),
            ticked,
            MarkerHistory(bay.camera.picture, marker_path_of(config, bay.name), files.keep).read(now_s),
        )
        hub.listen_to_readings(bay.name, control.on_reading)
        hub.listen_to_readings(bay.name, partial(_expect, control, vision))
        tasks += [
            Task(f"{bay.name}.control", control.run, vital=True),
            Task(f"{bay.name}.vision", vision.run, bay.camera.reconnect),
            *(
                Task(f"{bay.name}.ranger{n if n > 1 else ''}", ranger.run, sensor.reconnect)
                for n, (sensor, ranger) in enumerate(zip(bay.ranger.sensors, sensors.rangers[bay.name], strict=True), 1)
            ),
        ]
    units = {bay.unit_id: unit_of(controls[bay.name], config, shared.clock) for bay in config.bays}
    return BayTasks(controls, units, tasks)


def _relay(bay: BayConfig, config: GatewayConfig, ranger: RangerService) -> tuple[Callable[[StateVector], None], ...]:
    """What tells the board of the first ranger of each state, where its relay is used."""
    max_range_mm = bay.ranger.max_range_mm
    if not bay.ranger.has_relay or max_range_mm is None or not isinstance(session := ranger.session, RelaySession):
        return ()
    rules = Rules.of(bay, config)
    return (lambda state: session.decided(decided(state, rules.limits(state.plc.recipe), max_range_mm)),)


def _rings(config: GatewayConfig, resources: ExitStack) -> tuple[dict[str, RingSpec], dict[str, RingSpec]]:
    """Of each bay's frames, to be written and to be read only."""
    rings = {bay.name: RingSpec.create(bay.camera.max_megapixels) for bay in config.bays}
    readers = {bay: ring.reader() for bay, ring in rings.items()}
    for ring in rings.values():
        resources.callback(ring.close)
    for ring in readers.values():
        resources.callback(os.close, ring.fd)
    return rings, readers


def _expect(control: BayControl, vision: VisionService, reading: VisionReading | RangeReading) -> None:
    """A distance also gives the search the marker's possible size."""
    if isinstance(reading, RangeReading):
        vision.expect(control.marker_radii_px())


def _on_alarm(recorder: RecorderService, listeners: Sequence[Callable[[AlarmStep], None]], change: AlarmChange) -> None:
    recorder.on_alarm(change)
    for listener in () if change.by_design else listeners:
        listener(step_of(change))
    fields = {"alarm": change.kind} | ({} if change.bay is None else {"bay": change.bay})
    log.log(logging.DEBUG if change.by_design else logging.INFO, "alarm %s", change, extra={"fields": fields})
