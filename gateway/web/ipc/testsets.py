"""What the web process asks about test sets: labelled pictures that are kept, by name, for each bay. Pure.

The web process may write no file: a helper process does (gateway/web/testsets/process.py). A picture that is to be kept
travels with its question, as the memory that holds its file.
"""

from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta

from gateway.processes.codec import Codec, Message

MAX_SETS = 8  # of a bay
MAX_PICTURES = 100  # of a set
MAX_FILE_BYTES = 8 << 20  # of a picture
MAX_SET_BYTES = 200 << 20
MAX_NAME = 40  # characters

Text = Annotated[str, Meta(max_length=300)]
Pixels = Annotated[float, Meta(ge=-100_000, le=100_000)]


class SetsSetup(Message, frozen=True):
    """The process's job. `bays`: whose sets there may be."""

    folder: str  # of all bays' sets
    questions: int  # descriptor: a SOCK_SEQPACKET socket, inherited
    bays: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class MarkerPlace:
    """Centre and radius of the marker's rim, px, as `labels.jsonl` has them."""

    u_px: Pixels
    v_px: Pixels
    radius_px: Annotated[float, Meta(gt=0, le=100_000)]


class ListSets(Message, frozen=True):
    """All test sets of a bay."""

    bay: Text


class MakeSet(Message, frozen=True):
    """A new one, without pictures."""

    bay: Text
    name: Text


class RenameSet(Message, frozen=True):
    bay: Text
    name: Text
    new: Text


class DeleteSet(Message, frozen=True):
    """With its pictures."""

    bay: Text
    name: Text


class AddPicture(Message, frozen=True):
    """The picture is the file in the memory whose descriptor comes with it. `title`: what its name is made of."""

    bay: Text
    name: Text
    title: Text


class SetLabel(Message, frozen=True):
    """`place` None: there is no marker in the picture."""

    bay: Text
    name: Text
    file: Text
    place: MarkerPlace | None


class RemovePicture(Message, frozen=True):
    bay: Text
    name: Text
    file: Text


class ReadPicture(Message, frozen=True):
    """The answer is the file."""

    bay: Text
    name: Text
    file: Text


SetsQuestion = ListSets | MakeSet | RenameSet | DeleteSet | AddPicture | SetLabel | RemovePicture | ReadPicture
SETS_QUESTIONS = Codec(SetsQuestion)
SETS_SETUP = Codec(SetsSetup, compressed=True)


@dataclass(frozen=True, slots=True)
class SetPicture:
    """`labelled` False: nobody has said yet what is in it. `marker` None: none is in it, or it is not labelled.
    `missing`: it is in `labels.jsonl` only."""

    file: str
    bytes: int = 0
    labelled: bool = False
    marker: MarkerPlace | None = None
    missing: bool = False


@dataclass(frozen=True, slots=True)
class PictureSet:
    """One test set. `labels`: the text of `labels.jsonl`; `faults`: what is wrong with the set, in words; `digest`: of
    all that a score of it depends on."""

    name: str
    pictures: tuple[SetPicture, ...]
    bytes: int
    labels: str
    faults: tuple[str, ...]
    digest: str


class BaySets(Message, frozen=True):
    """To every question but `ReadPicture`: the bay's sets as they are now. `added`: name of a picture's new file."""

    sets: tuple[PictureSet, ...]
    added: str = ""


BAY_SETS = Codec(BaySets)
