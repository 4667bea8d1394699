"""Modbus/TCP Security over real sockets: who gets in, who may do what, and what the log says of the others."""

import asyncio
import logging
import random
import socket
import ssl
import struct
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from pymodbus.client import AsyncModbusTlsClient
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU

from gateway import event_loop
from gateway.certs import issue
from gateway.clock import SystemClock
from gateway.config import ModbusConfig, TlsConfig
from gateway.modbus.protocol.adu import ModbusException
from gateway.modbus.protocol.answers import MAY_NOT_WRITE, Peer, Unit
from gateway.modbus.registers.register_map import BLOCK_WORDS
from gateway.modbus.server.limits import Refusal
from gateway.modbus.server.modbus_service import Listening, serving
from gateway.modbus.server.tls_handshake_limiter import PLC_AT_ONCE
from gateway.net import tls
from tests.long import mostly_long
from tests.plant_certs import LONG_AGO, NOW, LaterClock, Plant
from tests.virtual_time import synchronous

COUNTING = tuple(range(1000, 1000 + BLOCK_WORDS))
READ_STOP = bytes((3,)) + struct.pack(">HH", 4, 1)
WRITE_HEARTBEAT = bytes((6,)) + struct.pack(">HH", 80, 7)
ANSWER_STOP = bytes((3, 2)) + struct.pack(">H", 1004)
FRAME = struct.pack(">HHHB", 0xBEEF, 0, 6, 1) + READ_STOP


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Plant:
    made = Plant(tmp_path_factory.mktemp("certs"))
    made.client("operator", "operator")
    made.client("viewer", "viewer")
    made.client("nobody", None)
    made.client("stranger", "Administrator")
    made.client("expired", now=LONG_AGO)
    made.revoke(made.client("revoked"))
    return made


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Plant:
    made = Plant(tmp_path_factory.mktemp("elsewhere"))
    made.client("operator", "operator")
    return made


LOOPS: dict[str, Callable[[], asyncio.AbstractEventLoop]] = {
    "own": event_loop.factory(),
    "asyncio": asyncio.new_event_loop,
}
_chosen = ["own"]


@pytest.fixture(params=mostly_long(LOOPS), autouse=True)
def _loop(request: pytest.FixtureRequest) -> None:
    """Everything holds on both event loops."""
    _chosen[:] = [request.param]


def play(scene: Coroutine[Any, Any, None]) -> None:
    with asyncio.Runner(loop_factory=LOOPS[_chosen[0]]) as runner:
        runner.run(scene)


played = partial(synchronous, runner=play)


class Bay:
    """One unit whose writes are kept with who wrote."""

    def __init__(self) -> None:
        self.written: list[tuple[int, tuple[int, ...], Peer]] = []
        self.refused: list[tuple[str, str]] = []

    def refuse(self, peer: Peer, why: str) -> None:
        self.refused.append((peer.subject, why))

    def write(self, address: int, words: Any, peer: Peer, mask: int = 0xFFFF) -> ModbusException | None:
        self.written.append((address, tuple(words), peer))
        return None


@asynccontextmanager
async def gateway(
    plant: Plant, bay: Bay, clock: SystemClock | None = None, **modbus: object
) -> AsyncIterator[Listening]:
    units = {1: Unit(lambda: COUNTING, bay.write, refused=bay.refuse)}
    config = ModbusConfig.model_validate({"port": 0, "writes": True, "tls": plant.config()} | modbus)
    async with serving(config, units, clock or SystemClock()) as listening:
        yield listening


def context_of(plant: Plant, name: str | None, trust: Plant | None = None) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=str((trust or plant).folder.certificate_path("ca")))
    if name is not None:
        context.load_cert_chain(plant.folder.certificate_path(name), plant.folder.key_path(name))
    return context


@contextmanager
def dialled(port: int, context: ssl.SSLContext) -> Iterator[ssl.SSLSocket]:
    with (
        socket.create_connection(("127.0.0.1", port), timeout=10) as tcp,
        context.wrap_socket(tcp, server_hostname="127.0.0.1", suppress_ragged_eofs=False) as tls,
    ):
        yield tls


