"""The files of `gateway fleet`, and what is said of their faults."""

from pathlib import Path

import pytest

from gateway.cli.main import main
from gateway.errors import ConfigError
from gateway.fleet.config import load, load_inventory

GOOD = '[mqtt]\nurl = "mqtt://broker"\n[hmi]\nwithout_login = "viewer"\n'


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "mqtt: is missing"),
        ('[mqtt]\nurl = "mqtt://broker"\n', "hmi.without_login"),
        (GOOD + 'first_password = true\ntls_cert = "auto"\n', "hmi.first_password"),
        ("silent_s = 1\n" + GOOD, "silent_s = 1"),
        ("silent = 1\n" + GOOD, "silent"),
    ],
)
def test_faults_name_file_key_and_what_is_allowed(tmp_path: Path, text: str, fault: str) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as found:
        load(path)
    assert str(path) in str(found.value)
    assert fault in str(found.value)


def test_a_gateway_twice_in_the_inventory_is_a_fault(tmp_path: Path) -> None:
    path = tmp_path / "inventory.toml"
    path.write_text('[[gateways]]\nsite = "north"\ninstance = "a"\n' * 2)
    with pytest.raises(ConfigError, match="an earlier gateway has this site and instance"):
        load_inventory(path)


def test_check_says_what_is_wrong_or_that_nothing_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text('inventory = "all.toml"\n' + GOOD)
    assert main(["fleet", str(path), "--check"]) == 2
    assert "all.toml" in capsys.readouterr().err
    (tmp_path / "all.toml").write_text('[[gateways]]\nsite = "north"\ninstance = "a"\n')
    assert main(["fleet", str(path), "--check"]) == 0
    assert "1 gateways in the inventory, page on 127.0.0.1:8080" in capsys.readouterr().out
