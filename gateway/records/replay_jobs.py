"""A replay shared among processes: each segment is a task, whose result has what the next one needs of it. IO.

A recording that several processes share is begun at several segments. Which result a segment has is named by its bytes
and by what is carried to it: where that is the same as in the replay from the beginning, what was found is taken, and
else it is decided again. So the result is that of one process in any case.
"""

from collections.abc import Callable, Sequence
from functools import reduce
from hashlib import sha256
from itertools import pairwise
from pathlib import Path

from gateway.processes.batch import BatchTask, TaskDone, Workers, in_turn, keep, kept, name_of, serve, taken
from gateway.processes.channel import Channel
from gateway.processes.codec import Codec, Message, record_packed
from gateway.records.replay_portions import Carried, Portion, ReplayRules, replayed

MIN_SEGMENTS = 2  # of each process: the first one's work is seldom used


class ReplaySegment(BatchTask, frozen=True, kw_only=True):
    """One segment, the `last` one or not."""

    rules: ReplayRules
    path: str
    last: bool


class ReplayedSegment(Message, frozen=True):
    portion: Portion
    carried: Carried


CODEC = Codec(ReplaySegment, compressed=True)
RESULT = Codec(ReplayedSegment, compressed=True)


def run(channel: Channel[TaskDone, BatchTask], task: ReplaySegment) -> None:
    """In a process of its own."""
    serve(channel, task)


def work(task: ReplaySegment) -> str:
    """The name of the segment's result. Raises ConfigError, LinkError, OSError."""
    path = Path(task.path)
    data = path.read_bytes()
    before = _result(task.results, task.after).carried if task.after else Carried()
    carried = sha256(record_packed(before)).hexdigest()
    rules = sha256(record_packed(task.rules)).hexdigest()
    name = name_of("replay", path.name, sha256(data).hexdigest(), task.last, rules, carried)
    if kept(task.results, name, RESULT) is None:
        keep(task.results, name, ReplayedSegment(*replayed(task.rules, path, data, before, last=task.last)))
    return name


def found_by(
    rules: ReplayRules,
    recordings: Sequence[Sequence[Path]],
    results: str,
    workers: Workers,
    count: int,
    advance: Callable[[], None] = lambda: None,
) -> list[Portion]:
    """Of each recording, whose segments these are, all. `results`: the folder for them. `count`: of the workers.
    `advance` is called for each segment. Raises ConfigError, LinkError and OSError."""
    whole = [_chain(rules, paths, results) for paths in recordings]
    shares = -(-count // len(whole))  # of each recording
    parts = [part for chain in whole for part in _later(chain, shares)]
    seen = in_turn([*whole, *parts], workers, lambda number: advance() if number < len(whole) else None)
    return [
        reduce(Portion.joined, (_result(results, name).portion for name in names), Portion())
        for names in seen[: len(whole)]
    ]


def _chain(rules: ReplayRules, paths: Sequence[Path], results: str) -> list[ReplaySegment]:
    texts = [str(path.absolute()) for path in paths]
    return [ReplaySegment(rules=rules, path=text, last=text == texts[-1], results=results) for text in texts]


def _later(chain: list[ReplaySegment], shares: int) -> list[list[ReplaySegment]]:
    """The parts of a recording but the first, each with one segment of the next, by which that one may go on."""
    shares = max(1, min(shares, len(chain) // MIN_SEGMENTS))
    begins = [number * len(chain) // shares for number in range(shares)] + [len(chain)]
    return [chain[begin : end + 1] for begin, end in pairwise(begins[1:])]


def _result(folder: str, name: str) -> ReplayedSegment:
    found: ReplayedSegment = taken(folder, name, RESULT)
    return found
