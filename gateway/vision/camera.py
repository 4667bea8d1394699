"""The camera process: open the source, stamp and number its frames, write them into the ring."""

from collections import deque

from gateway.children.link import Link
from gateway.vision.jobs import CameraJob, Captured, FrameRef, GiveBack, Opened
from gateway.vision.shm import Ring


def run(link: Link[Opened | Captured, GiveBack], job: CameraJob) -> None:
    """Until the source ends (LinkError) or the main process is gone. Never returns."""
    ring = Ring(job.ring, writable=True)
    source = job.spec.open(job.clock)
    link.send(Opened(source.lossless))
    free = deque(job.slots)
    seq, skipped = job.first_seq - 1, 0
    while True:
        frame = source.read()
        seq += 1
        free.extend(message.slot for message in link.waiting())
        if not free and not source.lossless:
            skipped += 1
            continue
        while not free:
            free.append(link.receive().slot)
        slot = free.popleft()  # the one longest free: a viewer has time to copy the newest frames
        generation = ring.write(slot, frame.image, seq, frame.t_capture_ns)
        link.send(Captured(FrameRef(slot, generation, seq, frame.t_capture_ns), skipped))
