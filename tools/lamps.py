"""The table of `signal_lamps` in docs/registers.md: what each instruction shows. Pure."""

from collections.abc import Callable, Iterable, Mapping

from gateway.core.state import GuidanceCode
from gateway.modbus.exports.tables import markdown_table
from gateway.modbus.registers.lamps import Lamp, lamps


def names(word: int) -> str:
    """The lamps that are on in a word of the register, for people."""
    return _listed(lamp for lamp in Lamp if word >> lamp & 1)


def instructions() -> str:
    """What each guidance code shows while the truck may move, and while it may not."""
    return markdown_table(
        ("guidance", "lamps, may_move on and stop off", "else"),
        (
            (f"{code.value} `{code.name.lower()}`", *(_listed(lamps(code, may_move=on)) for on in (True, False)))
            for code in GuidanceCode
        ),
    )


def _listed(on: Iterable[Lamp]) -> str:
    return ", ".join(lamp.name.lower() for lamp in on)


BLOCKS: Mapping[str, Callable[[], str]] = {"lamp instructions": instructions}
