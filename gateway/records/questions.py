"""What the web process asks the reader process, and how the answer comes back. Pure.

A question travels with the writing end of a pipe; the answer is one byte of AnswerKind and its content, until the end
of the file. Where the asker closes its end, the work is given up.
"""

from enum import Enum

from gateway.processes.codec import Codec, Message


class ReaderSetup(Message, frozen=True):
    """The reader process's job."""

    folder: str  # of all bays' recordings
    questions: int  # descriptor: a SOCK_SEQPACKET socket, inherited
    run_as: str | None  # user that it becomes, where the gateway runs as root


class WhyQuestion(Message, frozen=True):
    """Why were the outputs of `bay` as they were at `at_ms` (Unix time)? `html`: as a report, else as JSON. `pictures`:
    may it contain pictures?"""

    bay: str
    at_ms: int
    html: bool
    pictures: bool


class ValuesQuestion(Message, frozen=True):
    """R, Z and the outputs from `since_ms` to `until_ms` (Unix time) in at most `points` buckets: as JSON."""

    bay: str
    since_ms: int
    until_ms: int
    points: int


Question = WhyQuestion | ValuesQuestion
QUESTIONS = Codec(Question)


class AnswerKind(Enum):
    """The first byte of an answer. What follows is the answer itself, or a text for people."""

    ANSWER = b"+"
    NOTHING = b"0"  # nothing is recorded that it could be answered from
    FAULT = b"-"
