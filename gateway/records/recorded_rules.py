"""The rules by which a recording was made: those of the configuration in the head of each segment. Pure."""

from collections.abc import Iterable, Iterator

from gateway.core.interlock import Rules
from gateway.errors import ConfigError
from gateway.modbus.registers.register import WordOrder
from gateway.records.recording import Item, MissingItem, config_of
from gateway.records.segment import Head


class RecordedRules:
    """Called with a segment's head. Raises ConfigError where this version refuses its configuration."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, str], tuple[Rules, WordOrder]] = {}

    def __call__(self, head: Head) -> tuple[Rules, WordOrder]:
        key = head.bay, head.config
        if key not in self._known:
            settings = config_of(head)
            bay = next((bay for bay in settings.bays if bay.name == head.bay), None)
            if bay is None:
                raise ConfigError(f"the recorded configuration has no bay {head.bay!r}")
            self._known[key] = Rules.of(bay, settings), settings.modbus.word_order
        return self._known[key]

    def of(self, head: Head) -> Rules:
        return self(head)[0]

    def known(self, head: Head) -> Rules | None:
        """None: this version refuses its configuration."""
        return None if self.refused(head) else self.of(head)

    def readable(self, items: Iterable[Item | MissingItem]) -> Iterator[Item | MissingItem]:
        """The same, without the records whose configuration this version refuses: each such segment is missing."""
        head: Head | None = None
        refused = ""
        for item in items:
            if not isinstance(item, MissingItem) and item[0].head is not head:
                head = item[0].head
                refused = self.refused(head)
                if refused:
                    yield MissingItem(f"{item[0].path.name}: {refused}")
            if isinstance(item, MissingItem) or not refused:
                yield item

    def refused(self, head: Head) -> str:
        """Why this version refuses its configuration; empty: it does not."""
        try:
            self(head)
        except ConfigError as error:
            return str(error)
        return ""
