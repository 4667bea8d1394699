"""An evaluation shared among processes: some pictures, or one sequence, are a task. IO: reads pictures.

A result has what each method has found in them; the score is given where the results are joined.
"""

from collections.abc import Callable, Sequence
from hashlib import sha256
from pathlib import Path

import msgspec

from gateway.clock import SystemClock
from gateway.config import VisionConfig
from gateway.core.detection import Detection
from gateway.processes.batch import BatchTask, TaskDone, Workers, in_turn, keep, kept, name_of, serve, taken
from gateway.processes.channel import Channel
from gateway.processes.codec import Codec, Message, record_packed
from gateway.vision.offline.evaluation import runner
from gateway.vision.offline.evaluation.labels import Label, Labels
from gateway.vision.offline.evaluation.scoring import ScoredPicture, judge
from gateway.vision.offline.evaluation.summary import SeriesOf, in_sequence

PICTURES = 16  # of one task
Answer = tuple[Detection, int, tuple[int, int]]  # time in ns; width and height in px


class EvaluatePictures(BatchTask, frozen=True, kw_only=True):
    """`places`: of the labels, for errors. `series`: of the one sequence that they are; None: each is by itself."""

    folder: str
    labels: tuple[Label, ...]
    places: tuple[str, ...]
    methods: tuple[str, ...]
    params: VisionConfig
    series: str | None
    fps: float


class FoundInPictures(Message, frozen=True):
    """By method, in the order of the labels."""

    answers: dict[str, tuple[Answer, ...]]


CODEC = Codec(EvaluatePictures, compressed=True)
RESULT = Codec(FoundInPictures, compressed=True)


def run(channel: Channel[TaskDone, BatchTask], task: EvaluatePictures) -> None:
    """In a process of its own."""
    serve(channel, task)


def work(task: EvaluatePictures) -> str:
    """The name of the result. Raises ConfigError, OSError."""
    labels = Labels(Path(task.folder), "", task.labels, (), places=task.places)
    asked = msgspec.structs.replace(task, results="", folder="", places=())
    pictures = [sha256(labels.path(label).read_bytes()).digest() for label in task.labels]
    name = name_of("evaluate", record_packed(asked), pictures)
    if kept(task.results, name, RESULT) is None:
        clock = SystemClock()
        methods = runner.makers(task.params, task.methods, clock.now_ns)
        follow = None if task.series is None else lambda _: task.series or ""
        found = runner.run(labels, task.labels, methods, clock, follow=follow, fps=task.fps)
        answers = {
            method: tuple((each.detection, each.took_ns, each.size_px) for each in scored)
            for method, scored in found.items()
        }
        keep(task.results, name, FoundInPictures(answers))
    return name


def evaluated(
    labels: Labels,
    chosen: Sequence[Label],
    methods: Sequence[str],
    params: VisionConfig,
    results: str,
    workers: Workers,
    *,
    follow: SeriesOf | None = None,
    fps: float = 25.0,
    mean_radius: bool = False,
    advance: Callable[[], None] = lambda: None,
) -> dict[str, list[ScoredPicture]]:
    """As `runner.run`, by these workers; `results`: the folder for what they find. Raises ConfigError, LinkError."""
    sequences = in_sequence(chosen, follow) if follow else {}
    single = [label for label in chosen if follow is None or label.frame is None]
    parts: list[tuple[str | None, Sequence[Label]]] = [*sequences.items()]
    parts += [(None, single[at : at + PICTURES]) for at in range(0, len(single), PICTURES)]
    place = {id(label): labels.place(n) for n, label in enumerate(labels.labels)}
    tasks = [
        EvaluatePictures(
            folder=str(labels.folder.absolute()),
            labels=tuple(members),
            places=tuple(place[id(label)] for label in members),
            methods=tuple(methods),
            params=params,
            series=series,
            fps=fps,
            results=results,
        )
        for series, members in parts
    ]

    def done(number: int) -> None:
        for _ in parts[number][1]:
            advance()

    found: dict[str, dict[int, ScoredPicture]] = {method: {} for method in methods}
    names = in_turn([[task] for task in tasks], workers, done)
    for (_, members), (name,) in zip(parts, names, strict=True):
        result: FoundInPictures = taken(results, name, RESULT)
        for method, answers in result.answers.items():
            for label, (detection, took_ns, size_px) in zip(members, answers, strict=True):
                found[method][id(label)] = judge(label, detection, took_ns, size_px, mean=mean_radius)
    return {method: [scored[id(label)] for label in chosen] for method, scored in found.items()}
