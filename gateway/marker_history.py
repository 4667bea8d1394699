"""What the rims of a bay's markers looked like in the visits of the last weeks, in a small JSON file of its own. IO.

An older version would take a bay file with a further key for damaged. A file that can't be read is begun anew: nothing
is decided on it.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec

from gateway.bay_file import path_of, read_file
from gateway.config import GatewayConfig, PictureConfig
from gateway.core import marker_wear
from gateway.core.marker_wear import DAY_S, KEPT_DAYS, MAX_RIMS, NOT_KNOWN, MarkerWear, RimSeen
from gateway.core.visit_summary import MS_PER_S, VisitSummary

log = logging.getLogger(__name__)

VERSION = 1


class _MarkerFile(msgspec.Struct, frozen=True):
    """`worn`: the newest visit was found so."""

    version: int
    worn: bool
    rims: tuple[RimSeen, ...]


def marker_path_of(config: GatewayConfig, bay: str) -> Path | None:
    """None: nothing is kept."""
    path = path_of(config, bay)
    return None if path is None else path.with_suffix(".marker.json")


@dataclass(slots=True)
class MarkerHistory:
    """Of one bay. `keep`: writes a file without waiting."""

    limits: PictureConfig
    path: Path | None = None
    keep: Callable[[Path, bytes | None], None] | None = None
    rims: tuple[RimSeen, ...] = ()
    wear: MarkerWear | None = None
    doubted: tuple[RimSeen, ...] = ()  # of times that do not follow: three that follow each other begin anew

    def read(self, now_unix_s: int) -> "MarkerHistory":
        """With what the file holds of the last weeks. May wait for the disk."""
        try:
            data = None if self.path is None else read_file(self.path)
            if data is not None:
                kept = msgspec.json.decode(data, type=_MarkerFile)
                if kept.version != VERSION:
                    raise ValueError(f"not of version {VERSION}")
                self.rims = tuple(r for r in kept.rims[-MAX_RIMS:] if now_unix_s - r.unix_s < KEPT_DAYS * DAY_S)
                self.wear = marker_wear.wear(self.rims, self.limits, worn=kept.worn)
        except (OSError, ValueError, OverflowError, RecursionError, msgspec.MsgspecError) as error:
            log.warning("%s cannot be read (%s): the trend of the marker's rim begins anew", self.path, error)
        return self

    def visited(self, visit: VisitSummary) -> MarkerWear | None:
        """What is known after this visit; None: no more than before."""
        before, unix_s = self.wear, visit.begun_ms // MS_PER_S
        if visit.visible is not None and visit.contrast is not None:
            self._saw(RimSeen(unix_s, round(visit.visible, 3), round(visit.contrast, 3)))
        elif not marker_wear.follows(self.rims, unix_s):  # none was measured for long: nothing is known of now
            self.wear = None
        return None if self.wear == before else self.wear or NOT_KNOWN

    def _saw(self, rim: RimSeen) -> None:
        if not marker_wear.follows(self.rims, rim.unix_s):
            self.doubted = (*(self.doubted if marker_wear.follows(self.doubted, rim.unix_s) else ()), rim)
            if len(self.doubted) < 3:
                return
            self.rims = self.doubted[:-1]
        self.rims, self.doubted = marker_wear.with_visit(self.rims, rim), ()
        self.wear = marker_wear.wear(self.rims, self.limits, worn=self.wear is not None and self.wear.worn)
        if self.path is not None and self.keep is not None:
            worn = self.wear is not None and self.wear.worn
            self.keep(self.path, msgspec.json.encode(_MarkerFile(VERSION, worn, self.rims)) + b"\n")
