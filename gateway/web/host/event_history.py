"""The newest events of all bays with their numbers, from the gateway's first word on. Outlives the web process."""

from collections import deque
from itertools import islice

from gateway.core.model import Event
from gateway.hub import Hub
from gateway.web.ipc.messages import MAX_EVENTS, NumberedEvent

KEPT_EVENTS = 1000


class EventHistory:
    """To be made before the first state is published, or the start events would be missed."""

    def __init__(self, hub: Hub) -> None:
        self._kept: deque[NumberedEvent] = deque(maxlen=KEPT_EVENTS)
        self.newest = 0  # number of the newest event; the first is 1
        hub.listen(self._keep)

    def _keep(self, event: Event) -> None:
        self.newest += 1
        self._kept.append(NumberedEvent(self.newest, event))

    def after(self, number: int) -> tuple[NumberedEvent, ...]:
        """The oldest few of those kept that came after `number`."""
        missing = max(0, min(self.newest - number, len(self._kept)))
        first = len(self._kept) - missing
        return tuple(islice(self._kept, first, first + MAX_EVENTS))
