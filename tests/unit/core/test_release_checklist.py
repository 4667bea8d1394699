"""What a bay's checklist takes as tried, and what it does not."""

from dataclasses import replace

import pytest

from gateway.core.detection import Circle
from gateway.core.readings import Quality, RangeReading, RangerVote, VisionReading
from gateway.core.release_checklist import Checklist, HeartbeatLoss, Outage, Polled, confirmable, done, resumed, step
from gateway.core.state import FunctionCheck, Reason, StateVector

BEGUN = Checklist(1000.0, "anna")
PLC = Polled("10.20.0.10", 1001.0, 10.0)
GOOD, DOWN = Quality.GOOD, Quality.LINK_DOWN


def state(
    vision: Quality = GOOD,
    distance: Quality = GOOD,
    *,
    stop: bool = False,
    check: FunctionCheck = FunctionCheck.MAY_MOVE_OFF,
    reason: Reason = Reason.NONE,
) -> StateVector:
    seen = VisionReading(0, vision, Circle(320, 240, 100) if vision is GOOD else None)
    measured = RangeReading(0, distance, 900.0 if distance is GOOD else None)
    return StateVector("bay1", vision=seen, range=measured, stop=stop, function_check=check, reason=reason)


def run(*states: StateVector, polled: Polled | None = None, seconds: float = 1.0) -> Checklist:
    """One state every `seconds`."""
    now = BEGUN
    for n, one in enumerate(states):
        now = step(now, one, polled, 1000.0 + seconds * n)
    return now


def test_a_camera_that_is_unplugged_and_comes_back_was_tried() -> None:
    found = run(state(), state(DOWN, stop=True), state(DOWN, stop=True), state(stop=True))
    assert found.camera_out == Outage("link_down", 1001.0, 1003.0)
    assert (found.marker_unix_s, found.ranger_out) == (1000.0, None)
    again = step(step(found, state(DOWN, stop=True), None, 1010.0), state(), None, 1020.0)
    assert again.camera_out == found.camera_out


@pytest.mark.parametrize("quality", [DOWN, Quality.STALE, Quality.STUCK])
def test_so_was_the_ranger(quality: Quality) -> None:
    found = run(state(), state(distance=quality, stop=True), state(stop=True))
    assert (found.ranger_out, found.camera_out) == (Outage(quality.name.lower(), 1001.0, 1002.0), None)


def test_a_port_that_the_gateway_itself_gave_away_was_not_tried() -> None:
    """For the board's firmware: nobody has drawn a cable."""
    now = step(BEGUN, state(), None, 1000.0)
    for n, one in enumerate([state(), state(distance=DOWN, stop=True), state(distance=DOWN, stop=True)], 1):
        now = step(now, one, None, 1000.0 + n, ports_released=[0])
    for n, one in enumerate([state(distance=DOWN, stop=True), state(distance=DOWN, stop=True), state(stop=True)], 4):
        now = step(now, one, None, 1000.0 + n)
    assert now.ranger_out is None
    tried = run(state(), state(distance=DOWN, stop=True), state(stop=True))
    assert step(tried, state(distance=DOWN), None, 1010.0, ports_released=[0]).ranger_out == tried.ranger_out


def several(*qualities: Quality, stop: bool | None = None) -> StateVector:
    """Two must agree; those that are good do."""
    agree = qualities.count(GOOD) >= 2
    votes = tuple(RangerVote(one, 900.0 if one is GOOD else None, one is GOOD and agree) for one in qualities)
    found = state(distance=GOOD if agree else DOWN, stop=not agree if stop is None else stop)
    return replace(found, range=replace(found.range, rangers=votes))


@pytest.mark.parametrize("of", [2, 3])
def test_of_several_rangers_each_must_be_tried(of: int) -> None:
    """One of three may be out without a stop: the two others measure."""
    good, now, unix_s = several(*[GOOD] * of), BEGUN, 1000.0
    for n in range(of):
        out = several(*(DOWN if m == n else GOOD for m in range(of)))
        assert out.stop == (of == 2)
        assert not done(now, out, None)["ranger"]
        for one in (good, out, out, good):
            assert not done(now, good, None)["ranger_out"], f"{n} of {of} tried"
            now, unix_s = step(now, one, None, unix_s), unix_s + 1
    assert done(now, good, None)["ranger_out"]
    assert done(now, good, None)["ranger"]
    assert len(now.more_rangers_out) == of - 1
    assert not done(resumed(step(BEGUN, good, None, 0.0)), good, None)["ranger_out"]


