"""One approach: a driver, his truck, the simulated sensors and the gateway's own bay control, in virtual time."""

import random
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bench.guidance.driver import Aid, Driver, Person, Profile, Sign
from bench.guidance.truck import END_MM, DrivenWorld, Truck
from gateway.bay import BayControl
from gateway.config import GatewayConfig
from gateway.core.readings import RangeReading, VisionReading
from gateway.core.retained import RetainedState
from gateway.core.state import GuidanceCode, StateVector, Tick
from gateway.hub import Hub
from gateway.ranger.hcsr04.session import Hcsr04Session
from gateway.sim.scenario import parse as parse_scenario
from gateway.sim.world import Truth
from tests.fault_bay import VirtualClock
from tests.visit_bench import LEAD_S, STEP_S, Bench, MarkerSight, gateway

LIMIT_S = 120.0  # a driver who is not in place by then has failed
SETTLED_S = 4.0  # standing, and nobody wants anything else of him, for this time: the approach is over
GAVE_UP_S = 15.0  # standing for this time, in place or not: likewise
STEPS = 2  # of the bench: a tick of the control
DT_S = STEPS * STEP_S
CUT = 1.17  # R at most, of the way from the centre to the nearest edge of the picture
SHOWN_S = (0.03, 0.10)  # from the state to the driver's eye: message, page, screen


@dataclass(frozen=True, slots=True)
class Result:
    """Of one approach. Distances in mm; `error_mm`: true Z - Z_th at the end: + short of the mark, - past it."""

    seed: int
    profile: str
    aid: str
    error_mm: float
    deepest_mm: float  # the least true Z - Z_th on the way
    time_s: float | None  # from the first motion until it stands at its last place; None: not in place
    corrections: int  # starts from a standstill after the first
    reversals: int
    overshoots: int  # times that it came past the tolerance, guidance.overshoot_mm
    d: bool  # D = 1 at the end
    in_place: bool
    signs: int  # changes of the sign while the truck had not been at the mark yet
    way_s: float  # duration of the approach


class WholeRim(MarkerSight):
    """The robust method finds a marker that is cut by the picture's edge, too, while this share of its rim is in it.

    Measured on rendered frames, 640 x 480: found down to 19 cm (R 281 px, 0.64 of the rim), not at 18 cm.
    """

    def _can_see(self, truth: Truth) -> bool:
        camera = self.scenario.camera
        room = min(truth.u_px, camera.width_px - truth.u_px, truth.v_px, camera.height_px - truth.v_px)
        return truth.radius_px <= CUT * room


class GuidedBay(Bench):
    """The tests' bench, with the gateway's bay control in it instead of its pure step, and a driven truck."""

    def __init__(self, config: GatewayConfig, distance_mm: float, seed: int) -> None:
        chance = random.Random(f"truck {seed}")
        scenario = parse_scenario(
            {
                "seed": seed,
                "start": {"distance_cm": distance_mm / 10, "lateral_mm": chance.uniform(-20, 20)},
                "vibration": {"amplitude_mm": chance.uniform(0.5, 3.0)},
                "ranger": {"jitter_mm": chance.uniform(1.0, 2.5), "dropout": chance.choice((0.0, 0.005, 0.02))},
            }
        )
        self.clock = VirtualClock()
        super().__init__(scenario, config, seed=seed)
        self.driven = DrivenWorld(scenario)
        self.world = self.driven
        self._sight = WholeRim(scenario, self._chance)

    def power_on(self, retained: RetainedState | None = None) -> None:
        self.clock.now = self.now_ns
        bay = self.config.bays[0]
        self.hub = Hub([bay.name])
        self.control = BayControl(bay, self.hub, self.clock, (), self.config, retained)
        self.state = self.control.state()
        self._ticking = self.control.run()
        self._session = Hcsr04Session(bay.ranger)
        self._unplugged = False
        for reading in self._session.opened(self.now_ns):
            self.step(reading)

    def run(self, until_s: float) -> StateVector:
        """As the tests' bench, a control tick at each step, and without its record of moments."""
        while self.t_s < until_s - 1e-9:
            self._ticks += STEPS
            self._range()
            self._camera()
            self.step(Tick())
        self.state = self.control.state()  # as it is shown; nobody looks in between
        return self.state

    def step(self, observation: Any) -> StateVector:
        self.clock.now = self.now_ns
        match observation:
            case VisionReading():
                self.control.on_reading(observation)
            case RangeReading():
                self.control.on_reading(observation)
            case Tick():
                self._ticking.send(None)
            case _:
                raise TypeError(f"not of an approach: {observation}")
        return self.state


