"""The reader of the gateway's own registers: what it asks, and what it makes of each answer."""

import socket
from contextlib import closing

import pytest

from gateway.errors import ProtocolError
from gateway.modbus import client


def asked(answer: bytes, count: int = 2) -> tuple[tuple[int, ...], bytes]:
    """What is read where a server sends `answer` and then ends the connection; the request."""
    here, there = socket.socketpair()
    with closing(here), closing(there):
        there.sendall(answer)
        there.shutdown(socket.SHUT_WR)
        return client.holding_registers(here, 7, count), there.recv(100)


def test_registers_are_read_by_function_code_3() -> None:
    values, request = asked(bytes.fromhex("0001 0000 0007 07 03 04 00ff 8001"))
    assert values == (255, 32769)
    assert request == bytes.fromhex("0001 0000 0006 07 03 0000 0002")


@pytest.mark.parametrize(
    ("answer", "error", "words"),
    [
        ("", ConnectionResetError, "it closed the connection"),
        ("0001 0000 0007 07 03 04 00", ConnectionResetError, "it closed the connection"),
        ("0001 0000 0003 07 83 0b", ProtocolError, "it answers with exception 0B"),
        ("0001 0000 0005 07 03 02 00ff", ProtocolError, "it answers with 4 bytes: 03 02 00 ff"),
        ("0001 0000 0007 07 04 04 00ff 8001", ProtocolError, "it answers with 6 bytes: 04 04 00 ff 80 01"),
        ("0001 0009 0007 07 03 04 00ff 8001", ProtocolError, "it answers with another protocol id than 0"),
        ("4854 5450 2f31 2e31", ProtocolError, "it answers with a length outside of 2 to 254"),
    ],
)
def test_any_other_answer_is_an_error_with_its_reason(answer: str, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=f"{words}$"):
        asked(bytes.fromhex(answer))
