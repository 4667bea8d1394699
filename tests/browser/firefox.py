"""Debian's Firefox, driven by WebDriver BiDi (W3C), which it speaks itself: no driver program, no other library."""

import contextlib
import itertools
import json
import re
import subprocess
import tempfile
import time
from collections.abc import Iterator
from typing import Any

from websockets.sync.client import ClientConnection, connect

START_S = 60.0
ANSWER_S = 60.0
PREFERENCES = """\
user_pref("datareporting.policy.dataSubmissionEnabled", false);
user_pref("toolkit.telemetry.enabled", false);
user_pref("app.update.enabled", false);
user_pref("network.captive-portal-service.enabled", false);
user_pref("network.connectivity-service.enabled", false);
user_pref("browser.shell.checkDefaultBrowser", false);
"""


class Firefox:
    """One window. `complaints`: what the console got as an error, and exceptions of scripts."""

    def __init__(self, link: ClientConnection) -> None:
        self._link = link
        self._number = itertools.count(1)
        self.complaints: list[str] = []
        self.version = str(self._ask("session.new", capabilities={})["capabilities"]["browserVersion"])
        self._ask("session.subscribe", events=["log.entryAdded"])
        self._page = self._ask("browsingContext.getTree")["contexts"][0]["context"]

    def _ask(self, method: str, **params: Any) -> dict[str, Any]:
        number = next(self._number)
        self._link.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            message = json.loads(self._link.recv(timeout=ANSWER_S))
            if message.get("method") == "log.entryAdded" and message["params"]["level"] == "error":
                self.complaints.append(str(message["params"]["text"]))
            if message.get("id") == number:
                if message["type"] == "error":
                    raise RuntimeError(f"{method}: {message['message']}")
                result: dict[str, Any] = message["result"]
                return result

    def open(self, url: str) -> None:
        self._ask("browsingContext.navigate", context=self._page, url=url, wait="complete")

    def size(self, width_px: int, height_px: int) -> None:
        self._ask("browsingContext.setViewport", context=self._page, viewport={"width": width_px, "height": height_px})

    def evaluate(self, function: str) -> Any:
        """Of a function of JavaScript without arguments: what it returns as JSON."""
        made = self._ask(
            "script.evaluate",
            expression=f"Promise.resolve(({function})()).then((value) => JSON.stringify(value ?? null))",
            target={"context": self._page},
            awaitPromise=True,
        )
        if made["type"] != "success":
            raise RuntimeError(made["exceptionDetails"]["text"])
        return json.loads(made["result"]["value"])

    def until(self, function: str, within_s: float = 60.0) -> None:
        """Waits until it returns something true."""
        end = time.monotonic() + within_s
        while not self.evaluate(function):
            assert time.monotonic() < end, f"not within {within_s:g} s: {function}"
            time.sleep(0.1)


@contextlib.contextmanager
def firefox() -> Iterator[Firefox]:
    """Without a window on a screen, with a profile of its own."""
    with tempfile.TemporaryDirectory() as profile:
        with open(f"{profile}/user.js", "w", encoding="utf-8") as file:
            file.write(PREFERENCES)
        command = ["firefox-esr", "--headless", "--no-remote", "--profile", profile, "--remote-debugging-port", "0"]
        with subprocess.Popen([*command, "about:blank"], stderr=subprocess.PIPE, text=True) as running:
            assert running.stderr is not None
            try:
                for line in running.stderr:
                    if found := re.search(r"WebDriver BiDi listening on (ws://\S+)", line):
                        break
                else:
                    raise RuntimeError("Firefox ended without saying where it listens")
                with connect(f"{found[1]}/session", open_timeout=START_S, max_size=2**26, origin=None) as link:
                    yield Firefox(link)
            finally:
                running.kill()
