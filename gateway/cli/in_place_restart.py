"""Start this program again in its own place, as it was started: same process id, same arguments, after a clean end."""

import atexit
import os
import sys
from collections.abc import Mapping


class InPlaceRestart:
    """To be made before anything else that does its last work at the interpreter's end: that is done before.

    The process stays, and with it what its starter knows of it: a service manager, a terminal, a container.
    """

    def __init__(self) -> None:
        self.environment: dict[str, str] = {}
        self._requested = False
        atexit.register(self._replace)

    def request(self, environment: Mapping[str, str]) -> None:
        """`environment`: variables that this process has removed from its own."""
        self._requested = True
        self.environment = dict(environment)

    def _replace(self) -> None:
        """Does not return, or raises OSError: then the process ends, and its service manager starts it again."""
        if self._requested:
            os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], {**os.environ, **self.environment})
