"""The judge of the proof programs finds what it is for: each rule is broken once, on purpose."""

from collections.abc import Callable

import pytest

from bench.plant import judge as judging
from bench.plant.judge import Judge
from bench.plant.poller import ANSWERED, LOST, Poll
from gateway.config import parse
from gateway.sim.scenario import parse as parse_scenario
from gateway.sim.world import Truth

START_NS = 10_000_000_000
POLL_S = 0.05
Show = Callable[[Truth], dict[int, int]]
# A truck that drives in from 80 cm, stands at 27 cm for 6 s and leaves: D = 1 from 2.55 s to about 9 s.
SCENARIO = {
    "start": {"distance_cm": 80},
    "vibration": {"amplitude_mm": 0},
    "legs": [
        {"name": "drive in", "distance_cm": 27, "speed_cm_s": 25, "hold_s": 6},
        {"name": "leave", "distance_cm": 80, "speed_cm_s": 40, "hold_s": 20},
    ],
}
IN_PLACE_S = (4.5, 8.7)


def image(beat: int, **words: int) -> tuple[int, ...]:
    """Stop, both sensors good, alive."""
    shown = [0] * 100
    shown[judging.VERSION], shown[judging.HEARTBEAT], shown[judging.STOP] = 3, beat, 1
    shown[judging.GUIDANCE] = 6
    for name, value in words.items():
        shown[getattr(judging, name)] = value
    return tuple(shown)


def right(truth: Truth) -> dict[str, int]:
    """What a good gateway shows at this moment."""
    begins_s, ends_s = IN_PLACE_S
    if begins_s < truth.t_s < ends_s:
        return {"D": 1, "IN_PLACE": 1, "GUIDANCE": 7}
    if ends_s <= truth.t_s < ends_s + 1.5:  # released
        return {"D": int(truth.stop), "STOP": 0, "MAY_MOVE": 1, "POSITION": 1 << judging.RELEASED_BIT, "GUIDANCE": 10}
    if truth.stop:
        return {"D": 1}
    return {"D": 0, "STOP": 0, "MAY_MOVE": 1, "GUIDANCE": 10 if truth.t_s > ends_s else 1}


def judged(show: Callable[[Truth], dict[str, int] | None], *, until_s: float = 12.0) -> Judge:
    """`show`: what the gateway shows at each poll; None: the poll is lost, and its heartbeat stands still."""
    judge = Judge(parse_scenario(SCENARIO), parse({}))
    judge.gateway_started(START_NS)
    beat = 0
    for number in range(1, round(until_s / POLL_S)):
        at_ns = START_NS + round(number * POLL_S * 1e9)
        shown = show(judge.world.truth((at_ns - START_NS) / 1e9))
        if shown is None:
            judge.poll(Poll(0, at_ns - 1_000_000, at_ns, LOST, ()))
            continue
        beat = shown.pop("HEARTBEAT", beat + 3)
        judge.poll(Poll(0, at_ns - 1_000_000, at_ns, ANSWERED, image(beat, **shown)))
    judge.finish()
    return judge


def changed(when: Callable[[Truth], bool], **words: int) -> Callable[[Truth], dict[str, int]]:
    return lambda truth: right(truth) | (words if when(truth) else {})


def test_a_gateway_that_does_everything_right_is_not_blamed() -> None:
    judge = judged(right)
    assert judge.findings == []
    assert judge.figures.visits_in_place == 1
    assert judge.figures.crossings == 1
    assert judge.figures.late_s == {"none": [0.0]}  # before D = 1 is sure, as the sensors are off by some mm


@pytest.mark.parametrize(
    ("rule", "show"),
    [
        ("stop and may_move", changed(lambda t: t.stop, MAY_MOVE=1)),
        ("in_place without stop", changed(lambda t: 5 < t.t_s < 6, STOP=0)),
        ("in_place and may_move", changed(lambda t: 5 < t.t_s < 6, MAY_MOVE=1)),
        ("torn", changed(lambda t: t.t_s > 6, SEQ_END=2)),
        ("range", changed(lambda t: t.t_s > 6, STOP=2)),
        ("may_move by one sensor", changed(lambda t: t.t_s < 1, RANGE_QUALITY=2)),
        ("in_place not settled", changed(lambda t: 4.3 < t.t_s < 4.5, RANGE_QUALITY=2)),
        # D = 1 by the truth, and the truck may move all the same.
        ("visit", changed(lambda t: 2 < t.t_s < 4, STOP=0, MAY_MOVE=1, D=0, GUIDANCE=1)),
        # In place half a metre before the mark, and in place that does not end with the truck's leaving.
        ("visit", changed(lambda t: 1.2 < t.t_s < 1.5, IN_PLACE=1, STOP=1, MAY_MOVE=0, GUIDANCE=7)),
        ("visit", changed(lambda t: t.t_s > 5, IN_PLACE=1, STOP=1, MAY_MOVE=0, D=1, GUIDANCE=7)),
    ],
)
def test_each_rule_that_is_broken_is_found(rule: str, show: Callable[[Truth], dict[str, int]]) -> None:
    assert rule in {finding.rule for finding in judged(show).findings}


def test_outputs_stay_on_for_half_a_second_after_the_heartbeat_and_no_longer() -> None:
    """The gateway freezes at 2.2 s with MayMove on; D = 1 is reached at 2.5 s. The PLC switches off by itself."""
    judge = judged(lambda truth: right(truth) if truth.t_s < 2.2 else None, until_s=5)
    assert judge.findings == []
    (late_s,) = judge.figures.late_s["none"]
    assert late_s < judging.LATE_S
    assert not judge.recent[-1].may_move
    assert not judge.healthy()


def test_a_frozen_image_with_a_heartbeat_that_goes_on_is_found() -> None:
    """What a PLC could not notice by itself."""
    frozen = {"D": 0, "STOP": 0, "MAY_MOVE": 1, "GUIDANCE": 1}
    judge = judged(lambda truth: right(truth) if truth.t_s < 2.2 else dict(frozen), until_s=5)
    assert any("no stop, though the truck stands" in finding.text for finding in judge.findings)
