"""`labels.jsonl`: what is truly to be seen in each picture of a folder, one JSON object a line.

Pixel centres lie at integers: the centre of the top left pixel is (0, 0). `parse` is pure; only `load` reads files.
"""

import hashlib
import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from pydantic import ConfigDict, Field, ValidationError, model_validator

from gateway.config.strict.section import Section, bounds_of
from gateway.core.detection import Circle
from gateway.errors import ConfigError

FILE_NAME = "labels.jsonl"
MOST_FAULTS = 10  # shown at once; a file in another format has one in every line


class Label(Section):
    """The truth about one picture. Keys that are not here (source, licence, notes) are kept out, not refused."""

    model_config = ConfigDict(extra="ignore")

    file: str = Field(min_length=1, description="picture, relative to the folder of labels.jsonl")
    found: bool = Field(description="true: the marker is in the picture; false: it is not, every answer is wrong")
    u: float | None = Field(None, description="centre, px to the right")
    v: float | None = Field(None, description="centre, px down")
    r: float | None = Field(None, gt=0, le=100_000, description="radius, px; of an ellipse the geometric mean")
    a: float | None = Field(None, gt=0, le=100_000, description="semi-major axis of the rim, px")
    b: float | None = Field(None, gt=0, le=100_000, description="semi-minor axis of the rim, px")
    group: str | None = Field(None, description="a name for pictures of one kind; figures are given for each")
    series: str | None = Field(None, description="a name for pictures of one camera and one marker, or of one sequence")
    tol_px: float | None = Field(None, ge=0, le=1000, description="how far the label itself may be off, px")
    visible: float | None = Field(None, ge=0, le=1, description="share of the rim that can be seen")
    z_cm: float | None = Field(None, gt=0, le=100_000, description="distance from the camera, cm")
    frame: int | None = Field(None, ge=0, description="number in a sequence; gaps are time that went by")

    @model_validator(mode="after")
    def _whole(self) -> Self:
        places = {"u": self.u, "v": self.v, "r": self.r}
        if self.found and (missing := [key for key, value in places.items() if value is None]):
            raise ValueError(f"found is true, but {', '.join(missing)} is missing")
        if not self.found and (given := [key for key, value in places.items() if value is not None]):
            raise ValueError(f"found is false, but {', '.join(given)} is given")
        if self.a is not None and self.b is not None and self.a < self.b:
            raise ValueError(f"a = {self.a:g} is the semi-major axis: it can't be less than b = {self.b:g}")
        return self

    @property
    def major_px(self) -> float | None:
        """The radius of the circle round the rim, which is what R means (equation 10)."""
        return self.r if self.a is None else self.a

    @property
    def circle(self) -> Circle | None:
        """The circle round the rim, with radius `major_px`; None: no marker."""
        if self.u is None or self.v is None or self.major_px is None:
            return None
        return Circle(self.u, self.v, self.major_px)

    @property
    def tuning_half(self) -> bool:
        """Which half of a split the picture is in: for tuning, or for reporting. By its name's hash only, so that it
        stays there when others are added, and is not chosen."""
        return hashlib.sha256(Path(self.file).as_posix().encode("utf-8", "surrogatepass")).digest()[0] % 2 == 0


@dataclass(frozen=True, slots=True)
class Labels:
    """All labels of a folder, in the order of its files; `path` of a label's picture; `lines`: of each in `source`;
    `places`: the same as texts, where they are of several files."""

    folder: Path
    source: str
    labels: tuple[Label, ...]
    lines: tuple[int, ...]
    unused_keys: tuple[str, ...] = ()
    places: tuple[str, ...] = ()

    def path(self, label: Label) -> Path:
        return self.folder / label.file

    def where(self, label: Label) -> str:
        """`labels.jsonl:12`, for errors."""
        return self.place(self.labels.index(label))

    def place(self, number: int) -> str:
        return self.places[number] if self.places else f"{self.source}:{self.lines[number]}"


def load(folder: Path) -> Labels:
    """Labels beside their pictures, or those of all folders below it, each a group where labels name none. Raises
    ConfigError: no file, faults by line, pictures that are not there."""
    if not folder.is_dir():
        raise ConfigError(f"{folder}: {'not a folder' if folder.exists() else 'no such folder'}")
    below = [] if (folder / FILE_NAME).exists() else sorted(folder.rglob(FILE_NAME))
    return _joined(folder, below) if below else load_file(folder / FILE_NAME)


