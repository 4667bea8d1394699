"""What an update does to files and links."""

import os
import pwd
from pathlib import Path

import pytest

from gateway.files import plain_bytes
from gateway.update.finish import content, digest, undo_files
from gateway.update.machine import InstallPaths, Machine, Service, UpdateError
from gateway.update.state import Stage, UpdateState


@pytest.fixture
def synced(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What was forced to the disk, and what was renamed, in order."""
    order: list[str] = []
    real = Path.replace

    def replace(self: Path, target: Path) -> Path:
        order.append(f"rename {Path(target).name}")
        return real(self, target)

    monkeypatch.setattr(os, "fsync", lambda fd: order.append(Path(os.readlink(f"/proc/self/fd/{fd}")).name))
    monkeypatch.setattr(Path, "replace", replace)
    return order


def test_a_file_is_on_disk_before_its_name_and_the_name_when_it_returns(tmp_path: Path, synced: list[str]) -> None:
    machine, path = Machine(InstallPaths(tmp_path)), tmp_path / "state.json"
    machine.write(path, b"1")
    assert synced == [".state.json.new", "rename state.json", tmp_path.name]
    assert (path.read_bytes(), path.stat().st_mode & 0o777) == (b"1", 0o600)
    path.chmod(0o640)
    machine.write(tmp_path / "copy", b"2", like=path)
    assert (tmp_path / "copy").stat().st_mode & 0o777 == 0o640
    synced.clear()
    machine.copy(path, tmp_path / "package.deb")
    assert synced == [".package.deb.new", "rename package.deb", tmp_path.name]


def test_a_link_is_replaced_at_once_and_is_relative(tmp_path: Path, synced: list[str]) -> None:
    machine = Machine(InstallPaths(tmp_path))
    for name in ("1.0", "2.0"):
        (machine.paths.versions / name).mkdir(parents=True)
        machine.link(machine.paths.current, machine.paths.versions / name)
        assert os.readlink(machine.paths.current) == f"versions/{name}"
    assert synced == ["rename current", "loading-gateway"] * 2
    machine.link(machine.paths.current, machine.paths.versions / "2.0")
    assert len(synced) == 4, "it points there already"
    assert (machine.version(), machine.installed()) == ("2.0", ["1.0", "2.0"])


def test_a_machine_without_the_package_is_told(tmp_path: Path) -> None:
    with pytest.raises(UpdateError, match=r"current: No such file or directory: the gateway was not installed from"):
        Machine(InstallPaths(tmp_path)).version()


def test_programs_that_are_missing_fail_or_hang(tmp_path: Path) -> None:
    machine = Machine(InstallPaths(tmp_path))
    with pytest.raises(UpdateError, match=r"no-such-program: can't be started"):
        machine.command("no-such-program")
    with pytest.raises(UpdateError, match=r"sleep: has not ended within 0 s"):
        machine.command("sleep", "60", timeout_s=0.05)
    answer = machine.command("sh", "-c", "echo out; echo one >&2; exit 3")
    assert (answer.code, answer.out, answer.last_lines) == (3, "out\n", "one; out")
    assert machine.command("sh", "-c", "echo $HOME$PYTHONPATH").out == "\n", "the caller's variables are not handed on"


def test_a_program_is_run_as_another_user_with_that_user_s_rights_only(tmp_path: Path) -> None:
    """Where this process is root; where it is not, it has the rights that it has."""
    machine = Machine(InstallPaths(tmp_path))
    own, other = (machine.command("sh", "-c", "id -u; id -G", user=user).out for user in ("", "daemon"))
    user = pwd.getpwnam("daemon")
    assert own.startswith(f"{os.geteuid()}\n")
    assert other == (f"{user.pw_uid}\n{user.pw_gid}\n" if os.geteuid() == 0 else own)


def test_the_service_as_systemd_shows_it(tmp_path: Path) -> None:
    machine = played_systemctl(tmp_path, "printf 'ActiveState=active\\nMainPID=7\\nInvocationID=ab\\n'")
    assert machine.service() == Service("active", 7, "ab")


@pytest.mark.parametrize(("script", "user"), [("echo User=plc", "plc"), ("echo User=", "")])
def test_the_service_user(tmp_path: Path, script: str, user: str) -> None:
    assert played_systemctl(tmp_path, script).service_user() == user


@pytest.mark.parametrize("script", ["echo Failed to connect to bus >&2; exit 1", "echo User=plc; exit 1", "exit 0"])
def test_a_service_user_that_is_not_known_is_not_root(tmp_path: Path, script: str) -> None:
    with pytest.raises(UpdateError, match=r"loading-gateway\.service: the service's user is not known"):
        played_systemctl(tmp_path, script).service_user()


def played_systemctl(folder: Path, script: str) -> Machine:
    path = folder / "systemctl"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return Machine(InstallPaths(folder), {"systemctl": str(path)})


def test_a_configuration_that_is_gone_comes_back_readable_for_the_service(tmp_path: Path) -> None:
    machine = Machine(InstallPaths(tmp_path))
    for folder in (machine.paths.folder, machine.paths.config.parent, machine.paths.versions / "1.0"):
        folder.mkdir(parents=True)
    kept = machine.paths.kept_config("1.0")
    kept.write_bytes(b"old")
    kept.chmod(0o640)
    state = UpdateState(stage=Stage.RETURNING, old="1.0", new="2.0", boot="", began_unix_s=0, new_config=True)
    undo_files(machine, state, lambda _: None)
    assert machine.paths.config.read_bytes() == b"old"
    assert machine.paths.config.stat().st_mode & 0o777 == 0o640
    assert machine.version() == "1.0"


def test_root_reads_no_link_and_waits_for_no_pipe_in_the_services_folder(tmp_path: Path) -> None:
    (tmp_path / "secret").write_bytes(b"root's")
    (tmp_path / "link").symlink_to(tmp_path / "secret")
    os.mkfifo(tmp_path / "pipe")
    assert plain_bytes(tmp_path / "secret") == b"root's"
    for name in ("link", "pipe", "none"):
        with pytest.raises(OSError, match=name):
            plain_bytes(tmp_path / name)
        assert content(tmp_path / name) is None
    assert digest(None) == ""
