"""Which gateway and which bays an export is for, and what its files are called. Pure."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gateway.errors import ConfigError
from gateway.modbus.registers.bay_identity import BayIdentity
from gateway.modbus.registers.register import WordOrder

# 192.0.2.0/24 is set aside for documentation: an address that no plant can have.
EXAMPLE_HOST = "192.0.2.10"
POLLS_S = 2.0  # for what is written and read about a measurement, in slow polls


@dataclass(frozen=True, slots=True)
class Target:
    """One bay as its PLC sees it: where to connect, and under which unit id and word order it answers.

    `writes`: the gateway's [modbus] writes is on. Used only by tools that write whether they are answered or not.
    `site` and `gateway` (its `instance`) are the names in its configuration; with the bay's they make its identity.
    `trigger_timeout_s`: as [modbus.handshake] has it. `wait_s`: FB_Approach's WaitTimeout, for every bay of one export.
    """

    bay: str = "bay1"
    host: str = EXAMPLE_HOST
    port: int = 502
    unit_id: int = 1
    word_order: WordOrder = "big"
    writes: bool = False
    site: str = "site1"
    gateway: str = "gateway"
    trigger_timeout_s: float = 1.0
    wait_s: int = 10

    def __post_init__(self) -> None:
        """Raises ConfigError for what no PLC could be given."""
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}", self.bay):
            raise ConfigError(f"--bay: {self.bay!r}: letters, digits, - and _, at most 32, no space")
        if not re.fullmatch(r"[A-Za-z0-9.:-]+", self.host):
            raise ConfigError(f"--host: {self.host!r}: an IP address or a host name")
        if not 1 <= self.port <= 65535:
            raise ConfigError(f"--port: {self.port}: 1 to 65535")
        if not 1 <= self.unit_id <= 247:
            raise ConfigError(f"--unit-id: {self.unit_id}: 1 to 247")

    @property
    def identity(self) -> BayIdentity:
        """What the image of this bay has in its registers 101 to 103."""
        return BayIdentity.of(self.unit_id, self.site, self.gateway, self.bay)

    @property
    def step_timeout_ms(self) -> int:
        """A step of a triggered measurement that takes longer has failed: the gateway was given its time, and more."""
        return round(1000 * (self.trigger_timeout_s + POLLS_S))

    @property
    def identifier(self) -> str:
        """The bay's name as PLC languages take it: a letter first, then letters, digits and single underscores."""
        name = re.sub(r"[^A-Za-z0-9]+", "_", self.bay).strip("_")
        return name if name[0].isalpha() else f"bay_{name}"

    @property
    def instance(self) -> str:
        """The same as the name of a variable, which no language has as a keyword."""
        return self.identifier if self.identifier.lower().startswith("bay") else f"bay_{self.identifier}"

    def high_low(self, address: int) -> tuple[int, int]:
        """Addresses of the high and the low word of the 32-bit value at `address`."""
        return (address, address + 1) if self.word_order == "big" else (address + 1, address)


def distinct(targets: tuple[Target, ...]) -> tuple[Target, ...]:
    """The same targets. Raises ConfigError where two of them have the same name or unit id."""
    for what, of in (("name", [t.instance.lower() for t in targets]), ("unit id", [str(t.unit_id) for t in targets])):
        if len(set(of)) != len(of):
            raise ConfigError(f"--bay: two bays have the same {what}: {', '.join(of)}")
    return targets


def file_per_bay(name: str, text: Callable[[Target], str]) -> Callable[[tuple[Target, ...]], dict[str, str]]:
    """An export of one file a bay; `{}` in its name is the bay."""
    return lambda targets: {name.format(target.identifier): text(target) for target in targets}


def one_file(name: str, text: Callable[[tuple[Target, ...]], str]) -> Callable[[tuple[Target, ...]], dict[str, str]]:
    """An export of one file for all the bays; `{}` in its name is the first."""
    return lambda targets: {name.format(targets[0].identifier): text(targets)}


def template(name: str) -> str:
    """A program's text in its own language, from the folder `programs`, with places to fill in."""
    return (Path(__file__).parent / "programs" / name).read_text(encoding="utf-8")
