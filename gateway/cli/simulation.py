"""Builds the simulated ports of `gateway simulate` and watches what the gateway makes of them."""

import argparse
import asyncio
import contextlib
import os
import socket
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import AsyncExitStack
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

from gateway import app, config, event_loop
from gateway.cli import check, run_loop, sim_json, sim_trials, view
from gateway.cli.in_place_restart import InPlaceRestart
from gateway.cli.output import LossyOutput
from gateway.cli.sim_json import Bay
from gateway.clock import SystemClock
from gateway.config import GatewayConfig
from gateway.config.strict.errors import without_password
from gateway.config.strict.section import Section, upper_bound_of
from gateway.durations import NS_PER_S
from gateway.errors import ConfigError, LinkError
from gateway.hub import Hub
from gateway.net.listener import listening
from gateway.parts import Ports
from gateway.shared_state import attachable
from gateway.sim import scenario as scenarios
from gateway.sim import trials
from gateway.sim.camera import SimCameraSpec
from gateway.sim.drive import SimulatedDrive
from gateway.sim.driven_way import DrivenWay
from gateway.sim.emulator import EmulatedRanger, check_built
from gateway.sim.led import Led
from gateway.sim.ranger import SimulatedRanger, options_of
from gateway.sim.scenario import Scenario
from gateway.sim.vehicles import VehicleKind, drive_keys, typical
from gateway.sim.world import TruckHold
from gateway.supervisor import Task
from gateway.vision.source.v4l2_controls import settings_of
from gateway.web.host.startup import Startup

LEAD_S = 2.0  # world time starts so much later, when the processes have started and the surfaces are painted


def print_scenarios() -> None:
    """Name and first comment line of every scenario supplied with the gateway."""
    for path in sorted(run_loop.shipped("scenarios").glob("*.toml")):
        first = path.read_text(encoding="utf-8").splitlines()[0].lstrip("# ")
        print(f"{path.stem:16} {first}")


def scenario_file(name: str) -> Path:
    """A scenario by name or by path. Raises ConfigError that lists what there is."""
    path = Path(name)
    shipped = run_loop.shipped("scenarios", f"{name.removesuffix('.toml')}.toml")
    if path.is_file() or len(path.parts) > 1:
        return path
    if not shipped.is_file():
        known = ", ".join(sorted(p.stem for p in shipped.parent.glob("*.toml")))
        raise ConfigError(f"--scenario {name}: neither a file nor one of: {known}")
    return shipped


def simulate(args: argparse.Namespace) -> int:
    """The verb. Exit code 1 when trials were requested and one of them failed."""
    in_place_restart = InPlaceRestart()
    _check(args)
    with _only_simulation() as first:
        return _simulate(args, in_place_restart, first=first)


def _simulate(args: argparse.Namespace, in_place_restart: InPlaceRestart, *, first: bool) -> int:
    scenario = _scenario(args)
    settings = _at_speed(_settings(args, first=first), args.speed)
    if args.vehicle and len(settings.bays) > 1:
        raise ConfigError(f"--vehicle: one drive moves one vehicle, the settings have {len(settings.bays)} bays")
    clock = SystemClock(speed=args.speed)
    origin_ns = clock.now_ns() + int(LEAD_S * args.speed * NS_PER_S)
    if args.world_start_ns is not None:
        origin_ns = args.world_start_ns
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="simulation-")))
        bays = []
        for number, bay in enumerate(settings.bays):
            show = _variant(scenario, bay.name, number, len(settings.bays))
            rangers, hit = len(bay.ranger.sensors), max((fault.ranger for fault in show.faults), default=1)
            if hit > rangers:
                raise ConfigError(
                    f"the scenario has a fault of ranger {hit}, bay {bay.name} has {rangers}: --rangers {hit}"
                )
            hold = _hold(show, folder / bay.name, args.speed) if args.trials else None
            track = DrivenWay(str(folder / "track")) if args.vehicle else None
            bays.append(Bay(bay.name, bay.unit_id, show, bay.fusion, origin_ns, hold, track))
        live = not (args.json or args.quiet or args.trials) and sys.stdout is not None and sys.stdout.isatty()
        run_loop.setup_logging("error" if live else settings.log_level)
        return event_loop.run(_Simulation(args, scenario, settings, clock, bays, live, in_place_restart).run())


def _hold(scenario: Scenario, path: Path, speed: float) -> TruckHold:
    """Waiting is for this machine, so its limit is real seconds, as in `_at_speed`."""
    return TruckHold(str(path), trials.trial_legs(scenario), trials.WAIT_S * max(1.0, speed))


