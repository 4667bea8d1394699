"""SIGHUP: the configuration file of a gateway that runs is read again."""

import signal
import socket
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from gateway.core.state import Reason
from tests.e2e.plc import Plc
from tests.e2e.processes import Gateway, command
from tests.e2e.sim_ranger import Ranger
from tests.e2e.test_run import config_file, pages_of, port_of, ranger, video

__all__ = ["ranger", "video"]  # fixtures


def until(fact: Callable[[], bool], seconds: float = 20.0) -> None:
    for _ in range(round(seconds / 0.02)):
        if fact():
            return
        threading.Event().wait(0.02)
    raise AssertionError("in vain")


def alarms(gateway: Gateway) -> dict[str, str]:
    """Of the pages: kind and detail of those that are not normal, nor suppressed by a function check."""
    with pages_of(gateway) as pages:
        rows = pages.get("/api/alarms")["alarms"]
    return {row["kind"]: row["detail"] for row in rows if row["state"] != "suppressed"}


def recorder(gateway: Gateway) -> int:
    (found,) = (process for process in gateway.family() if process.name() == "gw-recorder")
    return found.pid


@pytest.mark.failure_mode("V7")
def test_a_reload_stops_the_bay_for_a_moment_and_a_faulty_file_changes_nothing(
    tmp_path: Path,
    video: Path,
    ranger: Ranger,
) -> None:
    config = config_file(tmp_path, video, ranger.port)
    pages = '[hmi]\nenabled = true\nport = 0\nwithout_login = "{}"\n'
    before = config.read_text()
    config.write_text(before + pages.format("driver"))
    recording = tmp_path / "state" / "records" / f"test.{tmp_path.name}" / "bay1"
    with Gateway("run", str(config)) as gateway, Plc(port_of(gateway)) as plc:
        plc.wait_for(lambda image: image["may_move"] == 1)
        until(lambda: any(file.stat().st_size for file in recording.glob("*.seg")))
        polls, recorded_by = len(plc.polls), recorder(gateway)
        changed = before.replace("[vision]", '[records]\nmax_mb = 50\n[vision]\nmethod = "paper"')
        config.write_text(changed + pages.format("viewer"))
        gateway.process.send_signal(signal.SIGHUP)
        stopped = plc.wait_for(lambda image: image["stop"] == 1).image
        assert (stopped["reason"], stopped["radius"]) == (Reason.VISION_STALE, None)
        plc.wait_for(lambda image: image["stop"] == 0)
        assert plc.last["may_move"] == 0, "nobody has tried this method"
        assert "bay1: not as last tried: vision.method: a function check begins" in gateway.stderr
        assert "bay1: function check begun: configuration file" in gateway.stderr
        assert all(poll.image["radius"] is not None or poll.image["stop"] for poll in plc.polls[polls:])
        assert "bay1: settings changed: configuration file: hmi.without_login" in gateway.stderr
        assert 'bays.bay1.vision.method: "robust" -> "paper"' in gateway.stderr
        assert recorder(gateway) != recorded_by
        # What a driver may not see, and a viewer may. A vision process that starts slowly is a camera without pictures.
        assert alarms(gateway).keys() <= {"camera_stale"}

        number = len(config.read_text().split("\n"))
        config.write_text(f"{config.read_text()}max_viewers = 0\n")
        polls = len(plc.polls)
        gateway.process.send_signal(signal.SIGHUP)
        until(lambda: "configuration_not_loaded" in alarms(gateway))
        where = f"{config}:{number}: hmi.max_viewers = 0"
        assert where in gateway.stderr
        assert alarms(gateway)["configuration_not_loaded"].startswith(where[:120])
        assert not [poll for poll in plc.polls[polls:] if poll.image["stop"]]
        assert gateway.end() == 0
    assert len(list(recording.glob("*.seg"))) == 2  # of each recorder process
    replayed = command("replay", str(recording))  # no step is missing, and none was decided otherwise
    assert replayed.code == 0, replayed


@pytest.mark.long
def test_under_a_service_manager_a_faulty_file_is_waited_for(
    tmp_path: Path, video: Path, ranger: Ranger, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = config_file(tmp_path, video, ranger.port)
    good = config.read_text()
    config.write_text(good + "site = 1\n[hmi]\nport = 70000\n")
    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(60)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        with Gateway("run", str(config)) as gateway:
            status = manager.recv(4096).decode()
            assert status.startswith(f"STATUS=waits for its configuration to be mended: {config}:")
            gateway.process.send_signal(signal.SIGHUP)  # asks once more, and reports the same fault no second time
            threading.Event().wait(0.3)
            assert gateway.process.poll() is None
            assert gateway.stderr.count("waiting until the file is changed") == 1
            config.write_text(good)
            while "READY=1" not in (message := manager.recv(4096).decode()):
                assert "STATUS=waits" not in message
            assert gateway.end() == 0
        config.write_text("site = 1\n")
        with Gateway("run", str(config)) as gateway:
            while "STATUS=waits" not in manager.recv(4096).decode():  # the last ones of the gateway before
                pass
            gateway.process.terminate()
            assert gateway.process.wait(30) == -signal.SIGTERM
    monkeypatch.delenv("NOTIFY_SOCKET")
    assert command("run", str(config)).code == 2
