"""Plays hostile clients of one door: many at a time, each from a loopback address of its own, each by one script.

A script is what one connection does, good or bad. It gets a `Connection` and a seeded `random.Random`; OSError (thrown
out) and TimeoutError end it, and another one begins. Runs in a process of its own at low priority: it stands for other
machines, which do not take the gateway's processor.
"""

import asyncio
import contextlib
import json
import os
import random
import signal
import socket
import struct
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field

LOW_PRIORITY = 15
PLAYING = "playing"
CONNECT_S = 2.0
SCRIPT_S = 15.0
FAMILIAR = 16  # addresses that come again and again, beside those that come once
RESET = struct.pack("ii", 1, 0)  # SO_LINGER: close with a reset


class WrongAnswerError(Exception):
    """The gateway answered what it must not."""


@dataclass
class Connection:
    """One connection to the gateway, and what this door's scripts share."""

    sock: socket.socket
    seen: Counter[str]

    async def send(self, data: bytes) -> None:
        await asyncio.get_running_loop().sock_sendall(self.sock, data)

    async def receive(self, most: int = 65536, within_s: float = 3.0) -> bytes:
        """b"": closed. Raises TimeoutError."""
        async with asyncio.timeout(within_s):
            return await asyncio.get_running_loop().sock_recv(self.sock, most)

    async def exactly(self, count: int, within_s: float = 3.0) -> bytes:
        """Raises ConnectionResetError if it is closed before."""
        data = b""
        while len(data) < count:
            more = await self.receive(count - len(data), within_s)
            if not more:
                raise ConnectionResetError
            data += more
        return data

    async def ragged(self, data: bytes, rng: random.Random) -> None:
        """In pieces of any size."""
        at = 0
        while at < len(data):
            size = rng.choice([1, 2, 7, 12, 100, 1000, 5000])
            await self.send(data[at : at + size])
            at += size
            await asyncio.sleep(0)

    async def slowly(self, data: bytes, pause_s: float) -> None:
        for at in range(len(data)):
            await self.send(data[at : at + 1])
            await asyncio.sleep(pause_s)

    async def until_closed(self, within_s: float = SCRIPT_S) -> None:
        while await self.receive(within_s=within_s):
            pass

    def reset(self) -> None:
        """Ends with a reset instead of an orderly close."""
        self.sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)


Script = Callable[[Connection, random.Random], Awaitable[None]]


@dataclass
class Door:
    """One port of the gateway, and what is played there: script -> weight."""

    name: str
    port: int
    scripts: Mapping[Script, float]
    clients: int = 32
    seen: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)

    async def play(self, seed: int) -> None:
        """Until cancelled."""
        async with asyncio.TaskGroup() as group:
            for number in range(self.clients):
                group.create_task(self._client(f"{self.name} {seed} {number}"))

    async def _client(self, seed: str) -> None:
        number = 0
        while True:
            rng = random.Random(f"{seed} {number}")
            number += 1
            (script,) = rng.choices(list(self.scripts), list(self.scripts.values()))
            name = getattr(script, "__name__", "script")
            with socket.socket() as sock:
                sock.setblocking(False)
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                if rng.random() < 0.3:
                    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
                try:
                    sock.bind((address(rng), 0))
                    async with asyncio.timeout(CONNECT_S):
                        await asyncio.get_running_loop().sock_connect(sock, ("127.0.0.1", self.port))
                    async with asyncio.timeout(SCRIPT_S):
                        await script(Connection(sock, self.seen), rng)
                    self.seen[name] += 1
                except WrongAnswerError as error:
                    self.wrong.append(f"{name}, {seed} {number - 1}: {error}")
                except TimeoutError:
                    self.seen[f"{name}: nothing came"] += 1
                except OSError:
                    self.seen[f"{name}: thrown out"] += 1
            await asyncio.sleep(rng.uniform(0, 0.05))


def address(rng: random.Random) -> str:
    """Of 127.0.0.0/8, but not those of honest programs (127.0.0.0/16)."""
    if rng.random() < 0.5:
        return f"127.1.0.{rng.randrange(1, FAMILIAR)}"
    return f"127.{rng.randrange(2, 255)}.{rng.randrange(256)}.{rng.randrange(1, 255)}"


def run(door: Door, seed: int) -> None:
    """In a process of its own, until SIGTERM: a line PLAYING on stdout, and a JSON line at the end."""
    os.nice(LOW_PRIORITY)

    async def main() -> None:
        playing = asyncio.current_task()
        assert playing is not None
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, playing.cancel)
        print(PLAYING, flush=True)
        await door.play(seed)

    with contextlib.suppress(asyncio.CancelledError):
        asyncio.run(main())
    print(json.dumps({"seen": door.seen, "wrong": door.wrong[:20], "wrong_count": len(door.wrong)}), flush=True)
