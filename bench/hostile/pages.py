"""Hostile clients of the pages: HTTP and WebSocket that is nearly right, slow, endless, or something else."""

import base64
import json
import random
import struct
from pathlib import Path

from bench.hostile.client import Connection, Script, WrongAnswerError
from bench.hostile.tls import hello, mutated

ROOT = Path(__file__).resolve().parents[2]
METHODS = ["GET", "POST", "HEAD", "PUT", "DELETE", "OPTIONS", "TRACE", "CONNECT", "PATCH", "G", "GET" * 50, "gét"]
PATHS = [
    "/", "/login", "/healthz", "/metrics", "/driver", "/driver/bay1", "/tune/bay1", "/api/session", "/api/login",
    "/api/logout", "/api/bays/bay1/picture?width=640", "/api/bays/bay1/function-check", "/api/bays/bay1/freeze",
    "/api/bays/bay1/record", "/api/bays/bay1/trial", "/api/bays/bay1/eyedropper", "/api/bays/bay1/profile",
    "/api/bays/bay1/profile/apply", "/api/bays/bay1/profile/save", "/api/bays/bay1/taken", "/static/x", "/favicon.ico",
    "/static/../../etc/passwd", "/%2e%2e/%00", "//", "*", "/api/live", "/api/driver", "/" + "a" * 9000,
]  # fmt: skip
VALUES = ["", "0", "-1", "1e999", "\x00", "a" * 5000, "bay1", "../..", "%ff", "é", "9" * 400, "null", "[]", "{}"]
BODIES = [
    b"",
    b"{}",
    b"[]",
    b"null",
    b'{"a":' * 2000,
    b'"' + b"x" * 60000 + b'"',
    b"\xff\xfe",
    b'{"on": true}',
    b"1" * 5000,
]


def addresses() -> list[str]:
    """Those that the gateway describes, and those it does not."""
    described = json.loads((ROOT / "docs" / "openapi.json").read_text(encoding="utf-8"))["paths"]
    return [path.replace("{bay}", "bay1") for path in described] + PATHS


ADDRESSES = addresses()


def request(rng: random.Random) -> bytes:
    """Nearly right."""
    method = "GET" if rng.random() < 0.5 else rng.choice(METHODS)
    path = rng.choice(ADDRESSES).replace("{alarm}", rng.choice(VALUES)[:100])
    if rng.random() < 0.3:
        path += f"?{rng.choice(['after', 'limit', 'width', 'bay', 'x'])}={rng.choice(VALUES)}"
    body = rng.choice(BODIES) if method == "POST" or rng.random() < 0.1 else b""
    headers = [("Host", rng.choice(["127.0.0.1", "localhost", "evil.example", "", "127.0.0.1:1"]))]
    for name, values in {
        "Origin": ["http://127.0.0.1", "http://evil.example", "null"],
        "Content-Type": ["application/json", "text/plain", "multipart/form-data; boundary=x"],
        "Cookie": ["session=" + "0" * 43, "a=b; " * 400],
        "Authorization": ["Basic " + base64.b64encode(b"anna:wrong password").decode(), "Basic !!", "Bearer x"],
        "Expect": ["100-continue"],
        "Range": ["bytes=0-1,5-", "bytes=-99999999999"],
        "Accept-Encoding": ["gzip;q=0, *", "x" * 3000],
        "X-Forwarded-For": ["127.0.0.2", "1, 2, 3"],
    }.items():
        if rng.random() < 0.2:
            headers.append((name, rng.choice(values)))
    match rng.randrange(10):
        case 0:
            headers.append(("Content-Length", rng.choice(["-1", "999999999999", "1 1", "0x10", "+3"])))
        case 1:
            headers.append(("Transfer-Encoding", rng.choice(["chunked", "chunked, chunked", "xchunked", "gzip"])))
            body = rng.choice(
                [b"5\r\nabcde\r\n0\r\n\r\n", b"ffffffffffffffff\r\n", b"-1\r\n", b"5;" + b"x" * 9000 + b"\r\n", body]
            )
        case 2:
            headers += [("Content-Length", str(len(body))), ("Content-Length", str(len(body) + 5))]
        case 3:
            headers += [(f"X-{n}", "y" * rng.randrange(200)) for n in range(rng.randrange(200))]
        case _:
            headers.append(("Content-Length", str(len(body))))
    text = f"{method} {path} HTTP/{rng.choice(['1.1'] * 6 + ['1.0', '0.9', '2.0', '9'])}\r\n"
    text += "".join(f"{name}: {value}\r\n" for name, value in headers)
    made = text.encode("utf-8", "surrogateescape") + b"\r\n" + body
    return mutated(made, rng) if rng.random() < 0.3 else made


