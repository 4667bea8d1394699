"""The answer with all rows: one for all viewers, and never an old one."""

import asyncio
import gzip
import json
from typing import Any

from gateway.fleet.answer import Answers
from gateway.fleet.listener import Listener
from tests.unit.fleet.test_listener import SetClock, hear, listening
from tests.unit.fleet.test_roster import status


def asked(answers: Answers) -> tuple[str, dict[str, Any]]:
    answer = asyncio.run(answers.newest())
    return answer.digest, json.loads(gzip.decompress(answer.compressed))


def alive() -> tuple[Listener, SetClock, Answers]:
    listener, clock = listening()
    for t_ms in (1, 2):
        hear(listener, status(t_ms))
    return listener, clock, Answers(listener)


def test_a_row_changes_with_its_status_and_with_time() -> None:
    listener, clock, answers = alive()
    first, found = asked(answers)
    assert [(row["life"], row["version"]) for row in found["rows"]] == [("online", "0.2.0")]
    assert (found["connected"], found["kept"], found["now_ms"]) == (False, False, clock.wall_ns() // 1_000_000)
    hear(listener, status(3, version="0.3.0"))
    clock.t_ns += 1_000_000_000
    second, found = asked(answers)
    assert [(row["life"], row["version"]) for row in found["rows"]] == [("online", "0.3.0")]
    clock.t_ns += 31_000_000_000
    third, found = asked(answers)
    assert [(row["life"], row["ne107"]) for row in found["rows"]] == [("silent", "")]
    assert len({first, second, third}) == 3


def test_it_is_made_once_a_second_and_keeps_its_digest_while_only_times_change() -> None:
    listener, clock, answers = alive()
    first, _ = asked(answers)
    hear(listener, status(3, version="0.3.0"))
    clock.t_ns += 999_000_000
    assert asked(answers)[0] == first
    hear(listener, status(4))
    clock.t_ns += 1_000_000
    assert asked(answers)[0] == first, "the version is that of before again"
    clock.ahead_ns -= 3600 * 1_000_000_000
    hear(listener, status(5, version="0.4.0"))
    assert asked(answers)[0] != first, "a clock that was set back keeps no answer"


def test_a_lost_link_is_known_at_once() -> None:
    listener, _, answers = alive()
    assert asked(answers)[1]["kept"] is False
    listener.keeper.connected = True
    assert asked(answers)[1]["kept"] is True
