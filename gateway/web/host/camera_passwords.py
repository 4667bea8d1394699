"""Passwords of network cameras that were typed on a page: each in a file that only the gateway's user reads. IO.

A file serves the address that its password was typed for, and no other. One that the configuration does not name is
removed when the next one is kept.
"""

import secrets
from collections.abc import Iterable
from pathlib import Path

from gateway.errors import ConfigError
from gateway.files import write_file

FOLDER = "camera-passwords"  # below state_dir
MOST_WAITING = 4  # typed, and not saved yet


class CameraPasswords:
    """`addresses`: by path, of what was typed since the start."""

    def __init__(self) -> None:
        self.addresses: dict[str, str] = {}

    def keep(self, state: Path | None, url: str, password: str, named: Iterable[str]) -> Path:
        """`state`: the folder of `state_dir`. `named`: texts of configurations whose files stay. Raises ConfigError."""
        if state is None:
            raise ConfigError("state_dir: is empty; there is no folder for the camera's password")
        if not password or "\n" in password or "\r" in password or "@" in url.partition("://")[2].partition("/")[0]:
            raise ConfigError("camera.password_file: one line of text, for an address without a login")
        path = (state / FOLDER / secrets.token_hex(8)).absolute()
        texts = " ".join(named)
        while len(self.addresses) >= MOST_WAITING:
            self.addresses.pop(next(iter(self.addresses)))
        try:
            for other in path.parent.glob("*"):
                if str(other) not in self.addresses and str(other) not in texts:
                    other.unlink()
            write_file(path, f"{password}\n".encode())
        except (OSError, UnicodeError) as error:
            raise ConfigError(f"state_dir: the camera's password can't be kept: {error}") from None
        self.addresses[str(path)] = url
        return path