def head(path: str, method: str = "GET", host: str = "127.0.0.1", **headers: str) -> bytes:
    """A right one. `headers`: with _ for -."""
    lines = [f"{method} {path} HTTP/1.1", f"Host: {host}"]
    lines += [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    return "\r\n".join([*lines, "", ""]).encode()


async def gets(connection: Connection, rng: random.Random) -> None:
    await connection.send(head(rng.choice(["/healthz", "/", "/api/state", "/metrics"]), Connection="close"))
    answer = await connection.receive(within_s=10)
    while answer and (more := await connection.receive(within_s=10)):
        answer += more
    if answer and not answer.startswith(b"HTTP/1.1 "):
        raise WrongAnswerError(f"something else than HTTP: {answer[:60]!r}")
    connection.seen[f"pages answered {answer[9:12].decode()}"] += 1


async def fuzz(connection: Connection, rng: random.Random) -> None:
    for _ in range(rng.randrange(1, 10)):
        await connection.ragged(request(rng), rng)
        answer = await connection.receive(within_s=5)
        if answer and b"Traceback" in answer:
            raise WrongAnswerError("a traceback")


async def slow_head(connection: Connection, rng: random.Random) -> None:
    await connection.slowly(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n" + b"X: y\r\n" * 1000, rng.choice([0.01, 0.1, 1.0]))


async def slow_body(connection: Connection, rng: random.Random) -> None:
    await connection.send(b"POST /api/login HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 4000\r\n\r\n")
    await connection.slowly(b" " * 4000, rng.choice([0.01, 0.5]))


async def never_reads(connection: Connection, rng: random.Random) -> None:
    while True:
        await connection.send(b"GET /api/bays/bay1/snapshot.png HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" * 5)


async def web_socket(connection: Connection, rng: random.Random) -> None:
    """A live view, then frames that are nearly right, or nothing is read."""
    path = rng.choice(["/api/live?bay=bay1", "/api/driver?bay=bay1", "/api/live?bay=x", "/api/live"])
    host = f"127.0.0.1:{connection.sock.getpeername()[1]}"
    origin = rng.choice([f"http://{host}"] * 4 + ["http://evil.example"])
    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Origin": origin, "Sec_WebSocket_Version": "13"}
    key = base64.b64encode(rng.randbytes(16)).decode()
    await connection.send(head(path, host=host, Sec_WebSocket_Key=key, **upgrade))
    await connection.receive(within_s=10)
    for _ in range(rng.randrange(1, 60)):
        payload = rng.choice([b"next", b"", b"x" * 200, b"\xff" * 10, rng.randbytes(300)])
        code = rng.choice([0x81, 0x81, 0x81, 0x82, 0x01, 0x80, 0x88, 0x89, 0x8A, 0x8F, 0xF1])
        mask = rng.randbytes(4)
        frame = bytes([code, 0x80 | min(len(payload), 126)])
        frame += struct.pack(">H", len(payload)) if len(payload) > 125 else b""
        frame += mask + bytes(byte ^ mask[n % 4] for n, byte in enumerate(payload))
        if rng.random() < 0.1:
            frame = rng.choice([b"\x81\xff" + b"\xff" * 8, mutated(frame, rng), frame[:-1], b"\x81\x05hello"])
        await connection.send(frame)
        if rng.random() < 0.7:
            await connection.receive(within_s=2)
    if rng.random() < 0.3:
        connection.reset()


async def login(connection: Connection, rng: random.Random) -> None:
    body = json.dumps(
        {"user": rng.choice(["anna", "admin", "x" * 300]), "password": rng.choice(["0" * 12, "x" * 3000])}
    ).encode()
    about = {"Origin": "http://127.0.0.1", "Content_Type": "application/json", "Content_Length": str(len(body))}
    await connection.send(head("/api/login", "POST", **about) + body)
    await connection.receive(within_s=10)


async def something_else(connection: Connection, rng: random.Random) -> None:
    await connection.send(rng.choice([hello(rng), b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes(40), rng.randbytes(400)]))
    await connection.until_closed()


async def half_open(connection: Connection, rng: random.Random) -> None:
    await connection.send(b"GET / HT")
    await connection.until_closed()


async def comes_and_goes(connection: Connection, rng: random.Random) -> None:
    connection.reset()


SCRIPTS: dict[Script, float] = {
    gets: 3, fuzz: 8, slow_head: 1, slow_body: 1, never_reads: 1, web_socket: 4, login: 1, something_else: 2,
    half_open: 1, comes_and_goes: 3,
}  # fmt: skip
