"""OPC UA clients that others wrote, each in a process of its own: open62541 (the wheel o6, which ends by itself after
ten minutes) and node-opcua (`./dev test` installs it).

A command is a line of JSON, `{"do": name, ...}`; the answer a line that begins with `> `.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
PROGRAMS = {
    "open62541": [sys.executable, str(HERE / "open62541_client.py")],
    "node-opcua": ["node", str(HERE / "node_opcua_client.js")],
}


class CommandError(Exception):
    """What the client reports; `code` is the status code, where it names one."""

    def __init__(self, text: str, code: int | None) -> None:
        super().__init__(text)
        self.code = code


class Client:
    def __init__(self, name: str) -> None:
        self._process = subprocess.Popen(
            PROGRAMS[name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )

    def __call__(self, do: str, **what: Any) -> Any:
        """Raises CommandError."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"do": do} | what) + "\n")
        self._process.stdin.flush()
        for line in self._process.stdout:
            if line.startswith("> "):
                answer = json.loads(line[2:])
                if "error" in answer:
                    raise CommandError(answer["error"], answer["code"])
                return answer["answer"]
        raise CommandError("the client has ended", None)

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
