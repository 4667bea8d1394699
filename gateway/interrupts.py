"""Ctrl-C that is not lost. IO: signals.

Python raises KeyboardInterrupt wherever the main thread stands. While modules are imported, that is often in a callback
of the import system or in a finalizer, which swallow every exception: the program would go on. So the request is kept,
and asked for where the program begins to serve.
"""

import _signal as signal  # type: ignore[import-not-found]  # `signal` adds 8 ms of imports, in which nothing is kept yet
import sys

_asked = False


def keep() -> None:
    """From here on Ctrl-C is kept, too; where it is not ignored. It is as Python has it otherwise."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupted)
        sys.unraisablehook = _reported


def asked() -> bool:
    """Was it pressed since `keep`?"""
    return _asked


def as_usual() -> None:
    """Before an event loop handles it: asyncio takes the signal only where Python's own handler is installed."""
    if signal.getsignal(signal.SIGINT) is _interrupted:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _interrupted(number: int, frame: object) -> None:
    global _asked  # noqa: PLW0603 - a process has one
    _asked = True
    signal.default_int_handler(number, frame)


def _reported(what: "sys.UnraisableHookArgs") -> None:
    if what.exc_type is not KeyboardInterrupt:  # a person has pressed it: no error, and kept above
        sys.__unraisablehook__(what)
