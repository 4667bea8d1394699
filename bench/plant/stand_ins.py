"""The cameras and rangers of many bays, in a process of their own, so that their cost is not counted as the gateway's.

    python -m bench.plant.stand_ins BAYS FPS      prints one line of JSON: {"camera": [url, ...], "ranger": [path, ...]}

Each camera is an HTTP stream of JPEGs (VGA, about 40 kB each) of the simulator's bay, encoded before the start; a frame
that the gateway does not take in time is dropped, as a camera does. Each ranger is the simulator's board on a pty. Ends
at the end of its standard input.
"""

import asyncio
import json
import sys
from contextlib import AsyncExitStack
from functools import partial

import cv2

from bench.speed_scenes import approach, back_and_forth
from gateway.clock import SystemClock
from gateway.durations import NS_PER_S
from gateway.sim.ranger import SimulatedRanger

PICTURES = 30  # rendered; shown forth and back
DISTANCE_MM = 1500.0
HEAD = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n\r\n"


async def _camera(
    parts: list[bytes], fps: float, clock: SystemClock, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
) -> None:
    """One connection. The request's path is the bay's number: cameras are out of step, as real ones are."""
    try:
        bay = int((await reader.readuntil(b"\r\n\r\n")).split()[1].strip(b"/"))
        writer.write(HEAD)
        period_ns = round(NS_PER_S / fps)
        due_ns, n = clock.now_ns() + bay * 7_000_000 % period_ns, bay
        while not writer.is_closing():
            due_ns = max(due_ns + period_ns, clock.now_ns() - period_ns)
            await clock.sleep(max(0, due_ns - clock.now_ns()) / NS_PER_S)
            n += 1
            if not writer.transport.get_write_buffer_size():
                writer.write(parts[n % len(parts)])
    except (OSError, ValueError, asyncio.IncompleteReadError, asyncio.CancelledError):
        pass
    finally:
        writer.close()


async def main(bays: int, fps: float) -> None:
    cv2.setNumThreads(1)
    parts = []
    for picture in back_and_forth(approach(640, 480, PICTURES)):
        jpeg = cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, 85))[1].tobytes()
        head = b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(jpeg)
        parts.append(head + jpeg + b"\r\n")
    clock = SystemClock()
    loop = asyncio.get_running_loop()
    over = loop.run_in_executor(None, sys.stdin.read)
    async with AsyncExitStack() as stack:
        server = await asyncio.start_server(partial(_camera, parts, fps, clock), "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        rangers = []
        for bay in range(bays):
            ranger = SimulatedRanger(lambda _: DISTANCE_MM, clock, seed=bay)
            rangers.append(await stack.enter_async_context(ranger))
        tasks = [asyncio.create_task(ranger.run()) for ranger in rangers]
        urls = [f"http://127.0.0.1:{port}/{bay}" for bay in range(bays)]
        print(json.dumps({"camera": urls, "ranger": [ranger.port for ranger in rangers]}), flush=True)
        await over
        for task in tasks:
            task.cancel()
        server.close()


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), float(sys.argv[2])))