def ask(port: int, context: ssl.SSLContext, *pdus: bytes) -> list[bytes]:
    """The answers' PDUs over one connection. Raises OSError where it is refused or cut."""
    found: list[bytes] = []
    with dialled(port, context) as tls:
        for number, pdu in enumerate(pdus):
            tls.sendall(struct.pack(">HHHB", number, 0, len(pdu) + 1, 1) + pdu)
            head = _exactly(tls, 7)
            assert head[:4] == struct.pack(">HH", number, 0)
            found.append(_exactly(tls, struct.unpack(">H", head[4:6])[0] - 1))
    return found


def _exactly(sock: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        more = sock.recv(count - len(data))
        if not more:
            raise ConnectionResetError("closed")
        data += more
    return data


async def threaded(work: Callable[..., Any], *args: Any) -> Any:
    return await asyncio.get_running_loop().run_in_executor(None, work, *args)


async def logged(caplog: pytest.LogCaptureFixture, words: str) -> None:
    for _ in range(1000):
        if words in caplog.text:
            return
        await asyncio.sleep(0.01)
    raise TimeoutError(f"not in the log: {words}")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("operator", [ANSWER_STOP, WRITE_HEARTBEAT]),
        ("viewer", [ANSWER_STOP, b"\x86\x01"]),
        ("nobody", [b"\x83\x01", b"\x86\x01"]),  # no role: connected, and nothing is allowed
        ("stranger", [b"\x83\x01", b"\x86\x01"]),
    ],
)
@played
async def test_the_role_in_the_certificate_decides(plant: Plant, name: str, expected: list[bytes]) -> None:
    bay = Bay()

    async with gateway(plant, bay) as listening:
        found = await threaded(ask, listening.tls, context_of(plant, name), READ_STOP, WRITE_HEARTBEAT)
        assert found == expected
    writers = [(peer.address, peer.subject, peer.role) for _, _, peer in bay.written]
    assert writers == ([("127.0.0.1", "operator", "operator")] if name == "operator" else [])
    assert bay.refused == ([] if name == "operator" else [(name, MAY_NOT_WRITE)])


@pytest.mark.parametrize(
    ("name", "other", "said"),
    [
        (None, False, "it showed no certificate"),
        ("expired", False, "its certificate was refused: certificate has expired"),
        ("revoked", False, "its certificate was refused: certificate revoked"),
        ("operator", True, "its certificate was refused: unable to get local issuer certificate"),
    ],
)
@pytest.mark.parametrize("version", mostly_long([ssl.TLSVersion.TLSv1_3, ssl.TLSVersion.TLSv1_2]))
@played
async def test_who_is_refused_and_what_the_log_says(
    plant: Plant,
    elsewhere: Plant,
    caplog: pytest.LogCaptureFixture,
    name: str | None,
    other: bool,
    said: str,
    version: ssl.TLSVersion,
) -> None:
    context = context_of(elsewhere if other else plant, name, trust=plant)
    context.minimum_version = context.maximum_version = version
    bay = Bay()

    with caplog.at_level(logging.WARNING):
        async with gateway(plant, bay) as listening:
            with pytest.raises(OSError, match=r"."):  # TLS 1.3 tells a client only when it reads
                await threaded(ask, listening.tls, context, READ_STOP, WRITE_HEARTBEAT)
            # The next good client is served all the same.
            assert await threaded(ask, listening.tls, context_of(plant, "operator"), READ_STOP) == [ANSWER_STOP]
    assert f"modbus: 127.0.0.1: {said}" in [record.getMessage() for record in caplog.records]
    assert bay.written == []


