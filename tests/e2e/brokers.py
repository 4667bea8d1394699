"""A broker we did not write and a subscriber we did not write, as processes that can be killed and paused."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self, TypeVar

T = TypeVar("T")
# Debian keeps the broker where a user's PATH may not look; programs of Python packages are beside the interpreter.
SEARCH = os.pathsep.join(
    [str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath), "/usr/sbin", "/usr/local/sbin"]
)


class Address(Protocol):
    """Where a broker listens."""

    @property
    def host(self) -> str: ...
    @property
    def port(self) -> int: ...


def program(name: str, source: str = "apt-get install mosquitto mosquitto-clients") -> str:
    found = shutil.which(name, path=SEARCH)
    assert found is not None, f"{name} is missing: {source}"
    return found


class Mosquitto:
    """A context manager: mosquitto on a free loopback port, with its files in `folder`.

    What it must remember after `kill` it must have been `stop`ped with once: it saves its memory only then. It passes a
    message on before it acknowledges it. `users` (name -> password) shuts strangers out; `tls` is (certificate, key) in
    PEM files.
    """

    host = "127.0.0.1"

    def __init__(
        self,
        folder: Path,
        *,
        users: Mapping[str, str] | None = None,
        tls: tuple[Path, Path] | None = None,
        lines: Sequence[str] = (),
    ) -> None:
        self.lines = list(lines)  # more of mosquitto.conf
        self._folder = folder
        self._users = users
        self._tls = tls
        self._process: subprocess.Popen[bytes] | None = None
        self.port = 0

    @property
    def url(self) -> str:
        return f"{'mqtts' if self._tls else 'mqtt'}://127.0.0.1:{self.port}"

    @property
    def log(self) -> str:
        return (self._folder / "mosquitto.log").read_text()

    def __enter__(self) -> Self:
        for _ in range(5):  # another process may take the port between finding and using it
            self.port = free_port()
            try:
                self.start()
            except ChildProcessError:
                continue
            return self
        raise AssertionError(f"mosquitto does not start: {self.log}")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.kill()

    def start(self, timeout_s: float = 30.0) -> None:
        """On the same port as before; returns when it can be connected to."""
        assert self._process is None
        config = self._folder / "mosquitto.conf"
        config.write_text("\n".join(self._lines()) + "\n")
        with (self._folder / "mosquitto.log").open("ab") as log:
            self._process = subprocess.Popen(
                [program("mosquitto"), "-c", str(config)], stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            if self._process.poll() is not None:
                self._process = None
                raise ChildProcessError(self.log)
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    return
            time.sleep(0.02)
        raise AssertionError(f"mosquitto does not listen: {self.log}")

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    def stop(self) -> None:
        """The proper end: SIGTERM."""
        self._end(signal.SIGTERM)

    def kill(self) -> None:
        """SIGKILL; nothing is said to anybody."""
        self._end(signal.SIGKILL)

    def pause(self) -> None:
        """SIGSTOP: connections stay open, the system still accepts new ones, nobody answers."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)

    def reload(self, *lines: str) -> None:
        """With these lines of configuration instead of those given before."""
        assert self._process is not None
        self.lines = list(lines)
        (self._folder / "mosquitto.conf").write_text("\n".join(self._lines()) + "\n")
        self._process.send_signal(signal.SIGHUP)

    def resume(self) -> None:
        assert self._process is not None
        self._process.send_signal(signal.SIGCONT)

    def _end(self, number: int) -> None:
        if self._process is not None:
            self._process.send_signal(number)
            self._process.wait(10)
            self._process = None

    def _lines(self) -> list[str]:
        lines = [
            f"listener {self.port} 127.0.0.1",
            "log_dest stdout",
            "log_type all",
            "persistence true",
            f"persistence_location {self._folder}/",
            "autosave_interval 0",
            "max_queued_messages 0",  # 0: no limit, here and below
            "max_inflight_messages 0",
            f"allow_anonymous {'false' if self._users else 'true'}",
        ]
        if os.geteuid() == 0:
            lines.append("user root")  # else it gives its rights up and can't write into the folder
        if self._tls:
            lines += [f"certfile {self._tls[0]}", f"keyfile {self._tls[1]}"]
        if self._users:
            passwords = self._folder / "passwords"
            passwords.touch(mode=0o600)
            for name, password in self._users.items():
                subprocess.run([program("mosquitto_passwd"), "-b", str(passwords), name, password], check=True)
            lines.append(f"password_file {passwords}")
        return lines + self.lines


@dataclass(frozen=True)
class Received:
    topic: str
    retained: bool
    qos: int
    text: str
    arrived_s: float  # time.monotonic()

    @property
    def json(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.text)
        return found


class Subscriber:
    """A context manager: mosquitto_sub, whose messages are collected as they come; subscribed when entered.

    With a `session` name the broker keeps what the subscriber misses. It connects again by itself.
    """

    def __init__(self, broker: Address, *topics: str, session: str = "", args: tuple[str, ...] = ()) -> None:
        command = [program("mosquitto_sub"), "-h", broker.host, "-p", str(broker.port), "-q", "1", "-d"]
        command += ["-F", "| %r %q %t %p", *(["-c", "-i", session] if session else []), *args]
        for topic in topics or ("#",):
            command += ["-t", topic]
        self._command = [program("stdbuf"), "-oL", *command]
        self._changed = threading.Condition()
        self._subscribed = False
        self.messages: list[Received] = []
        self.other: list[str] = []

    def __enter__(self) -> Self:
        self._process = subprocess.Popen(
            self._command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        with self._changed:
            assert self._changed.wait_for(lambda: self._subscribed, 30), self.other
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.wait(10)
        self._reader.join(10)
        assert self._process.stdout is not None
        self._process.stdout.close()

    def on(self, suffix: str) -> list[Received]:
        """What came on topics that end so."""
        with self._changed:
            return [message for message in self.messages if message.topic.endswith(suffix)]

    def wait_for(self, wanted: Callable[[Received], bool], timeout_s: float = 30.0) -> Received:
        """The first message so far, or to come, that `wanted` accepts."""
        return self.wait_until(lambda: next(filter(wanted, self.messages), None), timeout_s)

    def wait_until(self, found: Callable[[], T | None], timeout_s: float = 30.0) -> T:
        """What `found` returns, as soon as that is neither None nor false; asked anew with every message."""
        with self._changed:
            self._changed.wait_for(lambda: bool(found()), timeout_s)
            result = found()
        assert result, f"not seen in {timeout_s} s; last messages: {self.messages[-3:]}; {self.other[-5:]}"
        return result

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._changed:
                if line.startswith("| "):
                    _, retained, qos, topic, text = line.rstrip("\n").split(" ", 4)
                    self.messages.append(Received(topic, retained == "1", int(qos), text, time.monotonic()))
                else:
                    self.other.append(line)
                    self._subscribed = self._subscribed or line.startswith("Subscribed")
                self._changed.notify_all()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
