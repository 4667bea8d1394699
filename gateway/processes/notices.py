"""What is said about any child, whatever its work."""

from dataclasses import dataclass

from gateway.processes.codec import Message


class Failed(Message, frozen=True):
    """The child's last words; or, in its place, that it has said what is no message."""

    why: str
    config: bool = False  # only the operator can mend it


@dataclass(frozen=True, slots=True)
class Gone:
    """Said by the pool about a child: its process is no more."""

    how: str
    crashed: bool = False  # by a fault of its own code: SIGSEGV, SIGABRT and their like
