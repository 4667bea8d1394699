"""What bays that are gone have left at a broker: the gateway clears its own, `gateway mqtt ghosts` those of a site."""

import asyncio
import re
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.cli import main
from gateway.sinks.mqtt import broker_link, ghosts
from tests.e2e.brokers import Mosquitto, program
from tests.e2e.mqtt_plant import Plant
from tests.e2e.tcp_proxy import NetworkConditions, Proxy


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    with Mosquitto(tmp_path) as broker:
        yield broker


def retained(broker: Mosquitto, *user: str) -> set[str]:
    address = ["-h", broker.host, "-p", str(broker.port), *user]
    listed = [program("mosquitto_sub"), *address, "-t", "#", "--retained-only", "-W", "1", "-F", "%t"]
    return set(subprocess.run(listed, capture_output=True, text=True, check=False).stdout.split())


def topics(*bays: str, announced: tuple[str, ...] = (), status: tuple[str, ...] = ("gw",)) -> set[str]:
    found = {f"loading/site1/{bay}/{name}" for bay in bays for name in ("state", "alarms")}
    found |= {f"homeassistant/device/loading_site1_{bay}/config" for bay in announced}
    return found | {f"loading/site1/{instance}/status" for instance in status}


def left_by(broker: Mosquitto, expected: set[str], *bays: str, instance: str = "gw", announced: bool = True) -> None:
    """Runs a gateway until exactly this is retained. With MQTT 3.1.1 nothing expires by itself."""

    async def scenario() -> None:
        plant = Plant(broker.url, *bays, instance=instance, protocol="3.1.1", home_assistant=announced)
        deadline = time.monotonic() + 30
        async with plant.running():
            while (found := await asyncio.to_thread(retained, broker)) != expected:
                assert time.monotonic() < deadline, found ^ expected
        assert plant.link_errors == 0

    asyncio.run(scenario())


def test_a_gateway_clears_what_it_does_not_own_any_more_and_no_other_s(broker: Mosquitto) -> None:
    three, all_of = ("bay1", "bay2", "bay3"), ("gw", "other")
    left_by(broker, topics(*three, announced=three), *three)
    left_by(broker, topics(*three, announced=three, status=all_of), "bay3", instance="other")  # it has moved there
    now = ("bay1", "bay3", "bay4")
    left_by(broker, topics(*now, announced=now, status=all_of), "bay1", "bay4")
    left_by(broker, topics(*now, announced=("bay3",), status=all_of), "bay1", "bay4", announced=False)


def test_ghosts_of_a_site_are_listed_and_cleared(
    broker: Mosquitto, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ghosts, "ANSWER_S", 0.5)
    monkeypatch.setattr(ghosts, "SURE_S", 0.5)
    left_by(broker, topics("bay1", announced=("bay1",)), "bay1")
    both = ("bay1", "bay2")
    left_by(broker, topics(*both, announced=both, status=("gw", "old")), "bay2", instance="old")
    config = tmp_path / "gateway.toml"
    config.write_text(f'site = "site1"\n[mqtt]\nurl = "{broker.url}"\n')
    assert main(["mqtt", "ghosts", str(config)]) == 0  # a gateway that is off still owns its bays
    address = ["-h", broker.host, "-p", str(broker.port), "-r", "-t", "loading/site1/old/status"]
    subprocess.run([program("mosquitto_pub"), *address, "-m", '{"bays": ["bay9"]}'], check=True)
    capsys.readouterr()
    assert main(["mqtt", "ghosts", str(config)]) == 1
    why = "loading/site1/old/status does not list bay2"
    assert capsys.readouterr().out.splitlines() == [
        *(f"{topic}: {why}" for topic in sorted(topics("bay2", announced=("bay2",), status=()))),
        "retained messages of bays that are not served: 3",
    ]
    assert main(["mqtt", "ghosts", str(config), "--clear"]) == 0
    assert retained(broker) == topics("bay1", announced=("bay1",), status=("gw", "old"))


def test_a_gateway_that_lives_is_none_however_slow_its_broker(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ghosts, "ANSWER_S", 0.1)
    monkeypatch.setattr(ghosts, "SURE_S", 0.2)
    bays = ("bay1", "bay2", "bay3")
    config = tmp_path / "gateway.toml"
    with Mosquitto(tmp_path) as broker, Proxy(broker.port, conditions=NetworkConditions(delay_s=0.1)) as slow:
        left_by(broker, topics(*bays, announced=bays), *bays)
        broker.reload("max_inflight_messages 1")
        config.write_text(f'site = "site1"\n[mqtt]\nprotocol = "3.1.1"\nurl = "mqtt://127.0.0.1:{slow.port}"\n')
        assert main(["mqtt", "ghosts", str(config), "--clear"]) == 0
        assert retained(broker) == topics(*bays, announced=bays)
        monkeypatch.setattr(broker_link, "MAX_INCOMING", 1)
        assert main(["mqtt", "ghosts", str(config), "--clear"]) == 1
        assert "messages arrived faster than they were read" in capsys.readouterr().err


def test_the_access_list_for_a_fleet_permits_area_line_home_assistant_and_clearing(tmp_path: Path) -> None:
    fleet = (Path(__file__).parents[2] / "docs" / "fleet.md").read_text(encoding="utf-8")
    (rules,) = re.findall(r"```acl\n(.*?)```", fleet, re.DOTALL)
    acl = tmp_path / "acl"
    acl.write_text(rules.replace("cement-north", "site1") + "user reader\ntopic read #\n")
    acl.chmod(0o600)
    place = "loading/site1/hall1/line2/bay1"
    with Mosquitto(tmp_path, users={"bay1": "secret", "reader": "secret"}, lines=[f"acl_file {acl}"]) as broker:

        async def run(expected: set[str], *, announced: bool) -> None:
            url, levels = broker.url.replace("//", "//bay1:secret@"), {"area": "hall1", "line": "line2"}
            plant = Plant(url, "bay1", instance="bay1", protocol="3.1.1", home_assistant=announced, **levels)
            deadline = time.monotonic() + 30
            async with plant.running():
                while (found := await asyncio.to_thread(retained, broker, "-u", "reader", "-P", "secret")) != expected:
                    assert time.monotonic() < deadline, found ^ expected

        own = {f"{place}/{name}" for name in ("status", "state", "alarms")}
        asyncio.run(run(own | {"homeassistant/device/loading_site1_hall1_line2_bay1/config"}, announced=True))
        asyncio.run(run(own, announced=False))
