"""What the pool makes of its children's words, on real sockets with nobody behind them: order, and an end."""

import asyncio
import os
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, cast

import pytest

from gateway.processes.channel import Link
from gateway.processes.codec import Codec
from gateway.processes.notices import Failed
from gateway.processes.pool import MOST_WORDS, Child, Pool
from tests.virtual_time import LoopClock, run

TALK = 3 * MOST_WORDS
ANYTHING = Codec(Any)


class Alive:
    """Stands where a process stands that has not ended."""

    pid = 0
    killed = False

    def poll(self) -> None:
        return None

    def kill(self) -> None:
        self.killed = True


class Late(Link[Any, Any]):
    """Something happens just before it is read."""

    happens: Callable[[], None] = staticmethod(lambda: None)

    def received(self, most: int | None = None) -> list[Any]:
        self.happens()
        return super().received(most)


@contextmanager
def seated(
    pool: Pool[Any, Any], token: int, link: Link[Any, Any], notes: Link[Any, Any] | None = None
) -> Iterator[None]:
    process = cast("subprocess.Popen[bytes]", Alive())
    pool._children[token] = Child(process, link, os.open(os.devnull, os.O_RDONLY), notes)
    try:
        yield
    finally:
        pool._forget(token)


def test_a_note_written_while_the_children_are_heard_is_told_before_the_word_that_follows_from_it() -> None:
    """Or a result would come for a frame of which nobody knows that it was handed over, and its worker be killed."""

    async def scene() -> None:
        pool: Pool[Any, Any] = Pool("bay1", LoopClock(), ANYTHING)
        near_notes, far_notes = Link[Any, Any].pair(ANYTHING)
        camera, far_camera = Link[Any, Any].pair(ANYTHING)
        ours, theirs = Link[Any, Any].pair(ANYTHING)
        worker = Late(ours.sock, ANYTHING)
        notes, said = Link[Any, Any](far_notes, ANYTHING), Link[Any, Any](theirs, ANYTHING)

        def frame_goes_straight() -> None:
            notes.send("handed 7")
            said.send("looked at 7")
            worker.happens = lambda: None

        worker.happens = frame_goes_straight
        with far_camera, far_notes, theirs, seated(pool, 1, camera, near_notes), seated(pool, 2, worker):
            assert list(pool.messages()) == [(1, "handed 7"), (2, "looked at 7")]

    run(scene())


def test_a_child_that_talks_faster_than_it_is_heard_holds_up_nobody() -> None:
    async def scene() -> None:
        pool: Pool[Any, Any] = Pool("bay1", LoopClock(), ANYTHING)
        ours, theirs = Link[Any, Any].pair(ANYTHING)
        talker = Link[Any, Any](theirs, ANYTHING)
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
            assert len(list(pool.messages())) == MOST_WORDS
            assert list(pool.messages(most=2)) == [(1, "and another thing")] * 2

    run(scene())


@pytest.mark.parametrize("how", ["word", "note"])
def test_a_child_that_says_what_is_no_message_has_failed_and_is_killed(how: str) -> None:
    async def scene() -> None:
        pool: Pool[Any, Any] = Pool("bay1", LoopClock(), Codec(int))
        ours, theirs = Link[Any, Any].pair(Codec(int))
        near_notes, far_notes = Link[Any, Any].pair(Codec(int))
        talker = Link[Any, Any](theirs if how == "word" else far_notes, ANYTHING)
        with theirs, far_notes, seated(pool, 1, ours, near_notes):
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
        ours, theirs = Link[Any, Any].pair(ANYTHING)
        talker = Link[Any, Any](theirs, ANYTHING)
        with theirs, seated(pool, 1, ours):
            asyncio.get_running_loop().add_reader(ours.sock, pool._arrived, pool._spoke, 1)
            for word in range(5):
                talker.send(word)
            heard: list[Any] = []
            while len(heard) < 5:
                async with asyncio.timeout(5):
                    await pool.wait(None)
                heard += [word for _, word in pool.messages(most=2)]
            assert heard == [0, 1, 2, 3, 4]

    run(scene())
