"""The recorder process: blocks to the disk, pictures round what happened, and the oldest files away. IO.

Nothing waits for it: the main process keeps what it has not acknowledged, and counts what it must drop. It reads the
frames from the ring as any viewer does, so the vision process does not notice it either. A disk that refuses is
reported and tried again with the next block.
"""

import select
from dataclasses import dataclass
from pathlib import Path

import cv2
import msgspec

from gateway.clock import machine_ns
from gateway.core import details
from gateway.durations import NS_PER_S
from gateway.errors import LinkError
from gateway.processes.channel import Channel
from gateway.processes.child import lower_priority
from gateway.records import recording
from gateway.records.incident import Incident, IncidentPictures, budget_left, matters
from gateway.records.index import Index
from gateway.records.messages import (
    TO_RECORDER,
    BayJob,
    FromRecorder,
    Job,
    KeepPictures,
    OpenVisit,
    PicturesNotKept,
    RecorderStatus,
    Records,
    ToRecorder,
    Written,
)
from gateway.records.names import PICTURES
from gateway.records.privacy import blurred_outside
from gateway.records.retention import RetentionLimits
from gateway.records.segment import Head, PictureHead, picture_block, records_block
from gateway.records.store import Store
from gateway.vision.pixels import Image
from gateway.vision.transport.ring import Ring

CODEC = TO_RECORDER
MB = 1_000_000
TIDY_S = 60.0
RETRY_S = 1.0
STATUS_S = 10.0
INDEX_NS = 20_000_000  # at once; records and pictures come first
INDEX_PAUSE_S = 0.02
PNG_EFFORT = 1  # zlib's level: 8 ms for a VGA picture
MAX_CLOCK_JUMP_S = 86_400.0  # a clock that jumps farther ahead makes no file old


@dataclass(slots=True)
class _Bay:
    job: BayJob
    store: Store
    pictures: IncidentPictures
    ring: Ring | None


def run(channel: Channel[FromRecorder, ToRecorder], job: Job) -> None:
    """Until the main process has ended."""
    lower_priority()
    cv2.setNumThreads(1)
    Recorder(channel, job).run()


