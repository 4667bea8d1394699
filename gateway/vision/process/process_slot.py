"""The place of one process in the dispatcher's books. Pure."""

from dataclasses import dataclass, field
from enum import Enum, auto

from gateway.vision.transport.messages import FrameRef


class Phase(Enum):
    """Of one process. ABSENT: to be started when due. LEAVING: failed, not yet reported gone."""

    ABSENT = auto()
    STARTING = auto()
    IDLE = auto()  # a camera: giving frames
    BUSY = auto()  # workers only
    ENDING = auto()  # a lossless camera that has ended, while its last frames are looked at
    LEAVING = auto()


@dataclass(slots=True)
class Seat:
    """The processes in it come and go, each with its own token."""

    phase: Phase = Phase.ABSENT
    token: int = 0
    since_ns: int = 0  # of the phase, or the last sign of life
    due_ns: int = 0  # when ABSENT or LEAVING: not to be started before
    frames: list[FrameRef] = field(default_factory=list)  # BUSY workers: in their hands, one but for a race
    offered: bool = False  # workers: the camera may hand its next frame straight to this one
    reaped: bool = False  # the process is gone, whatever the phase
    failures: int = 0  # in a row

    @property
    def alive(self) -> bool:
        return self.phase not in (Phase.ABSENT, Phase.LEAVING)

    def take(self, frame: FrameRef, now_ns: int) -> None:
        """One more frame to look at; the deadline is that of the first in hand."""
        if not self.frames:
            self.phase, self.since_ns = Phase.BUSY, now_ns
        self.frames.append(frame)

    def put_down(self, seq: int, now_ns: int) -> FrameRef | None:
        """The frame of this number, if it was in hand: it is not any more."""
        for frame in self.frames:
            if frame.seq == seq:
                self.frames.remove(frame)
                self.since_ns = now_ns
                if not self.frames:
                    self.phase = Phase.IDLE
                return frame
        return None
