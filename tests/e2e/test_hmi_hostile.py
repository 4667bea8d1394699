"""A web process that floods the main process, or takes long to start: real processes, an event loop that goes on."""

import asyncio
import contextlib
import socket

import pytest

from gateway.clock import SystemClock
from gateway.config import GatewayConfig
from gateway.errors import LinkError
from gateway.web.host import web_process_service
from gateway.web.ipc.messages import StateReply, StateRequest, WebSetup
from tests.unit.web.gateway_client import plant
from tests.virtual_time import in_real_time


@pytest.mark.mostly_long
@pytest.mark.parametrize(
    ("instance", "why"),
    [
        ("hears", "without pause"),
        ("deaf", "killed by SIGKILL"),
        ("nonsense", "not a message that is taken here"),
    ],
)
@pytest.mark.failure_mode("W3")
@in_real_time
async def test_a_web_process_that_asks_without_end_is_ended_and_the_event_loop_goes_on(
    instance: str, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web_process_service, "MODULE", "tests.e2e.hmi_stand_ins")

    turns = 0

    async def others() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    async with plant(keep=False) as made:
        door = socket.create_server(("127.0.0.1", 0))
        with door, socket.create_connection(door.getsockname()):
            about = WebSetup(GatewayConfig(instance=instance), SystemClock(), {})
            at_work = asyncio.get_running_loop().create_task(others())
            try:
                async with asyncio.timeout(60):
                    with pytest.raises(LinkError, match=why):
                        await web_process_service.WebProcessService(made.handler, about, (door,)).run()
            finally:
                at_work.cancel()
                with contextlib.suppress(asyncio.CancelledError):
                    await at_work
    assert turns > 100


class EndOfTestError(Exception):
    """The web process has been answered."""


@pytest.mark.long
def test_a_web_process_that_starts_more_slowly_than_it_may_gets_more_time_until_it_is_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A loaded machine is this one, too: only the order of the deadlines is certain."""
    monkeypatch.setattr(web_process_service, "MODULE", "tests.e2e.hmi_stand_ins")
    monkeypatch.setattr(web_process_service, "START_S", 1.0)

    ended: list[str] = []

    def answer(_: StateRequest) -> StateReply:
        raise EndOfTestError

    async def scene() -> None:
        async with plant(keep=False) as made:
            monkeypatch.setattr(made.handler, "answer", answer)
            door = socket.create_server(("127.0.0.1", 0))
            with door, socket.create_connection(door.getsockname()):
                about = WebSetup(GatewayConfig(instance="late"), SystemClock(), {})
                web = web_process_service.WebProcessService(made.handler, about, (door,))
                with contextlib.suppress(EndOfTestError):
                    while True:
                        try:
                            await web.run()
                        except LinkError as error:
                            ended.append(str(error))

    asyncio.run(asyncio.wait_for(scene(), 500))
    deadlines = [f"the web process was not ready within {2**n} s" for n in range(len(ended))]
    assert ended == deadlines
    assert len(ended) >= 2  # one and two seconds are not enough for it
