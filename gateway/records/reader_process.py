"""The reader process: answers from the recordings themselves, one at a time (`processes.helper`). IO.

It reads for a process that any network client may send requests to, so it has no more rights than that one.
"""

import sys
from functools import partial
from pathlib import Path
from types import ModuleType

from gateway.errors import ConfigError
from gateway.processes import sandbox
from gateway.processes.answers import NothingError
from gateway.processes.channel import Channel, Failed
from gateway.processes.child import lower_priority
from gateway.processes.codec import Codec
from gateway.processes.helper import Helper, QuestionKind, Send
from gateway.records.questions import QUESTIONS, EvidenceQuestion, Question, ReaderSetup, ValuesQuestion, WhyQuestion

CODEC = Codec(ReaderSetup)
LIMIT_S = 100.0
EVIDENCE_LIMIT_S = 600.0  # its sending included
LIMIT_BYTES = 700_000_000  # an answer keeps six segments in memory, 60 MB each


def run(channel: Channel[Failed, ReaderSetup], setup: ReaderSetup) -> None:
    """Until nothing is asked any more, or the main process has ended."""
    lower_priority()
    for line in sandbox.enter(setup.run_as):
        print(f"records: the reader keeps a right that it does not need: {line}", file=sys.stderr)
    from gateway.records import answers  # noqa: PLC0415 - its libraries are loaded without these rights

    answered = partial(_answer, answers, Path(setup.folder))
    kind = QuestionKind(answered, LIMIT_S, LIMIT_BYTES)
    evidence = QuestionKind(answered, EVIDENCE_LIMIT_S, LIMIT_BYTES)
    kinds: dict[type, QuestionKind] = {WhyQuestion: kind, ValuesQuestion: kind, EvidenceQuestion: evidence}
    # One is a file of evidence that somebody fetches slowly.
    Helper(kinds, at_once=2).serve(channel, setup.questions, QUESTIONS)


def _answer(answers: ModuleType, folder: Path, question: Question, _: object, send: Send) -> None:
    """Raises GatewayError, OSError."""
    try:
        if isinstance(question, EvidenceQuestion):
            answers.give_evidence(folder, question, send)
        else:
            send(answers.answer(folder, question))
    except ConfigError as error:
        raise NothingError(str(error)) from error
