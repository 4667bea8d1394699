"""What the web process asks the reader process (`processes.answers`: how the answer comes back). Pure."""

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


class EvidenceQuestion(Message, frozen=True):
    """All that is recorded of `bay` from `begin_ms` to `end_ms` (Unix time), as a ZIP in pieces; behind its last one
    comes an empty one. `pictures`: may it contain pictures?"""

    bay: str
    begin_ms: int
    end_ms: int
    pictures: bool


Question = WhyQuestion | ValuesQuestion | EvidenceQuestion
QUESTIONS = Codec(Question)
