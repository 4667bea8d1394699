"""A socket between the main process and one child: complete messages, end of file when the other side is gone."""

import socket
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from gateway.errors import ProtocolError
from gateway.processes.codec import MAX_MESSAGE_BYTES, Codec, Message

MAX_FDS = 253  # with one message; Linux' own limit (SCM_MAX_FD)

Out = TypeVar("Out")
In = TypeVar("In")


class Failed(Message, frozen=True):
    """A child's last message; or, in its place, that it has sent an invalid one."""

    why: str
    config: bool = False  # only the operator can correct it


@dataclass(frozen=True, slots=True)
class Gone:
    """In place of a message: the child's process has ended."""

    how: str
    crashed: bool = False  # by a fault of the child's code: SIGSEGV, SIGABRT and their like


class Channel(Generic[Out, In]):
    """One end of a SOCK_SEQPACKET pair: the kernel keeps messages complete, so no reader ever waits for half of one.

    `codec` defines what may arrive. What may be sent is defined by the other side's codec.
    """

    def __init__(self, sock: socket.socket, codec: Codec) -> None:
        self.sock = sock
        self.codec = codec
        self.ended = False

    @classmethod
    def pair(cls, codec: Codec) -> tuple["Channel[Out, In]", socket.socket]:
        """The main process's end, never blocking, and the socket for the child."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        return cls(ours, codec), theirs

    def offer(self, message: Out, fds: Sequence[int] = ()) -> bool:
        """Send without waiting, descriptors with it. False: the other side is gone, or has not read for hundreds of
        messages."""
        try:
            if fds:
                socket.send_fds(self.sock, [self._packed(message)], fds, socket.MSG_DONTWAIT)
            else:
                self.sock.send(self._packed(message), socket.MSG_DONTWAIT)
        except (BlockingIOError, BrokenPipeError, ConnectionResetError):
            return False
        return True

    # For the main process.

    def received(self, most: int | None = None) -> list[In | Failed]:
        """Everything that has arrived, or the `most` oldest of it; sets `ended` at the end of file. Never waits.

        An invalid message ends it, too: it is reported as `Failed`, and nothing after it is read. Without a limit it
        ends with a system call that finds nothing.
        """
        messages: list[In | Failed] = []
        while not self.ended and len(messages) != most:
            try:
                data = self.sock.recv(MAX_MESSAGE_BYTES, socket.MSG_DONTWAIT)
            except BlockingIOError:
                break
            except ConnectionResetError:
                continue  # once, when the other side had not read all it was sent; its own last messages follow
            if not data:
                self.ended = True
                break
            try:
                messages.append(self.codec.unpacked(data))
            except ProtocolError as error:
                messages.append(Failed(str(error)))
                self.ended = True
        return messages

    # For the child.

    def send(self, message: Out) -> None:
        """Send, waiting for room. Ends the process when the main process is gone."""
        try:
            self.sock.send(self._packed(message))
        except (BrokenPipeError, ConnectionResetError):
            sys.exit(0)

    def receive(self) -> In:
        """Wait for the next message. Ends the process when the main process is gone."""
        message: In = self.codec.unpacked(self._read(0))
        return message

    def receive_with_fds(self) -> tuple[In, list[int]]:
        """As `receive`, with the descriptors that came with it; they are the caller's to close."""
        data, fds, _, _ = socket.recv_fds(self.sock, MAX_MESSAGE_BYTES, MAX_FDS, socket.MSG_CMSG_CLOEXEC)
        if not data:
            sys.exit(0)
        return self.codec.unpacked(data), fds

    def waiting(self) -> list[In]:
        """Everything that has arrived, without waiting for more. Ends the process when the main process is gone."""
        messages: list[In] = []
        while True:
            try:
                messages.append(self.codec.unpacked(self._read(socket.MSG_DONTWAIT)))
            except BlockingIOError:
                return messages

    def _read(self, flags: int) -> bytes:
        try:
            data = self.sock.recv(MAX_MESSAGE_BYTES, flags)
        except ConnectionResetError:
            sys.exit(0)
        if not data:
            sys.exit(0)
        return data

    def close(self) -> None:
        self.sock.close()

    def _packed(self, message: object) -> bytes:
        data = self.codec.packed(message)
        if len(data) > MAX_MESSAGE_BYTES:
            raise ValueError(f"a message of {len(data)} bytes; at most {MAX_MESSAGE_BYTES}")
        return data
