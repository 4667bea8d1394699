"""Do the pages cost the PLC anything? Registers' pace and answer times with and without viewers, turn about.

    python -m bench.hmi_viewers [--viewers 20] [--rounds 5] [--seconds 4]

One `gateway simulate` at work (camera, vision, ranger, all of it). A PLC polls 100 registers every 10 ms. In every
second round a crowd looks: each viewer has the operator's live view and the picture, a quarter of them stall and take
nothing. Told for both kinds of round, as medians over the rounds: fusion ticks a second, the PLC's answer times, and
the processor time of the main process and of the web process.
"""

import argparse
import asyncio
import http.client
import json
import os
import socket
import statistics
import struct
import subprocess
import sys
import threading
import time
import urllib.parse
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass

import psutil
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from gateway.modbus.registers.register_map import REGISTERS

ASK = struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 0, 100)
HEARTBEAT = next(row.address for row in REGISTERS if row.name == "heartbeat")
POLL_S = 0.01


@dataclass
class Round:
    """What one round showed."""

    ticks_hz: float
    answers_ms: list[float]
    main_cpu: float  # seconds of processor time a second
    web_cpu: float
    views_hz: float = 0.0
    pictures_hz: float = 0.0


def poll(port: int, seconds: float) -> tuple[float, list[float]]:
    """Ticks a second and answer times, ms."""
    took: list[float] = []
    with socket.create_connection(("127.0.0.1", port), timeout=5) as sock:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

        def once() -> int:
            begun = time.perf_counter()
            sock.sendall(ASK)
            data = b""
            while len(data) < 209:
                data += sock.recv(4096)
            took.append((time.perf_counter() - begun) * 1e3)
            value: int = struct.unpack_from(">H", data, 9 + 2 * HEARTBEAT)[0]
            return value

        begun, first = time.perf_counter(), once()
        while time.perf_counter() - begun < seconds:
            time.sleep(POLL_S)
            last = once()
        spent = time.perf_counter() - begun
    return (last - first) % 65536 / spent, took


class Crowd:
    """Viewers in a process of their own: this program's one thread must not slow the PLC it plays."""

    def __init__(self, url: str, viewers: int) -> None:
        code = f"from bench.hmi_viewers import crowd; crowd({url!r}, {viewers})"
        self.process = subprocess.Popen(
            [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "looking\n"

    def leave(self) -> tuple[int, int]:
        """Views and pictures that were shown in all."""
        out, _ = self.process.communicate("\n", timeout=60)
        views, pictures = out.split()
        return int(views), int(pictures)


def crowd(url: str, viewers: int) -> None:
    os.nice(5)
    left = threading.Event()

    def leave() -> None:
        sys.stdin.readline()
        left.set()

    threading.Thread(target=leave, daemon=True).start()
    asyncio.run(_look(url, viewers, left))


async def _look(url: str, viewers: int, left: threading.Event) -> None:
    host = urllib.parse.urlsplit(url).netloc
    views = [0] * viewers
    pictures = [0] * viewers

    async with AsyncExitStack() as pages:
        group = await pages.enter_async_context(asyncio.TaskGroup())

        async def live(n: int) -> None:
            address = f"ws://{host}/api/live?bay=bay1"
            page = await pages.enter_async_context(connect(address, origin=f"http://{host}", close_timeout=1))  # type: ignore[arg-type]
            if n % 4 == 3:
                await asyncio.sleep(3600)  # takes nothing
            with suppress(ConnectionClosed):
                async for _ in page:
                    views[n] += 1
                    await page.send("next")

        def fetch(n: int) -> None:
            connection, after = http.client.HTTPConnection(host, timeout=10), ""
            while not left.is_set():
                connection.request("GET", f"/api/bays/bay1/picture?width=640{after}")
                response = connection.getresponse()
                response.read()
                if response.status == 200:
                    pictures[n] += 1
                    after = f"&after={response.headers['X-Frame-Id']}"

        tasks = [group.create_task(live(n)) for n in range(viewers)]
        threads = [threading.Thread(target=fetch, args=(n,), daemon=True) for n in range(viewers) if n % 4 != 3]
        for thread in threads:
            thread.start()
        await asyncio.sleep(1)
        before = sum(views), sum(pictures)
        print("looking", flush=True)
        await asyncio.to_thread(left.wait)
        print(sum(views) - before[0], sum(pictures) - before[1], flush=True)
        for task in tasks:
            task.cancel()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--viewers", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=4.0)
    args = parser.parse_args()
    command = ["simulate", "--modbus-port", "0", "--hmi-port", "0", "--json"]
    with subprocess.Popen([sys.executable, "-m", "gateway", *command], stdout=subprocess.PIPE, text=True) as gateway:
        assert gateway.stdout is not None
        started = json.loads(gateway.stdout.readline())
        threading.Thread(target=gateway.stdout.read, daemon=True).start()
        time.sleep(4)
        rounds: dict[bool, list[Round]] = {False: [], True: []}
        try:
            for n in range(2 * args.rounds):
                crowded = n % 2 == 1
                rounds[crowded].append(_round(gateway.pid, started, args.viewers if crowded else 0, args.seconds))
        finally:
            gateway.terminate()
    print(
        f"{'':18}{'ticks/s':>9}{'p50 ms':>9}{'p99 ms':>9}{'main cpu':>10}{'web cpu':>9}{'views/s':>9}{'pictures/s':>12}"
    )
    for crowded, found in rounds.items():
        answers = sorted(ms for one in found for ms in one.answers_ms)
        cells = (
            f"{statistics.median(one.ticks_hz for one in found):9.2f}",
            f"{answers[len(answers) // 2]:9.3f}",
            f"{answers[len(answers) * 99 // 100]:9.3f}",
            f"{statistics.median(one.main_cpu for one in found):10.1%}",
            f"{statistics.median(one.web_cpu for one in found):9.1%}",
            f"{statistics.median(one.views_hz for one in found):9.1f}",
            f"{statistics.median(one.pictures_hz for one in found):12.1f}",
        )
        print(f"{f'{args.viewers} viewers' if crowded else 'nobody looks':18}{''.join(cells)}")


def _round(pid: int, started: dict[str, int | str], viewers: int, seconds: float) -> Round:
    looking = Crowd(str(started["hmi"]), viewers) if viewers else None
    main, web = psutil.Process(pid), [p for p in psutil.Process(pid).children() if p.name() == "gw-hmi"]

    def spent() -> tuple[float, float]:
        return sum(main.cpu_times()[:2]), sum(sum(p.cpu_times()[:2]) for p in web)

    before = spent()
    begun = time.perf_counter()
    ticks_hz, answers_ms = poll(int(started["modbus_port"]), seconds)
    took = time.perf_counter() - begun
    main_s, web_s = (after - was for after, was in zip(spent(), before, strict=True))
    views, pictures = looking.leave() if looking else (0, 0)
    return Round(ticks_hz, answers_ms, main_s / took, web_s / took, views / took, pictures / took)


if __name__ == "__main__":
    main()
