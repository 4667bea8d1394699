"""The packages, built, installed and run where no network is: in a fresh Debian for this machine, and in one for 64-bit
ARM, emulated.

Root's rights are needed (or `sudo` without a password): packages are installed by dpkg, below a root of their own.
"""

import json
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest

from tests import discs
from tests.e2e import debian_machine
from tests.e2e.debian_machine import (
    CONFIG,
    HERE,
    OPT,
    ROOT,
    SUDO,
    Machine,
    bootstrapped,
    built,
    debian_copied,
    removed,
    run,
)

FOREIGN = {"amd64": "arm64", "arm64": "amd64"}[HERE]
BINFMT = Path("/proc/sys/fs/binfmt_misc")

OPCUA = """
cd /tmp; loading-gateway certs init c --rsa; cd c
loading-gateway certs server --dir . --name opcua --uri urn:plant:gateway1 --host 127.0.0.1
loading-gateway certs client mes --dir . --uri urn:plant:mes --role viewer; cp mes.key mes.key.pem
cat >g.toml <<X
opcua = {{ cert = "/tmp/c/opcua.pem", key = "/tmp/c/opcua.key", ca = "/tmp/c/ca.pem" }}
modbus.port = 5020
hmi.enabled = false
X
chown -R loading-gateway /tmp/c
HOME=/tmp {user} loading-gateway simulate --config g.toml --json --duration 60 >/dev/null 2>&1 &
cat >client.py <<X
import asyncio
from asyncua import Client, ua
async def asked():
    client = Client("opc.tcp://127.0.0.1:4840/")
    client.application_uri = "urn:plant:mes"
    await client.set_security_string("Basic256Sha256,SignAndEncrypt,mes.pem,mes.key.pem,opcua.pem")
    async with client:
        bays = await client.get_node("ns=2;s=Bays").get_children()
        stop = await client.get_node("ns=2;s=bay1.stop").read_value()
        assert stop is False  # the truck of the simulation is on its way
        print("bays", str([bay.nodeid.Identifier for bay in bays]) + ", stop", stop)
async def main():
    while True:
        try:
            return await asked()
        except (OSError, asyncio.TimeoutError, ua.UaError, AssertionError):
            await asyncio.sleep(0.5)
asyncio.run(asyncio.wait_for(main(), 60))
X
{opt}/current/bin/python client.py
"""

pytestmark = [pytest.mark.xdist_group("package"), pytest.mark.timeout(900), pytest.mark.long]


@pytest.fixture(scope="module")
def machine(pytestconfig: pytest.Config) -> Iterator[Machine]:
    root = debian_copied(pytestconfig, "machine")
    yield Machine(root)
    removed(root)


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    """Debian for the other architecture: its packages are unpacked, and not set up, which would take minutes."""
    if not (BINFMT / "status").exists():
        run(*SUDO, "mount", "-t", "binfmt_misc", "none", str(BINFMT))
    emulator = {"arm64": "qemu-aarch64", "amd64": "qemu-x86_64"}[FOREIGN]
    if not (BINFMT / emulator).exists():  # where systemd does not
        run(*SUDO, "sh", "-ec", f"cat /usr/lib/binfmt.d/{emulator}.conf >{BINFMT}/register")
    root = tmp_path_factory.mktemp("foreign") / "root"
    packages = ("?essential", "python3", "systemd-standalone-sysusers", "init-system-helpers", "libstdc++6")
    bootstrapped(root, FOREIGN, "extract", *packages)
    for name in ("passwd", "group"):  # what setting up base-passwd would do
        run(*SUDO, "cp", f"{root}/usr/share/base-passwd/{name}.master", f"{root}/etc/{name}")
    yield Machine(root)
    removed(root)


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("picture") / "disc.png"
    assert cv2.imwrite(str(path), discs.disc(150.25, 100.5, 60))
    return path


@pytest.fixture(scope="module")
def package(pytestconfig: pytest.Config) -> Path:
    return debian_machine.package(pytestconfig)


def detected(machine: Machine, picture: Path) -> dict[str, float]:
    machine.put(picture, "/root/disc.png")
    row = json.loads(machine.sh("loading-gateway detect --json /root/disc.png").splitlines()[-1])
    return {key: row[key] for key in ("u", "v", "r")}


