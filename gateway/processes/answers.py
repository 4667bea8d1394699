"""How a helper process answers a question: pieces in the pipe that travels with it, until the end of the file.

A piece is its length, one byte of AnswerKind, and the content. Where the asker closes its end, the work is given up.
"""

from enum import Enum

from gateway.errors import GatewayError
from gateway.files import write_all

LENGTH_BYTES = 4  # before every piece


class AnswerKind(Enum):
    """What the content of a piece is: the answer itself, or a text for people."""

    ANSWER = b"+"
    NOTHING = b"0"  # there is nothing that it could be answered from
    REFUSED = b"!"  # a limit, a name that is taken
    FAULT = b"-"


class NothingError(GatewayError):
    """There is nothing that a question could be answered from."""


class QuestionRefusedError(GatewayError):
    """What was asked for can't be done as things are: a limit, a name that is taken or not possible."""


def write_piece(pipe: int, kind: AnswerKind, content: bytes) -> None:
    """Waits for room. Raises OSError where nobody reads."""
    write_all(pipe, (1 + len(content)).to_bytes(LENGTH_BYTES) + kind.value)
    write_all(pipe, content)
