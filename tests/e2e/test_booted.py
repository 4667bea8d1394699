"""The service on a Debian that is booted: the package's scripts, the unit and systemd itself, as an administrator and a
PLC see them.

Camera and ranger are there: pictures of a truck at its mark, and a simulated board behind a serial server. The address
of the PLC's network is not, until a test adds it: so it is on a machine whose cable is not plugged in.
"""

import json
import re
import time
from collections.abc import Iterator

import pytest

from tests.e2e.booted_machine import BootedMachine
from tests.e2e.debian_machine import CONFIG, OPT, debian_copied, package, removed, run
from tests.e2e.sim_ranger import Ranger
from tests.e2e.test_doctor import draw_truck

pytestmark = [pytest.mark.xdist_group("package"), pytest.mark.timeout(900), pytest.mark.long]

UNIT = "loading-gateway.service"
ADDRESS = "192.0.2.10"
SETTINGS = f"""\
site = "plant1"
[modbus]
host = "{ADDRESS}"
plc_addresses = ["{ADDRESS}"]
[hmi]
enabled = true
[camera]
url = "/srv/truck"
loop = true
fps = 10
[fusion]
vision_deadline_s = 0.5
[ranger]
port = "socket://127.0.0.1:4001"
"""


@pytest.fixture(scope="module")
def ranger() -> Iterator[Ranger]:
    with Ranger() as board:
        board.distance_mm = 270.0
        yield board


@pytest.fixture(scope="module")
def machine(
    pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory, ranger: Ranger
) -> Iterator[BootedMachine]:
    """With the package, installed while the PLC's cable is out."""
    folder = tmp_path_factory.mktemp("booted")
    (folder / "truck").mkdir()
    (folder / "gateway.toml").write_text(SETTINGS)
    root = debian_copied(pytestconfig, "booted")
    with BootedMachine(root) as made:
        made.beside("socat", "TCP-LISTEN:4001,bind=127.0.0.1,reuseaddr,fork", f"FILE:{ranger.port},rawer,nonblock")
        made.put(draw_truck(folder / "truck", 27), "/srv/")
        made.sh("mkdir /etc/loading-gateway")
        made.put(folder / "gateway.toml", CONFIG)
        made.install(package(pytestconfig))
        made.eventually(lambda: waits_for_its_address(made), 30)
        yield made
    removed(root)


@pytest.fixture
def served(machine: BootedMachine) -> BootedMachine:
    """The cable is in, and the PLC can read."""
    machine.address("replace", ADDRESS)
    machine.sh(f"systemctl start --no-block {UNIT}")
    machine.eventually(lambda: machine.shown(UNIT)["ActiveState"] == "active", 60)
    return machine


def holding_registers(machine: BootedMachine, address: int, count: int) -> list[int]:
    """As a PLC reads them."""
    command = ["mbpoll", "-0", "-B", "-m", "tcp", "-a", "1", "-r", str(address), "-c", str(count), "-1", ADDRESS]
    printed = run(*machine.entered("net"), *command, timeout_s=60)
    return [int(value) for value in re.findall(r"^\[\d+\]:\s+(\d+)", printed, re.MULTILINE)]


def waits_for_its_address(machine: BootedMachine) -> bool:
    shown = machine.shown(UNIT)
    return shown["ActiveState"] == "activating" and f"cannot listen on {ADDRESS} port 502" in shown.get(
        "StatusText", ""
    )


def test_apt_returns_while_the_address_is_missing_and_the_port_opens_with_it(machine: BootedMachine) -> None:
    machine.eventually(lambda: waits_for_its_address(machine), 30)
    assert machine.sh(f"stat -c '%A %U' {CONFIG}; grep -c plc_addresses {CONFIG}") == "-rw-rw---- loading-gateway\n1\n"
    machine.address("add", ADDRESS)
    machine.eventually(lambda: machine.shown(UNIT)["ActiveState"] == "active", 15)
    stop, may_move, _ = holding_registers(machine, 4, 3)
    assert (stop, may_move) == (1, 0)
    machine.eventually(lambda: holding_registers(machine, 36, 1) == [1], 15)  # in place: both sensors are at work


def test_doctor_finds_no_fault(served: BootedMachine) -> None:
    def examined() -> dict[str, tuple[str, str]]:
        printed = served.sh(f"loading-gateway doctor --json {CONFIG} || true")
        rows = [json.loads(line) for line in printed.splitlines()]
        return {
            f"{row['part']} {row['name']}".strip(): (row["verdict"], f"{row['tried']}: {row['result']}") for row in rows
        }

    sensors = ("camera bay1", "ranger bay1")
    served.eventually(lambda: {examined()[name][0] for name in sensors} == {"ok"}, 120)  # just opened, under load
    found = examined()
    assert {name: what for name, what in found.items() if what[0] == "fault"} == {}
    assert {found[name][0] for name in (*sensors, "port modbus", "disk state", "disk records")} == {"ok"}
    assert "/var/lib/loading-gateway" in found["disk state"][1]
    # What it wrote to try the disk is gone, or else belongs to the service.
    assert served.sh("find /var/lib/loading-gateway /dev/shm -not -user loading-gateway -name '*gateway*'") == ""


