"""The messages between the main process and the recorder process. Data only."""

from gateway.clock import SystemClock
from gateway.config import RecordsConfig
from gateway.core.visit_summary import VisitSummary
from gateway.processes.channel import Failed
from gateway.processes.codec import Codec, Message
from gateway.records.segment import Head
from gateway.vision.transport.ring_spec import RingSpec


class BayJob(Message, frozen=True):
    """`head`: of all its segments, but for number and times. `ring`: its frames; None: no pictures."""

    head: Head
    ring: RingSpec | None


class Job(Message, frozen=True):
    """The recorder's first message."""

    folder: str
    config: RecordsConfig
    clock: SystemClock
    bays: tuple[BayJob, ...]


class Records(Message, frozen=True):
    """One block. `begins`: a segment may begin with it. `visit_ended`: the index is brought up to date at once."""

    bay: str
    number: int
    t_ns: int
    begins: bool
    records: list[bytes]
    visit_ended: bool = False


class KeepPictures(Message, frozen=True):
    """Something happened: the pictures round `t_ns` are kept."""

    bay: str
    t_ns: int
    why: str


class Written(Message, frozen=True):
    """The batches up to this one are on the disk, or lost by `fault`."""

    number: int


class RecorderStatus(Message, frozen=True):
    """About once in ten seconds, and whenever `fault` changes; empty: none."""

    fault: str = ""
    index_fault: str = ""  # of index.sqlite; recording goes on


class PicturesNotKept(Message, frozen=True):
    """Of one incident. `detail`: how many, of what, and why, for people. `matters`: it is more than a
    routine stop for which the day's budget was used up."""

    bay: str
    number: int
    detail: str
    matters: bool


class OpenVisit(Message, frozen=True):
    """The visit that was open when the gateway ended before, from the recording. Once, for a bay that had one."""

    bay: str
    visit: VisitSummary


ToRecorder = Job | Records | KeepPictures
FromRecorder = Written | RecorderStatus | PicturesNotKept | OpenVisit
FROM_RECORDER = Codec(FromRecorder | Failed)
TO_RECORDER = Codec(ToRecorder, compressed=True)
