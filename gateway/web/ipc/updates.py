"""What the web process asks the process that leaves packages for the update: pieces of files, and requests. Pure."""

from typing import Annotated, Literal

from msgspec import Meta

from gateway.processes.codec import Codec, Message
from gateway.update_request import MAX_PACKAGE_BYTES, ShownUpdate, UpdateRequest

PIECE_BYTES = 1 << 20


class UpdatesSetup(Message, frozen=True):
    """The process's job."""

    spool: str
    shown: str  # path of what the root part shows
    questions: int  # descriptor: a SOCK_SEQPACKET socket, inherited


class TakePiece(Message, frozen=True):
    """A piece of a file, in the memory whose descriptor comes with it. `offset` 0: begin anew; else where the file ends
    now. `size`: of the whole file."""

    file: Literal["package", "signature"]
    offset: Annotated[int, Meta(ge=0, le=MAX_PACKAGE_BYTES)]
    size: Annotated[int, Meta(ge=1, le=MAX_PACKAGE_BYTES)]


class AskUpdate(Message, frozen=True):
    """Leave this request for the root part."""

    request: UpdateRequest


class ReadUpdate(Message, frozen=True):
    """Nothing but the answer."""


UpdatesQuestion = TakePiece | AskUpdate | ReadUpdate
UPDATES_QUESTIONS = Codec(UpdatesQuestion)
UPDATES_SETUP = Codec(UpdatesSetup)


class UpdateNow(Message, frozen=True):
    """To every question. Sizes of what was uploaded so far, bytes; `pending`: a request was not taken yet."""

    shown: ShownUpdate
    package_bytes: int
    signature_bytes: int
    pending: bool


UPDATE_NOW = Codec(UpdateNow)
