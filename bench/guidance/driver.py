"""A simulated driver: what he sees and hears, when he reacts, which speed he then wants. Pure, by seed.

He sees the display's sign as it was `reaction_s` ago, and, where he does not watch it all the time, as it was at his
last glance. The bell (`stop`) he hears at any time, `reaction_s` late. With his own eyes he estimates the distance to
go as `a + b` times the true one and slows down where he believes to be near; so he does with the display and with the
bell. After each change of direction he drives slower.

Where his foot leaves the brake, it returns when he notices that the truck rolls: by himself after `slip_s`, or a
reaction time after the display changes to BRAKE, STOP or TOO FAR. The bell rings by then anyway.
"""

import random
from collections import deque
from dataclasses import dataclass
from enum import StrEnum

from bench.guidance.truck import Dynamics, Truck
from gateway.core.state import GuidanceCode

LEARNS = 0.8  # after each change of direction he drives so much slower
BRAKING = frozenset({GuidanceCode.STOP, GuidanceCode.TOO_FAR, GuidanceCode.BRAKE})
STANDING = BRAKING | {GuidanceCode.WAIT, GuidanceCode.OK, GuidanceCode.FAULT}


class Profile(StrEnum):
    ATTENTIVE = "attentive"  # watches the display, does what it says
    IGNORING = "ignoring"  # glances at it now and then, and takes SLOW for advice
    OVER_CORRECTING = "over-correcting"  # does too much of everything, and for too long
    ROLLING = "rolling"  # a slope, and a foot that leaves the brake too early


class Aid(StrEnum):
    DISPLAY = "display"  # the gateway's guidance, and the bell
    BELL = "bell"  # `stop` only, as a bell or a lamp of the PLC shows it


@dataclass(frozen=True, slots=True)
class Person:
    """What is drawn for one approach. Speeds are positive."""

    profile: Profile
    reaction_s: float
    cruise_mm_s: float
    creep_mm_s: float
    back_mm_s: float
    glance_s: float  # between two looks at the display; 0: he watches it
    obeys_slow: bool
    least_s: float  # what he has begun he does for this time
    eyes_share: float  # his estimate of the way to go: true times this ...
    eyes_mm: float  # ... plus this
    eyes_slow_mm: float  # he creeps where he believes that no more is to go
    slips: tuple[float, ...]  # his foot leaves the brake this long after each standstill, s; in turn
    slip_s: float  # and he notices it by himself after this time
    dynamics: Dynamics

    @classmethod
    def drawn(cls, profile: Profile, seed: int) -> "Person":
        chance = random.Random(f"driver {profile} {seed}")
        uniform = chance.uniform
        too_much = 1.6 if profile is Profile.OVER_CORRECTING else 1.0
        rolling = profile is Profile.ROLLING
        slope = uniform(0.002, 0.01) * (1 if chance.random() < 0.7 else -1)
        return cls(
            profile,
            reaction_s=uniform(0.5, 2.0),
            cruise_mm_s=uniform(200, 600),
            creep_mm_s=uniform(40, 120) * too_much,
            back_mm_s=uniform(40, 120) * too_much,
            glance_s=uniform(1.0, 3.0) if profile is Profile.IGNORING else 0.0,
            obeys_slow=profile is not Profile.IGNORING,
            least_s=uniform(0.5, 2.0) if profile is Profile.OVER_CORRECTING else 0.0,
            eyes_share=chance.lognormvariate(0.0, 0.2),
            eyes_mm=chance.gauss(0.0, 250.0),
            eyes_slow_mm=uniform(300, 1000),
            slips=tuple(uniform(2.0, 8.0) for _ in range(2)) if rolling else (),
            slip_s=uniform(0.5, 1.5),
            dynamics=Dynamics(
                drive_mm_s2=uniform(250, 500),
                brake_mm_s2=uniform(700, 1500),
                gear_s=uniform(1.5, 4.0),
                slope=slope if rolling else 0.0,
            ),
        )


