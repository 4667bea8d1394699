"""What the TCK reports of a test, and the verdict on all tests. Pure."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

PASS, FAIL, MAYBE, NOT_EXECUTED = "PASS", "FAIL", "MAYBE", "NOT EXECUTED"
WORST_FIRST = (FAIL, MAYBE, PASS)
LINE = re.compile(r"^(?:Monitor:)?(tck-id-[\w-]+): (PASS|FAIL|MAYBE|NOT EXECUTED)(.*);$")
OVERALL = re.compile(r"^OVERALL: (.*);$")
PAGE_ROW = re.compile(r"^\| `(tck-id-[\w-]+)` \| not applicable \| (.+) \|$", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Outcome:
    """Of one run of one test: its assertions by id, what the TCK said of those that failed, and its own summary."""

    status: Mapping[str, str]
    why: Mapping[str, str]
    overall: str  # empty: the TCK gave none


def outcome(lines: Iterable[str]) -> Outcome:
    """Read the lines of the TCK's summary. An assertion that test and monitor report has the worse status."""
    status: dict[str, str] = {}
    why: dict[str, str] = {}
    overall = ""
    for line in lines:
        if found := OVERALL.match(line):
            overall = found[1]
        if not (found := LINE.match(line)):
            continue
        name, now, text = found[1], found[2], found[3]
        status[name] = worse(status.get(name, NOT_EXECUTED), now)
        if now in (FAIL, MAYBE):
            why[name] = text.strip()
    return Outcome(status, why, overall)


def worse(*found: str) -> str:
    """FAIL, then MAYBE, then PASS; NOT EXECUTED where nothing else was found."""
    return next((status for status in WORST_FIRST if status in found), NOT_EXECUTED)


def not_applicable(page: str) -> dict[str, str]:
    """Of docs/sparkplug.md: the assertions that do not concern this edge node, and why."""
    return dict(PAGE_ROW.findall(page))


@dataclass(frozen=True, slots=True)
class Row:
    """One assertion of one test: its status in each run (MQTT version -> status)."""

    name: str
    runs: Mapping[str, str]
    why: str = ""

    @property
    def status(self) -> str:
        return worse(*self.runs.values())


@dataclass(frozen=True, slots=True)
class Verdict:
    """A test over all its runs. `open`: assertions that no run reached, though they apply."""

    test: str
    rows: Sequence[Row]
    open: Sequence[str]
    unfinished: Sequence[str]  # runs without a summary

    @property
    def failed(self) -> list[Row]:
        """Without MAYBE, which is the TCK's word for a SHOULD that is not followed."""
        return [row for row in self.rows if row.status == FAIL]

    @property
    def passed(self) -> bool:
        return bool(self.rows) and not (self.failed or self.open or self.unfinished)

    def __str__(self) -> str:
        counts = {s: sum(row.status == s for row in self.rows) for s in (*WORST_FIRST, NOT_EXECUTED)}
        text = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
        missing = f"; not reached: {', '.join(self.open)}" if self.open else ""
        unfinished = f"; no summary with MQTT {', '.join(self.unfinished)}" if self.unfinished else ""
        return f"{self.test}: {'PASSED' if self.passed else 'FAILED'} ({text}{missing}{unfinished})"


def verdict(test: str, runs: Mapping[str, Outcome], excused: Mapping[str, str]) -> Verdict:
    """`runs`: MQTT version -> outcome. `excused`: see `not_applicable`."""
    names = sorted({name for run in runs.values() for name in run.status})
    rows = []
    for name in names:
        by_run = {version: run.status.get(name, NOT_EXECUTED) for version, run in runs.items()}
        excuse = excused.get(name, "") if worse(*by_run.values()) == NOT_EXECUTED else ""
        rows.append(Row(name, by_run, next((run.why[name] for run in runs.values() if name in run.why), excuse)))
    missing = [row.name for row in rows if row.status == NOT_EXECUTED and row.name not in excused]
    return Verdict(test, rows, missing, [version for version, run in runs.items() if not run.overall])


def markdown(verdicts: Sequence[Verdict]) -> str:
    """One table: test, assertion, and the status in each run."""
    versions = list(dict.fromkeys(version for verdict in verdicts for row in verdict.rows for version in row.runs))
    lines = [
        "| test | assertion | " + " | ".join(f"MQTT {version}" for version in versions) + " | |",
        "|---|---|" + "---|" * (len(versions) + 1),
    ]
    for one in verdicts:
        for row in one.rows:
            cells = [row.runs.get(version, NOT_EXECUTED) for version in versions]
            lines.append(f"| {one.test} | `{row.name}` | " + " | ".join([*cells, row.why]) + " |")
    return "\n".join(lines) + "\n"
