"""Tasks of a batch that end their process, raise, or give a text back."""

import os
import signal
from pathlib import Path

from gateway.errors import ConfigError
from gateway.processes.batch import BatchTask, TaskDone, serve
from gateway.processes.channel import Channel
from gateway.processes.codec import Codec


class Say(BatchTask, frozen=True, kw_only=True):
    """`dies`: so often, before it says `what`."""

    what: str
    dies: int = 0


CODEC = Codec(Say)


def run(channel: Channel[TaskDone, BatchTask], task: Say) -> None:
    serve(channel, task)


def work(task: Say) -> str:
    deaths = Path(task.results) / f"{task.what}.deaths"
    known = len(deaths.read_text()) if deaths.exists() else 0
    if known < task.dies:
        deaths.write_text("x" * (known + 1))
        os.kill(os.getpid(), signal.SIGKILL)
    if task.what == "wrong":
        raise ConfigError("wrong: edit it")
    if task.what == "unread":
        Path(task.results, "nowhere").read_bytes()
    return f"{task.after}{task.what}"
