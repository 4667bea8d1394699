"""A bad network between two honest programs: a TCP proxy that delays, throttles, swallows, cuts and refuses. Seeded.

What TCP delivers is only held back, cut off or lost with its connection, as by a bad network; never altered, unless a
test sets `alter`.
"""

import random
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

CHUNK = 65_536


@dataclass(frozen=True)
class NetworkConditions:
    """What the network is like. `cut_share`: chance that a connection is cut with each chunk that passes."""

    delay_s: float = 0.0
    jitter_s: float = 0.0
    bytes_per_s: float = 0.0  # 0: no limit
    cut_share: float = 0.0
    swallow: bool = False  # connections stand, nothing comes through any more
    refuse: bool = False  # new connections are closed at once


@dataclass
class _Pipe:
    source: socket.socket
    sink: socket.socket
    connection: int
    out: bool  # from the client
    waiting: deque[tuple[float, bytes]] = field(default_factory=deque)
    free_s: float = 0.0  # when the line can carry the next byte


class Proxy:
    """A context manager: a listener on a free loopback port in front of `target`; one thread serves it."""

    def __init__(self, target: int, *, conditions: NetworkConditions | None = None, seed: int = 1) -> None:
        self.target = target
        self.conditions = conditions or NetworkConditions()
        self.on_data: Callable[[int, bool, bytes], None] | None = None  # connection, from the client, data
        self.alter: Callable[[bool, bytes], bytes] | None = None  # from the client, data
        self.connections = 0
        self.cuts = 0
        self._random = random.Random(seed)
        self._pipes: list[_Pipe] = []
        self._over = False
        self._cut_all = False

    def __enter__(self) -> Self:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over = True
        self._thread.join(10)
        self._listener.close()

    def cut(self) -> None:
        """Cut every connection that stands now, without a word to either side."""
        self._cut_all = True

    def _run(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._listener, selectors.EVENT_READ)
            while not self._over:
                if self._cut_all:
                    self._cut_all = False
                    for pipe in list(self._pipes):
                        self._drop(pipe, selector)
                for key, _ in selector.select(0.002 if any(p.waiting for p in self._pipes) else 0.02):
                    if key.fileobj is self._listener:
                        self._accept(selector)
                    elif isinstance(key.data, _Pipe) and key.data in self._pipes:
                        self._take(key.data, selector)
                for pipe in list(self._pipes):
                    self._pass_on(pipe, selector)
            for pipe in list(self._pipes):
                self._drop(pipe, selector)

    def _accept(self, selector: selectors.BaseSelector) -> None:
        try:
            near, _ = self._listener.accept()
        except BlockingIOError:
            return
        if self.conditions.refuse:
            near.close()
            return
        try:
            far = socket.create_connection(("127.0.0.1", self.target), timeout=1)
        except OSError:
            near.close()
            return
        self.connections += 1
        for sock in (near, far):
            sock.setblocking(False)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for source, sink in ((near, far), (far, near)):
            pipe = _Pipe(source, sink, self.connections, source is near)
            self._pipes.append(pipe)
            selector.register(source, selectors.EVENT_READ, pipe)

    def _take(self, pipe: _Pipe, selector: selectors.BaseSelector) -> None:
        conditions = self.conditions
        try:
            data = pipe.source.recv(CHUNK if not conditions.bytes_per_s else 1024)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(pipe, selector)
            return
        if conditions.swallow:
            return
        if self.on_data is not None:
            self.on_data(pipe.connection, pipe.out, data)
        if self._random.random() < conditions.cut_share:
            self.cuts += 1
            self._drop(pipe, selector)
            return
        if self.alter is not None:
            data = self.alter(pipe.out, data)
        begun = max(time.monotonic(), pipe.free_s)
        line_s = len(data) / conditions.bytes_per_s if conditions.bytes_per_s else 0.0
        pipe.free_s = begun + line_s
        pipe.waiting.append((pipe.free_s + conditions.delay_s + self._random.random() * conditions.jitter_s, data))

    def _pass_on(self, pipe: _Pipe, selector: selectors.BaseSelector) -> None:
        while pipe.waiting and pipe.waiting[0][0] <= time.monotonic():
            due_s, data = pipe.waiting.popleft()
            try:
                sent = pipe.sink.send(data)
            except BlockingIOError:
                sent = 0
            except OSError:
                self._drop(pipe, selector)
                return
            if sent < len(data):
                pipe.waiting.appendleft((due_s, data[sent:]))
                return

    def _drop(self, pipe: _Pipe, selector: selectors.BaseSelector) -> None:
        """Both directions of the connection; what was on its way is lost."""
        for other in [p for p in self._pipes if p.source in (pipe.source, pipe.sink)]:
            self._pipes.remove(other)
            selector.unregister(other.source)
            other.source.close()