def settings(changed: Mapping[str, Any] | None = None) -> GatewayConfig:
    """Default settings, with `changed` in [guidance]."""
    return gateway(writes=False, guidance=dict(changed or {}))


def approach(
    profile: Profile, aid: Aid, seed: int, config: GatewayConfig, trace: list[tuple[float, ...]] | None = None
) -> Result:
    """Drive up once. Equal arguments give equal results."""
    person = Person.drawn(profile, seed)
    chance = random.Random(f"approach {profile} {seed}")
    start_mm = chance.uniform(1800, 3600)
    bay = GuidedBay(config, start_mm, seed)
    mark_mm = config.bays[0].fusion.distance_threshold_mm
    past_mm = -config.bays[0].guidance.overshoot_mm
    driver, truck = Driver(person, aid), Truck(person.dynamics, start_mm)
    late: deque[Sign] = deque()
    shown = Sign(-LEAD_S, GuidanceCode.WAIT, bell=False)
    bay.run(0.0)
    stood_s, overshoots, deepest_mm, signs, arrived = 0.0, 0, start_mm, 0, False
    inside, last_code, t_s = True, GuidanceCode.WAIT, 0.0
    while t_s < LIMIT_S:
        state = bay.state
        bell = state.stop
        late.append(Sign(t_s + chance.uniform(*SHOWN_S), state.guidance.code, bell))
        while late and late[0].t_s <= t_s:
            shown = late.popleft()
        sign = Sign(t_s, shown.code, shown.bell)
        arrived |= state.d is True
        signs += sign.code is not last_code and not arrived
        last_code = sign.code
        driver.drive(sign, truck, truck.distance_mm - mark_mm, DT_S)
        t_s = round(t_s + DT_S, 6)
        bay.driven.drove(t_s, truck.distance_mm, truck.speed_mm_s)
        bay.run(t_s)
        error_mm = truck.distance_mm - mark_mm
        deepest_mm = min(deepest_mm, error_mm)
        if inside and error_mm < past_mm:
            overshoots += 1
        inside = error_mm >= past_mm + (0 if inside else 20)
        if truck.speed_mm_s:
            stood_s = t_s
        if trace is not None:
            trace.append((t_s, truck.distance_mm, truck.speed_mm_s, float(sign.code), float(sign.bell)))
        if truck.distance_mm <= END_MM:
            break  # it has come to what is behind the spout
        quiet_s = t_s - stood_s
        done = state.in_place or aid is Aid.BELL
        slips = bool(driver.slips_left) and quiet_s < GAVE_UP_S
        if quiet_s >= (SETTLED_S if done and not slips else GAVE_UP_S):
            break
    state = bay.state
    return Result(
        seed=seed,
        profile=profile.value,
        aid=aid.value,
        error_mm=round(truck.distance_mm - mark_mm, 1),
        deepest_mm=round(deepest_mm, 1),
        time_s=round(stood_s, 2) if state.in_place else None,
        corrections=max(0, truck.starts - 1),
        reversals=truck.changes,
        overshoots=overshoots,
        d=state.d is True,
        in_place=state.in_place,
        signs=signs,
        way_s=t_s,
    )
