"""A hostile MQTT broker: the gateway is its client. Each connection is answered rightly for a while, then is not."""

import asyncio
import contextlib
import json
import os
import random
import signal
from collections import Counter

from bench.hostile.client import LOW_PRIORITY, PLAYING
from bench.hostile.tls import mutated

HONEST_SHARE = 0.15
TOPICS = ["spBv1.0/site1/NCMD/proof", "spBv1.0/site1/DCMD/proof/bay1", "spBv1.0/STATE/host", "STATE/host", "x", ""]


def size_of(length: int) -> bytes:
    out = b""
    while True:
        length, low = length >> 7, length & 127
        out += bytes([low | (128 if length else 0)])
        if not length:
            return out


def packet(first: int, body: bytes) -> bytes:
    return bytes([first]) + size_of(len(body)) + body


def text(value: str | bytes) -> bytes:
    data = value.encode() if isinstance(value, str) else value
    return len(data).to_bytes(2, "big") + data


class HostileBroker:
    """`seen`: what was played, and how often the gateway came."""

    def __init__(self, seed: int) -> None:
        self._rng = random.Random(f"broker {seed}")
        self.seen: Counter[str] = Counter()

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        rng = random.Random(self._rng.random())
        self.seen["connections"] += 1
        try:
            async with asyncio.timeout(rng.uniform(1, 15)):
                await self._connection(reader, writer, rng)
        except (OSError, TimeoutError, asyncio.IncompleteReadError, IndexError, asyncio.CancelledError):
            pass  # this connection's end, or the program's
        finally:
            writer.transport.abort()

    async def _connection(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, rng: random.Random) -> None:
        _, body = await self._packet(reader)
        level = body[6] if len(body) > 6 else 4
        properties = b"\0" if level == 5 else b""
        deed = rng.choice(
            ["refuse", "silent", "random", "wrong length", "huge", "flood", "flood", "mutate", "mutate", "acks", "deaf",
             "byte by byte", "disconnect", "close"]
        )  # fmt: skip
        if rng.random() < HONEST_SHARE:
            deed = "honest"
        self.seen[deed] += 1
        match deed:
            case "silent":
                await reader.read(-1)
            case "refuse":
                writer.write(packet(0x20, bytes([0, rng.randrange(256)]) + properties))
                await writer.drain()
                return
            case "random":
                writer.write(rng.randbytes(rng.randrange(1, 3000)))
                await reader.read(-1)
        writer.write(packet(0x20, bytes([0, 0]) + properties))
        worse = asyncio.get_running_loop().create_task(self._worse(deed, writer, rng, level))
        try:
            while deed != "deaf":
                first, body = await self._packet(reader)
                for answer in self._answers(first, body, properties):
                    out = mutated(answer, rng) if deed == "mutate" and rng.random() < 0.3 else answer
                    if deed == "byte by byte":
                        for at in range(len(out)):
                            writer.write(out[at : at + 1])
                            await asyncio.sleep(0.005)
                    else:
                        writer.write(out)
                await writer.drain()
            await asyncio.sleep(60)
        finally:
            worse.cancel()

    def _answers(self, first: int, body: bytes, properties: bytes) -> list[bytes]:
        kind = first >> 4
        if kind == 8:  # SUBSCRIBE: granted
            at, granted = 2 + (1 + body[2] if properties else 0), b""
            while at < len(body):
                at += 2 + int.from_bytes(body[at : at + 2], "big") + 1
                granted += b"\1"
            return [packet(0x90, body[:2] + properties + granted)]
        if kind == 3 and first & 6:  # PUBLISH with an acknowledgement
            length = int.from_bytes(body[:2], "big")
            return [packet(0x40, body[2 + length : 4 + length])]
        return [packet(0xD0, b"")] if kind == 12 else []

    async def _worse(self, deed: str, writer: asyncio.StreamWriter, rng: random.Random, level: int) -> None:
        await asyncio.sleep(rng.uniform(0, 3))
        properties = b"\0" if level == 5 else b""
        match deed:
            case "wrong length":
                writer.write(b"\x30\xff\xff\xff\xff\xff\xff")
            case "huge":
                writer.write(b"\x30" + size_of(268_435_455) + text(TOPICS[0]) + properties)
                while True:
                    writer.write(bytes(60_000))
                    await writer.drain()
                    await asyncio.sleep(0.01)
            case "flood":
                while True:
                    topic, payload = rng.choice(TOPICS), rng.randbytes(rng.choice([0, 1, 20, 300, 60_000]))
                    if rng.random() < 0.3:
                        payload = json.dumps(
                            {"online": rng.random() < 0.5, "timestamp": rng.randrange(1 << 63)}
                        ).encode()
                    qos = rng.randrange(4)
                    mid = rng.randbytes(2) if qos else b""
                    writer.write(packet(0x30 | qos << 1 | rng.randrange(2), text(topic) + mid + properties + payload))
                    await writer.drain()
            case "mutate":
                while True:
                    whole = packet(0x30, text(rng.choice(TOPICS)) + properties + rng.randbytes(30))
                    writer.write(mutated(whole, rng))
                    await asyncio.sleep(0.1)
            case "acks":
                while True:
                    kind = rng.choice([0x40, 0x50, 0x62, 0x70, 0x90, 0xB0, 0xD0, 0x20, 0xE0, 0xF0, 0x00, 0x10])
                    writer.write(packet(kind, rng.randbytes(rng.randrange(6))))
                    await asyncio.sleep(0.02)
            case "disconnect":
                writer.write(packet(0xE0, bytes([rng.randrange(256)]) + properties))
            case "close":
                writer.transport.abort()

    async def _packet(self, reader: asyncio.StreamReader) -> tuple[int, bytes]:
        first = (await reader.readexactly(1))[0]
        size = shift = 0
        while True:
            byte = (await reader.readexactly(1))[0]
            size |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return first, await reader.readexactly(size)


def run(port: int, seed: int) -> None:
    """In a process of its own, until SIGTERM: a line PLAYING on stdout, and a JSON line at the end."""
    os.nice(LOW_PRIORITY)
    broker = HostileBroker(seed)

    async def main() -> None:
        playing = asyncio.current_task()
        assert playing is not None
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, playing.cancel)
        print(PLAYING, flush=True)
        async with await asyncio.start_server(broker.serve, "127.0.0.1", port) as server:
            await server.serve_forever()

    with contextlib.suppress(asyncio.CancelledError):
        asyncio.run(main())
    print(json.dumps({"seen": broker.seen, "wrong": [], "wrong_count": 0}), flush=True)
