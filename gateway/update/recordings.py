"""What the new version would have decided otherwise on the last day's recordings."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.config import GatewayConfig
from gateway.errors import ConfigError
from gateway.records import recording
from gateway.records.names import parsed
from gateway.records.recorder_service import folder_of
from gateway.update.machine import Machine, UpdateError

REPLAY_S = 4 * 3600.0  # of one bay
SHOWN = 8  # differing moments, of one bay
_SAME_BY = ("time", "seconds", "outputs", "reason_now")


@dataclass(frozen=True, slots=True)
class Replayed:
    """One bay. `steps`: decisions taken again; `rows`: times in which the versions decide otherwise, as `gateway
    replay --json` has them, with `by`: which version does; `fault`: why it could not be replayed."""

    bay: str
    steps: int = 0
    missing: int = 0
    rows: tuple[dict[str, Any], ...] = ()
    fault: str = ""

    @property
    def lines(self) -> Iterator[str]:
        """For people."""
        if self.fault:
            yield f"recordings of {self.bay}: {self.fault}"
            return
        parts = f", {self.missing} parts of it are missing" if self.missing else ""
        if not self.rows:
            yield f"recordings of {self.bay}: {self.steps} decisions taken again, none is other{parts}"
            return
        yield f"recordings of {self.bay}: {self.steps} decisions taken again, {len(self.rows)} times other{parts}:"
        for row in self.rows[:SHOWN]:
            yield f"  {row['time']} for {row['seconds']}: {row['outputs']} by {row['by']}: {_reasons(row)}"
        if len(self.rows) > SHOWN:
            yield f"  and {len(self.rows) - SHOWN} more"


def _reasons(row: dict[str, Any]) -> str:
    return f"reason {row['reason_now']}, recorded {row['reason_then']}; R {row['radius_px']} Z {row['distance_mm']}"


def segments(config: GatewayConfig, hours: float, unix_s: int) -> tuple[dict[str, list[Path]], dict[str, str]]:
    """By bay, the segments of the last `hours`, with the one that was being written when they began; and by bay, why
    they can't be listed. A bay that has recorded nothing then is in neither."""
    folder = folder_of(config)
    found: dict[str, list[Path]] = {}
    faults: dict[str, str] = {}
    if folder is None:
        return found, faults
    for bay in config.bays:
        try:
            paths = _listed(folder / bay.name)
            began = [name.unix_s if (name := parsed(path.name)) is not None else 0 for path in paths]
            ended = [*began[1:], *(path.stat().st_mtime for path in paths[-1:])]
        except OSError as error:
            faults[bay.name] = str(error)
            continue
        inside = [path for path, end_s in zip(paths, ended, strict=True) if end_s > unix_s - hours * 3600]
        if inside:
            found[bay.name] = inside
    return found, faults


def _listed(folder: Path) -> list[Path]:
    """Raises OSError where there may be segments."""
    try:
        folder.stat()
    except FileNotFoundError:
        return []
    try:
        return recording.segments_of([folder])
    except ConfigError:  # none is in it
        return []


def replay(
    machine: Machine, bay: str, paths: list[Path], old: tuple[str, Path], new: tuple[str, Path], user: str
) -> Replayed:
    """`old`, `new`: version and the configuration that it runs with. The old one is asked only where the new one
    decides otherwise than recorded: settings may have been changed since."""
    try:
        found = _run(machine, new, paths, user)
        rows = found["otherwise"]
        by_new = [{**row, "by": new[0]} for row in rows]
        if rows:
            known = _run(machine, old, paths, user)["otherwise"]
            old_keys, new_keys = {_key(row) for row in known}, {_key(row) for row in rows}
            by_new = [row for row in by_new if _key(row) not in old_keys]
            by_new += [{**row, "by": old[0]} for row in known if _key(row) not in new_keys]
            by_new.sort(key=lambda row: str(row["time"]))
        return Replayed(bay, int(found["steps"]), len(found["missing"]), tuple(by_new))
    except (UpdateError, ValueError, KeyError, TypeError) as error:
        return Replayed(bay, fault=f"cannot be replayed: {error}")


def _key(row: dict[str, Any]) -> tuple[str, ...]:
    return tuple(str(row[name]) for name in _SAME_BY)


def _run(machine: Machine, version: tuple[str, Path], paths: list[Path], user: str) -> dict[str, Any]:
    name, config = version
    executable = machine.paths.executable(name)
    # The running gateway has real-time priority; this has the lowest.
    answer = machine.command(
        "nice", "-n", "19", executable, "replay", *paths, "--against", config, "--json", user=user, timeout_s=REPLAY_S
    )
    try:
        found = json.loads(answer.out)
    except ValueError:
        raise UpdateError(f"{name} replay: {answer.last_lines}") from None
    if not isinstance(found, dict):
        raise UpdateError(f"{name} replay: {answer.last_lines}")
    return found


def day_of(hours: float) -> str:
    return "last day" if hours == 24 else f"last {hours:g} hours"
