"""A replay by several processes: each begins at another segment, and goes on until the next one's work is its own. IO.

Each process is `replay_portions.replayed` from its first segment on. Where the fingerprint of a segment is that of the
process behind it, that one's portions are what this one would find, and it is ended. A process that never comes to that
does all the rest by itself: the result is that of one process in any case.
"""

import select
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import reduce
from subprocess import Popen

import msgspec

from gateway.errors import ConfigError, LinkError
from gateway.processes.channel import Channel, Failed
from gateway.processes.codec import Codec
from gateway.processes.start import Role, spawned
from gateway.records.replay_portions import Portion, ReplayJob, replayed

CODEC = Codec(ReplayJob, compressed=True)
ANSWERS = Codec(Portion | Failed, compressed=True)
MIN_SEGMENTS = 2  # of each process: only from the second on its work may be used


def run(channel: Channel[Portion, ReplayJob], job: ReplayJob) -> None:
    """In a process of its own."""
    try:
        replayed(job, channel.send)
    except OSError as error:
        raise LinkError(f"{error.filename}: {error.strerror}") from error


def found_by(job: ReplayJob, jobs: int, advance: Callable[[], None]) -> Portion:
    """All of it, by so many processes at most. `advance` is called for each segment. Raises ConfigError, LinkError and
    OSError."""
    count = len(job.paths)
    jobs = max(1, min(jobs, count // MIN_SEGMENTS))
    if jobs == 1:
        made = [Portion()]

        def report(portion: Portion) -> None:
            made[0] = made[0].joined(portion)
            advance()

        replayed(job, report)
        return made[0]
    workers: list[_Worker] = []
    try:
        for number in range(jobs):
            workers.append(_Worker.begun(msgspec.structs.replace(job, first=number * count // jobs)))
        done: set[int] = set()
        while _portion(workers, 0, count - 1) is None:
            for at in _arrived(workers, count):
                if at not in done:
                    done.add(at)
                    advance()
        found = (_portion(workers, 0, at) for at in range(count))
        return reduce(Portion.joined, (portion for portion in found if portion is not None), Portion())
    finally:
        for worker in workers:
            worker.end()


@dataclass(slots=True)
class _Worker:
    """`portions`: of the segments from `first` on. `until`: from this segment on they are those of the next one."""

    first: int
    process: "Popen[bytes]"
    channel: Channel[ReplayJob, Portion | Failed]
    portions: list[Portion] = field(default_factory=list)
    until: int | None = None

    @staticmethod
    def begun(job: ReplayJob) -> "_Worker":
        channel, theirs = Channel[ReplayJob, Portion | Failed].pair(ANSWERS)
        with theirs:
            process = spawned(Role(__name__, "gw-replay", job), theirs)
        channel.offer(job)
        return _Worker(job.first, process, channel)

    def end(self) -> None:
        self.process.kill()
        self.process.wait()
        self.channel.close()


def _arrived(workers: list[_Worker], count: int) -> list[int]:
    """The segments of which portions have arrived; waits for at least one. Ends processes that are not needed."""
    found: list[int] = []
    going = [worker.channel.sock for worker in workers if worker.until is None and not worker.channel.ended]
    ready, _, _ = select.select(going, [], [])
    for number, worker in enumerate(workers):
        if worker.channel.sock not in ready:
            continue
        for message in worker.channel.received():
            if isinstance(message, Failed):
                raise ConfigError(message.why) if message.config else LinkError(message.why)
            at = worker.first + len(worker.portions)
            worker.portions.append(message)
            found.append(at)
            if message.begins_as and _begins_as(workers, number + 1, at) == message.begins_as:
                worker.until = at
                worker.process.kill()
                break
        if worker.channel.ended and worker.until is None and worker.first + len(worker.portions) < count:
            raise LinkError("a process that replays has ended")
    return found


def _portion(workers: list[_Worker], number: int, at: int) -> Portion | None:
    """Of this segment, by this process or, where that was ended, the next; None: it has not arrived."""
    worker = workers[number]
    if worker.until is not None and at >= worker.until:
        return _portion(workers, number + 1, at)
    n = at - worker.first
    return worker.portions[n] if n < len(worker.portions) else None


def _begins_as(workers: list[_Worker], number: int, at: int) -> bytes:
    """Empty: that process does not know, or there is none."""
    if number == len(workers) or at <= workers[number].first:
        return b""
    portion = _portion(workers, number, at)
    return b"" if portion is None else portion.begins_as
