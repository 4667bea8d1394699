"""Secrets are read from where the configuration names, and are never quoted in an error."""

import os
import threading
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from gateway.config import MqttConfig, MqttTls
from gateway.errors import SettingError
from gateway.sinks.mqtt.broker import Broker, Proxy, brokers_of, certificates_of

SECRET = "p@ss/wörd"


def config(**values: Any) -> MqttConfig:
    return MqttConfig(**{"url": "mqtt://broker", "username": "gw", **values})


def broker_of(config: MqttConfig) -> Broker:
    (broker,) = brokers_of(config)
    return broker


@pytest.mark.parametrize("end", ["", "\n", "\r\n"])
def test_a_password_from_a_file(tmp_path: Path, end: str) -> None:
    path = tmp_path / "secret"
    path.write_bytes((SECRET + end).encode())
    broker = broker_of(config(password_file=str(path)))
    assert (broker.username, broker.password) == ("gw", SECRET)
    assert SECRET not in repr(broker) + str(broker)


def test_a_password_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PLANT_SECRET", SECRET)
    assert broker_of(config(password_env="PLANT_SECRET")).password == SECRET
    monkeypatch.delenv("PLANT_SECRET")
    with pytest.raises(SettingError, match=r'mqtt\.password_env = "PLANT_SECRET": no such variable'):
        broker_of(config(password_env="PLANT_SECRET"))


def test_without_any_there_is_none() -> None:
    assert broker_of(config()).password is None
    assert broker_of(config(url="mqtt://u:p@broker", username=None)).password == "p"


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (b"", "one line of 1 to 65535"),
        (b"\n", "one line"),
        (b"two\nlines", "one line"),
        (b"x" * 65_536, "one line"),
        (b"\xff\xfe", "not UTF-8"),
        (None, "No such file"),
    ],
)
def test_a_bad_password_file_is_named_and_not_quoted(tmp_path: Path, data: bytes | None, fault: str) -> None:
    path = tmp_path / "secret"
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(SettingError, match=fault) as caught:
        broker_of(config(password_file=str(path)))
    assert caught.value.place == ("mqtt", "password_file")
    assert "two" not in caught.value.fault
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("values", "key"),
    [
        ({"url": "mqtt://other@broker"}, "mqtt.username"),
        ({"url": "mqtt://u:hunter2@broker", "username": None, "password_env": "HOME"}, "mqtt.url"),
        ({"username": None, "password_env": "HOME"}, "mqtt.username"),
    ],
)
def test_a_secret_has_one_source(values: dict[str, Any], key: str) -> None:
    with pytest.raises(SettingError) as caught:
        broker_of(config(**values))
    assert ".".join(map(str, caught.value.place)) == key
    assert "hunter2" not in str(caught.value)


def test_user_and_password_hold_for_every_broker(tmp_path: Path) -> None:
    path = tmp_path / "secret"
    path.write_text(SECRET)
    found = brokers_of(config(url=None, urls=("mqtt://b1", "mqtt://b2:99"), password_file=str(path)))
    assert found == (Broker("b1", 1883, False, "gw", SECRET), Broker("b2", 99, False, "gw", SECRET))


@pytest.mark.parametrize(
    ("urls", "place", "fault"),
    [
        (("mqtt://b1", "mqtt://joe:hunter2@"), ("mqtt", "urls", 1), "names no host"),
        (("mqtt://b1", "mqtts://b2"), ("mqtt", "urls", 1), "all must be alike"),
        (("mqtt://b1", "mqtt://b2", "mqtt://b1:1883"), ("mqtt", "urls", 2), "mqtt://b1:1883 is in the list twice"),
        (("mqtt://b1", "mqtt://joe@b2"), ("mqtt", "username"), "mqtt.urls.1 names a user, too"),
    ],
)
def test_a_list_of_brokers_is_checked(urls: tuple[str, ...], place: tuple[str | int, ...], fault: str) -> None:
    with pytest.raises(SettingError, match=fault) as caught:
        brokers_of(config(url=None, urls=urls))
    assert caught.value.place == place
    assert "hunter2" not in str(caught.value)


