"""The folders of test sets: pictures, and beside them `labels.jsonl` as `gateway evaluate` reads it. IO.

    <folder>/<bay>/<set>/labels.jsonl
    <folder>/<bay>/<set>/0001-dusk.png

Every change is one file written completely, or not at all, before it is reported; a picture is there before its label,
and is removed after it. What people have put there themselves is used where it is a picture, and reported where it is
not. Nothing outside of the folder is touched: names are checked, links are not followed.
"""

import hashlib
import json
import os
import re
import unicodedata
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gateway.errors import ConfigError
from gateway.files import plain_bytes, sync_folder, write_file
from gateway.processes.answers import NothingError, QuestionRefusedError
from gateway.vision.offline.evaluation import labels
from gateway.vision.offline.evaluation.labels import Label
from gateway.web.ipc.testsets import (
    MAX_FILE_BYTES,
    MAX_NAME,
    MAX_PICTURES,
    MAX_SET_BYTES,
    MAX_SETS,
    MarkerPlace,
    PictureSet,
    SetPicture,
)
from gateway.web.testsets.folder import LABELS, PICTURE_NAME, SET_NAME
from gateway.web.tuning import uploads
from gateway.web.tuning.uploads import UploadError

ALL_BYTES = 2 << 30  # of all bays' sets
FREE_BYTES = 256 << 20  # of the disk, which stay free for what the bays need
MAX_LABELS_BYTES = 200_000
MAX_FAULTS = 10
LISTED_SETS = 4 * MAX_SETS  # people may make folders, too
LISTED = 1000  # files of a folder that are looked at
_NUMBERED = re.compile(r"(\d{4,9})-")


@dataclass(slots=True)
class _Folder:
    """One set as it is on the disk. `pictures`: name, size and time of change; `rows`: by file what its line of
    `labels.jsonl` says; None: the file is damaged."""

    path: Path
    pictures: dict[str, tuple[int, int]] = field(default_factory=dict)
    unfinished: list[str] = field(default_factory=list)  # of a write that was cut off
    others: list[str] = field(default_factory=list)
    text: str = ""
    rows: dict[str, tuple[Label, dict[str, Any]]] | None = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)

    @property
    def bytes(self) -> int:
        return sum(size for size, _ in self.pictures.values())


