import json

import msgspec
import pytest
from pydantic import TypeAdapter

from gateway.explained import ExplainedInt, ExplainedStr


class Lamp(ExplainedInt):
    OFF = 0, "dark"
    ON = 5, "lit"


class Way(ExplainedStr):
    LEFT = "left", "to the left"


def test_a_member_is_its_value_and_says_what_it_means() -> None:
    assert (Lamp.ON.value, int(Lamp.ON), Lamp(5), Lamp.ON.meaning) == (5, 5, Lamp.ON, "lit")
    assert (Way.LEFT.value, str(Way.LEFT), Way("left"), Way.LEFT.meaning) == ("left", "left", Way.LEFT, "to the left")
    assert Lamp.meanings() == {Lamp.OFF: "dark", Lamp.ON: "lit"}
    assert Way.meanings() == {Way.LEFT: "to the left"}


def test_messages_and_models_hold_the_value_only() -> None:
    assert json.dumps([Lamp.ON, Way.LEFT]) == '[5, "left"]'
    assert msgspec.json.encode([Lamp.ON, Way.LEFT]) == b'[5,"left"]'
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(5), type=Lamp) is Lamp.ON
    assert TypeAdapter(Way).validate_python("left") is Way.LEFT
    assert TypeAdapter(Lamp).json_schema()["enum"] == [0, 5]


def test_a_member_without_its_meaning_is_refused() -> None:
    with pytest.raises(TypeError, match="meaning"):

        class Bare(ExplainedInt):
            OFF = 0
