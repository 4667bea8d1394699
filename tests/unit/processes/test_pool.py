"""What the pool makes of its children's words, on real sockets with nobody behind them: order, and an end."""

import asyncio
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

from gateway.processes.channel import Channel, Failed
from gateway.processes.codec import Codec
from gateway.processes.pool import MAX_MESSAGES, Child, Pool
from tests.virtual_time import LoopClock, run

TALK = 3 * MAX_MESSAGES
ANYTHING = Codec(Any)


class Alive:
    """Stands where a process stands that has not ended."""

    pid = 0
    killed = False

    def poll(self) -> None:
        return None

    def kill(self) -> None:
        self.killed = True


@contextmanager
def seated(pool: Pool[Any, Any], token: int, channel: Channel[Any, Any]) -> Iterator[None]:
    process = cast("subprocess.Popen[bytes]", Alive())
    pool._children[token] = Child(process, channel, os.open(os.devnull, os.O_RDONLY))
    try:
        yield
    finally:
        pool._forget(token)


def test_a_child_that_talks_faster_than_it_is_heard_holds_up_nobody() -> None:
    async def scene() -> None:
        pool: Pool[Any, Any] = Pool("bay1", LoopClock(), ANYTHING)
        ours, theirs = Channel[Any, Any].pair(ANYTHING)
        talker = Channel[Any, Any](theirs, ANYTHING)
        talked = 0

        class Egged(Codec):
            def unpacked(self, data: bytes) -> Any:
                nonlocal talked
                if (talked := talked + 1) < TALK:
                    talker.send("and another thing")
                return super().unpacked(data)

        ours.codec = Egged(Any)
        talker.send("one thing")
        with theirs, seated(pool, 1, ours):
            assert len(list(pool.messages())) == MAX_MESSAGES
            assert list(pool.messages(most=2)) == [(1, "and another thing")] * 2

    run(scene())


def test_all_that_waits_in_a_socket_is_read_at_once() -> None:
    """A result that has arrived is not late; and what one flood may cost the event loop is not much more."""
    ours, theirs = Channel[Any, Any].pair(ANYTHING)
    child, waiting = Channel[Any, Any](theirs, ANYTHING), 0
    with ours.sock, theirs:
        while child.offer(0):
            waiting += 1
    assert 100 < waiting < MAX_MESSAGES <= 5 * waiting


def test_a_child_that_says_what_is_no_message_has_failed_and_is_killed() -> None:
    async def scene() -> None:
        pool: Pool[Any, Any] = Pool("bay1", LoopClock(), Codec(int))
        ours, theirs = Channel[Any, Any].pair(Codec(int))
        talker = Channel[Any, Any](theirs, ANYTHING)
        with theirs, seated(pool, 1, ours):
            talker.send(1)
            assert list(pool.messages()) == [(1, 1)]
            talker.send({"a": "map"})
            (told,) = pool.messages()
            assert told == (1, Failed("not a message that is taken here: Expected `int`, got `object`"))
            assert cast("Alive", pool._children[1].process).killed

    run(scene())


def test_what_was_not_taken_at_once_wakes_the_pool_again() -> None:
    async def scene() -> None:
        pool: Pool[Any, Any] = Pool("bay1", LoopClock(), ANYTHING)
        ours, theirs = Channel[Any, Any].pair(ANYTHING)
        talker = Channel[Any, Any](theirs, ANYTHING)
        with theirs, seated(pool, 1, ours):
            asyncio.get_running_loop().add_reader(ours.sock, pool._arrived, pool._readable, 1)
            for word in range(5):
                talker.send(word)
            heard: list[Any] = []
            while len(heard) < 5:
                async with asyncio.timeout(5):
                    await pool.wait(None)
                heard += [word for _, word in pool.messages(most=2)]
            assert heard == [0, 1, 2, 3, 4]

    run(scene())
