"""The rules by which a recording was made: those of the configuration in the head of each segment. Pure."""

from gateway.core.interlock import Rules
from gateway.errors import ConfigError
from gateway.modbus.registers.register import WordOrder
from gateway.records.recording import config_of
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