def test_the_journal_has_its_lines_with_their_priorities_and_fields(served: BootedMachine) -> None:
    lines = [json.loads(line) for line in served.sh("journalctl -u loading-gateway -o json").splitlines()]
    own = [line for line in lines if line.get("SYSLOG_IDENTIFIER") == "gateway"]
    assert {line["PRIORITY"] for line in own if f"cannot listen on {ADDRESS} port 502" in line["MESSAGE"]} == {"4"}
    assert {line["PRIORITY"] for line in own if line["MESSAGE"].startswith("gateway runs: Modbus TCP on")} == {"6"}
    served.sh("journalctl -u loading-gateway -o cat BAY=bay1 EVENT=in_place | grep -q 'in place'")


def test_systemd_finds_it_little_exposed(served: BootedMachine) -> None:
    judged = served.sh(f"systemd-analyze security --no-pager {UNIT}")
    assert float(re.findall(r"Overall exposure level for \S+: ([\d.]+)", judged)[0]) <= 2.0


def test_a_main_process_that_stands_still_is_ended_by_the_watchdog_and_started_again(served: BootedMachine) -> None:
    before = served.shown(UNIT)
    served.sh(f"kill -STOP {before['MainPID']}")
    served.eventually(lambda: int(served.shown(UNIT)["NRestarts"]) == int(before["NRestarts"]) + 1, 30)
    served.eventually(lambda: served.shown(UNIT)["ActiveState"] == "active", 30)
    assert served.shown(UNIT)["MainPID"] != before["MainPID"]
    assert "Watchdog timeout" in served.sh(f"journalctl -u {UNIT} --since -90s")
    assert holding_registers(served, 4, 1) == [1]


def test_stop_ends_within_seconds_and_nothing_starts_it_again(served: BootedMachine) -> None:
    began_s = time.monotonic()
    served.sh(f"systemctl stop {UNIT}")
    assert time.monotonic() - began_s < 5
    shown = served.shown(UNIT)
    assert (shown["ActiveState"], shown["Result"]) == ("inactive", "success")
    assert (
        served.sh("find /proc -maxdepth 1 -user loading-gateway; ls -A /run/loading-gateway 2>/dev/null || true") == ""
    )


def test_an_environment_that_is_made_anew_is_started_without_dpkg_waiting_for_the_address(
    served: BootedMachine,
) -> None:
    """As where the distribution's Python was replaced, in a plant where the cable is out."""
    before = served.shown(UNIT)["InvocationID"]
    served.address("delete", ADDRESS)
    served.sh(f"rm -r {OPT}/versions/1.2.3/lib")
    served.sh("dpkg-trigger --no-await /usr/bin/python3; timeout 120 dpkg --triggers-only --pending")
    served.eventually(lambda: waits_for_its_address(served), 30)
    assert served.shown(UNIT)["InvocationID"] != before
    # Where the machine's policy forbids it, the gateway goes on with what it has, and dpkg is content. The link is
    # missing: that is mended and would be a reason, too.
    before = served.shown(UNIT)["InvocationID"]
    policy = "/usr/sbin/policy-rc.d"
    served.sh(f"printf '#!/bin/sh\\necho $* >>/run/asked\\nexit 101\\n' >{policy}; chmod +x {policy}")
    served.sh(f"rm {OPT}/current; dpkg-trigger --no-await /usr/bin/python3; dpkg --triggers-only --pending")
    assert served.sh(f"cat /run/asked; rm {policy} /run/asked; readlink {OPT}/current").splitlines() == [
        *(f"{UNIT} restart", "versions/1.2.3"),
    ]
    assert served.shown(UNIT)["InvocationID"] == before
    assert served.sh("dpkg --audit") == ""


def test_removing_it_ends_an_update_first_and_leaves_nothing_that_would_go_on_with_it(served: BootedMachine) -> None:
    update, folder = "loading-gateway-update.service", "/var/lib/loading-gateway-update"
    served.sh(f"""
        mkdir -p {folder} /run/systemd/system/{update}.d
        touch {folder}/log.txt {folder}/state.json
        ln -s {OPT}/versions/1.2.3 {folder}/watcher
        cd /run/systemd/system/{update}.d
        printf '[Service]\\nType=exec\\nExecStart=\\nExecStart=sleep infinity\\n' >sleeps.conf
        systemctl daemon-reload
        systemctl start {update}
    """)
    assert served.shown(update)["ActiveState"] == "active"
    served.sh("apt-get remove -y loading-gateway")
    assert {served.shown(unit)["ActiveState"] for unit in (update, UNIT)} == {"inactive"}
    assert served.sh(f"ls {folder}; ls -d {OPT} 2>/dev/null || true") == "log.txt\n"
    ended = [line for line in served.sh("journalctl -o cat -n 30").splitlines() if line.startswith("Stopped ")]
    assert [line.partition(" - ")[0] for line in ended[-2:]] == [f"Stopped {update}", f"Stopped {UNIT}"]
