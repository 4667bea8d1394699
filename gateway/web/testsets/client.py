"""The web process's side of the process that keeps test sets. IO."""

from gateway.errors import ProtocolError
from gateway.web.auth.refusals import RefusalError
from gateway.web.helper_client import TEST_SETS, HelperClient
from gateway.web.ipc.testsets import BAY_SETS, BaySets, ListSets, PictureSet, ReadPicture, SetsQuestion


class SetsClient:
    """`fd`: of the socket to that process; None: nothing is kept. For one event loop."""

    def __init__(self, fd: int | None) -> None:
        self._helper: HelperClient[SetsQuestion] = HelperClient(TEST_SETS, fd)
        self.kept = self._helper.present
        self.close = self._helper.close

    async def sets(self, bay: str) -> tuple[PictureSet, ...]:
        """Raises RefusalError."""
        return (await self.change(ListSets(bay))).sets

    async def change(self, question: SetsQuestion, picture: bytes | None = None) -> BaySets:
        """Anything but `ReadPicture`; `picture`: the file of `AddPicture`. The bay's sets as they are then. Raises
        RefusalError."""
        try:
            sets: BaySets = BAY_SETS.unpacked(await self._helper.ask(question, picture))
        except ProtocolError as error:
            raise RefusalError(503, TEST_SETS.code, str(error)) from None
        return sets

    async def picture(self, bay: str, name: str, file: str) -> bytes:
        """Raises RefusalError."""
        return await self._helper.ask(ReadPicture(bay, name, file))