def with_other_defaults(package: Path) -> Path:
    """The same package, but for the file of settings that it brings."""
    tree = package.with_suffix("")
    run("dpkg-deb", "--raw-extract", str(package), str(tree))
    defaults = tree / "usr/share/loading-gateway/gateway.toml"
    defaults.write_text(defaults.read_text().replace('site = "plant1"', 'site = "plant2"'))
    run("dpkg-deb", "--root-owner-group", "-Zgzip", "-z1", "--build", str(tree), str(package))
    removed(tree)
    return package


def test_a_machine_without_a_network(machine: Machine, package: Path, picture: Path, tmp_path: Path) -> None:
    """One life of an installation: its parts share what takes long."""
    # Installed.
    machine.install(package)
    assert machine.sh("loading-gateway --version") == "gateway 1.2.3\n"
    assert machine.sh(f"readlink {OPT}/current") == "versions/1.2.3\n"
    assert machine.sh(f"stat -c '%A %U %G' /etc/loading-gateway {CONFIG}").splitlines() == [
        "drwxrwx--- root loading-gateway",  # the pages save to it
        "-rw-rw---- loading-gateway loading-gateway",  # who replaces only a file of its own
    ]
    announced = "/etc/avahi/services/loading-gateway.service"
    assert "<port>8080</port>" in machine.sh(f"cat {announced}")
    groups = machine.sh("id -nG loading-gateway").split()
    assert sorted(groups) == ["dialout", "loading-gateway", "video"]
    enabled = "/etc/systemd/system/multi-user.target.wants/loading-gateway.service"
    assert "loading-gateway.service" in machine.sh(f"readlink {enabled}")

    # The manual, on the disk and for the pages; the man page.
    pages = "import gateway.web.server.manual as it; print(it.FOLDER.name, it.html('technician').count('<img'))"
    pictures = (ROOT / "docs/technician.md").read_text().count("![")
    assert machine.sh(f'{OPT}/current/bin/python -c "{pages}"') == f"manual {pictures}\n"
    machine.sh("cd /usr/share/doc/loading-gateway/manual && test -s technician.md -a -s images/hmi-teach-in.png")
    assert ".TH GATEWAY 1 " in machine.sh("zcat /usr/share/man/man1/loading-gateway.1.gz")

    # At work, as the service's user: nothing it reads is root's alone.
    user = "setpriv --reuid=loading-gateway --regid=loading-gateway --init-groups "
    checked = machine.sh(f"{user} loading-gateway check {CONFIG}")
    assert "pages on 0.0.0.0:8080, with TLS, the driver's display without a login; no users: the first" in checked
    found = detected(machine, picture)
    assert found["u"] == pytest.approx(150.25, abs=0.1)
    assert found["v"] == pytest.approx(100.5, abs=0.1)
    assert found["r"] == pytest.approx(60, abs=0.1)
    simulated = machine.sh(
        f"cd /tmp; HOME=/tmp {user} loading-gateway simulate --json --duration 2 --modbus-port 0 --no-hmi 2>/tmp/said "
        "|| { cat /tmp/said; exit 1; }"
    )
    rows = [json.loads(line) for line in simulated.splitlines()]
    assert rows[0]["type"] == "started"
    assert any(row["type"] == "state" and row["stop"] for row in rows)

    # The OPC UA server, with what the package carries: encrypted, and asked by its own library's client.
    assert "bays ['bay1'], stop False" in machine.sh(OPCUA.format(user=user, opt=OPT)).splitlines()[-1]

    # An interrupted installation, and one whose environment is damaged, are mended by setting it up again.
    machine.sh(f"rm {OPT}/versions/1.2.3/installed.json; mkdir {OPT}/versions/.1.2.3.new")
    machine.sh("dpkg-reconfigure -f noninteractive loading-gateway 2>&1 || dpkg --configure loading-gateway")
    assert machine.sh(f"ls -A {OPT}/versions") == "1.2.3\n"

    # A file of settings that is missing is made again, and root follows no link that the service's user has laid.
    machine.sh(f"rm {CONFIG}; ln -s /root/taken {CONFIG}.new; dpkg-reconfigure -f noninteractive loading-gateway 2>&1")
    assert machine.sh(f"stat -c '%A %U %F' {CONFIG}; ls /root/taken 2>/dev/null || true").splitlines() == [
        "-rw-rw---- loading-gateway regular file"
    ]

    # The next version lies beside the one that runs; what the administrator wrote stays, without a question, though the
    # package's own file is another one.
    # A file of before there was a first password is not opened to the network by it, and not announced.
    machine.sh(f"echo '# ours' >>{CONFIG}; sed -i /first_password/d {CONFIG}; rm {announced}")
    said = machine.install(with_other_defaults(built(tmp_path, HERE, "1.2.4")))
    assert "plant2" in machine.sh("cat /usr/share/loading-gateway/gateway.toml")
    assert "plant2" not in machine.sh(f"cat {CONFIG}")
    assert machine.sh(f"grep -c first_password {CONFIG} || true; ls {announced} 2>/dev/null || true") == "0\n"
    assert "version 1.2.4 is installed beside 1.2.3, which goes on running" in said
    assert machine.sh(f"ls {OPT}/versions; loading-gateway --version; tail -n 1 {CONFIG}").splitlines() == [
        *("1.2.3", "1.2.4", "gateway 1.2.3", "# ours"),
    ]
    # Another Python: what the link names can't start any more, the version of the package can.
    machine.sh(f"rm -r {OPT}/versions/1.2.3/lib; dpkg-trigger --no-await /usr/bin/python3; dpkg --triggers-only -a")
    assert machine.sh(f"loading-gateway --version; readlink {OPT}/current") == "gateway 1.2.4\nversions/1.2.4\n"

    # Removed, and purged.
    machine.sh("mkdir -p /var/lib/loading-gateway; dpkg --remove loading-gateway")
    assert machine.sh(f"ls -d {OPT} {CONFIG} /var/lib/loading-gateway 2>/dev/null || true").splitlines() == [
        *(CONFIG, "/var/lib/loading-gateway"),
    ]
    machine.sh("dpkg --purge loading-gateway")
    assert machine.sh("find / -xdev -name '*loading-gateway*' -not -path '/root/*' -not -path '/proc/*'") == ""


