"""What an installation copies: the unit, its user, the names of devices."""

import re
import sys
from pathlib import Path

import pytest

from gateway.cli.main import VERBS

PACKAGING = Path(__file__).parents[2] / "packaging"

sys.path.insert(0, str(PACKAGING))
try:
    import deb
finally:
    sys.path.remove(str(PACKAGING))

LINES = (PACKAGING / "systemd/loading-gateway.service").read_text().splitlines()
UNIT = [line.split("=", 1) for line in LINES if line and line[0] not in "#["]
RULES = (PACKAGING / "udev/70-loading-gateway.rules").read_text().splitlines()


def unit(key: str) -> list[str]:
    return [value for name, value in UNIT if name == key]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("Type", "notify"),
        ("NotifyAccess", "main"),  # the children must not speak for the gateway
        ("WatchdogSec", "10"),  # above the longest pause before a crashed control task starts again, 5 s, and a feed
        ("Restart", "always"),
        ("StartLimitIntervalSec", "0"),
        ("TimeoutStartSec", "infinity"),  # it waits for the network itself
        ("KillMode", "mixed"),
        ("AmbientCapabilities", "CAP_NET_BIND_SERVICE"),
        ("CapabilityBoundingSet", "CAP_NET_BIND_SERVICE"),
        ("CPUSchedulingPolicy", "fifo"),
        ("CPUSchedulingPriority", "10"),
        ("StateDirectory", "loading-gateway"),
        ("SupplementaryGroups", "dialout video"),
        ("RemoveIPC", "no"),  # the journal of events is in /dev/shm
        ("DevicePolicy", "closed"),
    ],
)
def test_what_the_gateway_relies_on(key: str, value: str) -> None:
    assert unit(key) == [value]


def test_the_unit_waits_for_no_network_and_has_its_devices() -> None:
    assert not any("network-online" in value for _, value in UNIT)
    assert {device.split()[0] for device in unit("DeviceAllow")} >= {"char-video4linux", "char-ttyACM", "char-ttyUSB"}
    assert "PrivateDevices" not in dict(UNIT)
    drivers = "modprobe@videodev.service modprobe@cdc_acm.service modprobe@usbserial.service"
    assert unit("Wants") == [drivers], "systemd looks up the numbers of the devices once, at the start"
    assert drivers in unit("After")


def test_its_user_is_the_one_that_is_made() -> None:
    lines = (PACKAGING / "sysusers/loading-gateway.conf").read_text().splitlines()[1:]
    made, *groups = [line.split() for line in lines]
    assert [made[1]] == unit("User") == unit("Group") == unit("StateDirectory")
    wanted = [["m", made[1], group] for group in unit("SupplementaryGroups")[0].split()]
    assert groups == wanted, "also what the user starts by hand has its devices"


def links(device: dict[str, str]) -> tuple[set[str], dict[str, str]]:
    """What the rules give a device: names, properties. As udev(7): a rule applies where all its matches do."""
    names: set[str] = set()
    properties: dict[str, str] = {}
    for line in RULES:
        if not line or line.startswith(("#", "LABEL")):
            continue
        parts = re.findall(r'([A-Z]+(?:\{\w+\})?)(==|\+=|=)"([^"]*)"', line)
        assert ", ".join(f'{key}{sign}"{value}"' for key, sign, value in parts) == line, "no other syntax"
        if not all(
            any(re.fullmatch(one.replace("?", ".").replace("*", ".*"), device.get(key, "")) for one in value.split("|"))
            for key, sign, value in parts
            if sign == "=="
        ):
            continue
        for key, sign, value in parts:
            if key == "GOTO":
                return names, properties
            if key == "SYMLINK":
                names.add(re.sub(r"\$env(\{\w+\})", lambda name: device["ENV" + name[1]], value))
            elif sign == "=":
                properties[key] = value
    return names, properties


CAMERA = {"SUBSYSTEM": "video4linux", "KERNEL": "video2", "ATTR{index}": "0", "ACTION": "add"}
BOARD = {"SUBSYSTEM": "tty", "KERNEL": "ttyACM0", "ENV{ID_BUS}": "usb", "ACTION": "add"}
SERIAL = {"ENV{ID_SERIAL_SHORT}": "5A3F"}
SOCKET = {"ENV{ID_PATH_TAG}": "pci-0000_00_14_0-usb-0_2_1_0"}


@pytest.mark.parametrize(
    ("device", "named"),
    [
        (CAMERA | SERIAL | SOCKET, {"camera-5A3F", "camera-at-pci-0000_00_14_0-usb-0_2_1_0"}),
        (CAMERA | SOCKET, {"camera-at-pci-0000_00_14_0-usb-0_2_1_0"}),
        (CAMERA | SERIAL | {"ATTR{index}": "1"}, set()),  # its metadata
        (CAMERA | SERIAL | {"ACTION": "remove"}, set()),
        (BOARD | SERIAL | SOCKET, {"board-5A3F", "board-at-pci-0000_00_14_0-usb-0_2_1_0"}),
        (BOARD | SOCKET | {"KERNEL": "ttyUSB3"}, {"board-at-pci-0000_00_14_0-usb-0_2_1_0"}),
        (BOARD | SERIAL | {"KERNEL": "ttyS0"}, set()),
    ],
)
def test_the_names_of_devices(device: dict[str, str], named: set[str]) -> None:
    names, properties = links(device)
    assert names == {f"loading-gateway/{name}" for name in named}
    is_board = device["SUBSYSTEM"] == "tty" and device["KERNEL"] != "ttyS0"
    assert properties == ({"ENV{ID_MM_DEVICE_IGNORE}": "1"} if is_board else {})


def test_the_man_page_is_the_commands_own_help() -> None:
    page = deb.man_page("1.2.3", "Thu, 26 Nov 2026 00:00:00 +0000")
    assert page.splitlines()[0] == '.TH GATEWAY 1 "Thu, 26 Nov 2026 00:00:00 +0000" "loading-gateway 1.2.3"'
    sections = dict(re.findall(r"^\.SH GATEWAY ?(.*)\n\.nf\n((?:\\&.*\n)+)\.fi$", page, re.MULTILINE))
    assert list(sections) == ["", *map(str.upper, VERBS)]
    assert r"\&usage: gateway run [\-h]" in sections["RUN"]
    assert deb.roff(".so a\\b 'c'\n") == "\\&.so a\\eb \\(aqc\\(aq\n", "no request, no escape"