@dataclass(frozen=True, slots=True)
class SetStore:
    """`bays`: whose sets there may be. Everything may raise OSError."""

    folder: Path
    bays: frozenset[str]

    def sets(self, bay: str) -> tuple[PictureSet, ...]:
        """By name. What can't be read is among their faults."""
        return tuple(_described(_read(path)) for path in self._paths(bay))

    def make(self, bay: str, name: str) -> None:
        path = self._free(bay, name)
        if len(self._paths(bay)) >= MAX_SETS:
            raise QuestionRefusedError(f"{bay} has {MAX_SETS} test sets already, and may have no more: delete one")
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        path.mkdir(mode=0o700)
        sync_folder(path.parent)

    def rename(self, bay: str, name: str, new: str) -> None:
        path = self._existing(bay, name)
        if _named(new) == name:
            return
        path.rename(self._free(bay, new))
        sync_folder(path.parent)

    def delete(self, bay: str, name: str) -> None:
        """All or nothing of what is the gateway's: files of others are not deleted."""
        path = self._existing(bay, name)
        found = _read(path)
        if found.others:
            raise QuestionRefusedError(
                f"{path}: holds what does not belong to a test set ({_some(found.others)}): remove that first"
            )
        _clean(found)
        (path / LABELS).unlink(missing_ok=True)
        for file in found.pictures:
            (path / file).unlink(missing_ok=True)
        path.rmdir()
        sync_folder(path.parent)

    def add(self, bay: str, name: str, title: str, data: bytes) -> str:
        """The name of the picture's file. It is not labelled yet."""
        path = self._existing(bay, name)
        try:
            uploads.check(data)
        except UploadError as error:
            raise QuestionRefusedError(str(error)) from None
        found = _read(path)
        _clean(found)
        if len(found.pictures) >= MAX_PICTURES:
            raise QuestionRefusedError(f"the test set {name} has {MAX_PICTURES} pictures already, and may have no more")
        if found.bytes + len(data) > MAX_SET_BYTES:
            raise QuestionRefusedError(f"the test set {name} would be larger than {MAX_SET_BYTES >> 20} MiB")
        if self._all_bytes() + len(data) > ALL_BYTES:
            raise QuestionRefusedError(f"all test sets would be larger than {ALL_BYTES >> 30} GiB: delete one")
        disk = os.statvfs(path)
        if disk.f_bavail * disk.f_frsize < FREE_BYTES + len(data):
            raise QuestionRefusedError(f"less than {FREE_BYTES >> 20} MiB of the disk would be free")
        taken = [int(match[1]) for file in (*found.pictures, *(found.rows or ())) if (match := _NUMBERED.match(file))]
        kind = "png" if data.startswith(b"\x89PNG") else "jpg"
        file = f"{max(taken, default=0) + 1:04d}-{_slug(title)}.{kind}"
        write_file(path / file, data)
        return file

    def label(self, bay: str, name: str, file: str, place: MarkerPlace | None) -> None:
        """What else its line says (a group, a distance) stays, but for what the former place alone meant."""
        found = self._picture(bay, name, file)
        rows = _sound(found)
        former = rows[file][1] if file in rows else {}
        kept = {key: value for key, value in former.items() if key not in ("u", "v", "r", "a", "b", "tol_px")}
        row = {**kept, "file": file, "found": place is not None}
        if place is not None:
            row |= {"u": round(place.u_px, 2), "v": round(place.v_px, 2), "r": round(place.radius_px, 2)}
        else:
            row.pop("visible", None)
        try:
            Label.model_validate(row)
        except ValueError:
            raise QuestionRefusedError(f"{file}: no possible place of a marker") from None
        _write(found, {**{key: data for key, (_, data) in rows.items()}, file: row})

    def remove(self, bay: str, name: str, file: str) -> None:
        found = self._picture(bay, name, file, missing=True)
        if found.rows and file in found.rows:
            _write(found, {key: data for key, (_, data) in found.rows.items() if key != file})
        (found.path / file).unlink(missing_ok=True)
        sync_folder(found.path)

    def read(self, bay: str, name: str, file: str) -> bytes:
        data = plain_bytes(self._picture(bay, name, file).path / file, MAX_FILE_BYTES + 1)
        if len(data) > MAX_FILE_BYTES:
            raise QuestionRefusedError(f"{file}: larger than {MAX_FILE_BYTES >> 20} MiB")
        return data

    def _bay(self, bay: str) -> Path:
        if bay not in self.bays:
            raise NothingError(f"no bay {bay[:100]!r}")
        return self.folder / bay

    def _paths(self, bay: str) -> list[Path]:
        try:
            with os.scandir(self._bay(bay)) as entries:
                names = [entry.name for entry in entries if entry.is_dir(follow_symlinks=False)]
        except FileNotFoundError:
            return []
        return [self.folder / bay / name for name in sorted(names) if SET_NAME.fullmatch(name)][:LISTED_SETS]

    def _existing(self, bay: str, name: str) -> Path:
        path = next((path for path in self._paths(bay) if path.name == name), None)
        if path is None:
            raise NothingError(f"{bay} has no test set {name[:MAX_NAME]!r}")
        return path

    def _free(self, bay: str, name: str) -> Path:
        path = self._bay(bay) / _named(name)
        if os.path.lexists(path):
            raise QuestionRefusedError(f"{bay} has a test set {name} already")
        return path

    def _picture(self, bay: str, name: str, file: str, *, missing: bool = False) -> _Folder:
        found = _read(self._existing(bay, name))
        if file not in found.pictures and not (
            missing and found.rows and file in found.rows and PICTURE_NAME.fullmatch(file)
        ):
            raise NothingError(f"the test set {name} has no picture {file[:100]!r}")
        return found

    def _all_bytes(self) -> int:
        return sum(_read(path).bytes for bay in self.bays for path in self._paths(bay))


def _named(name: str) -> str:
    """Raises QuestionRefusedError for a name that can't be one."""
    if unicodedata.normalize("NFC", name) != name or not SET_NAME.fullmatch(name):
        raise QuestionRefusedError(
            f"{name[:MAX_NAME]!r} is no name for a test set: 1 to {MAX_NAME} letters, digits, spaces, - and _, "
            "with a letter or digit at both ends"
        )
    return name


