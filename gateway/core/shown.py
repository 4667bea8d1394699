"""What may be shown of a bay now: the one rule that every output asks, so that none of them says another thing. Pure.

A state is valid until `valid_until_ns`, which every tick of the control task moves on. Sensors that still speak do not:
when nobody ticks any more, nobody decides, and good values must not stand beside a heartbeat that stands still.
"""

from gateway.core import fusion
from gateway.core.model import Reason, StateVector


def shown(state: StateVector, now_ns: int) -> StateVector:
    """`state`, or, when nobody vouches for it any more, the same with stop on and every value withdrawn.

    `now_ns`: monotonic, the clock of the state. The last word of a gateway that has shut down stays.
    """
    if valid(state.valid_until_ns, now_ns) or state.reason is Reason.SHUTDOWN:
        return state
    return fusion.forced_stop(state, Reason.GATEWAY_FAULT, now_ns)


def valid(valid_until_ns: int, now_ns: int) -> bool:
    """May what is valid until then be shown at `now_ns`?"""
    return now_ns <= valid_until_ns
