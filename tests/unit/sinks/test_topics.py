"""Topics and the broker's address: what is right comes out right, what is wrong is reported without the password."""

from urllib.parse import quote

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from gateway.config import MqttConfig
from gateway.errors import ConfigError
from gateway.sinks.mqtt.broker import Broker, parse
from gateway.sinks.mqtt.topics import Topics


def test_the_topics_of_a_gateway() -> None:
    topics = Topics("loading", "plant7", "north")
    assert topics.status == "loading/plant7/north/status"
    assert topics.state("bay2") == "loading/plant7/bay2/state"
    assert topics.event("bay2") == "loading/plant7/bay2/event"


def test_a_root_may_have_several_levels() -> None:
    assert Topics("acme/cement/loading", "s", "g").status == "acme/cement/loading/s/g/status"


@pytest.mark.parametrize(
    ("keys", "topic"),
    [
        ({}, "loading/s/bay1/state"),
        ({"area": "packing"}, "loading/s/packing/bay1/state"),
        ({"line": "line 2"}, "loading/s/line 2/bay1/state"),
        ({"area": "packing", "line": "line2"}, "loading/s/packing/line2/bay1/state"),
    ],
)
def test_area_and_line_stand_between_site_and_bay(keys: dict[str, str], topic: str) -> None:
    config = MqttConfig.model_validate({"url": "mqtt://b"} | keys)
    assert Topics.of_config(config, "s", "g").state("bay1") == topic


@pytest.mark.parametrize("level", ["", "a/b", "a+", "#", "$a", " a", "x" * 65])
def test_a_level_that_is_none_is_refused(level: str) -> None:
    with pytest.raises(ValidationError, match="area"):
        MqttConfig.model_validate({"url": "mqtt://b", "area": level})


def test_two_gateways_of_one_site_have_different_wills() -> None:
    assert Topics("loading", "s", "north").status != Topics("loading", "s", "south").status


def test_an_instance_with_the_name_of_a_bay_clashes_with_none_of_its_topics() -> None:
    topics = Topics("loading", "s", "bay1")
    assert len({topics.status, topics.state("bay1"), topics.event("bay1")}) == 3


@pytest.mark.parametrize(
    "root", ["", "/loading", "loading/", "a//b", "$SYS", "$share/x", "a/#", "a+b", "a\0b", "x" * 1001]
)
def test_a_root_that_no_client_could_subscribe_to_is_refused(root: str) -> None:
    with pytest.raises(ConfigError, match=r"mqtt\.root"):
        Topics(root, "site", "gateway")


@pytest.mark.parametrize(
    ("url", "broker"),
    [
        ("mqtt://broker", Broker("broker", 1883, False)),
        ("mqtts://broker", Broker("broker", 8883, True)),
        ("mqtt://broker:1884/", Broker("broker", 1884, False)),
        ("mqtt://Broker.Example", Broker("broker.example", 1883, False)),
        ("mqtt://mqtt_broker_1", Broker("mqtt_broker_1", 1883, False)),
        ("mqtt://[::1]:1885", Broker("::1", 1885, False)),
        ("mqtt://joe@broker", Broker("broker", 1883, False, "joe")),
        ("ws://broker", Broker("broker", 80, False, path="/mqtt")),
        ("wss://joe:p@broker:8443/a/b", Broker("broker", 8443, True, "joe", "p", "/a/b")),
        ("wss://broker/", Broker("broker", 443, True, path="/")),
        ("mqtts://joe:p%40ss%2Fw%3Ard@h:1", Broker("h", 1, True, "joe", "p@ss/w:rd")),
        ("mqtt://joe:@broker", Broker("broker", 1883, False, "joe", "")),
        ("mqtt://j%C3%B6:%E2%82%AC@broker", Broker("broker", 1883, False, "jö", "€")),
    ],
)
def test_a_url_is_read(url: str, broker: Broker) -> None:
    assert parse(url) == broker


@pytest.mark.parametrize(
    "url",
    [
        "",
        "broker",
        "http://broker",
        "mqtt://",
        "mqtt://:1883",
        "mqtt://joe@:1883",
        "mqtt://broker:0",
        "mqtt://broker:65536",
        "mqtt://broker:abc",
        "mqtt://broker/path",
        "ws://broker/path?x=1",
        "wss://joe:hunter2@",
        "mqtt://broker?x=1",
        "mqtt://broker#x",
        "mqtt://broker?",
        "mqtt://bro ker",
        "mqtt://broker\n",
        "mqtt://.broker",
        "mqtt://[::1",
        "mqtt://:hunter2@broker",
        "mqtt://joe:hunter2%ff@broker",
        "mqtt://joe:hunter2/x@broker",
        "mqtt://joe:hunter2#x@broker",
        "mqtt://joe:hunter2@bro\u2100ker",
        "mqtt://joe:hunter2\udcff@broker",
        "mqtt://j%00:hunter2@broker",
        "mqtt://joe:hunter2" + "x" * 65_535 + "@broker",
    ],
)
def test_a_wrong_url_is_a_config_error_that_keeps_the_password(url: str) -> None:
    with pytest.raises(ConfigError, match=r"^mqtt\.url: ") as caught:
        parse(url)
    assert "hunter2" not in str(caught.value)
    assert caught.value.__cause__ is None
    assert caught.value.__suppress_context__ or caught.value.__context__ is None


def test_the_password_is_in_no_text_of_the_address() -> None:
    broker = parse("mqtts://joe:hunter2@broker:99")
    assert str(broker) == "mqtts://broker:99"
    assert str(parse("wss://joe:hunter2@[::1]/x")) == "wss://[::1]:443/x"
    assert "hunter2" not in repr(broker)
    assert str(parse("mqtt://[fe80::1]")) == "mqtt://[fe80::1]:1883"


TEXT = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=40)


@given(user=TEXT.filter(bool), password=TEXT, port=st.integers(1, 65535))
def test_any_user_and_password_survive_quoting(user: str, password: str, port: int) -> None:
    broker = parse(f"mqtt://{quote(user, safe='')}:{quote(password, safe='')}@h:{port}")
    assert broker == Broker("h", port, False, user, password)


@given(st.text(max_size=60))
def test_any_text_is_an_address_or_a_config_error(rest: str) -> None:
    try:
        broker = parse("mqtt://" + rest)
    except ConfigError:
        return
    assert broker.host
    assert 1 <= broker.port <= 65535
