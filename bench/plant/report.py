"""What a run of bench.chaos, bench.neighbours or bench.soak ends with: a verdict, a Markdown table, a JSON file."""

import json
import os
import platform
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bench.plant.judge import Finding

SHOWN = 20


@dataclass
class Report:
    """`fail` makes the verdict; `rows` are for people and bench/reports; `data` is for the JSON beside them."""

    program: str
    seed: int
    again: str  # the command that plays the same once more
    rows: list[tuple[str, str]] = field(default_factory=list)
    data: dict[str, Any] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)
    begun_s: float = field(default_factory=time.monotonic)

    def row(self, what: str, value: str) -> None:
        self.rows.append((what, value))

    def fail(self, text: str) -> None:
        self.failures.append(text)

    def findings(self, found: Sequence[Finding]) -> None:
        self.row("forbidden by the simulator's truth", str(len(found)))
        self.data["findings"] = [vars_of(one) for one in found]
        for one in found[:SHOWN]:
            self.fail(f"world time {one.t_s:.2f} s: {one.rule}: {one.text}")
        if len(found) > SHOWN:
            self.fail(f"and {len(found) - SHOWN} more of these")

    def markdown(self) -> str:
        lines = [f"| {self.program}, seed {self.seed} | |", "|---|---|"]
        return "\n".join([*lines, *(f"| {what} | {value} |" for what, value in self.rows)]) + "\n"

    def end(self, folder: Path | None) -> int:
        """Print it, write NAME.md and NAME.json into `folder`; the exit code."""
        seconds = time.monotonic() - self.begun_s
        machine = f"{os.cpu_count()} CPUs, Linux {platform.release().split('-')[0]}, Python {platform.python_version()}"
        self.row("length; machine", f"{seconds:.0f} s; {machine}, load average at the end {os.getloadavg()[0]:.1f}")
        self.row("verdict", "**passed**" if not self.failures else f"**failed** ({len(self.failures)})")
        print(self.markdown())
        for text in self.failures:
            print(f"FAILED: {text}")
        if self.failures:
            print(f"again: {self.again}")
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"{self.program}.md").write_text(self.markdown(), encoding="utf-8")
            document = {
                "program": self.program,
                "seed": self.seed,
                "ended": datetime.now(UTC).isoformat(timespec="seconds"),
                "seconds": round(seconds, 1),
                "passed": not self.failures,
                "failures": self.failures,
                "again": self.again,
                "table": dict(self.rows),
                **self.data,
            }
            (folder / f"{self.program}.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        return int(bool(self.failures))


def vars_of(finding: Finding) -> dict[str, Any]:
    return {"t_s": finding.t_s, "rule": finding.rule, "text": finding.text}


def percentile(values: Sequence[float], share: float) -> float:
    """Of any order; nan of none."""
    if not values:
        return float("nan")
    return sorted(values)[min(len(values) - 1, int(share * len(values)))]


def answer_times(times_ms: Sequence[float]) -> str:
    if not times_ms:
        return "none"
    ordered = sorted(times_ms)
    shares = [f"{name} {percentile(ordered, share):.2f}" for name, share in (("p50", 0.5), ("p99", 0.99))]
    return f"{', '.join(shares)}, p99.9 {percentile(ordered, 0.999):.2f}, longest {ordered[-1]:.1f} ms"


def progress(text: str) -> None:
    """A line on stderr: rewritten on a terminal, else one each time it is called."""
    end = "" if sys.stderr.isatty() else "\n"
    print(f"\r{text:<110}" if not end else text, end=end, file=sys.stderr, flush=True)


def table(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in sorted(counts.items(), key=lambda item: -item[1])) or "none"