def _read(path: Path) -> _Folder:
    found = _Folder(path)
    with os.scandir(path) as entries:
        for number, entry in enumerate(entries):
            if number >= LISTED:
                found.faults.append(f"more than {LISTED} files")
                break
            plain = entry.is_file(follow_symlinks=False)
            if entry.name == LABELS:
                continue
            if plain and PICTURE_NAME.fullmatch(entry.name):
                info = entry.stat(follow_symlinks=False)
                found.pictures[entry.name] = info.st_size, info.st_mtime_ns
            elif plain and entry.name.endswith(".new"):
                found.unfinished.append(entry.name)
            else:
                found.others.append(entry.name)
    if found.others:
        found.faults.append(f"not part of a test set, and not used: {_some(found.others)}")
    _read_labels(found)
    return found


def _clean(found: _Folder) -> None:
    for file in found.unfinished:
        (found.path / file).unlink(missing_ok=True)


def _read_labels(found: _Folder) -> None:
    try:
        data = plain_bytes(found.path / LABELS, MAX_LABELS_BYTES + 1)
    except FileNotFoundError:
        return
    except OSError as error:
        found.rows = None
        found.faults.append(f"{LABELS}: cannot be read: {error.strerror or error}")
        return
    try:
        if len(data) > MAX_LABELS_BYTES:
            raise ConfigError(f"{LABELS}: larger than {MAX_LABELS_BYTES} bytes")
        found.text = data.decode("utf-8-sig")
        if not found.text.strip():
            return
        parsed = labels.parse(found.text)
    except UnicodeDecodeError as error:
        found.faults.append(f"{LABELS}: not UTF-8 text: {error.reason} at byte {error.start}")
        found.rows = None
    except ConfigError as error:
        found.faults += str(error).split("\n")
        found.rows = None
    else:
        lines = found.text.split("\n")
        rows = zip(parsed.labels, parsed.lines, strict=True)
        found.rows = {os.path.normpath(label.file): (label, json.loads(lines[line - 1])) for label, line in rows}


def _sound(found: _Folder) -> dict[str, tuple[Label, dict[str, Any]]]:
    """The rows of labels that are not damaged: others would be lost."""
    if found.rows is None:
        raise QuestionRefusedError(f"{found.path / LABELS} is damaged: mend it, or delete the set")
    return found.rows


def _write(found: _Folder, rows: Mapping[str, dict[str, Any]]) -> None:
    path = found.path / LABELS
    if not rows:
        path.unlink(missing_ok=True)
        sync_folder(found.path)
        return
    lines = [json.dumps(row) for row in rows.values()]
    write_file(path, ("\n".join(lines) + "\n").encode())


def _described(found: _Folder) -> PictureSet:
    rows = found.rows or {}
    missing = [file for file in rows if file not in found.pictures]
    pictures = [_picture(file, size, rows) for file, (size, _) in found.pictures.items()]
    pictures += [_picture(file, 0, rows, missing=True) for file in missing if PICTURE_NAME.fullmatch(file)]
    faults = [*found.faults, *([f"no such picture: {_some(missing)}"] if missing else [])]
    parts = json.dumps([found.text, sorted(found.pictures.items()), faults])
    return PictureSet(
        found.path.name,
        tuple(sorted(pictures, key=lambda one: one.file)),
        found.bytes,
        found.text,
        tuple(_plain(fault)[:300] for fault in faults[:MAX_FAULTS]),
        hashlib.sha256(parts.encode("utf-8", "surrogatepass")).hexdigest(),
    )


def _picture(
    file: str, size: int, rows: Mapping[str, tuple[Label, dict[str, Any]]], *, missing: bool = False
) -> SetPicture:
    label = rows[file][0] if file in rows else None
    marker = None
    if label is not None and label.u is not None and label.v is not None and label.r is not None:
        marker = MarkerPlace(label.u, label.v, label.r)
    return SetPicture(file, size, label is not None, marker, missing)


def _slug(title: str) -> str:
    bare = os.path.splitext(unicodedata.normalize("NFC", title))[0]
    return re.sub(r"[^\w-]+", "-", bare).strip("-_")[:40] or "picture"


def _some(names: Iterable[str]) -> str:
    shown = sorted(names)
    text = ", ".join(_plain(name)[:60] for name in shown[:3])
    return f"{text} and {len(shown) - 3} more" if len(shown) > 3 else text


def _plain(text: str) -> str:
    """Names on a disk, and in JSON, need not be Unicode."""
    return text.encode("utf-8", "backslashreplace").decode()
