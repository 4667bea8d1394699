"""Random faults of one approach: of sensors, network, PLC, drive, gateway. Pure, by seed."""

from dataclasses import dataclass
from enum import StrEnum
from random import Random

from gateway.core.stopping_way import FASTER


class Fault(StrEnum):
    RANGER_SILENT = "ranger sends nothing"
    RANGER_DEAF = "no echo"
    RANGER_FROZEN = "ranger repeats its last distance"
    RANGER_NEAR = "echo of something nearer"
    RANGER_FAR = "echo from farther away"
    RANGER_WILD = "every other distance is wild"
    RANGER_LATE = "distances arrive late"
    CAMERA_FROZEN = "no new pictures"
    CAMERA_STUCK = "camera repeats its last picture"
    CAMERA_LATE = "pictures arrive late"
    MARKER_HIDDEN = "marker hidden"
    DRIVE_FASTER = "drive faster than its reference"
    POLL_LOST = "the PLC's polls are lost"
    GATEWAY_KILLED = "gateway killed, and back"
    CONTROL_HELD = "control task held"


@dataclass(frozen=True, slots=True)
class Failure:
    """`amount`: mm of an echo, s of a delay, times its reference of a drive; else 0."""

    fault: Fault
    at_s: float
    for_s: float
    amount: float = 0.0


AMOUNTS = {
    Fault.RANGER_NEAR: (40.0, 1500.0),  # its distance
    Fault.RANGER_FAR: (10.0, 400.0),  # so much too far
    Fault.RANGER_WILD: (100.0, 3500.0),
    Fault.RANGER_LATE: (0.05, 0.5),
    Fault.CAMERA_LATE: (0.05, 0.5),
    Fault.DRIVE_FASTER: (1.02, FASTER),
}


def failures(seed: int, within_s: float) -> tuple[Failure, ...]:
    """One to three that overlap or follow each other, most of them in the first `within_s`."""
    chance = Random(f"faults {seed}")
    found = []
    for _ in range(chance.randint(1, 3)):
        fault = chance.choice(list(Fault))
        low, high = AMOUNTS.get(fault, (0.0, 0.0))
        found.append(
            Failure(
                fault,
                chance.uniform(0.5, within_s),
                chance.choice((0.2, 0.6, 1.5, 4.0, 30.0)) * chance.uniform(0.5, 1.5),
                chance.uniform(low, high),
            )
        )
    return tuple(found)
