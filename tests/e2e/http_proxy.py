"""An HTTP proxy that only connects (CONNECT), and may want a user and a password."""

import asyncio
import base64
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress


class HttpProxy:
    def __init__(self, user: str = "", status: str = "200 Connection established") -> None:
        self._wanted = f"Basic {base64.b64encode(user.encode()).decode()}" if user else ""
        self._status = status
        self.targets: list[str] = []
        self.url = ""

    @asynccontextmanager
    async def running(self) -> AsyncIterator["HttpProxy"]:
        async with await asyncio.start_server(self._serve, "127.0.0.1", 0) as server:
            self.url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"
            yield self

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError, asyncio.IncompleteReadError):
            first, *rest = (await reader.readuntil(b"\r\n\r\n")).decode().split("\r\n")
            headers = dict(line.split(": ", 1) for line in rest if line)
            method, target, version = first.split(" ")
            assert (method, version, headers["Host"]) == ("CONNECT", "HTTP/1.1", target)
            self.targets.append(target)
            refused = headers.get("Proxy-Authorization", "") != self._wanted
            status = "407 Proxy Authentication Required" if refused else self._status
            writer.write(f"HTTP/1.1 {status}\r\nVia: test\r\n\r\n".encode())
            if status.startswith("200"):
                host, _, port = target.rpartition(":")
                far_reader, far_writer = await asyncio.open_connection(host, int(port))
                await asyncio.gather(_pump(reader, far_writer), _pump(far_reader, writer))
        writer.close()


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while data := await reader.read(65_536):
            writer.write(data)
            await writer.drain()
    writer.close()
