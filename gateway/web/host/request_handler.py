"""The main process's side of the pages: what an answer holds, and how an order is carried out. Never waits.

Nothing here can end a stop: a function check withholds `may_move` or leaves it as it is, and settings that go live
begin with a new vision, whose first word is that it has seen nothing yet.
"""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from msgspec.structs import replace

from gateway.alarms.records import Deed, Reply
from gateway.bay import BayControl
from gateway.clock import Clock
from gateway.config import VisionConfig
from gateway.core.model import FunctionCheck
from gateway.core.plc import Writer
from gateway.errors import GatewayError
from gateway.modbus.protocol.answers import ReadImage
from gateway.net import rate_limit
from gateway.vision.process.service import VisionService
from gateway.web.host.event_history import Chronicle
from gateway.web.ipc.messages import MAX_STATES, Answer, Apply, Ask, BayNow, Check, Done, LinksNow, Order

log = logging.getLogger(__name__)

MAX_NAME = 120  # of somebody, or of something asked for
MAX_TOLD = 1000  # of what has changed


@dataclass(frozen=True, slots=True)
class BayParts:
    """The parts of one bay that the pages show or may ask something of."""

    control: BayControl
    image: ReadImage
    vision: VisionService


class Feed:
    """Answers the web process."""

    def __init__(
        self,
        chronicle: Chronicle,
        bays: Mapping[str, BayParts],
        clock: Clock,
        links: Callable[[], LinksNow],
        alarms: Callable[[Deed], Reply],
    ) -> None:
        self._bays = bays
        self._clock = clock
        self._links = links
        self._alarms = alarms
        self._chronicle = chronicle
        self._orders = rate_limit.Bucket()

    def answer(self, ask: Ask) -> Answer:
        known = [bay for bay in ask.bays if bay in self._bays][:MAX_STATES]
        return Answer(
            number=ask.number,
            now_ns=self._clock.now_ns(),
            wall_ns=self._clock.wall_ns(),
            bays=tuple(self._now(self._bays[bay]) for bay in known),
            links=self._links() if ask.links else None,
            events=self._chronicle.after(ask.after),
            newest_event=self._chronicle.newest,
        )

    def _now(self, bay: BayParts) -> BayNow:
        return BayNow(bay.control.state(), tuple(bay.image()), bay.vision.settings)

    def carry_out(self, order: Order) -> Done:
        """What makes no sense is refused, whatever the web process's own checks say: strangers talk to it."""
        if isinstance(order.what, Deed):
            return Done(order.number, self._alarms(replace(order.what, who=order.what.who[:MAX_NAME])).why)
        bay = self._bays.get(order.what.bay)
        if bay is None:
            return Done(order.number, f"no bay {order.what.bay[:MAX_NAME]!r}")
        self._orders, untold = rate_limit.take(self._orders, self._clock.now_ns())
        if untold is None:  # each is told as an event, and may begin processes anew
            return Done(order.number, "too many orders one after the other: wait a little")
        return Done(order.number, _carried_out(order.what, bay, _clipped(order.who)))


def _carried_out(what: Check | Apply, bay: BayParts, who: Writer) -> str:
    """What is wrong with it; empty: it was done."""
    match what:
        case Check(mode=mode):
            bay.control.check_function(mode, who)
        case Apply(vision=vision, over=over):
            if bay.control.state().function_check is FunctionCheck.OFF:
                return "begin a function check first: settings never change in a bay at work"
            try:
                if over is not None and (others := _changed(over, bay.vision.settings)):
                    return f"somebody else has let other settings go live meanwhile: {others}"[:MAX_TOLD]
                told = _changed(bay.vision.settings, vision)
                bay.vision.apply(vision)
            except (GatewayError, ValueError) as error:
                return str(error)[:MAX_TOLD]
            bay.control.settings_changed(told[:MAX_TOLD] or "the same settings", who)
    return ""


def _clipped(who: Writer) -> Writer:
    """It stands in events, which are kept and must fit into messages."""
    return Writer(who.address[:MAX_NAME], who.subject[:MAX_NAME], who.role[:MAX_NAME])


def _changed(old: VisionConfig, new: VisionConfig) -> str:
    """`key: old -> new`, for the record."""
    keys = type(new).model_fields
    return ", ".join(
        f"{key}: {getattr(old, key)} -> {getattr(new, key)}" for key in keys if getattr(old, key) != getattr(new, key)
    )
