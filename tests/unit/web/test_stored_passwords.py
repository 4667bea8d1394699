"""Where a password that the file has may be sent after a change."""

from typing import Any

import pytest

from gateway.web.profile.stored_passwords import faults

MQTT = {"url": "mqtts://broker:8883", "password_file": "/etc/pw", "proxy": "http://proxy:3128"}
INLINE = {"url": "mqtt://me:s3cret@broker"}


@pytest.mark.parametrize(
    ("after", "key"),
    [
        (MQTT, None),
        ({**MQTT, "url": "mqtts://you@broker:8883"}, None),  # the same place
        ({**MQTT, "url": "mqtts://evil:8883"}, "url"),
        ({**MQTT, "url": "mqtts://broker:8884"}, "url"),
        ({**MQTT, "url": "mqtt://broker:8883"}, "url"),  # readable on the way
        ({**MQTT, "url": "mqtts://broker:8883#@evil"}, "url"),
        ({**MQTT, "url": "mqtts://broker:8883@evil"}, "url"),
        ({**MQTT, "proxy": "http://evil:3128"}, "url"),
        ({**MQTT, "password_file": "/etc/shadow"}, "url"),
        ({"url": "mqtts://me@broker:8883", "password_env": "PW"}, "url"),
        ({**MQTT, "proxy_password_file": "/etc/pw"}, "proxy"),
        ({"urls": ["mqtts://broker:8883"], **{k: v for k, v in MQTT.items() if k != "url"}}, None),
        ({"urls": ["mqtts://broker:8883", "mqtts://evil"], "password_file": "/etc/pw"}, "urls"),
        ({"url": "mqtts://evil:8883"}, None),  # without the password
        ({"url": "mqtts://me:typed@evil:8883"}, None),
    ],
)
def test_a_named_password_goes_where_it_went(after: dict[str, Any], key: str | None) -> None:
    found = faults({"mqtt": MQTT}, {"mqtt": after}, "mqtts://me:typed@evil:8883")
    assert list(found) == ([] if key is None else [("mqtt", key)])


def test_it_can_be_paired_again_in_no_second_step_and_under_no_other_name() -> None:
    moved = {"url": "mqtts://evil:8883"}
    assert faults({"mqtt": MQTT}, {"mqtt": moved}, "") == {}
    assert list(faults({"mqtt": moved}, {"mqtt": {**moved, "password_file": "/etc/pw"}}, "")) == [("mqtt", "url")]
    sinks = {"sinks": {"postgresql": {"url": "postgresql://db/loading", "password_env": "PG"}}}
    assert faults(sinks, sinks, "") == {}
    other = {"sinks": {"postgresql": {"url": "postgresql://evil/loading", "password_env": "PG"}}}
    (found,) = faults(sinks, other, "").items()
    assert found == (
        ("sinks", "postgresql", "url"),
        "the password that password_env names would be sent to another address than before: type it into the address "
        "and remove password_env, or change the file on the machine",
    )


def test_a_password_in_an_address_goes_through_no_new_proxy_unless_it_is_typed() -> None:
    after = {"mqtt": {**INLINE, "proxy": "http://evil:3128"}}
    (why,) = faults({"mqtt": INLINE}, after, "http://evil:3128").values()
    assert why == "its password would be sent through another proxy than before: type the whole address anew"
    assert faults({"mqtt": INLINE}, after, "mqtt://me:s3cret@broker http://evil:3128") == {}
    assert faults({}, after, "") == {}


def test_a_cameras_password_for_every_bay_goes_where_one_of_them_has_sent_it() -> None:
    """It and the address may be in different tables."""
    shared = {"camera": {"password_file": "/etc/pw"}}
    before = {**shared, "bays": {"A": {"camera": {"url": "rtsp://cam/1"}}, "B": {"camera": {"url": "rtsp://cam/2"}}}}
    moved = {**shared, "bays": {"A": {"camera": {"url": "rtsp://cam/1"}}, "B": {"camera": {"url": "rtsp://evil/2"}}}}
    assert list(faults(before, moved, "rtsp://evil/2")) == [("bays", "B", "camera", "url")]
    renamed = {**shared, "bays": {"C": {"camera": {"url": "rtsp://cam/2"}}, "D": {}}}
    assert faults(before, renamed, "") == {}
    assert faults(before, {**shared, "bays": {"A": {"camera": "?"}, "B": 1}}, "?") == {}
