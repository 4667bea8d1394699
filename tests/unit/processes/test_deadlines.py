"""How long a start may take, and a silence: with plain numbers."""

import pytest

from gateway.processes.deadlines import SignsOfLife, StartDeadline


class Watched:
    """A process that is looked at each second; `now_s` is the time."""

    def __init__(self) -> None:
        self.life = SignsOfLife(StartDeadline(30.0), 15.0)
        self.now_s = 1000.0
        self.life.begin(self.now_s)

    def start(self) -> None:
        self.life.begin(self.now_s)

    def look(self, *, heard: bool = False, after_s: float = 1.0, expected: bool = True) -> str:
        self.now_s += after_s
        return self.life.missing(self.now_s, heard=heard, expected=expected)

    def silent_until_ended(self) -> tuple[int, str]:
        """How many seconds it may be silent, and why it is ended then."""
        for seconds in range(1, 1000):
            if why := self.look():
                return seconds, why
        raise AssertionError("it is never ended")


def test_a_start_has_a_deadline_of_its_own_that_doubles_up_to_some_minutes() -> None:
    it = Watched()
    allowed = []
    for _ in range(6):
        it.start()
        allowed.append(it.silent_until_ended())
    assert allowed == [(s, f"was not ready within {s} s") for s in (30, 60, 120, 240, 240, 240)]


def test_a_first_deadline_beyond_the_bound_stays() -> None:
    deadline = StartDeadline(600.0)
    deadline.missed()
    assert deadline.seconds == 600.0


def test_a_process_that_has_given_a_sign_may_be_silent_for_another_time() -> None:
    it = Watched()
    for _ in range(29):
        assert it.look() == ""
    assert it.look(heard=True) == ""
    assert it.silent_until_ended() == (15, "has sent nothing for 15 s")


@pytest.mark.parametrize(("ran_s", "next_s"), [(60, 60), (61, 30)])
def test_only_a_run_that_was_longer_than_a_start_brings_the_first_deadline_back(ran_s: int, next_s: int) -> None:
    it = Watched()
    it.silent_until_ended()
    it.start()
    for _ in range(ran_s + 1):  # the first of these is the first sign
        it.look(heard=True)
    it.silent_until_ended()
    it.start()
    assert it.silent_until_ended()[0] == next_s


def test_who_has_not_looked_for_long_has_not_heard_that_nothing_was_said() -> None:
    it = Watched()
    it.look(heard=True)
    for _ in range(14):
        assert it.look(after_s=100.0) == ""
    assert it.look(after_s=100.0) == "has sent nothing for 15 s"


@pytest.mark.parametrize("started", [False, True])
def test_a_process_that_has_nothing_to_answer_is_not_silent(started: bool) -> None:
    it = Watched()
    it.look(heard=started)
    for _ in range(500):
        assert it.look(expected=False) == ""
    assert it.silent_until_ended()[0] == (15 if started else 30)
