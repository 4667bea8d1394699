"""Which version of MQTT to try next. Pure.

MQTT 5 comes first. A broker that does not know it says so, or hangs up without a word; then 3.1.1 has its turn. After
silence 5 is tried again in turn, for the broker may only have been slow. What a broker has greeted is kept.
"""

from enum import Enum
from typing import Literal


class Protocol(Enum):
    """The versions that the gateway speaks."""

    V5 = "5"
    V311 = "3.1.1"


class Versions:
    """`next` is the version to connect with; tell what came of it."""

    def __init__(self, asked: Literal["auto", "5", "3.1.1"]) -> None:
        self._fixed = asked != "auto"
        self._greeted = False
        self.next = Protocol.V5 if asked == "auto" else Protocol(asked)

    def greeted(self) -> None:
        """The broker has accepted `next`."""
        self._greeted = True

    def failed(self, *, certain: bool) -> None:
        """It has not. `certain`: because it does not know that version."""
        if self._fixed or (self._greeted and not certain):
            return
        self._greeted = False
        self.next = Protocol.V311 if self.next is Protocol.V5 else Protocol.V5
