"""Hostile clients of Modbus/TCP Security: handshakes that are broken, slow, abandoned or without a right certificate.

A client with a viewer's certificate may read: what it sends within TLS is judged as by bench/hostile/modbus.py.
"""

import contextlib
import random
import ssl
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path

from bench.hostile import modbus
from bench.hostile.client import Connection, Script


@dataclass
class Within(Connection):
    """The same, within TLS: `start` is the handshake."""

    context: ssl.SSLContext | None = None

    async def start(self) -> None:
        assert self.context is not None
        self._come, self._go = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = self.context.wrap_bio(self._come, self._go, server_hostname="127.0.0.1")
        await self._done(self._tls.do_handshake)

    async def send(self, data: bytes) -> None:
        await self._done(lambda: self._tls.write(data))
        await self._flush()

    async def receive(self, most: int = 65536, within_s: float = 3.0) -> bytes:
        return await self._done(lambda: self._tls.read(most), within_s)

    async def _flush(self) -> None:
        if out := self._go.read():
            await super().send(out)

    async def _done(self, work: Callable[[], object], within_s: float = 3.0) -> bytes:
        while True:
            try:
                result = work()
            except ssl.SSLWantReadError:
                await self._flush()
                came = await super().receive(within_s=within_s)
                if not came:
                    raise ConnectionResetError from None
                self._come.write(came)
            except ssl.SSLError as error:
                raise ConnectionResetError from error
            else:
                await self._flush()
                return result if isinstance(result, bytes) else b""


def context(ca: Path, certificate: tuple[Path, Path] | None = None) -> ssl.SSLContext:
    """Of a client that trusts `ca`, with (certificate, key)."""
    made = ssl.create_default_context(cafile=str(ca))
    if certificate is not None:
        made.load_cert_chain(*map(str, certificate))
    return made


def hello(rng: random.Random) -> bytes:
    """A client's first flight, as a library makes it."""
    come, go = ssl.MemoryBIO(), ssl.MemoryBIO()
    made = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    made.check_hostname, made.verify_mode = False, ssl.CERT_NONE
    if rng.random() < 0.3:
        made.maximum_version = ssl.TLSVersion.TLSv1_2
    with contextlib.suppress(ssl.SSLWantReadError):
        made.wrap_bio(
            come, go, server_hostname=rng.choice([None, "127.0.0.1", ".".join(["x" * 60] * 3)])
        ).do_handshake()
    return go.read()


def mutated(data: bytes, rng: random.Random) -> bytes:
    """Bits flipped, numbers set to their limits, parts cut out, doubled or made longer."""
    changed = bytearray(data)
    for _ in range(rng.randrange(1, 6)):
        at = rng.randrange(len(changed))
        match rng.randrange(5):
            case 0:
                changed[at] ^= 1 << rng.randrange(8)
            case 1:
                changed[at] = rng.choice([0, 1, 0x7F, 0x80, 0xFF])
            case 2:
                del changed[at : at + rng.randrange(1, 20)]
            case 3:
                changed[at:at] = changed[at : at + rng.randrange(1, 40)]
            case _:
                changed[at:at] = rng.randbytes(rng.randrange(1, 40))
        if not changed:
            return data
    return bytes(changed)


def scripts(ca: Path, viewer: tuple[Path, Path], stranger: tuple[Path, Path]) -> dict[Script, float]:
    """`viewer` may read; `stranger` is a certificate of another authority."""
    known, unknown, foreign = context(ca, viewer), context(ca), context(ca, stranger)

    def within(made: ssl.SSLContext, script: Script) -> Callable[[Connection, random.Random], Awaitable[None]]:
        async def play(connection: Connection, rng: random.Random) -> None:
            inner = Within(connection.sock, connection.seen, made)
            await inner.start()
            await script(inner, rng)

        play.__name__ = f"within TLS: {script.__name__}" if made is known else "TLS without a right certificate"
        return play

    async def mutated_hello(connection: Connection, rng: random.Random) -> None:
        await connection.ragged(mutated(hello(rng), rng), rng)
        await connection.until_closed()

    async def half_hello(connection: Connection, rng: random.Random) -> None:
        first = hello(rng)
        await connection.send(first[: rng.randrange(1, len(first))])
        await connection.until_closed()

    async def slow_hello(connection: Connection, rng: random.Random) -> None:
        await connection.slowly(hello(rng), rng.choice([0.001, 0.02, 0.1]))
        await connection.until_closed()

    async def only_hello(connection: Connection, rng: random.Random) -> None:
        await connection.send(hello(rng))
        connection.reset()

    async def records(connection: Connection, rng: random.Random) -> None:
        for _ in range(rng.randrange(1, 10)):
            size = rng.choice([0, 1, 100, 16384, 16385, 65535])
            body = rng.randbytes(min(size, rng.choice([0, 10, 20000])))
            await connection.send(
                bytes([rng.choice([20, 21, 22, 23, 24, 255]), 3, rng.randrange(5)]) + size.to_bytes(2, "big") + body
            )
        await connection.until_closed()

    async def broken_record(connection: Connection, rng: random.Random) -> None:
        inner = Within(connection.sock, connection.seen, known)
        await inner.start()
        await connection.send(b"\x17\x03\x03\x00\x30" + rng.randbytes(0x30))
        await connection.until_closed()

    return {
        within(known, modbus.polls): 3, within(known, modbus.fuzz): 4, within(known, modbus.half_frame): 1,
        within(known, modbus.never_reads): 1, within(unknown, modbus.polls): 2, within(foreign, modbus.polls): 2,
        mutated_hello: 5, half_hello: 2, slow_hello: 2, only_hello: 4, records: 2, broken_record: 2,
        modbus.random_bytes: 1, modbus.polls: 1, modbus.idle: 1,
    }  # fmt: skip