def test_the_archive_of_wheels_is_installed_by_what_the_manual_says(
    package: Path, picture: Path, tmp_path: Path
) -> None:
    page = (ROOT / "docs/operations.md").read_text()
    (commands,) = re.findall(r"### Archive of wheels\n.*?```\n(.*?)```", page, re.DOTALL)
    commands = re.sub(r"\d+\.\d+\.\d+-wheels-\w+", f"1.2.3-wheels-{HERE}", commands)
    run(
        *(
            "env",
            "-C",
            str(package.parent),
            f"HOME={tmp_path}",
            f"PATH={Path(sys.executable).parent}:{os.environ['PATH']}",
        ),
        *("sh", "-ec", commands),
    )
    gateway = str(tmp_path / "loading-gateway/bin/gateway")
    assert run(gateway, "--version") == "gateway 1.2.3\n"
    assert json.loads(run(gateway, "detect", "--json", str(picture)).splitlines()[-1])["r"] == pytest.approx(
        60, abs=0.1
    )


def test_the_other_architecture_finds_the_same_circle(
    foreign: Machine, picture: Path, package: Path, machine: Machine, tmp_path: Path
) -> None:
    foreign.install(built(tmp_path, FOREIGN), "--force-depends")
    kernel = "from gateway.vision.compiled.library import LIBRARY; import ctypes, platform; ctypes.CDLL(str(LIBRARY))"
    printed = foreign.sh(f"{OPT}/current/bin/python -c '{kernel}; print(platform.machine())'")
    assert printed == {"arm64": "aarch64\n", "amd64": "x86_64\n"}[FOREIGN]
    circle = detected(foreign, picture)
    image = json.loads(
        run(str(ROOT / ".venv/bin/gateway"), "detect", "--json", str(picture)).splitlines()[-1],
    )
    for key in ("u", "v", "r"):
        assert circle[key] == pytest.approx(image[key], abs=0.001), "px"
