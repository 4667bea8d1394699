"""Which bay an image is of, as its registers 101 to 103 have it. Pure.

A PLC that reads the wrong bay, by a unit id or an address mixed up, would open its spout over another's truck: so every
exported program compares both numbers with those that it was made for.
"""

import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from gateway.config import GatewayConfig

_POSITIVE = 0x7FFF_FFFF  # so that PLCs without unsigned numbers compare it, too


@dataclass(frozen=True, slots=True)
class BayIdentity:
    """The default is that of no bay: both numbers 0, which no gateway serves and no program accepts."""

    unit_id: int = 0
    number: int = 0

    @classmethod
    def of(cls, unit_id: int, site: str, instance: str, bay: str) -> Self:
        """Names as in the configuration. Another name of any of the three gives another number."""
        return cls(unit_id, zlib.crc32(f"{site}/{instance}/{bay}".encode()) & _POSITIVE or 1)


def identities(config: "GatewayConfig") -> dict[str, BayIdentity]:
    """Of every bay, by its name."""
    return {bay.name: BayIdentity.of(bay.unit_id, config.site, config.instance, bay.name) for bay in config.bays}


NO_BAY = BayIdentity()
