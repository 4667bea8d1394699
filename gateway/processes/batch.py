"""Work in many small tasks by several processes, each result one file. IO.

A task is data and is done anew anywhere with the same result: where a process has died, another one does its task. A
result's file is named by all that it depends on, so what is there is taken and never written otherwise.
"""

import os
import socket
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import msgspec

from gateway import __version__
from gateway.errors import ConfigError, LinkError, ProtocolError
from gateway.files import replacing
from gateway.processes.channel import Channel
from gateway.processes.codec import Codec, Message


class BatchTask(Message, frozen=True, kw_only=True):
    """The base of a task. `results`: the folder of the files. `after`: the result of the task before it; empty:
    there is none."""

    results: str
    after: str = ""


class TaskDone(Message, frozen=True):
    result: str  # name of its file


class Workers(Protocol):
    """Who does tasks: `submitted` with a number, in any order; `done` gives number and result until none is left."""

    def submit(self, number: int, task: BatchTask) -> None: ...

    def done(self) -> Iterator[tuple[int, str]]: ...


def in_turn(chains: Sequence[Sequence[BatchTask]], workers: Workers, advance: Callable[[int], None]) -> list[list[str]]:
    """The results of all tasks, by chain: a task begins when the one before it in its chain is done. `advance`: is
    called with the chain's number for each."""
    found: list[list[str]] = [[] for _ in chains]
    for number, chain in enumerate(chains):
        workers.submit(number, chain[0])
    for number, result in workers.done():
        found[number].append(result)
        advance(number)
        at = len(found[number])
        if at < len(chains[number]):
            workers.submit(number, msgspec.structs.replace(chains[number][at], after=result))
    return found


def name_of(*parts: object) -> str:
    """Of a result, by all that it depends on, the program's version among it."""
    return sha256(msgspec.msgpack.encode((__version__, *parts))).hexdigest()


def kept(folder: str, name: str, codec: Codec) -> Any:
    """That result; None: it is not there, or damaged. Raises OSError."""
    with suppress(FileNotFoundError, ProtocolError):
        return codec.unpacked(_path(folder, name).read_bytes())
    return None


def taken(folder: str, name: str, codec: Codec) -> Any:
    """That result, which has been written. Raises LinkError, OSError."""
    found = kept(folder, name, codec)
    if found is None:
        raise LinkError(f"{folder}: a result that was written is not there: do all workers see this folder?")
    return found


def keep(folder: str, name: str, result: Message) -> None:
    """On disk when it returns, whoever else writes the same. Raises OSError."""
    path = _path(folder, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_name(f"{name}.{socket.gethostname()}.{os.getpid()}.new")
    with replacing(path, 0o644, fresh=fresh) as file:
        file.write(Codec.packed(result))


def _path(folder: str, name: str) -> Path:
    return Path(folder) / name[:2] / name


def answer(module: str, data: bytes) -> str:
    """Does a task of this module, in any process: its `CODEC` reads it, its `work` does it. Raises LinkError."""
    found = import_module(module)
    task: BatchTask = found.CODEC.unpacked(data)
    try:
        return str(found.work(task))
    except OSError as error:
        raise LinkError(f"{error.filename}: {error.strerror}") from error


def answer_elsewhere(module: str, data: bytes, version: str) -> str:
    """`answer` on a machine that may have another version. Raises ConfigError, too."""
    if version != __version__:
        raise ConfigError(f"{socket.gethostname()} has version {__version__}, and {version} asks: use one version")
    return answer(module, data)


def serve(channel: Channel[TaskDone, BatchTask], task: BatchTask) -> None:
    """In a process of its own: this task, and what comes then. `channel`'s codec is that of the tasks' module."""
    while True:
        channel.send(TaskDone(answer(type(task).__module__, Codec.packed(task))))
        task = channel.receive()


@dataclass(slots=True)
class ThisProcess:
    """Does the tasks by itself, one after the other."""

    module: str
    _tasks: deque[tuple[int, BatchTask]] = field(default_factory=deque)

    def submit(self, number: int, task: BatchTask) -> None:
        self._tasks.append((number, task))

    def done(self) -> Iterator[tuple[int, str]]:
        while self._tasks:
            number, task = self._tasks.popleft()
            yield number, answer(self.module, Codec.packed(task))

    def close(self) -> None:
        pass
