"""Whose rights an examination has, and what they permit."""

import grp
import os
import pwd
import subprocess
import sys
from pathlib import Path

import pytest

from gateway.cli.main import main
from gateway.config import GatewayConfig
from gateway.doctor import permissions, rights
from gateway.web.ipc.devices import Verdict

OTHER = "nobody"
PROBE = f"""
import os, socket
from gateway import bay_file
from gateway.config import parse
from gateway.doctor import rights
rights.become({OTHER!r}, ("video", "no-such-group"))
text = open("/proc/self/status").read()
held = {{line.split()[0]: line.split()[1] for line in text.splitlines() if line.startswith("Cap")}}
socket.socket().bind(("127.0.0.1", 0))
try:
    os.setuid(0)
    back = True
except PermissionError:
    back = False
held = int(held["CapEff:"], 16), int(held["CapPrm:"], 16)
print(os.getresuid(), os.getgroups(), *held, back, bay_file.folder_of(parse({{}})))
"""


def config(**sections: object) -> GatewayConfig:
    return GatewayConfig.model_validate(sections)


@pytest.mark.one_interpreter
def test_root_takes_the_rights_of_the_service_and_keeps_ports_below_1024() -> None:
    user = pwd.getpwnam(OTHER)
    done = subprocess.run([sys.executable, "-c", PROBE], capture_output=True, text=True, check=False)
    if os.geteuid() != 0:
        assert "PermissionError" in done.stderr
        return
    groups = sorted({user.pw_gid, grp.getgrnam("video").gr_gid})
    assert done.stdout.strip() == f"{(user.pw_uid,) * 3} {groups} {1 << 10} {1 << 10} False /var/lib/loading-gateway"


@pytest.mark.parametrize(
    ("uid", "path", "found"),
    [
        (0, "/etc/loading-gateway/gateway.toml", "loading-gateway"),
        (0, "/etc/loading-gateway/../other/gateway.toml", ""),
        (0, "my-bay.toml", ""),
        (1000, "/etc/loading-gateway/gateway.toml", ""),
    ],
)
def test_whose_rights_are_taken(monkeypatch: pytest.MonkeyPatch, uid: int, path: str, found: str) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: uid)
    monkeypatch.setattr(pwd, "getpwnam", lambda name: type("User", (), {"pw_name": name}))
    assert rights.of_service(Path(path)) == found


def test_the_rights_are_taken_before_the_configuration_is_read(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    taken: list[str] = []
    monkeypatch.setattr(rights, "of_service", lambda path: f"the user for {path.name}")
    monkeypatch.setattr(rights, "become", taken.append)
    assert main(["doctor", str(tmp_path / "none.toml")]) == 2  # there is no such file
    assert taken == ["the user for none.toml"]


def test_where_the_package_is_not_installed_root_stays_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(rights, "SERVICE_USER", "no-such-user")
    assert rights.of_service(Path("/etc/loading-gateway/gateway.toml")) == ""


def test_a_key_that_may_not_be_read_is_a_fault_and_a_missing_one_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    secret, there = tmp_path / "broker.pw", tmp_path / "ca.crt"
    secret.write_text("x")
    there.write_text("x")
    made = config(
        mqtt={
            "url": "mqtts://broker",
            "username": "u",
            "password_file": str(secret),
            "tls": {"ca_file": str(there), "cert_file": str(tmp_path / "no.crt"), "key_file": str(tmp_path / "no.key")},
        }
    )
    allowed = list(permissions.permissions(made))
    assert [(f.verdict, f.result) for f in allowed] == [
        (Verdict.OK, "devices and files that the configuration names: 2, all may be used")
    ]
    monkeypatch.setattr(os, "access", lambda path, mode: (Path(path), mode) != (secret, os.R_OK))
    (refused,) = permissions.permissions(made)
    assert (refused.verdict, refused.name) == (Verdict.FAULT, "mqtt.password_file")
    assert refused.result == f"{secret}: reading is refused"
    assert refused.remedy.startswith("chgrp ")


def test_a_device_whose_group_this_user_is_not_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """/dev/null stands for a serial port: it is there, and may be refused."""
    made = config(bays=[{"ranger": {"port": "/dev/null"}, "camera": {"url": "7"}}])
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    (refused,) = permissions.permissions(made)
    assert (refused.name, refused.result) == ("bay1 ranger.port", "/dev/null: reading and writing is refused")
