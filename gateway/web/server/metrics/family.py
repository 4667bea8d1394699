"""What a row of the metrics' table is, and what its samples are read from. Pure."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from gateway.web.server.gateway_client import GatewayClient
from gateway.web.server.live import ViewerCounts
from gateway.web.server.process_usage import ProcessUsage

PREFIX = "loading_gateway_"
Value = float | int | None
Labelled = tuple[tuple[str, ...], Value]
Form = Literal["gauge", "counter", "state set"]


@dataclass(frozen=True, slots=True)
class PageStatistics:
    """What the web process itself has done."""

    viewers: Mapping[str, ViewerCounts] = field(default_factory=dict)  # by page
    pictures_encoded: int = 0
    refusals: Mapping[str, int] = field(default_factory=dict)  # by code


@dataclass(frozen=True, slots=True)
class MetricsSource:
    """All there is to report."""

    client: GatewayClient
    pages: PageStatistics
    processes: tuple[ProcessUsage, ...] = ()


@dataclass(frozen=True, slots=True)
class Family:
    """One row. `labels` without the bay's; `states` of a state set."""

    name: str
    form: Form
    help: str
    read: Callable[[MetricsSource], Iterable[Labelled]] = field(repr=False)
    labels: tuple[str, ...] = ()
    states: tuple[str, ...] = ()
