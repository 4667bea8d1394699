"""Debian's PostgreSQL as a process that can be killed and paused, on a folder of its own, and psql to look into it.

The server refuses to run as root: there, it runs as the user `nobody`.
"""

import contextlib
import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import psutil

from tests.e2e.brokers import free_port

USER, PASSWORD = "gateway", "s/e:c@r#t 1"
PASSWORD_IN_URL = "s%2Fe%3Ac%40r%23t%201"
QUICK = ("shared_buffers = 16MB", "fsync = off", "max_connections = 20", "autovacuum = off")


def program(name: str) -> str:
    """Debian keeps one folder for each version, beside the PATH."""
    found = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"), key=lambda path: float(path.parts[-3]))
    assert found, f"{name} is missing: apt-get install postgresql"
    return str(found[-1])


class Postgres:
    """A context manager: a server on a free loopback port, with the superuser `gateway` and one database, `plant`.

    After SIGKILL it has what it had acknowledged: with `fsync` off, too, as long as the machine runs.
    """

    def __init__(self, *, tls: tuple[Path, Path] | None = None, lines: Sequence[str] = ()) -> None:
        self.lines = list(lines)  # more of postgresql.conf
        self._tls = tls
        self._process: subprocess.Popen[bytes] | None = None
        self.port = 0

    @property
    def url(self) -> str:
        return f"postgresql://{USER}:{PASSWORD_IN_URL}@127.0.0.1:{self.port}/plant"

    @property
    def log(self) -> str:
        return (self.folder / "log").read_text(errors="replace")

    def __enter__(self) -> Self:
        # Not below pytest's folders, which are closed to the user that the server runs as.
        self.folder = Path(tempfile.mkdtemp(prefix="postgres-"))
        self._data = self.folder / "data"
        (self.folder / "password").write_text(PASSWORD + "\n")
        if self._tls is not None:
            for name, source in zip(("server.crt", "server.key"), self._tls, strict=True):
                shutil.copyfile(source, self.folder / name)
                (self.folder / name).chmod(0o600)
        if os.geteuid() == 0:
            nobody = pwd.getpwnam("nobody")
            for path in (self.folder, *self.folder.iterdir()):
                os.chown(path, nobody.pw_uid, nobody.pw_gid)
        try:
            made = self._run("initdb", "-D", str(self._data), "-U", USER, "-E", "UTF8", "--locale=C.UTF-8", "--no-sync",
                             "--auth=scram-sha-256", f"--pwfile={self.folder / 'password'}")  # fmt: skip
            assert made.returncode == 0, made.stdout
            for _ in range(5):  # another process may take the port between finding and using it
                self.port = free_port()
                with contextlib.suppress(ChildProcessError):
                    self.start()
                    break
            else:
                raise AssertionError(f"PostgreSQL does not start: {self.log}")
            self.sql("CREATE DATABASE plant", database="postgres")
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process is not None:
            self._end(signal.SIGQUIT)
        shutil.rmtree(self.folder, ignore_errors=True)

    def start(self, timeout_s: float = 30.0) -> None:
        """On the same port as before; returns when it answers."""
        assert self._process is None
        lines = [
            *QUICK, f"port = {self.port}", "listen_addresses = '127.0.0.1'",
            f"unix_socket_directories = '{self.folder}'", *self.lines,
        ]  # fmt: skip
        if self._tls is not None:
            lines += ["ssl = on", f"ssl_cert_file = '{self.folder}/server.crt'",
                      f"ssl_key_file = '{self.folder}/server.key'"]  # fmt: skip
        config = self.folder / "postgresql.conf"
        config.write_text("\n".join(lines) + "\n")
        config.chmod(0o644)
        files = ["-c", f"hba_file={self._data}/pg_hba.conf", "-c", f"ident_file={self._data}/pg_ident.conf"]
        with (self.folder / "log").open("ab") as log:
            self._process = subprocess.Popen(
                [program("postgres"), "-D", str(self._data), "-c", f"config_file={config}", *files],
                cwd=self.folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log, **_USER,
            )  # fmt: skip
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            if self._process.poll() is not None:
                self._process = None
                raise ChildProcessError(self.log)
            if self._run("pg_isready", "-q", "-h", "127.0.0.1", "-p", str(self.port)).returncode == 0:
                return
            time.sleep(0.02)
        raise AssertionError(f"PostgreSQL does not answer: {self.log}")

    def stop(self) -> None:
        """The proper end: clients are disconnected."""
        self._end(signal.SIGINT)

    def kill(self) -> None:
        """SIGKILL of the server and of all processes that serve its clients."""
        self._signal(signal.SIGKILL)
        self._ended()

    def pause(self) -> None:
        """SIGSTOP: connections stay open, the system still accepts new ones, nobody answers."""
        self._signal(signal.SIGSTOP)

    def resume(self) -> None:
        self._signal(signal.SIGCONT)

    def sql(self, text: str, *, database: str = "plant") -> list[list[str]]:
        """The rows that psql prints, as text; NULL is empty."""
        done = self._run(
            "psql", "-X", "-q", "-v", "ON_ERROR_STOP=1", "-A", "-t", "-F", "\x1f", "-h", "127.0.0.1",
            "-p", str(self.port), "-U", USER, "-d", database, "-f", "-", stdin=text,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout
        return [line.split("\x1f") for line in done.stdout.splitlines()]

    def _run(self, *command: str, stdin: str = "") -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "PGPASSWORD": PASSWORD, "PGCONNECT_TIMEOUT": "20"}
        return subprocess.run(
            [program(command[0]), *command[1:]], cwd=self.folder, env=environment, input=stdin, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=60, check=False, **_USER,
        )  # fmt: skip

    def _end(self, number: int) -> None:
        assert self._process is not None
        self._signal(signal.SIGCONT)
        self._process.send_signal(number)
        try:
            self._ended()
        except subprocess.TimeoutExpired:
            self.kill()

    def _ended(self) -> None:
        assert self._process is not None
        self._process.wait(20)
        self._process = None

    def _signal(self, number: int) -> None:
        """To the server and to the processes that serve its clients, each of which is a session of its own."""
        assert self._process is not None
        server = psutil.Process(self._process.pid)
        for process in (server, *server.children()):
            with contextlib.suppress(psutil.NoSuchProcess):
                process.send_signal(number)


_USER: dict[str, Any] = (
    {"user": "nobody", "group": pwd.getpwnam("nobody").pw_gid, "extra_groups": []} if os.geteuid() == 0 else {}
)