@dataclass(slots=True)
class Sign:
    """What the display shows and the bell does at one time."""

    t_s: float
    code: GuidanceCode
    bell: bool


class Driver:
    """Call `drive` at each step of time with what is shown now."""

    def __init__(self, person: Person, aid: Aid) -> None:
        self.person = person
        self._aid = aid
        self._signs: deque[Sign] = deque()  # newer than the reaction time
        self._known = Sign(-1e9, GuidanceCode.WAIT, bell=False)  # what he reacts to
        self._glanced = self._known
        self._glance_due_s = -1e9
        self._wanted_mm_s = 0.0
        self._until_s = -1e9  # what he does now he does until then
        self._standing_since_s: float | None = None
        self._slips = list(person.slips)
        self._slipped_s: float | None = None
        self._slipped_at = GuidanceCode.WAIT  # what the display showed then

    @property
    def slips_left(self) -> int:
        return len(self._slips)

    def drive(self, sign: Sign, truck: Truck, to_go_mm: float, dt_s: float) -> None:
        """`to_go_mm`: the true distance to go, for his eyes."""
        t_s, person = sign.t_s, self.person
        self._signs.append(sign)
        while self._signs and self._signs[0].t_s <= t_s - person.reaction_s:
            self._known = self._signs.popleft()
            if self._known.t_s >= self._glance_due_s:
                self._glanced, self._glance_due_s = self._known, self._known.t_s + person.glance_s
        wanted_mm_s = self._wanted(to_go_mm, truck)
        if wanted_mm_s != self._wanted_mm_s and t_s >= self._until_s:
            begins = (wanted_mm_s > 0) != (self._wanted_mm_s > 0) or (wanted_mm_s < 0) != (self._wanted_mm_s < 0)
            self._wanted_mm_s = wanted_mm_s
            # Whoever overdoes it brakes late as well, but he does brake: `least_s` is for moving only.
            self._until_s = t_s + person.least_s if begins and wanted_mm_s else t_s
        truck.step(self._wanted_mm_s, self._slipping(sign, truck), dt_s)

    def _wanted(self, to_go_mm: float, truck: Truck) -> float:
        person = self.person
        believed_mm = person.eyes_share * to_go_mm + person.eyes_mm
        creep_mm_s = person.creep_mm_s * LEARNS**truck.changes
        own_mm_s = creep_mm_s if believed_mm <= person.eyes_slow_mm else person.cruise_mm_s
        if self._aid is Aid.BELL:
            return 0.0 if self._known.bell else own_mm_s
        code = self._glanced.code
        if self._known.bell and self._glanced.t_s < self._known.t_s and truck.gear > 0:
            code = GuidanceCode.STOP  # he hears it without a look
        if code in STANDING:
            return 0.0
        if code in (GuidanceCode.BACK, GuidanceCode.LEAVE):
            return -person.back_mm_s * LEARNS**truck.changes
        return min(own_mm_s, creep_mm_s) if code is GuidanceCode.SLOW and person.obeys_slow else own_mm_s

    def _slipping(self, sign: Sign, truck: Truck) -> bool:
        """Has his foot left the brake?"""
        t_s, person = sign.t_s, self.person
        if self._wanted_mm_s or (truck.speed_mm_s and self._slipped_s is None):
            self._standing_since_s = self._slipped_s = None
            return False
        if self._slipped_s is None:
            if self._standing_since_s is None:
                self._standing_since_s = t_s
            if self._slips and t_s - self._standing_since_s >= self._slips[0]:
                self._slips.pop(0)
                self._slipped_s, self._slipped_at = t_s, sign.code
        elif t_s - self._slipped_s >= person.slip_s or self._sees_to_brake(self._slipped_s):
            self._standing_since_s = self._slipped_s = None
        return self._slipped_s is not None

    def _sees_to_brake(self, since_s: float) -> bool:
        seen = self._glanced
        new = self._aid is Aid.DISPLAY and seen.t_s > since_s and seen.code is not self._slipped_at
        return new and seen.code in BRAKING
