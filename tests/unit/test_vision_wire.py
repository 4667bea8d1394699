"""What the processes of a bay say to each other comes out as it went in."""

import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.children.words import Failed
from gateway.model import Circle, Detection, Ellipse, Rejection, Tracking
from gateway.vision import wire
from gateway.vision.jobs import Captured, FrameRef, GiveBack, Handed, Look, Looked, Opened, Ready, Straight

INT = st.integers(-(2**63), 2**63 - 1)
NUMBER = st.floats(allow_nan=False)
FRAMES = st.builds(FrameRef, st.integers(0, 2**31 - 1), INT, INT, INT)
CIRCLES = st.builds(Circle, NUMBER, NUMBER, NUMBER)
MAYBE = st.none() | NUMBER
STAGE = st.tuples(st.text(st.characters(codec="ascii", exclude_characters="\n"), min_size=1), INT)
DETECTIONS = st.builds(
    Detection,
    circle=st.none() | CIRCLES,
    area_px2=NUMBER,
    circularity=NUMBER,
    fill=NUMBER,
    candidates=INT,
    x_n=MAYBE,
    y_n=MAYBE,
    stage_ns=st.lists(STAGE, max_size=12).map(tuple),
    ellipse=st.none() | st.builds(Ellipse, NUMBER, NUMBER, NUMBER, NUMBER, NUMBER),
    confidence=MAYBE,
    visible=MAYBE,
    tracking=st.sampled_from(Tracking),
    predicted=st.none() | CIRCLES,
)
MESSAGES = st.one_of(
    st.builds(Look, FRAMES),
    st.builds(GiveBack, INT),
    st.builds(Straight, INT),
    st.builds(Captured, FRAMES, INT),
    st.builds(Handed, FRAMES, INT, INT, INT),
    st.builds(Looked, INT, st.none() | DETECTIONS),
    st.builds(Opened, st.booleans()),
    st.builds(Failed, st.text(), st.booleans()),
    st.just(Ready()),
)


@given(MESSAGES)
def test_every_message_comes_out_as_it_went_in(message: object) -> None:
    assert wire.unpacked(wire.packed(message)) == message


@given(st.builds(Looked, INT, DETECTIONS))
def test_a_result_is_a_small_record_not_a_pickle(message: Looked) -> None:
    assert wire.packed(message)[0] == wire.Tag.LOOKED


def test_candidates_not_taken_stay_where_they_were_found() -> None:
    rejected = (Rejection(Circle(1.0, 2.0, 3.0), "dull"),)
    found = Detection(Circle(5.0, 6.0, 7.0), rejected=rejected)

    assert wire.unpacked(wire.packed(Looked(4, found))) == Looked(4, Detection(Circle(5.0, 6.0, 7.0)))


@pytest.mark.parametrize("tag", wire.Tag)
def test_no_tag_looks_like_a_pickle(tag: wire.Tag) -> None:
    assert tag < pickle.dumps(None, pickle.HIGHEST_PROTOCOL)[0]
    assert list(wire.Tag).count(tag) == 1
