"""The names of the files of one bay's recording. Pure.

    00000042-20261123T035712Z.seg           a segment
    00000042-20261123T035712Z.pictures      pictures round an incident, a segment, too
    00000042-20261123T035712Z.pictures.pin  somebody keeps it: deleted last
    00000042-20261123T035712Z.rows          visits and minutes of segments, kept for longer than these

The number counts up for each bay, whatever the clock does; the time is for people.
"""

import re
from datetime import UTC, datetime
from typing import NamedTuple

SEGMENT, PICTURES, ROWS, PIN = ".seg", ".pictures", ".rows", ".pin"
_NAME = re.compile(r"(\d{8,})-(\d{8}T\d{6}Z)(\.seg|\.pictures|\.rows)")
_TIME = "%Y%m%dT%H%M%SZ"


class FileName(NamedTuple):
    number: int
    unix_s: int
    kind: str  # SEGMENT, PICTURES or ROWS

    def __str__(self) -> str:
        return f"{self.number:08d}-{datetime.fromtimestamp(self.unix_s, UTC):{_TIME}}{self.kind}"


def parsed(name: str) -> FileName | None:
    """None: a file that is not of a recording."""
    found = _NAME.fullmatch(name)
    if found is None:
        return None
    try:
        moment = datetime.strptime(found[2], _TIME).replace(tzinfo=UTC)
    except ValueError:
        return None
    return FileName(int(found[1]), int(moment.timestamp()), found[3])
