"""Calibrations under way: a bay's live picture is looked at while a page asks, and good views are kept. asyncio.

Nothing here touches the bay: frames are copied as for any viewer, and worked on by the technicians' one thread. One
session for each bay, in memory only; without a page that asks it ends after IDLE_S.
"""

import asyncio
import itertools
from collections import OrderedDict
from dataclasses import dataclass, field

from gateway.clock import Clock
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.errors import ConfigError, GatewayError, LinkError
from gateway.vision.offline.calibration.boards import Board, Points, other_size
from gateway.vision.offline.calibration.selection import Stillness, ViewVerdict
from gateway.vision.offline.calibration.solve import BoardView, Calibration, calibrate
from gateway.vision.transport.ring import Snapshot
from gateway.web.calibration.examine import Examined, examine
from gateway.web.server.gateway_client import BayReport, GatewayClient
from gateway.web.server.pictures import encoded
from gateway.web.tuning.trial_thread import TrialThread

MAX_SESSIONS = 2  # each keeps pictures
MAX_VIEWS = 40
MAX_BYTES = 128 << 20  # of a session's pictures
IDLE_S = 600.0  # a session that no page has asked about for this time is dropped
NEWER_S = 1.0  # a look waits at most this long for a newer frame
POLL_S = 0.02
KEPT_LOOKS = 2  # whose pictures may still be fetched
THUMBNAIL_PX = 240
HINT_S = 3.0  # without a board for this time, and then so often, one of another size is searched
NO_FRAME = "there is no frame: the camera has given none"


class CalibrationError(GatewayError):
    """It can't be done now, and why."""


@dataclass(frozen=True, slots=True)
class KeptView:
    """`png`: grey; `thumbnail`: JPEG. `wall_ns`: Unix time when it was taken."""

    number: int
    points: Points
    png: bytes
    thumbnail: bytes
    wall_ns: int

    @property
    def name(self) -> str:
        """Of its file: in the order in which they were taken."""
        return f"view-{self.number:03}.png"


@dataclass(frozen=True, slots=True)
class BoardLook:
    """One look at the live picture. `frame_id` None: there was no new one; `age_ms` is of the one before then. `other`:
    of a board of another size."""

    number: int
    examined: Examined
    size_px: tuple[int, int]
    frame_id: int | None = None
    age_ms: float | None = None
    work_ms: float = 0.0
    view: int | None = None  # number of the view that was taken
    other: tuple[int, int] | None = None


@dataclass(slots=True)
class CalibrationSession:
    """One calibration. `coefficients`: of distortion; None: as many as can be determined."""

    bay: str
    who: str
    board: Board
    coefficients: int | None
    size_px: tuple[int, int]
    watched_ns: int
    seq: int  # of the newest frame that was looked at, and when it was taken: no frame is looked at twice
    t_capture_ns: int
    views: list[KeptView] = field(default_factory=list)
    revision: int = 0  # of `views`
    looked: BoardLook | None = None
    pictures: OrderedDict[int, bytes] = field(default_factory=OrderedDict)
    outcome: Calibration | str = ""  # or why there is none
    solved: int = -1  # the revision of `outcome`
    stillness: Stillness = field(default_factory=Stillness)
    lost_ns: int | None = None  # since when there is no board, or a hint was searched
    other: tuple[int, int] | None = None
    looking: asyncio.Lock = field(default_factory=asyncio.Lock)
    solving: asyncio.Lock = field(default_factory=asyncio.Lock)
    numbers: "itertools.count[int]" = field(default_factory=lambda: itertools.count(1))
    view_numbers: "itertools.count[int]" = field(default_factory=lambda: itertools.count(1))

    @property
    def full(self) -> bool:
        return len(self.views) >= MAX_VIEWS or sum(len(view.png) for view in self.views) >= MAX_BYTES


@dataclass(frozen=True, slots=True)
class _Work:
    """What the thread has made of a frame; pictures as JPEG."""

    found: Examined
    jpeg: bytes
    thumbnail: bytes
    work_ms: float


