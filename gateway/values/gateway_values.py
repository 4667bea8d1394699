"""What outputs show of the gateway itself, beside its bays. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from gateway.core.visit_summary import VisitSummary
from gateway.values.value import Value, by_name


@dataclass(frozen=True, slots=True)
class GatewayFacts:
    """`in_force`, `reviewed`: digests (`gateway.config.digest`); `reviewed` empty: none is stated. `update_stage`,
    `update_outcome`: as of `gateway update`; empty: there was none. `certificate_days`: until the first certificate of
    each server of the gateway ends. `pages`: where they are opened. `last_visits`: the newest that is over, by bay."""

    in_force: str = ""
    reviewed: str = ""
    update_stage: str = ""
    update_outcome: str = ""
    certificate_days: Mapping[str, int] = field(default_factory=dict)
    pages: str = ""
    last_visits: Mapping[str, VisitSummary] = field(default_factory=dict)


def _as_reviewed(facts: GatewayFacts) -> bool | None:
    return facts.in_force == facts.reviewed if facts.reviewed else None


_NOT_STATED = "none is stated"
_NO_UPDATE = "there was none"
ROWS: tuple[Value[GatewayFacts], ...] = (
    Value("configuration.in_force", str, "digest of the configuration in force (docs/fleet.md)", lambda f: f.in_force),
    Value("configuration.reviewed", str, "digest of the one that was reviewed", lambda f: f.reviewed or None,
          _NOT_STATED),
    Value("configuration.as_reviewed", bool, "the two are equal", _as_reviewed, _NOT_STATED),
    Value("update.stage", str, "step of the newest update, by its name in docs/update.md",
          lambda f: f.update_stage or None, _NO_UPDATE),
    Value("update.outcome", str, "how it ended: updated, abandoned, returned or not_proven",
          lambda f: f.update_outcome or None, "there was none, or it has not ended"),
    Value("certificate_days", int, "until the first certificate of the gateway's own servers ends",
          lambda f: min(f.certificate_days.values(), default=None), "without TLS"),
    Value("pages", str, "where its pages are opened", lambda f: f.pages or None, "not served"),
)  # fmt: skip
GATEWAY_VALUES = by_name(ROWS, {})
