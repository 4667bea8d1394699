"""The helper process that leaves a package and a request for the update: it alone writes the spool folder. IO.

It has the gateway's own rights, for the web process may write no file. It judges nothing: the root part does, which
trusts none of it (gateway/update/requested.py).
"""

import os
import shutil
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import get_args

import msgspec

from gateway.files import write_all, write_file
from gateway.processes.answers import QuestionRefusedError
from gateway.processes.channel import Channel, Failed
from gateway.processes.child import lower_priority
from gateway.processes.codec import record_packed
from gateway.processes.helper import Helper, QuestionKind, Send
from gateway.update_request import MAX_SIGNATURE_BYTES, PACKAGE, REQUEST, SIGNATURE, shown_now
from gateway.web.ipc.updates import (
    PIECE_BYTES,
    UPDATES_QUESTIONS,
    UPDATES_SETUP,
    AskUpdate,
    ReadUpdate,
    TakePiece,
    UpdateNow,
    UpdatesQuestion,
    UpdatesSetup,
)

CODEC = UPDATES_SETUP
LIMIT_S = 40.0
LIMIT_BYTES = 50_000_000
SPARE_BYTES = 200_000_000
FILES = {"package": PACKAGE, "signature": SIGNATURE}
PENDING = "a request waits for its start: systemctl status loading-gateway-update-request.path"


def run(channel: Channel[Failed, UpdatesSetup], setup: UpdatesSetup) -> None:
    """Until nothing is asked any more, or the main process has ended."""
    lower_priority()
    kind = QuestionKind(partial(answer, Path(setup.spool), Path(setup.shown)), LIMIT_S, LIMIT_BYTES, to_its_end=True)
    Helper(dict.fromkeys(get_args(UpdatesQuestion), kind)).serve(channel, setup.questions, UPDATES_QUESTIONS)


def answer(spool: Path, shown: Path, question: UpdatesQuestion, fds: Sequence[int], send: Send) -> None:
    """Raises OSError, QuestionRefusedError."""
    spool.mkdir(mode=0o700, exist_ok=True)
    request = spool / REQUEST
    if request.exists() and not isinstance(question, ReadUpdate):
        raise QuestionRefusedError(PENDING)
    match question:
        case TakePiece():
            _take(spool, question, fds)
        case AskUpdate(wanted):
            if wanted.action != "back" and not all(_size(spool / name) for name in FILES.values()):
                raise QuestionRefusedError("choose a package and its signature first")
            write_file(request, msgspec.json.encode(wanted))
    package_bytes, signature_bytes = (_size(spool / name) for name in FILES.values())
    send(record_packed(UpdateNow(shown_now(shown), package_bytes, signature_bytes, request.exists())))


def _take(spool: Path, piece: TakePiece, fds: Sequence[int]) -> None:
    if len(fds) != 1:
        raise QuestionRefusedError("no piece came with it")
    data = os.pread(fds[0], PIECE_BYTES + 1, 0)
    path = spool / FILES[piece.file]
    if piece.file == "signature" and piece.size > MAX_SIGNATURE_BYTES:
        raise QuestionRefusedError("this is no detached signature: it is too large")
    if len(data) > PIECE_BYTES or piece.offset + len(data) > piece.size:
        raise QuestionRefusedError("more than the file has")
    if piece.offset == 0:
        path.unlink(missing_ok=True)
        needed, free = 2 * piece.size + SPARE_BYTES, shutil.disk_usage(spool).free
        if needed > free:
            raise QuestionRefusedError(f"{needed / 1e6:.0f} MB of the disk are needed, {free / 1e6:.0f} MB are free")
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    try:
        if os.fstat(fd).st_size != piece.offset:
            raise QuestionRefusedError("another upload goes on: begin anew")
        write_all(fd, data)
    finally:
        os.close(fd)


def _size(path: Path) -> int:
    return path.lstat().st_size if path.is_file() else 0