def _check(args: argparse.Namespace) -> None:
    for name, low, high in (
        ("speed", 0.05, 20),
        ("duration", 0.1, 86_400),
        ("bays", 1, 64),
        ("rangers", 1, 3),
        ("trials", 1, 100),
    ):
        value = getattr(args, name)
        if value is not None and not low <= value <= high:
            raise ConfigError(f"--{name} {value:g}: must lie in {low} to {high}")
    if args.world_start_ns is not None and (args.speed != 1.0 or args.trials):
        raise ConfigError("--world-start-ns: only at --speed 1, and without --trials")
    if args.seed is not None and not 0 <= args.seed <= 2**31:
        raise ConfigError(f"--seed {args.seed}: must lie in 0 to {2**31}")
    if args.trials and args.scenario:
        raise ConfigError("--trials brings its own scenario: leave out --scenario")
    if args.vehicle and args.trials:
        raise ConfigError("--vehicle: the trials' truck drives by itself: leave out --trials")
    if args.ranger == "firmware":
        check_built()
    elif args.ranger_log:
        raise ConfigError("--ranger-log: only the emulated firmware keeps one, add --ranger firmware")


def _scenario(args: argparse.Namespace) -> Scenario:
    if args.trials:
        return trials.trial_scenario(seed=1 if args.seed is None else args.seed, n=args.trials)
    over: dict[str, Any] = {} if args.seed is None else {"seed": args.seed}
    if args.vehicle and not args.scenario:  # it drives straight on: beside the axis it would never be in place
        over |= {"start": {"lateral_mm": 0.0, "vertical_mm": 0.0}, "repeat": False}
    return scenarios.load(scenario_file(args.scenario or "approach"), over)


