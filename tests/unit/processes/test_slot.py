"""What the slot makes of its child's messages, on real sockets with no process behind them: order, and an end."""

import asyncio
import os
import socket
import subprocess
from collections.abc import Awaitable, Callable
from typing import Any, cast

from gateway.processes.channel import Channel, Failed
from gateway.processes.codec import Codec
from gateway.processes.slot import MAX_MESSAGES, Child, ProcessSlot
from gateway.processes.start import Role
from tests.virtual_time import LoopClock, run

ANYTHING = Codec(Any)
Slot = ProcessSlot[Any, Any]


class Alive:
    """In place of a process that has not ended."""

    pid = 0
    killed = False

    def poll(self) -> None:
        return None

    def kill(self) -> None:
        self.killed = True


def with_child(codec: Codec, scene: Callable[[Slot, Channel[Any, Any]], Awaitable[None]]) -> Alive:
    """Runs the scene with a slot, and the other side of its child's channel. Returns the process."""
    process = Alive()

    async def main() -> None:
        slot = Slot("bay1", LoopClock(), codec)
        ours, theirs = Channel[Any, Any].pair(codec)
        with theirs:
            child = Child(cast("subprocess.Popen[bytes]", process), ours, os.open(os.devnull, os.O_RDONLY))
            slot._child = child
            asyncio.get_running_loop().add_reader(ours.sock, slot._arrived, False)
            await scene(slot, Channel(theirs, ANYTHING))
            slot._forget(child)

    run(main())
    return process


def test_a_child_that_sends_faster_than_it_is_read_holds_up_nothing() -> None:
    async def scene(slot: Slot, sender: Channel[Any, Any]) -> None:
        sent = 0

        class SendsAnother(Codec):
            def unpacked(self, data: bytes) -> Any:
                nonlocal sent
                if (sent := sent + 1) < 3 * MAX_MESSAGES:
                    sender.send("another")
                return super().unpacked(data)

        assert slot._child is not None
        slot._child.channel.codec = SendsAnother(Any)
        sender.send("one")
        assert len(slot.messages()) == MAX_MESSAGES
        assert slot.messages(most=2) == ["another"] * 2

    with_child(ANYTHING, scene)


def test_all_that_waits_in_a_socket_is_read_at_once() -> None:
    """A result that has arrived is not late; and what one flood may cost the event loop is not much more."""
    ours, theirs = Channel[Any, Any].pair(ANYTHING)
    child, waiting = Channel[Any, Any](theirs, ANYTHING), 0
    with ours.sock, theirs:
        while child.offer(0):
            waiting += 1
    assert 100 < waiting < MAX_MESSAGES <= 5 * waiting


def test_a_child_that_sends_what_is_no_message_has_failed_and_is_killed() -> None:
    async def scene(slot: Slot, sender: Channel[Any, Any]) -> None:
        sender.send(1)
        assert slot.messages() == [1]
        sender.send({"a": "map"})
        assert slot.messages() == [Failed("not a message that is taken here: Expected `int`, got `object`")]

    assert with_child(Codec(int), scene).killed


def test_what_was_not_taken_at_once_wakes_the_slot_again() -> None:
    async def scene(slot: Slot, sender: Channel[Any, Any]) -> None:
        for number in range(5):
            sender.send(number)
        found: list[Any] = []
        while len(found) < 5:
            async with asyncio.timeout(5):
                await slot.wait(None)
            found += slot.messages(most=2)
        assert found == [0, 1, 2, 3, 4]

    with_child(ANYTHING, scene)


def test_what_is_sent_before_the_template_has_made_the_process_follows_its_job() -> None:
    class Later:
        """A template that has not answered yet."""

        answer: Callable[[Any], bool]
        theirs: socket.socket

        def start(self, role: Role[Any], theirs: socket.socket, answer: Callable[[Any], bool]) -> None:
            self.theirs, self.answer = theirs, answer

    async def main() -> None:
        template, process = Later(), Alive()
        process.pid = os.getpid()
        slot = Slot("recorder", LoopClock(), ANYTHING, template=template)
        slot.start(Role("module", "name", "the job"))
        slot.send("first")
        slot.send("second")
        other: Channel[Any, Any] = Channel(template.theirs, ANYTHING)
        with template.theirs:
            assert other.waiting() == []
            assert template.answer(process)
            slot.send("third")
            assert other.waiting() == ["the job", "first", "second", "third"]
        assert slot._child is not None
        slot._forget(slot._child)

    run(main())