def test_a_proxy_has_a_user_and_a_password_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "secret"
    path.write_text(SECRET)
    broker = broker_of(config(proxy="http://proxy", proxy_username="pat", proxy_password_file=str(path)))
    assert broker.proxy == Proxy("proxy", 3128, "pat", SECRET)
    assert broker.reached_at == ("proxy", 3128)
    assert str(broker) == "mqtt://broker:1883 through http://proxy:3128"
    assert SECRET not in repr(broker)
    assert broker.password is None


@pytest.mark.parametrize(
    ("values", "place", "fault"),
    [
        ({"proxy": "http://joe:hunter2@proxy"}, "mqtt.proxy", "names a user; that and the password are proxy_username"),
        ({"proxy": "http://proxy:0"}, "mqtt.proxy", "port 0 cannot be connected to; expected http://host:port"),
        ({"proxy": "http://proxy/x"}, "mqtt.proxy", "nothing may follow the port"),
        ({"proxy_username": "pat"}, "mqtt.proxy", "is missing beside a user"),
        ({"proxy": "http://proxy", "proxy_password_env": "HOME"}, "mqtt.proxy_username", "is missing"),
        ({"proxy": "http://p", "proxy_password_file": "/no"}, "mqtt.proxy_password_file", "No such file"),
        ({"proxy": "http://p", "proxy_password_env": "NO_SUCH"}, "mqtt.proxy_password_env", "no such variable"),
    ],
)
def test_a_wrong_proxy_is_named(values: dict[str, Any], place: str, fault: str) -> None:
    with pytest.raises(SettingError, match=fault) as caught:
        brokers_of(config(**values))
    assert ".".join(map(str, caught.value.place)) == place
    assert "hunter2" not in str(caught.value)


def test_certificates_need_an_encrypted_url_and_each_other() -> None:
    plain = config(tls=MqttTls(ca_file="x"))
    with pytest.raises(SettingError, match="mqtts://"):
        certificates_of(plain, brokers_of(plain))
    assert certificates_of(config(), brokers_of(config())) is None
    with pytest.raises(ValidationError, match="key_file"):
        MqttTls(cert_file="x")
    with pytest.raises(ValidationError, match="keep one of them"):
        config(password_file="x", password_env="Y")


@pytest.mark.parametrize("key", ["ca_file", "cert_file"])
@pytest.mark.parametrize("damage", [None, b"", b"no certificate"])
def test_a_bad_certificate_file_is_named(tmp_path: Path, key: str, damage: bytes | None) -> None:
    path = tmp_path / "pem"
    if damage is not None:
        path.write_bytes(damage)
    tls = MqttTls(ca_file=str(path)) if key == "ca_file" else MqttTls(cert_file=str(path), key_file=str(path))
    bad = config(url="mqtts://broker", tls=tls)
    with pytest.raises(SettingError) as caught:
        certificates_of(bad, brokers_of(bad))
    assert caught.value.place == ("mqtt", "tls", key)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("key", ["password_file", "tls.key_password_file"])
def test_a_pipe_is_no_place_for_a_secret(tmp_path: Path, key: str) -> None:
    """It would be waited for without end, and again by the next reader: the operator would not know why."""
    pipe = tmp_path / "secret"
    os.mkfifo(pipe)
    tls = MqttTls(cert_file="c.pem", key_file="c.key", key_password_file=str(pipe))
    configured = config(password_file=str(pipe)) if key == "password_file" else config(url="mqtts://broker", tls=tls)

    found: list[SettingError] = []
    done = threading.Event()

    def attempt() -> None:
        try:
            certificates_of(configured, brokers_of(configured))
        except SettingError as error:
            found.append(error)
        done.set()

    threading.Thread(target=attempt, daemon=True).start()
    assert done.wait(30), "waits for the pipe"
    assert str(found[0]) == f'mqtt.{key} = "{pipe}": must be a plain file'