@contextlib.contextmanager
def _only_simulation() -> Iterator[bool]:
    """Is no other simulation running? Of two that start at the same moment, only one hears yes.

    A name in the kernel that one process has as long as it lives, and that leaves nothing behind.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as name:
        try:
            name.bind("\0loading-gateway-simulate")
        except OSError:
            yield False
        else:
            yield not any(instance == "simulate" for instance, _ in attachable())


def _overrides(args: argparse.Namespace) -> dict[str, Any]:
    """Of the file, by options."""
    over: dict[str, Any] = {"state_dir": args.state_dir or ""}
    if args.modbus_port is not None:
        over["modbus"] = {"port": args.modbus_port}
    if args.no_hmi:
        over["hmi"] = {"enabled": False}
    elif args.hmi_port is not None:
        over["hmi"] = {"port": args.hmi_port}
    if args.mqtt_url is not None:
        outbox = Path(args.state_dir) / "outbox.sqlite" if args.state_dir else ""
        over["mqtt"] = {"url": args.mqtt_url, "urls": [], "outbox_file": str(outbox)}
    if args.method is not None:
        over["vision"] = {"method": args.method}
    if args.exposure is not None:
        over["camera"] = {"exposure": args.exposure}
    if args.rangers is not None:
        over["ranger"] = {"more": [{"port": f"/dev/ttyACM{n}"} for n in range(1, args.rangers)]}
    if args.vehicle and args.config is None:
        over["drive"] = drive_keys(VehicleKind(args.vehicle))
    if args.bays is not None:
        over["bays"] = [{"name": f"bay{n}", "unit_id": n} for n in range(1, args.bays + 1)]
    return over


def _settings(args: argparse.Namespace, *, first: bool) -> GatewayConfig:
    over = _overrides(args)
    if args.config is None:
        over["instance"] = "simulate" if first else f"simulate-{os.getpid()}"  # several may run side by side
    settings = config.load(args.config or run_loop.shipped("simulate.toml"), over)
    if args.trials:  # the paper's table is of the paper's own rule
        settings = settings.model_copy(update={"bays": tuple(_plain(bay) for bay in settings.bays)})
    if args.config is not None:
        return settings
    hmi, modbus = settings.hmi, settings.modbus
    if args.hmi_port is None and hmi.enabled and not (first and _can_listen("hmi", hmi.host, hmi.port)):
        settings = settings.model_copy(update={"hmi": hmi.model_copy(update={"port": 0})})
    if args.modbus_port is None and not _can_listen("modbus", modbus.host, modbus.port):
        settings = settings.model_copy(update={"modbus": modbus.model_copy(update={"port": 0})})
    return settings


def _plain(bay: config.BayConfig) -> config.BayConfig:
    if bay.vision.method != "paper":
        return bay
    return bay.model_copy(update={"fusion": bay.fusion.model_copy(update={"decision": "plain"})})


def _can_listen(what: str, host: str, port: int) -> bool:
    """Is the usual port free? Beside another simulation, or another program, any other is taken."""
    try:
        with listening(what, host, port):
            return True
    except LinkError:
        return False


def _at_speed(settings: GatewayConfig, speed: float) -> GatewayConfig:
    """Limits of this machine's performance are real seconds, whatever the speed of the world: as far as their
    ranges allow, for the settings are checked again in the processes that they are sent to."""

    def longer(section: Section, *keys: str) -> dict[str, float]:
        fields = type(section).model_fields
        return {key: min(getattr(section, key) * speed, upper_bound_of(fields[key])) for key in keys}

    def stretched(bay: config.BayConfig) -> config.BayConfig:
        camera, vision, fusion = bay.camera, bay.vision, bay.fusion
        return bay.model_copy(
            update={
                "camera": camera.model_copy(update=longer(camera, "deadline_s", "open_deadline_s")),
                "vision": vision.model_copy(update=longer(vision, "deadline_s")),
                "fusion": fusion.model_copy(update=longer(fusion, "start_grace_s")),
            }
        )

    return (
        settings.model_copy(update={"bays": tuple(stretched(bay) for bay in settings.bays)}) if speed > 1 else settings
    )


def _variant(scenario: Scenario, bay: str, number: int, bays: int) -> Scenario:
    """Each bay has its own truck; the schedule of faults hits only the bay that the scenario names."""
    if bays == 1 or bay == scenario.bay:
        return scenario
    return scenario.model_copy(update={"seed": (scenario.seed + number) % 2**31, "bay": bay, "faults": ()})


class _Simulation:
    """One run: the ports, the tasks that watch, and what is printed."""

    def __init__(
        self,
        args: argparse.Namespace,
        scenario: Scenario,
        settings: GatewayConfig,
        clock: SystemClock,
        bays: list[Bay],
        live: bool,
        in_place_restart: InPlaceRestart,
    ) -> None:
        self._args = args
        self._scenario = scenario
        self._settings = settings
        self._clock = clock
        self._bays = bays
        self._live = live
        self._in_place_restart = in_place_restart
        self._header = "starting"
        self._trials = [sim_trials.TrialRecorder(bay) for bay in bays] if args.trials else []
        self._lead_s = max(0.0, (bays[0].origin_ns - clock.now_ns()) / NS_PER_S)  # the show is what `--duration` counts
        self._stop = asyncio.Event()
        self._begun = asyncio.Event()  # a PLC could poll; the first line printed says where
        self._out = LossyOutput(sys.stdout, on_lost=self._reader_lost)
        self._json = sim_json.JsonLines(bays, clock, self._out) if args.json else None

    async def run(self) -> int:
        self._loop = asyncio.get_running_loop()
        async with AsyncExitStack() as stack:
            sensors = {bay.name: bay.ranger.sensors for bay in self._settings.bays}
            rangers = {bay.name: [self._ranger(bay, n) for n, _ in enumerate(sensors[bay.name])] for bay in self._bays}
            for ranger in chain(*rangers.values()):
                await stack.enter_async_context(ranger)
            drive = await stack.enter_async_context(self._drive()) if self._args.vehicle else None
            self._drive_port = drive.port if drive else None
            cameras = {bay.name: bay.camera for bay in self._settings.bays}
            ports = Ports(
                camera={
                    bay.name: SimCameraSpec(
                        bay.scenario,
                        bay.origin_ns,
                        f"simulated camera of {bay.name}",
                        bay.hold,
                        bay.track,
                        settings_of(cameras[bay.name].controls),
                        Led.of(
                            cameras[bay.name],
                            rangers[bay.name][0].led,
                            (bay.scenario.camera.width_px, bay.scenario.camera.height_px),
                        ),
                    )
                    for bay in self._bays
                },
                ranger={name: [ranger.port for ranger in several] for name, several in rangers.items()},
            )

            def extra_tasks(hub: Hub) -> Sequence[Task]:
                far_ends = [
                    Task(f"{name}.simulated-ranger{n if n > 1 else ''}", ranger.run)
                    for name, several in rangers.items()
                    for n, ranger in enumerate(several, 1)
                ]
                if drive:
                    far_ends.append(Task("simulated-drive", drive.run))
                return [*far_ends, *self._watchers(hub)]

            await run_loop.serve(
                self._settings,
                ports,
                self._clock,
                duration_s=None if self._args.duration is None else self._args.duration + self._lead_s,
                on_started=self._started,
                extra_tasks=extra_tasks,
                stop=self._stop,
                source=str(self._args.config.resolve()) if self._args.config else "",
                startup=Startup(overrides=_overrides(self._args), warnings=check.warnings),
                in_place_restart=self._in_place_restart,
            )
        if self._trials:
            self._out.close(None)  # the report follows on the same stdout
            return sim_trials.report(self._trials, as_json=self._args.json)
        if self._json:
            self._json.summary()
        self._out.close()
        return int(self._out.lost and sys.stdout is not None)

    def _reader_lost(self) -> None:
        """The reader has ended (`gateway simulate | head`): end as on Ctrl-C. Called from the outlet's thread."""
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            self._loop.call_soon_threadsafe(self._stop.set)

    def _ranger(self, bay: Bay, n: int) -> SimulatedRanger | EmulatedRanger:
        options = options_of(bay.scenario, bay.world, bay.origin_ns, n + 1)
        if self._args.ranger == "simulated":
            return SimulatedRanger(clock=self._clock, **options)
        log = self._args.ranger_log
        log = log.with_name(f"{log.name}.{bay.name}") if log and len(self._bays) > 1 else log
        log = log.with_name(f"{log.name}.{n + 1}") if log and n else log
        return EmulatedRanger(clock=self._clock, log=log, **options)

    def _drive(self) -> SimulatedDrive:
        (bay,) = self._bays
        assert bay.track is not None
        return SimulatedDrive(
            typical(VehicleKind(self._args.vehicle)),
            10.0 * bay.scenario.start.distance_cm,
            bay.track.path,
            self._clock,
            lambda: bay.t_s(self._clock.now_ns()),
        )

    def _watchers(self, hub: Hub) -> list[Task]:
        tasks: list[Task] = []
        if self._trials:
            progress = None if self._args.json else sim_trials.progress_bar()
            tasks.append(
                Task("trials", lambda: sim_trials.record(self._trials, hub, self._clock, self._stop, progress))
            )
        if self._json:
            tasks += map(self._after_start, self._json.tasks(hub))
        elif not self._trials:
            console = view.console(self._out, live=self._live)
            screen = view.TerminalView(self._settings, hub, self._clock, console, lambda: self._header)
            watching = Task("view", screen.run)
            tasks.append(watching if self._live else self._after_start(watching))
        return tasks

    def _after_start(self, task: Task) -> Task:
        async def run() -> None:
            await self._begun.wait()
            await task.factory()

        return replace(task, factory=run)

    def _started(self, now: app.Running) -> None:
        self._begun.set()
        broker = ", ".join(map(without_password, self._settings.mqtt.brokers)) if self._settings.mqtt else None
        if self._json:
            self._json.started(
                modbus_host=now.modbus_host,
                modbus_port=now.modbus_port,
                modbus_tls_port=now.modbus_tls_port,
                mqtt=broker,
                hmi=now.hmi_url,
                instance=self._settings.instance,
                speed=self._args.speed,
                drive_port=self._drive_port,
                seed=self._scenario.seed,
                world_start_ns=self._bays[0].origin_ns,
            )
            return
        name = f"{self._args.trials} trials" if self._args.trials else (self._args.scenario or "approach")
        units = f"unit id {self._bays[0].unit_id}" + (f" to {self._bays[-1].unit_id}" if len(self._bays) > 1 else "")
        pages = f"the pages: {now.hmi_url}\n" if now.hmi_url else ""
        other = self._args.modbus_port is None and not self._settings.modbus.port
        taken = " (the usual port is taken)" if other else ""
        self._header = (
            f"{pages}simulated bay: {name}, seed {self._scenario.seed}, speed {self._args.speed:g}\n"
            f"Modbus TCP on {now.modbus_host}:{now.modbus_port}{taken}, {units}; "
            + (f"MQTT {broker}" if broker else "no broker given (--mqtt-url), so none is used")
            + f"\nthe {self._args.vehicle}'s drive: Modbus TCP on 127.0.0.1:{self._drive_port}" * bool(self._drive_port)
            + "\nCtrl-C ends"
        )
        if self._trials:
            print(self._header, file=sys.stderr)
