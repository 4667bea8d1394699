"""A faulty configuration is waited for; a gateway that found a fault pauses before it is started again."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

import pytest

from gateway.cli import awaited_config

WAITING = """
import sys
from pathlib import Path
from gateway.cli import awaited_config
from gateway.errors import ConfigError

path = Path(sys.argv[1])

def load():
    if path.read_text() == "faulty":
        raise ConfigError("faulty")

awaited_config.LOOK_S = 0.001
awaited_config.wait_for_valid_config(load, path)
"""


@pytest.mark.long
@pytest.mark.one_interpreter
def test_no_number_of_reload_requests_hangs_the_wait(tmp_path: Path) -> None:
    """A handler that takes a lock (threading.Event.set) hangs in the thread that it interrupts, sooner or later."""
    path = tmp_path / "g.toml"
    path.write_text("faulty")
    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(30)
        environment = {**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify")}
        with subprocess.Popen([sys.executable, "-c", WAITING, str(path)], env=environment) as process:
            try:
                assert manager.recv(4096).startswith(b"STATUS=waits")
                for _ in range(200_000):
                    process.send_signal(signal.SIGHUP)
                path.write_text("good")
                assert process.wait(10) == 0
            finally:
                process.kill()


@pytest.mark.parametrize(("found", "looks"), [([1] * 100, 1 + 8), ([1, 1, 2, 2], 1 + 2)])
def test_it_lasts_eight_looks_or_until_the_file_is_changed(
    monkeypatch: pytest.MonkeyPatch, found: list[int], looks: int
) -> None:
    seen: list[Path] = []

    def stamps(paths: Iterable[str]) -> int:
        seen.extend(map(Path, paths))
        return found[len(seen) - 1]

    monkeypatch.setattr(awaited_config, "stamps", stamps)
    monkeypatch.setattr(awaited_config, "LOOK_S", 0.001)
    monkeypatch.setattr(awaited_config, "PAUSE_S", 0.008)
    awaited_config.pause(Path("g.toml"))
    assert seen == [Path("g.toml")] * looks
