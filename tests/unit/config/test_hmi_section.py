"""`[hmi]`: what is refused, and with which text."""

import tomllib
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.config import HmiConfig, load, parse
from gateway.config.reference import flat
from gateway.config.sections.hmi import host_name
from gateway.errors import ConfigError

SALT = "c29tZXNhbHRzb21lc2FsdA"
DIGEST = "iWh06vD8Fy27wf9npn6FXWiCX4K6pW6Ue1Bnzz07Z8A"
HASH = f"$argon2id$v=19$m=19456,t=2,p=1${SALT}${DIGEST}"
USER = f"[[hmi.users]]\nname = 'anna'\npassword_hash = '{HASH}'\n"


def hmi(text: str) -> HmiConfig:
    return parse(tomllib.loads(text), source="g.toml", text=text).hmi


def refusal(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        hmi(text)
    return str(caught.value)


def test_off_and_on_loopback_by_default() -> None:
    config = hmi("")
    assert (config.enabled, config.host, config.port) == (False, "127.0.0.1", 8080)
    assert config.without_login == "driver"
    assert config.users == ()
    assert config.loopback
    assert not config.tls
    assert config.hosts == {"127.0.0.1", "::1", "localhost"}
    assert config.warnings() == []


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "[hmi]\nwithout_login = 'technician'\nhost = '10.0.0.5'\n",
            'g.toml:2: hmi.without_login = "technician": "technician" opens tuning to anybody who reaches 10.0.0.5;',
        ),
        (
            "[hmi]\nwithout_login = 'technician'\nhost = 'plant-pc'\n",
            "anybody who reaches plant-pc; it is allowed for loopback only",
        ),
        ("[hmi]\nwithout_login = 'none'\n", 'g.toml:2: hmi.without_login = "none": "none" needs [[hmi.users]]'),
        ("[hmi]\nwithout_login = 'all'\n", "g.toml:2: hmi.without_login"),
        ("[hmi]\ntls_cert = 'a.pem'\n", 'g.toml:2: hmi.tls_cert = "a.pem": needs tls_key, too'),
        ("[hmi]\ntls_key = 'a.key'\n", 'g.toml:2: hmi.tls_key = "a.key": needs tls_cert, too'),
        ("[hmi]\nhost = '0.0.0.0'\n", "hmi.allowed_hosts: must name the host in the pages' URL"),
        ("[hmi]\nhost = '[::]'\n", "hmi.allowed_hosts: must name the host in the pages' URL"),
        ("[hmi]\nhost = 'http://pc'\n", 'g.toml:2: hmi.host = "http://pc": should be one name or address'),
        ("[hmi]\nallowed_hosts = ['*']\n", 'g.toml:2: hmi.allowed_hosts.0 = "*": should be one name or address'),
        ("[hmi]\nallowed_hosts = ['pc:80']\n", "should be one name or address"),
        ("[hmi]\nport = 65536\n", "g.toml:2: hmi.port = 65536: "),
        ("[hmi]\nsession_hours = 0.05\n", "(allowed: >= 0.1, <= 168)"),
        (USER + USER.replace("anna", "Anna"), 'g.toml:5: hmi.users.1.name = "Anna": an earlier user has the name Anna'),
        (
            USER.replace("anna", "an na"),
            'g.toml:2: hmi.users.0.name = "an na": should be letters from A to Z, digits, dots',
        ),
        (USER + "role = 'admin'\n", 'g.toml:4: hmi.users.0.role = "admin": '),
        (USER.replace(HASH, "secret"), "g.toml:3: hmi.users.0.password_hash = ***: should be what `gateway password`"),
        (USER.replace("argon2id", "argon2i"), "should be what `gateway password`"),
        (USER.replace("m=19456", "m=19455"), "needs m=19455 KiB of memory; 19456 to 262144 are taken"),
        (USER.replace("m=19456", "m=262145"), "needs m=262145 KiB"),
        (USER.replace("t=2", "t=17"), "t=17, p=1; t up to 16 and p up to 16 are taken"),
        (USER.replace("p=1", "p=17"), "t=2, p=17; "),
        (USER.replace("t=2", "t=0"), "should be what `gateway password`"),
    ],
)
def test_refused(text: str, expected: str) -> None:
    found = refusal(text)
    assert expected in found
    assert "\n" not in found


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.8.8", "::1", "[::1]", "localhost", "LocalHost"])
def test_technicians_without_login_on_loopback_only(host: str) -> None:
    config = hmi(f"[hmi]\nhost = '{host}'\nwithout_login = 'technician'\n")
    assert config.loopback
    assert {"localhost", "127.0.0.1", "::1"} <= config.hosts


def test_the_hosts_that_are_answered() -> None:
    assert hmi("[hmi]\nhost = '10.0.0.5'\n").hosts == {"10.0.0.5"}
    assert hmi("[hmi]\nhost = 'Bay-PC.plant'\n").hosts == {"bay-pc.plant"}
    named = hmi("[hmi]\nhost = '0.0.0.0'\nallowed_hosts = ['Bay-PC', '10.0.0.5', '[2001:DB8::1]']\n")
    assert named.hosts == {"bay-pc", "10.0.0.5", "2001:db8::1"}
    assert not named.loopback


@pytest.mark.parametrize(
    ("text", "warned"),
    [
        ("[hmi]\nenabled = true\nhost = '10.0.0.5'\n" + USER, True),
        ("[hmi]\nenabled = true\nhost = '10.0.0.5'\n", False),  # no password is typed
        ("[hmi]\nenabled = true\n" + USER, False),
        ("[hmi]\nenabled = true\nhost = '10.0.0.5'\ntls_cert = 'a'\ntls_key = 'b'\n" + USER, False),
        ("[hmi]\nhost = '10.0.0.5'\n" + USER, False),
    ],
)
def test_users_without_tls_are_worth_a_warning(text: str, warned: bool) -> None:
    warnings = hmi(text).warnings()
    assert len(warnings) == warned
    assert all(line.startswith("hmi.tls_cert: is missing, and host = 10.0.0.5 is no loopback") for line in warnings)


def test_no_hash_is_shown() -> None:
    text = USER + "role = 'technician'\n"
    config = parse({"hmi": {"users": [{"name": "anna", "password_hash": HASH}]}})
    assert config.hmi.users[0].password_hash == HASH
    assert DIGEST not in repr(config)
    shown = dict(flat(config))
    assert shown["hmi.users[0].password_hash"] == '"***"'
    assert shown["hmi.users[0].name"] == '"anna"'
    assert DIGEST not in refusal(text.replace("technician", "admin"))


def test_the_shipped_play_bay() -> None:
    config = load(Path(__file__).parents[3] / "config" / "simulate.toml").hmi
    assert (config.enabled, config.host, config.without_login) == (True, "127.0.0.1", "technician")


@given(st.text(max_size=300))
def test_a_host_name_is_refused_or_plain(text: str) -> None:
    with suppress(ValueError):
        found = host_name(text)
        assert found == found.lower() == host_name(found)
        assert not set(found) & set("/@*,;[] \t\r\n\\")