class Calibrations:
    """One for the web process. `worker`: the thread for pictures."""

    def __init__(self, client: GatewayClient, pace: Clock, worker: TrialThread) -> None:
        self._client = client
        self._pace = pace
        self._worker = worker
        self._sessions: dict[str, CalibrationSession] = {}
        client.listeners.append(self._on_report)

    def of(self, bay: str) -> CalibrationSession | None:
        """Looked at by a page: it is kept."""
        self._drop_old()
        session = self._sessions.get(bay)
        if session is not None:
            session.watched_ns = self._client.clock.now_ns()
        return session

    def mine(self, bay: str, who: str) -> CalibrationSession:
        """Raises CalibrationError where there is none, or it is another user's."""
        self._drop_old()
        session = self._sessions.get(bay)
        if session is None:
            raise CalibrationError("no calibration is under way here (any more): begin one")
        self._check(session, who)
        session.watched_ns = self._client.clock.now_ns()
        return session

    async def begin(self, bay: str, board: Board, coefficients: int | None, who: str) -> CalibrationSession:
        """Its former views, if any, are lost. Raises CalibrationError, LinkError."""
        self._drop_old()
        if (before := self._sessions.get(bay)) is not None:
            self._check(before, who)
        elif len(self._sessions) >= MAX_SESSIONS:
            others = ", ".join(f"{session.bay} ({session.who})" for session in self._sessions.values())
            raise CalibrationError(f"cameras of other bays are being calibrated: {others}; end one of these first")
        frame = await self._newer(bay, None)
        if frame is None:
            raise LinkError(NO_FRAME)
        now_ns = self._client.clock.now_ns()
        session = CalibrationSession(
            bay, who, board, coefficients, _size_px(frame), now_ns, frame.seq, frame.t_capture_ns
        )
        self._sessions[bay] = session
        return session

    def end(self, bay: str) -> None:
        """Forget the bay's session, whoever's it is."""
        self._sessions.pop(bay, None)

    async def look(self, session: CalibrationSession, after: int, width_px: int, *, take: bool = False) -> BoardLook:
        """The newest look after number `after`: another page's, or one at the next frame. `take`: a view by hand.

        Raises TrialsBusyError, UnencodableError.
        """
        async with session.looking:
            before = session.looked
            if before is not None and before.number > after and not take:
                return before
            frame = await self._newer(session.bay, session.seq)
            number = next(session.numbers)
            if frame is None:
                age_ms = self._client.age_ms(session.t_capture_ns)
                nothing = Examined(ViewVerdict.NO_PICTURE, None, 0.0)
                session.looked = BoardLook(number, nothing, session.size_px, age_ms=age_ms)
            else:
                session.seq, session.t_capture_ns = frame.seq, frame.t_capture_ns
                who = f"calibration of {session.bay}"
                work = await self._worker.work(who, lambda _: self._work(session, frame, width_px, by_hand=take))
                session.looked = self._noted(session, number, frame, work)
            return session.looked

    def remove(self, session: CalibrationSession, number: int) -> bool:
        """Whether there was such a view."""
        kept = [view for view in session.views if view.number != number]
        if len(kept) == len(session.views):
            return False
        session.views, session.revision = kept, session.revision + 1
        return True

    async def result(self, session: CalibrationSession) -> Calibration | str:
        """Of all views, or why none follows from them: as `gateway calibrate` has it. Raises TrialsBusyError."""
        async with session.solving:
            while session.solved != session.revision:
                revision = session.revision
                views = [BoardView(view.name, view.points) for view in session.views]
                who = f"result of {session.bay}"
                session.outcome = await self._worker.work(who, lambda _, views=views: _solved(session, views))  # type: ignore[misc]
                session.solved = revision
            return session.outcome

    def _work(self, session: CalibrationSession, frame: Snapshot, width_px: int, *, by_hand: bool) -> "_Work":
        """On the thread. It reads the session's views, and nobody else uses its stillness and hint meanwhile."""
        begun_ns = self._pace.now_ns()
        found = Examined(ViewVerdict.OTHER_SIZE, None, 0.0)
        if _size_px(frame) == session.size_px:
            taken = [view.points for view in session.views]
            lens = session.outcome.lens if isinstance(session.outcome, Calibration) else None
            found = examine(session.board, frame, taken, lens, session.stillness, by_hand=by_hand)
            _hint(session, frame, found)
        thumbnail = b"" if found.view is None else encoded(frame.image, THUMBNAIL_PX)
        jpeg = encoded(frame.image, width_px)
        return _Work(found, jpeg, thumbnail, (self._pace.now_ns() - begun_ns) / NS_PER_MS)

    def _noted(self, session: CalibrationSession, number: int, frame: Snapshot, work: "_Work") -> BoardLook:
        found, taken = work.found, None
        if found.view is not None and session.full:
            found = Examined(ViewVerdict.FULL, found.points, found.held_s)
        elif found.view is not None:
            points, png = found.view
            taken = next(session.view_numbers)
            view = KeptView(taken, points, png, work.thumbnail, self._client.clock.wall_ns())
            session.views, session.revision = [*session.views, view], session.revision + 1
        session.pictures[number] = work.jpeg
        while len(session.pictures) > KEPT_LOOKS:
            session.pictures.popitem(last=False)
        age_ms = self._client.age_ms(frame.t_capture_ns)
        return BoardLook(number, found, _size_px(frame), frame.seq, age_ms, work.work_ms, taken, session.other)

    async def _newer(self, bay: str, seq: int | None) -> Snapshot | None:
        """A frame that is not number `seq`; None: none comes."""
        until_ns = self._pace.now_ns() + round(NEWER_S * NS_PER_S)
        while True:
            frame = self._client.snapshot(bay)
            if frame is not None and frame.seq != seq:
                return frame
            if self._pace.now_ns() >= until_ns:
                return None
            await self._pace.sleep(POLL_S)

    def _check(self, session: CalibrationSession, who: str) -> None:
        if session.who != who:
            raise CalibrationError(f"{session.who} is calibrating the camera of {session.bay}; wait, or end that")

    def _on_report(self, _bay: str, _report: BayReport) -> None:
        self._drop_old()

    def _drop_old(self) -> None:
        now_ns = self._client.clock.now_ns()
        for bay, session in list(self._sessions.items()):
            if now_ns - session.watched_ns > IDLE_S * NS_PER_S:
                del self._sessions[bay]


def _size_px(frame: Snapshot) -> tuple[int, int]:
    return frame.image.shape[1], frame.image.shape[0]


def _hint(session: CalibrationSession, frame: Snapshot, found: Examined) -> None:
    """Now and then, while there is no board: is there one of another size?"""
    if found.points is not None:
        session.lost_ns = session.other = None
    elif session.lost_ns is None:
        session.lost_ns = frame.t_capture_ns
    elif frame.t_capture_ns - session.lost_ns > HINT_S * NS_PER_S:
        session.lost_ns = frame.t_capture_ns
        session.other = other_size(session.board, frame.image)


def _solved(session: CalibrationSession, views: list[BoardView]) -> Calibration | str:
    try:
        return calibrate(session.board, views, session.size_px, session.coefficients)
    except ConfigError as error:
        return str(error)
