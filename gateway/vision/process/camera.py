"""The camera process: open the source, check and number its frames, write them into the ring, hand them on."""

import gc
import socket
from collections import deque

from gateway.processes.channel import Link
from gateway.processes.codec import Codec
from gateway.vision.source.checks import FrameChecks
from gateway.vision.transport.messages import CameraJob, Captured, FrameRef, GiveBack, Handed, Look, Opened, Straight
from gateway.vision.transport.ring import Ring

CODEC = Codec(CameraJob | GiveBack | Straight, compressed=True)
NOTHING = Codec(None)
"""Of links that this process only says something over."""


def run(link: Link[Opened | Captured, GiveBack | Straight], job: CameraJob, notes: Link[Handed, None]) -> None:
    """Until the source ends (LinkError) or the main process is gone. Never returns."""
    ring = Ring(job.ring, writable=True)
    spec = job.source.spec()
    source = spec.open(job.clock)
    gc.collect()
    gc.freeze()  # as in `worker`
    link.send(Opened(source.lossless, source.finite))
    checks = FrameChecks(spec.label, job.rules, ring.newest_px(), may_repeat=source.may_repeat)
    desk = Desk(link, job.slots)
    seq, skipped = job.first_seq - 1, 0
    while True:
        image = source.read()
        changed_ns = checks.passed(image)
        if changed_ns is None:
            continue
        seq += 1
        desk.read()
        if not desk.free and not source.lossless:
            skipped += 1
            continue
        while not desk.free:
            desk.wait()
        slot = desk.free.popleft()  # the one longest free: a viewer has time to copy the newest frames
        generation = ring.write(slot, image.image, seq, image.t_capture_ns, changed_ns)
        frame = FrameRef(slot, generation, seq, image.t_capture_ns)
        if not desk.straight:
            link.send(Captured(frame, skipped))
            continue
        worker, inbox = desk.straight.popleft()
        # The note first: no worker ever has a frame that the main process can't know of. A worker that is gone already
        # does not get it; the main process hears of both, and sees to it.
        notes.send(Handed(frame, skipped, worker, job.clock.now_ns()))
        inbox.offer(Look(frame))
        inbox.close()


class Desk:
    """What the main process has given to this camera: slots to be written, and workers with nothing to do."""

    def __init__(self, link: Link[Opened | Captured, GiveBack | Straight], slots: tuple[int, ...]) -> None:
        self._link = link
        self.free = deque(slots)
        self.straight: deque[tuple[int, Link[Look, None]]] = deque()

    def read(self) -> None:
        """All that has come."""
        for message in self._link.waiting():
            self._take(message)

    def wait(self) -> None:
        """For one message more."""
        self._take(self._link.receive())

    def _take(self, message: GiveBack | Straight) -> None:
        match message:
            case GiveBack(slot):
                self.free.append(slot)
            case Straight(worker):
                # Its own copy of the main process's end, closed when it has been used.
                if (fd := self._link.taken_fd()) is not None:
                    self.straight.append((worker, Link(socket.socket(fileno=fd), NOTHING)))