@played
async def test_a_client_that_trusts_another_authority_goes_away_and_the_log_says_so(
    plant: Plant, elsewhere: Plant, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        async with gateway(plant, Bay()) as listening:
            with pytest.raises(ssl.SSLCertVerificationError):
                await threaded(ask, listening.tls, context_of(plant, "operator", trust=elsewhere), READ_STOP)
            await logged(caplog, "it does not trust the authority")
    assert "it does not trust the authority of the gateway's certificate" in caplog.text


async def openssl(port: int, plant: Plant, name: str, request: bytes, *options: str) -> tuple[bytes, str]:
    """What `openssl s_client` prints of the answer, and its other words. Ends when the answer is there, or it fails."""
    folder = plant.folder
    process = await asyncio.create_subprocess_exec(
        "openssl", "s_client", "-quiet", "-verify_return_error", "-connect", f"127.0.0.1:{port}",
        "-CAfile", str(folder.certificate_path("ca")),
        "-cert", str(folder.certificate_path(name)), "-key", str(folder.key_path(name)), *options,
        stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stderr is not None
    try:
        async with asyncio.timeout(30):
            process.stdin.write(request)
            await process.stdin.drain()
            answer = await process.stdout.read(300)
            if answer:
                process.terminate()  # it waits for more
            process.stdin.close()
            said = await process.stderr.read()
            await process.wait()
    except (BrokenPipeError, ConnectionResetError):
        answer, said = b"", await process.stderr.read()
        await process.wait()
    return answer, said.decode()


@pytest.mark.parametrize("option", mostly_long(["-tls1_3", "-tls1_2"]))
@played
async def test_openssl_reads_a_register(plant: Plant, option: str) -> None:
    async with gateway(plant, Bay()) as listening:
        assert listening.tls is not None
        answer, said = await openssl(listening.tls, plant, "viewer", FRAME, option)
        assert answer == struct.pack(">HHHB", 0xBEEF, 0, 5, 1) + ANSWER_STOP, said


@played
async def test_tls_1_1_is_refused(plant: Plant, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        async with gateway(plant, Bay()) as listening:
            assert listening.tls is not None
            options = ("-tls1_1", "-cipher", "ALL:@SECLEVEL=0")
            answer, said = await openssl(listening.tls, plant, "operator", FRAME, *options)
            assert answer == b""
            assert "alert protocol version" in said
    assert "it supports no TLS version from 1.2 up" in caplog.text


@played
async def test_plain_modbus_on_the_tls_port_is_cut(plant: Plant, caplog: pytest.LogCaptureFixture) -> None:
    def plainly(port: int) -> bytes:
        with socket.create_connection(("127.0.0.1", port), timeout=10) as tcp:
            tcp.sendall(FRAME)
            try:
                return tcp.recv(300)
            except ConnectionResetError:
                return b""

    with caplog.at_level(logging.WARNING):
        async with gateway(plant, Bay()) as listening:
            answer = await threaded(plainly, listening.tls)
            assert b"\x03\x02\x03\xec" not in answer  # at most a TLS alert, no register
    assert "it does not use TLS" in caplog.text


@played
async def test_a_client_that_never_begins_its_handshake_is_cut_in_time(plant: Plant) -> None:
    def silent(port: int) -> bytes:
        with socket.create_connection(("127.0.0.1", port), timeout=20) as tcp:
            try:
                return tcp.recv(300)
            except ConnectionResetError:
                return b""

    async with gateway(plant, Bay(), tls=plant.config(handshake_deadline_s=0.5)) as listening:
        assert await threaded(silent, listening.tls) == b""


@played
async def test_a_port_scanner_is_told_once(plant: Plant, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        async with gateway(plant, Bay()) as listening:
            for _ in range(3):
                _, writer = await asyncio.open_connection("127.0.0.1", listening.tls)
                writer.close()
            await logged(caplog, "it ended the TLS handshake, or did not finish it in time")
    assert caplog.text.count("it ended the TLS handshake") == 1


@played
async def test_leaving_does_not_wait_for_handshakes(plant: Plant) -> None:
    async with asyncio.timeout(10):
        async with gateway(plant, Bay(), tls=plant.config(handshake_deadline_s=60)) as listening:
            _, writer = await asyncio.open_connection("127.0.0.1", listening.tls)
            await asyncio.sleep(0.1)
        writer.close()
    for _ in range(3):
        await asyncio.sleep(0)
    assert asyncio.all_tasks() == {asyncio.current_task()}


BEGUN = TlsConfig.model_fields["handshakes_per_address"].default


def ask_from(source: str, port: int, context: ssl.SSLContext) -> bytes:
    with (
        socket.create_connection(("127.0.0.1", port), timeout=10, source_address=(source, 0)) as tcp,
        context.wrap_socket(tcp, server_hostname="127.0.0.1") as connection,
    ):
        connection.sendall(FRAME)
        return _exactly(connection, 11)[7:]


@played
@pytest.mark.failure_mode("P7")
async def test_one_address_may_begin_only_so_many_handshakes_and_others_are_not_held_up(
    plant: Plant, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        async with gateway(plant, Bay(), plc_addresses=["127.0.0.1"]) as listening:
            assert listening.tls is not None
            idle = [
                await asyncio.open_connection("127.0.0.1", listening.tls, local_addr=("127.0.0.2", 0))
                for _ in range(BEGUN + 5)
            ]
            await logged(caplog, "127.0.0.2: too many TLS handshakes")
            assert await threaded(ask_from, "127.0.0.3", listening.tls, context_of(plant, "viewer")) == ANSWER_STOP
            assert await threaded(ask, listening.tls, context_of(plant, "operator"), READ_STOP) == [ANSWER_STOP]
            for _, writer in idle:
                writer.close()


@played
async def test_plain_tcp_beside_tls_only_reads(plant: Plant) -> None:
    bay = Bay()

    async def exchange(port: int, pdu: bytes) -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(struct.pack(">HHHB", 1, 0, len(pdu) + 1, 1) + pdu)
        head = await reader.readexactly(7)
        answer = await reader.readexactly(struct.unpack(">H", head[4:6])[0] - 1)
        writer.close()
        return answer

    async with gateway(plant, bay) as listening:
        assert listening.plain is not None
        assert await exchange(listening.plain, READ_STOP) == ANSWER_STOP
        assert await exchange(listening.plain, WRITE_HEARTBEAT) == b"\x86\x01"
    async with gateway(plant, bay, plain=False) as listening:
        assert listening.plain is None
        assert listening.first == listening.tls
    assert bay.written == []


@played
async def test_pymodbus_reads_and_writes_over_tls(plant: Plant) -> None:
    bay = Bay()

    async with gateway(plant, bay) as listening:
        client = _pymodbus(plant, listening.tls or 0)
        async with client:
            answer = await client.read_holding_registers(0, count=BLOCK_WORDS)
            assert answer.registers == list(COUNTING)
            assert not (await client.write_registers(80, [5, 6, 0])).isError()
    assert [(address, words) for address, words, _ in bay.written] == [(80, (5, 6, 0))]


def _pymodbus(plant: Plant, port: int) -> AsyncModbusTlsClient:
    """With the frames of the specification: pymodbus's own for TLS have no header."""
    client = AsyncModbusTlsClient("127.0.0.1", port=port, sslctx=context_of(plant, "operator"), timeout=10)
    client.ctx.framer = FramerSocket(DecodePDU(False))
    return client


@played
async def test_requests_sent_with_the_last_bytes_of_the_handshake_are_answered(plant: Plant) -> None:
    """TLS 1.3: the client may speak before the server has looked at its certificate; nothing may get lost."""

    def pipelined(port: int) -> bytes:
        with dialled(port, context_of(plant, "viewer")) as tls:
            tls.sendall(b"".join(FRAME for _ in range(50)))
            return _exactly(tls, 50 * 11)

    async with gateway(plant, Bay()) as listening:
        expected = struct.pack(">HHHB", 0xBEEF, 0, 5, 1) + ANSWER_STOP
        for _ in range(5):
            assert await threaded(pipelined, listening.tls) == expected * 50


class Slicer:
    """A TLS client of our own on a plain socket: what it sends leaves in slices of `size` bytes."""

    def __init__(self, port: int, context: ssl.SSLContext, size: int) -> None:
        self._tcp = socket.create_connection(("127.0.0.1", port), timeout=10)
        self._tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._in, self._out, self._size = ssl.MemoryBIO(), ssl.MemoryBIO(), size
        self._tls = context.wrap_bio(self._in, self._out, server_hostname="127.0.0.1")
        self._all(self._tls.do_handshake)

    def send(self, data: bytes) -> None:
        self._tls.write(data)
        self._push()

    def receive(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            data += self._all(self._tls.read)
        assert len(data) == count
        return data

    def close(self) -> None:
        self._tcp.close()

    def _all(self, work: Callable[[], Any]) -> Any:
        while True:
            try:
                done = work()
            except ssl.SSLWantReadError:
                self._push()
                more = self._tcp.recv(4096)
                if not more:
                    raise ConnectionResetError("closed") from None
                self._in.write(more)
                continue
            self._push()
            return done

    def _push(self) -> None:
        data = self._out.read()
        for at in range(0, len(data), self._size):
            self._tcp.sendall(data[at : at + self._size])


@pytest.mark.parametrize("size", [1, 7, 1400])
@played
async def test_tls_records_and_requests_in_any_slices(plant: Plant, size: int) -> None:
    """The cable cuts where it likes, and a client may put every byte into a record of its own."""

    def talk(port: int) -> None:
        client = Slicer(port, context_of(plant, "viewer"), size)
        expected = struct.pack(">HHHB", 0xBEEF, 0, 5, 1) + ANSWER_STOP
        client.send(FRAME * 3)
        assert client.receive(3 * len(expected)) == expected * 3
        for n in range(len(FRAME)):
            client.send(FRAME[n : n + 1])
        assert client.receive(len(expected)) == expected
        client.close()

    async with gateway(plant, Bay()) as listening:
        await threaded(talk, listening.tls)


@played
async def test_a_frame_of_an_impossible_length_ends_the_connection_with_a_goodbye(plant: Plant) -> None:
    def talk(port: int) -> bytes:
        with dialled(port, context_of(plant, "viewer")) as tls:
            tls.sendall(FRAME + struct.pack(">HHHB", 1, 0, 9999, 1))
            return _exactly(tls, 11) + tls.recv(100)  # an end without close_notify would raise SSLEOFError

    async with gateway(plant, Bay()) as listening:
        assert (await threaded(talk, listening.tls))[7:] == ANSWER_STOP


@played
async def test_a_client_that_does_not_read_is_cut_and_the_others_do_not_notice(
    plant: Plant, caplog: pytest.LogCaptureFixture
) -> None:
    whole = struct.pack(">HHHB", 1, 0, 6, 1) + bytes((3,)) + struct.pack(">HH", 0, BLOCK_WORDS)

    def flood(port: int) -> int:
        with socket.socket() as tcp:
            for buffer in (socket.SO_RCVBUF, socket.SO_SNDBUF):  # the kernel's megabytes would hide the end
                tcp.setsockopt(socket.SOL_SOCKET, buffer, 16384)
            tcp.settimeout(20)
            tcp.connect(("127.0.0.1", port))
            sent = 0
            with context_of(plant, "viewer").wrap_socket(tcp, server_hostname="127.0.0.1") as tls:
                try:
                    while True:
                        tls.sendall(whole * 100)
                        sent += 100
                except OSError:
                    return sent

    with caplog.at_level(logging.WARNING):
        async with gateway(plant, Bay(), send_timeout_s=0.5) as listening:
            flooding = threaded(flood, listening.tls)
            task = asyncio.get_running_loop().create_task(flooding)
            while not task.done():
                assert await threaded(ask, listening.tls, context_of(plant, "operator"), READ_STOP) == [ANSWER_STOP]
                await asyncio.sleep(0.3)  # strangers may begin a few handshakes a second
            assert await task < 20_000
    assert "it did not read its answers" in caplog.text


@played
async def test_nobody_is_left_behind(plant: Plant) -> None:
    """Clients that come, ask and go leave neither connections nor waiting places."""

    async with gateway(plant, Bay(), plc_addresses=["127.0.0.1"]) as listening:
        for _ in range(PLC_AT_ONCE + 2):
            assert await threaded(ask, listening.tls, context_of(plant, "viewer"), READ_STOP) == [ANSWER_STOP]


@played
async def test_what_is_renewed_and_taken_back_holds_without_a_restart(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tls, "LOOK_NS", 0)  # look at the files at every connection
    own = Plant(tmp_path)
    client = own.client("plc1")
    good = context_of(own, "plc1")

    with caplog.at_level(logging.INFO):
        async with gateway(own, Bay()) as listening:
            assert await threaded(ask, listening.tls, good, READ_STOP) == [ANSWER_STOP]
            # A damaged file is told, and what was read before stays in force.
            crl = own.folder.crl_path.read_bytes()
            own.folder.crl_path.write_text("nonsense")
            assert await threaded(ask, listening.tls, good, READ_STOP) == [ANSWER_STOP]
            assert "crl.pem: nothing in PEM form in it" in caplog.text
            assert "the files read before stay in force" in caplog.text
            own.folder.crl_path.write_bytes(crl)
            # Another certificate for the gateway.
            old = own.folder.certificate("gateway")
            own.folder.replace_certificate("gateway", issue.renewed(own.by, old, own.folder.key("gateway"), NOW, 60))

            def shown(port: int) -> int:
                with dialled(port, good) as connection:
                    der = connection.getpeercert(binary_form=True)
                    assert der is not None
                    return x509.load_der_x509_certificate(der).serial_number

            assert await threaded(shown, listening.tls) == own.folder.certificate("gateway").serial_number
            # The client's is taken back.
            own.revoke(client)
            with pytest.raises(OSError, match=r"."):
                await threaded(ask, listening.tls, good, READ_STOP)
    assert "its certificate was refused: certificate revoked" in caplog.text


class Standing:
    """A connection that stays, and is asked again and again."""

    def __init__(self, port: int, context: ssl.SSLContext) -> None:
        tcp = socket.create_connection(("127.0.0.1", port), timeout=10)
        self._tls = context.wrap_socket(tcp, server_hostname="127.0.0.1")

    def ask(self) -> bytes:
        self._tls.sendall(FRAME)
        return _exactly(self._tls, 11)[7:]

    def cut(self) -> bool:
        """Waits for the end. False: none comes within 10 s."""
        try:
            return self._tls.recv(100) == b""
        except TimeoutError:
            return False
        except OSError:
            return True

    def close(self) -> None:
        self._tls.close()


@played
@pytest.mark.failure_mode("P9")
async def test_a_certificate_that_is_taken_back_ends_its_connection(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tls, "LOOK_NS", 0)
    own = Plant(tmp_path)
    plc1 = own.client("plc1")
    own.client("plc2")

    with caplog.at_level(logging.WARNING):
        async with gateway(own, Bay()) as listening:
            assert listening.tls is not None
            first = await threaded(Standing, listening.tls, context_of(own, "plc1"))
            second = await threaded(Standing, listening.tls, context_of(own, "plc2"))
            for one in (first, second):
                assert await threaded(one.ask) == ANSWER_STOP
            crl = own.folder.crl_path.read_bytes()
            own.folder.crl_path.write_text("nonsense")  # is told, and nothing ends
            await logged(caplog, "the files read before stay in force")
            assert await threaded(first.ask) == ANSWER_STOP
            own.folder.crl_path.write_bytes(crl)
            own.revoke(plc1)
            assert await threaded(first.cut)
            assert await threaded(second.ask) == ANSWER_STOP
            assert listening.servers[0].stats.refused[Refusal.CERTIFICATE_REVOKED] == 1
            first.close()
            second.close()
    assert "127.0.0.1: its certificate was revoked (modbus.tls.crl) while it was connected" in caplog.text


@played
@pytest.mark.failure_mode("P9")
async def test_a_certificate_that_expires_ends_its_connection(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    own, clock = Plant(tmp_path), LaterClock()
    own.client("plc1")  # for 30 days
    key = issue.new_key()
    own.folder.add("plc2", issue.client(own.by, "plc2", "operator", key, NOW, 90), key)

    with caplog.at_level(logging.WARNING):
        async with gateway(own, Bay(), clock) as listening:
            assert listening.tls is not None
            first = await threaded(Standing, listening.tls, context_of(own, "plc1"))
            second = await threaded(Standing, listening.tls, context_of(own, "plc2"))
            for one in (first, second):
                assert await threaded(one.ask) == ANSWER_STOP
            clock.days.append(31)
            assert await threaded(first.cut)
            assert await threaded(second.ask) == ANSWER_STOP
            assert listening.servers[0].stats.refused[Refusal.CERTIFICATE_EXPIRED] == 1
            first.close()
            second.close()
    assert "127.0.0.1: its certificate has expired while it was connected" in caplog.text


@played
@pytest.mark.failure_mode("P8")
async def test_any_bytes_at_any_moment_leave_the_server_well(plant: Plant) -> None:
    """Seeded noise: before the handshake, in it, and in the middle of an encrypted connection."""
    chance = random.Random(20)

    def noise(port: int) -> None:
        with socket.create_connection(("127.0.0.1", port), timeout=10) as tcp:
            start = chance.choice([b"", b"\x16\x03\x01", b"\x16\x03\x03\x00\x05", b"\x80\x2e\x01"])
            with suppress(OSError):
                tcp.sendall(start + chance.randbytes(chance.randrange(600)))
                if chance.random() < 0.5:
                    tcp.shutdown(socket.SHUT_WR)
                tcp.recv(100)

    def spoiled(port: int) -> None:
        client = Slicer(port, context_of(plant, "viewer"), 1400)
        with suppress(OSError):
            client._tcp.sendall(b"\x17\x03\x03\x00\x20" + chance.randbytes(32))  # a record that nobody encrypted
            while client._tcp.recv(1000):
                pass
        client.close()

    async with gateway(plant, Bay(), plc_addresses=["127.0.0.1"], tls=plant.config(handshake_deadline_s=0.5)) as it:
        for _ in range(60):
            await threaded(noise, it.tls)
        for _ in range(10):
            await threaded(spoiled, it.tls)
        assert await threaded(ask, it.tls, context_of(plant, "operator"), READ_STOP) == [ANSWER_STOP]
