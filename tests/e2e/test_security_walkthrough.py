"""The commands of docs/modbus-security.md, run as they stand there, but for the ports."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.e2e.brokers import free_port

PAGE = Path(__file__).parents[2] / "docs" / "modbus-security.md"
WAIT = "for _ in $(seq 300); do (exec 3<>/dev/tcp/127.0.0.1/{port}) 2>/dev/null && break; sleep 0.1; done"


def commands() -> list[str]:
    """Each command with the lines that belong to it (here-documents), in order."""
    found: list[str] = []
    for block in re.findall(r"^```console\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
        for line in block.splitlines():
            if line.startswith("$ "):
                found.append(line[2:])
            else:
                found[-1] += f"\n{line}"
    return found


@pytest.fixture
def shell(tmp_path: Path) -> "Shell":
    return Shell(tmp_path)


class Shell:
    """Runs commands one after another in one folder; what ends in & goes on until the end."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._ports = {port: str(free_port()) for port in ("8802", "5020", "5802", "5803")}
        self._env = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}:/usr/sbin:/sbin"}
        self._behind: list[subprocess.Popen[bytes]] = []

    def run(self, command: str) -> str:
        for wanted, port in self._ports.items():
            command = re.sub(rf"\b{wanted}\b", port, command)
        if command.endswith("&"):
            log = (self._folder / f"behind{len(self._behind)}.log").open("wb")
            with log:
                self._behind.append(
                    subprocess.Popen(
                        ["bash", "-c", f"exec {command[:-1]}"], cwd=self._folder, env=self._env, start_new_session=True,
                        stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                    )
                )  # fmt: skip
            return self._wait(command)
        done = subprocess.run(
            ["bash", "-c", command], cwd=self._folder, env=self._env, capture_output=True, text=True, timeout=60,
            check=False,
        )  # fmt: skip
        logs = "".join(path.read_text(errors="replace")[-2000:] for path in self._folder.glob("behind*.log"))
        assert done.returncode == 0, f"$ {command}\n{done.stdout}{done.stderr}\n{logs}"
        return done.stdout + done.stderr

    def _wait(self, command: str) -> str:
        listening = re.search(r"TCP-LISTEN:(\d+)", command)
        port = listening[1] if listening else self._ports["8802"]
        return self.run(WAIT.format(port=port))

    def end(self) -> None:
        for process in self._behind:
            os.killpg(process.pid, signal.SIGTERM)
        for process in self._behind:
            process.wait(20)


def test_the_page_does_what_it_says(shell: Shell) -> None:
    said: list[str] = []
    try:
        for command in commands():
            said.append(shell.run(command))
    finally:
        shell.end()
    init, server, operator, viewer, listed, _, check, _, tls, _, read, refused, _, written, *rest = said
    back, plain, unwritten = rest
    assert "certs/ca.key: signs any certificate" in init
    assert 'cert = "certs/gateway.pem"' in server
    assert "role operator" in operator
    assert "role viewer" in viewer
    assert re.search(r"^hmi1 +viewer .*\nplc1 +operator ", listed, re.MULTILINE)
    assert "secure.toml: good" in check
    assert "Verification: OK" in tls
    assert "Protocol version: TLSv1.3" in tls
    assert len(re.findall(r"^\[\d\]:", read, re.MULTILINE)) == 8
    assert "Illegal function" in refused
    assert "Written 1 references" in written
    assert re.search(r"^\[80\]:\s+4711$", back, re.MULTILINE)
    assert re.search(r"^\[80\]:\s+4711$", plain, re.MULTILINE)
    assert "Illegal function" in unwritten
