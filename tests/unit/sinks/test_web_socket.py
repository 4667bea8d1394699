"""Bytes through the frames of a WebSocket, against the frames of the library's server side."""

import socket
from collections.abc import Iterator
from typing import Any

import pytest
from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.server import ServerProtocol
from websockets.typing import Subprotocol

from gateway.sinks.mqtt.web_socket import MAX_FRAME_BYTES, WebSocket, answered, protocol_of, request


def connected(subprotocol: str = "mqtt") -> tuple[Any, ServerProtocol]:
    client, server = protocol_of("ws://192.0.2.1:80/mqtt"), ServerProtocol(subprotocols=[Subprotocol(subprotocol)])
    sent = request(client)
    assert sent.startswith(b"GET /mqtt HTTP/1.1\r\nHost: 192.0.2.1\r\n")
    server.receive_data(sent)
    (asked,) = server.events_received()
    assert isinstance(asked, Request)
    server.send_response(server.accept(asked))
    answer = b"".join(server.data_to_send())
    assert not answered(client, answer[:20])  # it may come in parts
    assert answered(client, answer[20:])
    return client, server


@pytest.fixture
def pair() -> Iterator[tuple[WebSocket, socket.socket, ServerProtocol]]:
    ours, peer = socket.socketpair()
    ours.setblocking(False)
    client, server = connected()
    with ours, peer:
        yield WebSocket(ours, client), peer, server


def frames(server: ServerProtocol, data: bytes) -> list[tuple[Opcode, bytes]]:
    server.receive_data(data)
    return [(event.opcode, bytes(event.data)) for event in server.events_received() if isinstance(event, Frame)]


def test_a_server_that_does_not_offer_mqtt_is_refused() -> None:
    with pytest.raises(OSError, match="no WebSocket"):
        connected("chat")


Pair = tuple[WebSocket, socket.socket, ServerProtocol]


def test_what_is_sent_is_one_binary_frame(pair: Pair) -> None:
    sock, peer, server = pair
    assert sock.send(b"\x10abc") == 4
    assert frames(server, peer.recv(100)) == [(Opcode.BINARY, b"\x10abc")]


def test_bytes_of_several_frames_and_of_fragments_are_one_stream(pair: Pair) -> None:
    sock, peer, server = pair
    server.send_binary(b"ab")
    server.send_binary(b"cd", fin=False)
    server.send_continuation(b"ef", fin=True)
    data = b"".join(server.data_to_send())
    peer.sendall(data[:3])
    with pytest.raises(BlockingIOError):
        sock.recv(10)  # half a frame
    peer.sendall(data[3:])
    assert [sock.recv(1), sock.pending(), sock.recv(3), sock.recv(10)] == [b"a", 5, b"bcd", b"ef"]
    assert sock.pending() == 0
    with pytest.raises(BlockingIOError):
        sock.recv(1)


def test_a_ping_is_answered(pair: Pair) -> None:
    sock, peer, server = pair
    server.send_ping(b"?")
    peer.sendall(b"".join(server.data_to_send()))
    with pytest.raises(BlockingIOError):
        sock.recv(1)
    assert frames(server, peer.recv(100)) == [(Opcode.PONG, b"?")]


def test_a_close_is_answered_and_is_the_end(pair: Pair) -> None:
    sock, peer, server = pair
    server.send_binary(b"last")
    server.send_close(1000)
    peer.sendall(b"".join(server.data_to_send()))
    assert [sock.recv(10), sock.recv(10)] == [b"last", b""]
    assert frames(server, peer.recv(100)) == [(Opcode.CLOSE, b"\x03\xe8")]
    with pytest.raises(ConnectionResetError):
        sock.send(b"x")


def test_an_end_without_a_close_is_one(pair: Pair) -> None:
    sock, peer, _ = pair
    peer.close()
    assert sock.recv(1) == b""


class Narrow(socket.socket):
    """Takes three bytes at a time, and every other time none."""

    full = False

    def send(self, data: Any, flags: int = 0) -> int:
        self.full = not self.full
        if not self.full:
            raise BlockingIOError
        return super().send(data[:3])


def test_a_frame_that_the_network_takes_in_parts_is_sent_once_and_whole() -> None:
    inner, peer = socket.socketpair()
    client, server = connected()
    with Narrow(fileno=inner.detach()) as ours, peer:
        ours.setblocking(False)
        sock = WebSocket(ours, client)
        tries = 0
        for message in (b"first message", b"second"):
            while True:
                tries += 1
                try:
                    assert sock.send(message) == len(message)
                except BlockingIOError:
                    continue
                break
        assert tries > 4
        assert frames(server, peer.recv(1000)) == [(Opcode.BINARY, b"first message"), (Opcode.BINARY, b"second")]


@pytest.mark.parametrize(
    "data",
    [
        b"\x81\x01a",  # text
        b"\x82\x7f" + (MAX_FRAME_BYTES + 1).to_bytes(8, "big"),  # larger than is kept
        b"\x82\x81\x00\x00\x00\x00a",  # masked by a server
        b"\xf2\x01a",  # reserved bits
    ],
    ids=["text", "huge", "masked", "reserved"],
)
def test_a_violation_ends_the_connection(pair: Pair, data: bytes) -> None:
    sock, peer, _ = pair
    peer.sendall(data)
    with pytest.raises(OSError, match=r"a text frame|not a WebSocket's frame"):
        sock.recv(10)