class Recorder:
    """What the recorder process does."""

    def __init__(self, channel: Channel[FromRecorder, ToRecorder], job: Job) -> None:
        self._channel = channel
        self._job = job
        self._clock = job.clock
        self._bays = {bay.head.bay: self._bay(bay) for bay in job.bays}
        self._unwritten: list[Records] = []
        self._index = Index(Path(job.folder))
        self._fault = ""
        self._wall_offset_ns = self._offset_ns()

    def run(self) -> None:
        """Until the main process has ended, which ends this process."""
        self._find_open_visits()
        period_s = 1 / self._job.config.picture_hz / self._job.clock.speed
        next_picture = next_tidy = next_status = _now_s()
        while True:
            now = _now_s()
            if now >= next_picture:
                next_picture = max(next_picture + period_s, now)
                self._take_pictures()
            if now >= next_tidy:
                next_tidy = now + TIDY_S
                self._tidy()
            if now >= next_status:
                next_status = now + STATUS_S
                self._report()
            more = not self._unwritten and self._index.work(INDEX_NS)
            wait_s = min(next_picture, next_tidy, now + RETRY_S if self._unwritten else next_tidy) - _now_s()
            wait_s = min(wait_s, INDEX_PAUSE_S) if more else wait_s
            select.select([self._channel.sock], [], [], max(0.0, wait_s))
            for message in self._channel.waiting():
                match message:
                    case Records():
                        self._unwritten.append(message)
                    case KeepPictures():
                        self._bays[message.bay].pictures.happened(message.t_ns, message.why)
            self._write()

    def _find_open_visits(self) -> None:
        """Of the gateway before this one."""
        for name, bay in self._bays.items():
            try:
                visit = recording.open_visit(bay.store.folder, bay.job.head.boot)
            except OSError:
                continue  # there is no recording yet, or it cannot be read
            if visit is not None:
                self._channel.send(OpenVisit(name, visit))

    def _write(self) -> None:
        """Everything that waits, to the disk. What a disk has refused waits on: the main process sends only so much."""
        if not self._unwritten:
            return
        try:
            for message in self._unwritten:
                block = records_block(message.number, message.records)
                self._bays[message.bay].store.append(block, message.t_ns, begins=message.begins)
            for bay in self._bays.values():
                bay.store.sync()
        except OSError as error:
            for bay in self._bays.values():
                bay.store.close()  # all of it is written again, to other segments
            self._failed(error)
            self._tidy()
            return
        self._channel.send(Written(self._unwritten[-1].number))
        for message in self._unwritten:
            if message.visit_ended:
                self._index.soon(message.bay)
        self._unwritten.clear()
        if self._fault:
            self._fault = ""
            self._report()

    def _take_pictures(self) -> None:
        now_ns = self._clock.now_ns()
        for bay in self._bays.values():
            if bay.ring is None:
                continue
            if (picture := bay.ring.snapshot(request=bay.pictures.pending)) is not None:
                bay.pictures.add(picture)
            if (incident := bay.pictures.due(now_ns)) is not None:
                self._keep(bay, incident, now_ns)

    def _keep(self, bay: _Bay, incident: Incident, now_ns: int) -> None:
        offset_ns = self._offset_ns()
        region = self._job.config.picture_region_px

        def encode(image: Image) -> bytes:
            return _png(image if region is None else blurred_outside(image, region))

        encoded = bay.pictures.kept(incident, now_ns, encode)
        blocks = [
            picture_block(
                PictureHead(
                    p.seq,
                    p.t_capture_ns,
                    p.t_capture_ns + offset_ns,
                    "png",
                    incident.why,
                    "" if region is None else "blurred",
                ),
                encoded[n],
            )
            for n, p in enumerate(incident.pictures)
            if n in encoded
        ]
        matter = matters(incident.why)
        if missing := len(incident.pictures) - len(blocks):
            self._not_kept(bay, incident, missing, details.PICTURES_BUDGET(), matters=matter)
        if matter and not incident.pictures:
            self._not_kept(bay, incident, 0, details.PICTURES_NONE(), matters=False)
        if incident.dropped:
            self._not_kept(bay, incident, incident.dropped, details.PICTURES_TOO_LARGE(), matters=matter)
        try:
            if blocks:
                bay.store.pictures(blocks, matter=matter)
        except OSError as error:
            bay.pictures.not_written(encoded)
            self._not_kept(bay, incident, len(blocks), str(error.strerror or error), matters=True)
            self._failed(error)

    def _not_kept(self, bay: _Bay, incident: Incident, number: int, why: str, *, matters: bool) -> None:
        number_of = len(incident.pictures) + incident.dropped
        detail = details.PICTURES_NOT_KEPT(number, number_of, ", ".join(incident.why), why)
        self._channel.send(PicturesNotKept(bay.job.head.bay, number, detail, matters))

    def _tidy(self) -> None:
        offset_ns = self._offset_ns()
        jumped = abs(offset_ns - self._wall_offset_ns) > MAX_CLOCK_JUMP_S * NS_PER_S  # believed next time, if it stays
        self._wall_offset_ns = offset_ns
        unix_s = None if jumped else self._clock.wall_ns() / NS_PER_S
        for bay in self._bays.values():
            try:
                bay.store.delete_surplus(unix_s)
            except OSError as error:
                self._failed(error)

    def _report(self) -> None:
        self._channel.send(RecorderStatus(self._fault, self._index.fault))

    def _failed(self, error: OSError) -> None:
        fault = f"{self._job.folder}: {error.strerror or error}"
        if fault != self._fault:
            self._fault = fault
            self._report()

    def _bay(self, job: BayJob) -> _Bay:
        config = self._job.config
        limits = RetentionLimits(config.max_mb * MB, config.max_days, config.picture_days, config.visit_days)
        folder = Path(self._job.folder) / job.head.bay
        store = Store(folder, limits, config.min_free_percent / 100, lambda number: self._head(job.head, number))
        ring = None if job.ring is None else Ring(job.ring, writable=False)
        now_ns, per_day = self._clock.now_ns(), config.picture_mb_per_day * MB
        pictures = IncidentPictures(
            config.picture_before_s, config.picture_after_s, per_day, self._budget_left(store, per_day), now_ns
        )
        return _Bay(job, store, pictures, ring)

    def _budget_left(self, store: Store, per_day: int) -> float | None:
        try:
            files = [file for file in store.files() if file.name.kind == PICTURES]
        except OSError:
            return None
        return budget_left(files, self._clock.wall_ns() / NS_PER_S, per_day)

    def _head(self, head: Head, number: int) -> Head:
        return msgspec.structs.replace(head, number=number, t_ns=self._clock.now_ns(), unix_ns=self._clock.wall_ns())

    def _offset_ns(self) -> int:
        return self._clock.wall_ns() - self._clock.now_ns()


def _now_s() -> float:
    return machine_ns() / NS_PER_S


def _png(image: cv2.typing.MatLike) -> bytes:
    done, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, PNG_EFFORT])
    if not done:
        raise LinkError("a picture cannot be encoded")
    return data.tobytes()
