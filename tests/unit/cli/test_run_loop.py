"""What SIGHUP means: with real terminals, and without."""

import asyncio
import os
import pty
import subprocess
import sys

import pytest

from gateway.cli import run_loop
from gateway.config import GatewayConfig
from gateway.reload import ReloadRequests

WATCH = """
import fcntl, signal, termios
signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})  # before libraries start their threads
from gateway.cli.run_loop import _has_terminal
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
print(_has_terminal(), flush=True)
signal.sigwait({signal.SIGHUP})
print(_has_terminal(), flush=True)
"""


@pytest.mark.parametrize(("had", "has", "reloads"), [(False, False, True), (True, True, True), (True, False, False)])
def test_it_asks_for_a_reload_unless_the_terminal_went_away(
    monkeypatch: pytest.MonkeyPatch, had: bool, has: bool, reloads: bool
) -> None:
    monkeypatch.setattr(run_loop, "_has_terminal", lambda: has)

    async def scene() -> tuple[bool, bool]:
        requests, stop = ReloadRequests(GatewayConfig), asyncio.Event()
        run_loop._hung_up(requests, stop, had_terminal=had)
        return requests.requested.is_set(), stop.is_set()

    assert asyncio.run(scene()) == (reloads, not reloads)


@pytest.mark.long
@pytest.mark.one_interpreter
def test_a_terminal_is_gone_when_the_signal_comes() -> None:
    ours, theirs = pty.openpty()

    process = subprocess.Popen(
        [sys.executable, "-c", WATCH], stdin=theirs, stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    os.close(theirs)
    try:
        assert process.stdout is not None
        before = process.stdout.readline()
        os.close(ours)
        after = process.communicate(timeout=30)[0]
    finally:
        process.kill()
    assert (before, after) == ("True\n", "False\n")
