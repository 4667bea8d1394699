"""Which port URLs are refused before anything is opened, and with which text."""

import asyncio
from pathlib import Path

import pytest

from gateway.clock import SystemClock
from gateway.config import RangerConfig
from gateway.core.readings import RangeReading
from gateway.errors import ConfigError, LinkError
from gateway.ranger.port import Port, check_url
from gateway.ranger.ranger_service import RangerService


@pytest.mark.parametrize(
    "url",
    [
        "/dev/ttyACM0",
        "/dev/serial/by-id/usb-Arduino_Uno",
        "socket://192.168.1.5:3000",
        "SOCKET://[::1]:3000",
        "rfc2217://host:2217",
        "rfc2217://host:2217?ign_set_control&timeout=5",
        "loop://",
        "hwgrep://2341:0043",
    ],
)
def test_what_may_be_there_one_day_passes(url: str) -> None:
    check_url(url)


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("http://host:80", "http:// is not supported; use a device path, socket://host:port or rfc2217://host:port"),
        ("sockets://host:80", "sockets:// is not supported"),
        ("://", "is not supported"),
        ("alt:///dev/ttyACM0?class=Serial", "alt:// is not supported"),
        ("hwgrep://[", "unterminated character set"),
        ("hwgrep://2341:0043&n=first", "invalid literal"),
        ("socket://host", "needs a host and a port from 0 to 65535, socket://host:port"),
        ("socket://:3000", "needs a host and a port"),
        ("socket://host:99999", "needs a host and a port"),
        ("rfc2217://host:name", "needs a host and a port"),
        ("socket://[::1:3000", "needs a host and a port"),
        ("socket://host:3000?ign_set_control", "unknown option 'ign_set_control'; known: logging"),
        (
            "rfc2217://host:3000?speed=9600",
            "unknown option 'speed'; known: ign_set_control, logging,",
        ),
    ],
)
def test_what_can_never_be_opened_is_a_fault_of_the_file(url: str, expected: str) -> None:
    with pytest.raises(ConfigError) as caught:
        check_url(url)
    assert expected in str(caught.value)
    assert repr(url) in str(caught.value)


@pytest.mark.parametrize("scheme", ["spy", "SPY"])
def test_a_url_that_would_have_a_file_written_writes_none(tmp_path: Path, scheme: str) -> None:
    kept = tmp_path / "kept"
    kept.write_text("contents")
    with pytest.raises(ConfigError, match="spy:// is not supported"):
        check_url(f"{scheme}:///dev/ttyACM0?file={kept}")
    assert kept.read_text() == "contents"


def test_the_service_refuses_it_when_it_is_built() -> None:
    with pytest.raises(ConfigError, match="gopher:// is not supported"):
        RangerService(RangerConfig(port="gopher://host:1"), SystemClock(), lambda _: None)
    with pytest.raises(ConfigError, match="needs a host"):
        RangerService(RangerConfig(), SystemClock(), lambda _: None, port="socket://x")


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("/dev/not-there", "ranger port /dev/not-there: no such device"),
        ("/dev/null", "ranger port /dev/null: Could not configure port"),
        ("socket://127.0.0.1:1", "ranger port socket://127.0.0.1:1: [Errno 111] Connection refused"),
    ],
)
def test_a_port_that_cannot_be_opened_is_named(url: str, expected: str) -> None:
    with pytest.raises(LinkError) as caught:
        Port(url, 9600)
    assert str(caught.value).startswith(expected)
    assert "\n" not in str(caught.value)


def test_a_missing_port_is_reported_before_it_is_raised() -> None:
    readings: list[RangeReading] = []
    service = RangerService(RangerConfig(), SystemClock(), readings.append, port="/dev/not-there")
    with pytest.raises(LinkError, match="no such device"):
        asyncio.run(service.run())
    assert [(r.quality.name, r.detail) for r in readings] == [
        ("LINK_DOWN", "ranger port /dev/not-there: no such device")
    ]
