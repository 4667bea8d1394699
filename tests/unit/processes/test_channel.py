"""Two ends of a channel in one process: messages stay complete, an end is noticed."""

import os
from typing import Any

import pytest

from gateway.processes.channel import Channel, Failed
from gateway.processes.codec import MAX_MESSAGE_BYTES, Codec

ANYTHING = Codec(Any)


def pair() -> tuple[Channel[object, object], Channel[object, object]]:
    ours, theirs = Channel[object, object].pair(ANYTHING)
    return ours, Channel(theirs, ANYTHING)


def test_messages_arrive_complete_and_in_order() -> None:
    ours, theirs = pair()
    with ours.sock, theirs.sock:
        assert ours.offer("first")
        assert ours.offer(["second", 2])
        assert theirs.receive() == "first"
        assert theirs.waiting() == [["second", 2]]
        assert theirs.waiting() == []
        theirs.send("answer")
        assert ours.received() == ["answer"]
        assert not ours.ended


def test_nothing_is_sent_to_one_that_is_gone() -> None:
    ours, theirs = pair()
    theirs.close()

    assert not ours.offer("anything")
    assert ours.received() == []
    assert ours.ended
    ours.close()


def test_the_last_messages_of_one_that_did_not_read_all_are_received() -> None:
    """The kernel reports the reset before the messages that wait."""
    ours, theirs = pair()
    assert ours.offer("a slot to be written")
    theirs.send("a frame")
    theirs.send("the source has ended")
    theirs.close()

    assert ours.received(1) == ["a frame"]
    assert ours.received() == ["the source has ended"]
    assert ours.ended
    ours.close()


def test_sending_to_one_that_does_not_read_fails_without_waiting() -> None:
    ours, theirs = pair()
    with ours.sock, theirs.sock:
        assert any(not ours.offer("x" * 1000) for _ in range(100_000))


def test_a_child_whose_main_process_is_gone_ends() -> None:
    ours, theirs = pair()
    ours.close()
    for call in (theirs.receive, theirs.waiting, lambda: theirs.send("?")):
        with pytest.raises(SystemExit):
            call()
    theirs.close()


def test_a_message_too_long_for_the_other_side_is_refused_here() -> None:
    ours, theirs = pair()
    with ours.sock, theirs.sock, pytest.raises(ValueError, match="at most 65536"):
        ours.offer(os.urandom(MAX_MESSAGE_BYTES))


def test_an_invalid_message_is_the_last_one_that_is_read() -> None:
    ours, theirs = pair()
    ours.codec = Codec(int)
    with ours.sock, theirs.sock:
        theirs.send(7)
        theirs.send("seven")
        theirs.send(8)

        assert ours.received() == [7, Failed("not a message that is taken here: Expected `int`, got `str`")]
        assert ours.ended
        assert ours.received() == []
