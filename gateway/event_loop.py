"""Which event loop the gateway runs on: uvloop where it can be had, else asyncio's own. They behave alike.

uvloop is libuv in C: a Modbus poll costs a third less CPU on it (docs/modbus-server.md has the figures). There are
wheels for Linux on x86-64 and 64-bit ARM; elsewhere the gateway runs without.
"""

import asyncio
import gc
import importlib.util
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from gateway import interrupts

T = TypeVar("T")


def factory() -> Callable[[], asyncio.AbstractEventLoop]:
    """What makes the gateway's event loops."""
    if importlib.util.find_spec("uvloop") is None:
        return asyncio.new_event_loop
    import uvloop  # noqa: PLC0415 - only where it is

    return uvloop.new_event_loop


def run(main: Coroutine[Any, Any, T]) -> T:
    """As `asyncio.run`, for the life of a process.

    What is loaded by now stays, so the collector need not look through 64,000 objects, which takes it a tick or more.
    """
    gc.freeze()
    make = factory()  # the last import before the signals are handled
    interrupts.as_usual()
    with asyncio.Runner(loop_factory=make) as runner:
        return runner.run(main)