def _joined(folder: Path, files: Sequence[Path]) -> Labels:
    labels: list[Label] = []
    places: list[str] = []
    unused: dict[str, None] = {}
    for path in files:
        part, below = load_file(path), path.parent.relative_to(folder).as_posix()
        for number, label in enumerate(part.labels):
            named = {"file": f"{below}/{label.file}", "group": label.group or below}
            labels.append(label.model_copy(update=named))
            places.append(part.place(number))
        unused |= dict.fromkeys(part.unused_keys)
    return Labels(folder, str(folder), tuple(labels), (), tuple(unused), tuple(places))


def load_file(path: Path) -> Labels:
    """The same for a file of any name; its pictures are searched for beside it."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise ConfigError(f"{path}: no such file; it holds one JSON object a line, as {_EXAMPLE}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text: {error.reason} at byte {error.start}") from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    labels = parse(text, folder=path.parent, source=str(path))
    lost = [label for label in labels.labels if not os.path.isfile(labels.path(label))]
    if lost:
        _fail([f"{labels.where(label)}: file = {json.dumps(label.file)}: no such picture" for label in lost])
    return labels


def parse(text: str, *, folder: Path = Path(), source: str = FILE_NAME) -> Labels:
    """Checks every line; blank ones are skipped. Raises ConfigError with one line per fault, the first few."""
    labels: list[Label] = []
    lines: list[int] = []
    faults: list[str] = []
    first: dict[str, int] = {}
    unused: dict[str, None] = {}
    for number, line in enumerate(text.split("\n"), start=1):
        if not line.strip():
            continue
        where = f"{source}:{number}"
        try:
            data = _object(line)
            label = Label.model_validate(data)
        except ValidationError as error:
            faults += [f"{where}: {text}" for text in _texts(error)]
            continue
        except ValueError as error:
            faults.append(f"{where}: {error}")
            continue
        unused |= dict.fromkeys(key for key in data if key not in Label.model_fields)
        name = os.path.normpath(label.file)
        if name in first:
            faults.append(f"{where}: file = {json.dumps(label.file)}: already labelled in line {first[name]}")
            continue
        first[name] = number
        labels.append(label)
        lines.append(number)
    if faults:
        _fail(faults)
    if not labels:
        raise ConfigError(f"{source}: holds no label; one JSON object a line is expected, as {_EXAMPLE}")
    return Labels(folder, source, tuple(labels), tuple(lines), tuple(unused))


def outside(label: Label, width_px: int, height_px: int) -> str:
    """What is wrong with a label for a picture of this size, in words; empty: nothing.

    The centre may lie outside (a marker that is cut by the border), but some of the disc must be in the picture.
    """
    circle = label.circle
    if circle is None:
        return ""
    away_u = max(-0.5 - circle.u_px, 0, circle.u_px - (width_px - 0.5))
    away_v = max(-0.5 - circle.v_px, 0, circle.v_px - (height_px - 0.5))
    if away_u**2 + away_v**2 < circle.radius_px**2:
        return ""
    place = f"u = {label.u:g}, v = {label.v:g}, r = {label.r:g}"
    return f"{place}: lies outside the picture, which has {width_px} x {height_px} px"


_EXAMPLE = '{"file": "bay1.jpg", "found": true, "u": 412.5, "v": 300.2, "r": 96.0} or {"file": "b.jpg", "found": false}'


def _object(line: str) -> dict[str, Any]:
    try:
        data = json.loads(line)
    except json.JSONDecodeError as error:
        raise ValueError(f"not valid JSON: {error.msg} at column {error.colno}") from error
    except RecursionError as error:
        raise ValueError("not valid JSON: nested too deeply") from error
    if not isinstance(data, dict):
        raise ValueError(f"should be a JSON object in braces; example: {_EXAMPLE}")
    return data


def _texts(error: ValidationError) -> Sequence[str]:
    texts = []
    for fault in error.errors():
        key = ".".join(str(part) for part in fault["loc"])
        words = {"missing": "is missing"}.get(fault["type"], fault["msg"].removeprefix("Value error, "))
        if not key:
            texts.append(words)
            continue
        value = "" if fault["type"] == "missing" else f" = {_shown(fault['input'])}"
        info = Label.model_fields.get(key)
        allowed = bounds_of(info) if info else ""
        texts.append(f"{key}{value}: {words}{f' (allowed: {allowed})' if allowed else ''}")
    return texts


def _shown(value: object) -> str:
    shown = re.sub(r"\s+", " ", json.dumps(value, ensure_ascii=True))
    return shown if len(shown) <= 60 else f"{shown[:60]}..."


def _fail(faults: Sequence[str]) -> None:
    more = len(faults) - MOST_FAULTS
    lines = [*faults[:MOST_FAULTS], *([f"... and {more} more"] if more > 0 else [])]
    raise ConfigError("\n".join(lines))
