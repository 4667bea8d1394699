"""The one thread of the web process on which the index and kept pictures are read, one question at a time. IO.

Only what is bounded and small is read here; the recordings themselves are read by a process of its own.
"""

import asyncio
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from gateway.config import GatewayConfig
from gateway.errors import LinkError, ProtocolError
from gateway.records.index import NAME
from gateway.records.index_reader import IndexReader
from gateway.records.recorder_service import folder_of
from gateway.web.auth.refusals import RefusalError

MAX_WAITING = 24  # pages and programs
T = TypeVar("T")

NOT_RECORDED = "nothing is recorded: set state_dir in the configuration, and [records] enabled (docs/records.md)"


@dataclass(slots=True)
class RecordsThread:
    """`folder`: of all bays' recordings; None: nothing is recorded. For one event loop."""

    folder: Path | None
    thread: Executor
    _waiting: int = 0
    _turn: asyncio.Lock = field(default_factory=asyncio.Lock)

    @staticmethod
    def of(config: GatewayConfig, thread: Executor | None = None) -> "RecordsThread":
        return RecordsThread(folder_of(config), thread or ThreadPoolExecutor(1, thread_name_prefix="records"))

    async def index(self, what: Callable[[IndexReader], T]) -> T:
        """Raises RefusalError: nothing is recorded, the index is missing or damaged, or too many wait."""
        folder = self._folder()
        try:
            return await self._read(lambda: what(IndexReader(folder)))
        except LinkError as error:
            why = str(error)
        raise RefusalError(503, "index", await self._read(lambda: _why(folder, why)))

    async def pictures(self, bay: str, what: Callable[[Path], T]) -> T:
        """`what` gets the bay's folder, which need not be there. Raises RefusalError: as above, or it can't be read."""
        folder = self._folder() / bay
        try:
            return await self._read(lambda: what(folder))
        except (OSError, ProtocolError) as error:
            raise RefusalError(503, "records", f"the kept pictures cannot be read: {error}") from None

    def _folder(self) -> Path:
        if self.folder is None:
            raise RefusalError(503, "not_recorded", NOT_RECORDED)
        return self.folder

    async def _read(self, what: Callable[[], T]) -> T:
        if self._waiting >= MAX_WAITING:
            raise RefusalError(503, "busy", "too many requests for records wait", headers={"Retry-After": "2"})
        self._waiting += 1
        try:
            async with self._turn:
                return await asyncio.get_running_loop().run_in_executor(self.thread, what)
        finally:
            self._waiting -= 1


def _why(folder: Path, error: str) -> str:
    """For people: why there is no index now, and what to do."""
    path = folder / NAME
    try:
        with path.open("rb"):
            return f"{error}; the recorder makes one that is damaged anew within two minutes"
    except FileNotFoundError:
        return f"{path} is not there yet: the recorder makes it within a minute"
    except OSError as fault:
        return (
            f"{path} cannot be read ({fault.strerror}): the user of the web process (hmi.run_as) needs to be in the "
            "group of the recordings"
        )
