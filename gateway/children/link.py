"""A socket between the main process and one child: whole messages, end of file when the other side is gone."""

import pickle
import socket
import sys
from typing import Generic, TypeVar

MAX_MESSAGE_BYTES = 64 * 1024

Out = TypeVar("Out")
In = TypeVar("In")


class Link(Generic[Out, In]):
    """One end of a SOCK_SEQPACKET pair: the kernel keeps messages whole, so nobody ever waits for half of one."""

    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        self.ended = False

    @classmethod
    def pair(cls) -> tuple["Link[Out, In]", socket.socket]:
        """The main process's end, never blocking, and the socket for the child."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        return cls(ours), theirs

    # For the main process.

    def offer(self, message: Out) -> bool:
        """Send without waiting. False: the child is gone, or has not read for hundreds of messages."""
        try:
            self.sock.send(_packed(message))
        except (BlockingIOError, BrokenPipeError, ConnectionResetError):
            return False
        return True

    def received(self) -> list[In]:
        """Everything that has arrived; sets `ended` at the end of file. Never waits."""
        messages: list[In] = []
        while not self.ended:
            try:
                data = self.sock.recv(MAX_MESSAGE_BYTES)
            except BlockingIOError:
                break
            except ConnectionResetError:
                data = b""
            if data:
                messages.append(pickle.loads(data))
            else:
                self.ended = True
        return messages

    # For the child.

    def send(self, message: Out) -> None:
        """Send, waiting for room. Ends the process when the main process is gone."""
        try:
            self.sock.send(_packed(message))
        except (BrokenPipeError, ConnectionResetError):
            sys.exit(0)

    def receive(self) -> In:
        """Wait for the next message. Ends the process when the main process is gone."""
        try:
            data = self.sock.recv(MAX_MESSAGE_BYTES)
        except ConnectionResetError:
            data = b""
        if not data:
            sys.exit(0)
        message: In = pickle.loads(data)
        return message

    def waiting(self) -> list[In]:
        """Everything that has arrived, without waiting for more. Ends the process when the main process is gone."""
        self.sock.setblocking(False)
        messages = self.received()
        self.sock.setblocking(True)
        if self.ended:
            sys.exit(0)
        return messages

    def close(self) -> None:
        self.sock.close()


def _packed(message: object) -> bytes:
    data = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
    if len(data) > MAX_MESSAGE_BYTES:
        raise ValueError(f"a message of {len(data)} bytes; at most {MAX_MESSAGE_BYTES}")
    return data
