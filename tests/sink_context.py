"""What a sink is made of, without a file for its outbox."""

import secrets
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from gateway.clock import Clock
from gateway.config import parse
from gateway.sinks.contract import AlarmSource, AlarmStep, Bays, SinkContext, no_alarm_steps, no_alarms


def sink_context(
    settings: Any,
    bays: Bays,
    clock: Clock,
    *,
    site: str = "site",
    instance: str = "gw",
    boot: str = "",
    alarms: AlarmSource = no_alarms,
    listen_to_alarms: Callable[[Callable[[AlarmStep], None]], None] = no_alarm_steps,
) -> SinkContext:
    """`settings`: of the sink. `boot`: random where it is not given."""
    config = parse({"site": site, "instance": instance})
    in_memory = settings.model_copy(update={"outbox_file": ""})
    return SinkContext(
        config, in_memory, bays, clock, boot or secrets.token_hex(8), ExitStack(), alarms, listen_to_alarms
    )
