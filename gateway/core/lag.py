"""How late the vehicle follows its setpoint, and how late it stands: measured on the way. Pure.

How late it follows is measured while the setpoint falls, and nothing else limits the vehicle; how late it stands, from
approach to approach, within what the lag permits.
"""

from statistics import median

from gateway.config import DriveConfig
from gateway.core.movement import DriveMemory, Movement
from gateway.core.setpoint_history import KEPT_S, SetpointHistory
from gateway.durations import NS_PER_S
from gateway.replacing import replace

SOONER = 0.85  # of the lag: a drive that stops needs no time to correct its speed
SOONEST = 0.75  # likewise: what is learned of it is not less
FALLEN = 0.85  # of its highest value: the setpoint has fallen, and half the longest delay later it is measured
FALLS_MM_S = 60.0  # for so much of a fall the lag is measured
SLIPS = 5  # approaches from which the way out is learned


def lag_s(memory: DriveMemory, config: DriveConfig) -> float:
    """So late the vehicle follows its setpoint: as measured while it slowed down, else at the longest."""
    return config.delay_s if memory.lag_s is None else memory.lag_s


def slip_s(memory: DriveMemory, config: DriveConfig) -> float:
    """So late the vehicle comes to a standstill, compared with the worst brake that acts at once."""
    late_s = lag_s(memory, config)
    if memory.lag_s is None or 0 < memory.peak_mm_s <= config.creep_speed_mm_s:
        return late_s
    learned_s = median(memory.slips_s) if memory.slips_s else SOONER * late_s
    return min(max(learned_s, SOONEST * late_s), late_s)


def measured(memory: DriveMemory, found: Movement, config: DriveConfig) -> DriveMemory:
    """While the setpoint falls, and only it limits the vehicle: how late does it act for the way that was gone?"""
    speed_mm_s, begun, history = memory.speed_mm_s, memory.begun, memory.history
    if speed_mm_s == 0 or found.t_ns - memory.peak_ns < config.delay_s / 2 * NS_PER_S:
        return memory if begun is None else replace(memory, begun=None)
    begins = (found.t_ns, found.distance_mm, speed_mm_s)
    if begun is None or found.t_ns - begun[0] > KEPT_S * NS_PER_S:
        return replace(memory, begun=begins)
    if speed_mm_s > begun[2] - FALLS_MM_S:
        return memory
    gone_mm, longest_ns = begun[1] - found.distance_mm, config.delay_s * NS_PER_S
    if history.way_at(found.t_ns - longest_ns) - history.way_at(begun[0] - longest_ns) < gone_mm:
        return replace(memory, begun=begins)  # a rise, too, may have moved it so far
    late_s = _late_s(history, begun[0], found.t_ns, gone_mm, config.delay_s)
    late_s = late_s if memory.lag_s is None else (memory.lag_s + late_s) / 2
    changed_mm_s = history.acting_mm_s(lag_s(memory, config)) - history.acting_mm_s(late_s)
    found = replace(found, excess_mm_s=found.excess_mm_s + changed_mm_s)
    return replace(memory, lag_s=late_s, begun=begins, movement=found)


def learned(memory: DriveMemory, distance_mm: float, config: DriveConfig) -> DriveMemory:
    """It stands there after the setpoint became 0: how late it followed. A slower run than creep speed does not show it
    well."""
    cut = memory.cut
    if cut is None:
        return memory
    memory = replace(memory, cut=None)
    if not cut.moving or cut.speed_mm_s < 0.7 * config.creep_speed_mm_s:
        return memory
    history = memory.history
    late_s = _late_s(history, cut.t_ns, history.t_ns, cut.distance_mm - distance_mm, config.delay_s)
    return replace(memory, slips_s=(*memory.slips_s, late_s)[-SLIPS:])


def _late_s(history: SetpointHistory, from_ns: int, to_ns: int, gone_mm: float, longest_s: float) -> float:
    """By so much was a falling setpoint late that moved the vehicle so far."""
    short_s, long_s = 0.0, longest_s
    for _ in range(10):
        late_s = (short_s + long_s) / 2
        if history.moved_mm(from_ns, to_ns, late_s) < gone_mm:
            short_s = late_s
        else:
            long_s = late_s
    return (short_s + long_s) / 2
