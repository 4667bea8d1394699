"""An event as it was sent, whatever fields a client asks for, and what a client's filter of events may hold."""

import logging
from collections.abc import Sequence
from typing import Any

from asyncua import ua
from asyncua.common.events import Event
from asyncua.common.utils import ServiceError
from asyncua.server.address_space import AddressSpace
from asyncua.server.monitored_item_service import WhereClauseEvaluator

MAX_FIELDS = 150  # that a client selects
MAX_OPERANDS = 500  # of a where-clause: one names all of the standard's types of events
_NULL = ua.Variant(None)


class SentEvent:
    """Stands for the library's Event, which fails where a client selects a name of its insides. Its fields are
    attributes: the library reads them so."""

    def __init__(self, event: Event) -> None:
        self.emitting_node: ua.NodeId = event.emitting_node
        values = {name: getattr(event, name) for name in event.data_types}
        self._fields = {
            name: _NULL if value is None else ua.Variant(value, event.data_types[name])
            for name, value in values.items()
        }

    def __getattr__(self, name: str) -> Any:
        try:
            return self.__dict__["_fields"][name].Value
        except KeyError:
            raise AttributeError(name) from None

    def to_event_fields(self, clauses: Sequence[Any]) -> list[ua.Variant]:
        return [self._fields.get(_name(clause), _NULL) for clause in clauses]


def _name(clause: Any) -> str:
    if not clause.BrowsePath:
        return "NodeId" if clause.AttributeId == ua.AttributeIds.NodeId else ""
    return "/".join(str(part.Name) for part in clause.BrowsePath)


def check_filter(wanted: ua.EventFilter) -> None:
    """A where-clause is a tree, so that it ends soon. Raises ServiceError."""
    operands = [one for element in wanted.WhereClause.Elements for one in element.FilterOperands]
    inner = [one.Index for one in operands if isinstance(one, ua.ElementOperand)]
    if len(wanted.SelectClauses) > MAX_FIELDS or len(operands) > MAX_OPERANDS:
        raise ServiceError(ua.StatusCodes.BadTooManyOperations)
    if 0 in inner or len(set(inner)) < len(inner):
        raise ServiceError(ua.StatusCodes.BadContentFilterInvalid)


def matching(events: Sequence[SentEvent], wanted: ua.EventFilter, nodes: AddressSpace) -> list[SentEvent]:
    """As a subscription with the filter gets them."""
    where = WhereClauseEvaluator(logging.getLogger("asyncua"), nodes, wanted.WhereClause)
    return [event for event in events if where.eval(event)]
