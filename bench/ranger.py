"""The figures of bench/reports/ranger.md: python -m bench.ranger

Error against the truth in virtual time, damage over ten thousand lines in the bench's own wire, and the latency from
trigger to register of a real `gateway simulate --ranger firmware` polled over Modbus. Takes three minutes, best on an
idle machine: the last one is in real time.
"""

import json
import random
import tempfile
from collections.abc import Sequence
from pathlib import Path

from gateway.ranger.hcsr04.protocol import NO_FLAGS, Damaged, Measurement
from gateway.ranger.hcsr04.session import distance_mm
from tests.e2e.plc import Plc
from tests.e2e.processes import Gateway
from tests.firmware.bench_runs import PERIOD_MS, run

LATENCY_S = 60
STANDING = "seed = 3\nstart = { distance_cm = 52 }\nduration_s = 3600\n[ranger]\njitter_mm = 0.0\nstep_mm = 0.0\n"


def percentile(values: Sequence[float], share: float) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, round(share * (len(ordered) - 1)))]


def errors(scenario: str, until_ms: float) -> list[tuple[float, float]]:
    """True distance and error of every valid line, mm."""
    played = run(scenario, until_ms)
    triggers = {row["n"]: row for row in played.of("trigger")}
    return [
        (triggers[m.seq]["true_mm"], distance_mm(m.ticks, 20.0) - triggers[m.seq]["true_mm"])
        for _, m in played.measurements
        if m.flags == NO_FLAGS
    ]


def accuracy() -> None:
    draw = random.Random(2)
    bands = [(50, 200), (200, 520), (520, 1000), (1000, 2000), (2000, 3999)]
    print(
        "| distance | lines | chain alone: mean | worst | with 4 mm steps: rms | worst "
        "| with 1.5 mm jitter too: rms | worst |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for low, high in bands:
        walk = "".join(
            f"track {2 * PERIOD_MS * n} {mm}\ntrack {2 * PERIOD_MS * (n + 1) - 1} {mm}\n"
            for n, mm in enumerate(draw.uniform(low, high) for _ in range(200))
        )
        cells = []
        for extra in ("", "step 4\n", "step 4\njitter 1.5\n"):
            found = [error for _, error in errors(extra + walk, 400 * PERIOD_MS)]
            middle = sum(found) / len(found) if not extra else (sum(e * e for e in found) / len(found)) ** 0.5
            cells += [f"{middle:.2f}", f"{max(map(abs, found)):.2f}"]
        print(f"| {low / 10:g} to {high / 10:g} cm | {len(found)} | " + " | ".join(cells) + " |")


def damage() -> None:
    played = run("track 0 2500\ntrack 300000 200\ntrack 602000 3500\nnoise 0.03\n", 602_000)
    said = {m.seq: m for _, m in played.measurements}
    heard = [event for event in played.events if isinstance(event, Measurement)]
    wrong = [m for m in heard if said.get(m.seq) != m]
    damaged = sum(isinstance(event, Damaged) for event in played.events)
    print(
        f"{len(played.lines)} lines sent, {damaged} pieces of damage, "
        f"{len(heard)} measurements accepted, {len(wrong)} wrong"
    )


def latency() -> None:
    with tempfile.TemporaryDirectory() as name:
        log, scenario = Path(name) / "played", Path(name) / "standing.toml"
        scenario.write_text(STANDING)
        with Gateway(
            *("simulate", "--ranger", "firmware", "--ranger-log", str(log), "--scenario", str(scenario)),
            *("--modbus-port", "0", "--json", "--duration", str(LATENCY_S + 4)),
        ) as gateway:
            with Plc(gateway.started()["modbus_port"], period_s=0.001) as plc:
                plc.wait_for(lambda image: image["may_move"] == 1)
                first = len(plc.polls)
                gateway.process.wait(LATENCY_S + 30)
            polls = plc.polls[first:]
        rows = [json.loads(line) for line in log.read_text().splitlines()]
    origin_ns = rows[0]["origin_ns"]
    triggers = {row["n"]: origin_ns + row["t_ns"] for row in rows if row["type"] == "trigger"}
    lines = {
        int(row["text"].split(",")[1]): origin_ns + row["t_ns"]
        for row in rows
        if row["type"] == "line" and row["text"].startswith("$HCM")
    }
    seen: dict[int, float] = {}
    for poll in polls:
        seen.setdefault(poll.image["range_seq"], poll.read_s)
    known = [n for n in list(seen)[1:] if n in triggers and n in lines]
    parts = {
        "trigger to whole line": [(lines[n] - triggers[n]) / 1e6 for n in known],
        "whole line to register, as read by the PLC": [seen[n] * 1e3 - lines[n] / 1e6 for n in known],
        "trigger to register": [seen[n] * 1e3 - triggers[n] / 1e6 for n in known],
    }
    print(f"| {len(known)} cycles at 52 cm, {len(polls)} polls | mean, ms | median | 95 % | 99 % | largest |")
    print("|---|---|---|---|---|---|")
    for name_, values in parts.items():
        cells = [sum(values) / len(values), *(percentile(values, share) for share in (0.5, 0.95, 0.99, 1.0))]
        print(f"| {name_} | " + " | ".join(f"{cell:.1f}" for cell in cells) + " |")


if __name__ == "__main__":
    accuracy()
    damage()
    latency()