def test_what_was_tried_of_several_rangers_outlasts_a_moment_in_which_nothing_is_known_of_them() -> None:
    good, now = several(GOOD, GOOD), BEGUN
    for n, one in enumerate([good, several(GOOD, DOWN), several(GOOD, DOWN), good, state(distance=Quality.STALE)]):
        now = step(now, replace(one, stop=one is not good), None, 1000.0 + n)
    tried = (Outage("link_down", 1001.0, 1003.0),)
    assert (now.ranger_out, now.more_rangers_out) == (None, tried)
    assert not done(now, state(), None)["ranger_out"]
    now = step(step(now, good, None, 1010.0), good, None, 1012.0)
    assert (now.ranger_out, now.more_rangers_out) == (None, tried), "nobody has unplugged the first one"


def test_of_several_rangers_only_the_port_that_was_given_away_is_not_tried() -> None:
    now = step(BEGUN, several(GOOD, GOOD), None, 1000.0)
    for n in (1, 2):
        now = step(now, several(DOWN, DOWN), None, 1000.0 + n, ports_released=[1])
    now = step(now, several(GOOD, GOOD), None, 1003.0)
    assert (now.ranger_out, now.more_rangers_out) == (Outage("link_down", 1001.0, 1003.0), (None,))


OFF = FunctionCheck.OFF
NOT_TRIED = {
    "it was not good before": [state(DOWN, stop=True), state(DOWN, stop=True), state()],
    "it was good before the function check": [state(check=OFF), state(DOWN, stop=True), state()],
    "stop was off": [state(), state(DOWN), state(DOWN), state()],
    "stop went off meanwhile": [state(), state(DOWN, stop=True), state(DOWN), state()],
    "the function check ended meanwhile": [state(), state(DOWN, stop=True), state(DOWN, stop=True, check=OFF), state()],
    "its process was replaced": [state(), state(Quality.PROCESS_FAULT, stop=True), state(stop=True)],
    "new settings begin without a frame": [state(), state(Quality.STALE, stop=True), state(stop=True)],
    "it sees no marker since": [state(), state(DOWN, stop=True), state(Quality.NO_TARGET, stop=True)],
}


@pytest.mark.parametrize("states", NOT_TRIED.values(), ids=NOT_TRIED)
def test_not_tried(states: list[StateVector]) -> None:
    found = run(*states)
    assert not done(found, states[-1], None)["camera_out"]


def test_a_loss_of_half_a_second_is_no_unplugged_camera() -> None:
    assert run(state(), state(DOWN, stop=True), state(stop=True), seconds=0.5).camera_out is None


def test_what_had_not_ended_before_a_restart_is_seen_again() -> None:
    found = run(state(), state(DOWN, Quality.LINK_DOWN, stop=True), state(DOWN, stop=True))
    assert found.camera_out == Outage("link_down", 1001.0)
    after = resumed(found)
    assert (after.camera_out, after.ranger_out, after.good) == (None, Outage("link_down", 1001.0, 1002.0), ())
    assert step(after, state(), None, 1100.0).camera_out is None


def test_the_heartbeat_was_lost_once_the_same_plc_polls_again() -> None:
    ending = state(reason=Reason.SHUTDOWN, stop=True)
    ended = run(state(), ending, ending, polled=PLC)
    assert ended.heartbeat == HeartbeatLoss("10.20.0.10", 1001.0)
    assert list(confirmable(ended)) == ["thresholds"]
    after = resumed(ended)
    assert step(after, state(), None, 1010.0).heartbeat == ended.heartbeat
    assert step(after, state(), Polled("10.20.0.99", 1011.0, 10.0), 1011.0).heartbeat == ended.heartbeat
    back = step(after, state(), replace(PLC, unix_s=1012.5), 1012.6)
    assert back.heartbeat == HeartbeatLoss("10.20.0.10", 1001.0, 1012.5)
    assert list(confirmable(back)) == ["heartbeat", "thresholds"]
    assert not done(back, state(), PLC)["heartbeat"]
    assert done(replace(back, confirmed=("heartbeat",)), state(), PLC)["heartbeat"]
    assert run(state(), ending).heartbeat is None, "no PLC polled"


def test_what_holds_now_is_judged_now() -> None:
    all_good = done(BEGUN, state(), PLC)
    assert [item for item, so in all_good.items() if so] == ["function_check", "camera", "ranger", "plc"]
    blind = done(BEGUN, state(DOWN, Quality.NO_ECHO, stop=True, check=OFF), None)
    assert not any(blind.values())
    dead = done(BEGUN, state(reason=Reason.GATEWAY_FAULT, stop=True), PLC)
    assert (dead["camera"], dead["ranger"]) == (False, False)
