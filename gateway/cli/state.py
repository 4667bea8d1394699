"""Attach to the shared state vector x = [u, v, R, Z, tau] of a running gateway and print it.

Reading never disturbs the gateway: no lock is taken that it could wait for.

examples:
  gateway state                       live, every bay of the one gateway that runs here
  gateway state --once --json         one JSON object a bay, then end
  gateway state --instance line2 --bay bay1 --period 0.05
exit code 1 when no live gateway shares a state
"""

import argparse
import contextlib
import json
import math

from gateway.clock import SystemClock
from gateway.durations import NS_PER_MS
from gateway.errors import ConfigError, LinkError
from gateway.shared_state import SharedStateReader, SharedVector, attachable


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--instance", metavar="NAME", help="which gateway, where several run on this machine")
    parser.add_argument("--bay", action="append", metavar="NAME", help="only this bay; may be repeated")
    parser.add_argument("--once", action="store_true", help="print once instead of live")
    parser.add_argument("--period", type=float, default=0.2, metavar="S", help="between two readings (default 0.2)")
    parser.add_argument("--json", action="store_true", help="one JSON object a line, for programs")


def main(args: argparse.Namespace) -> int:
    if not args.period > 0:
        raise ConfigError(f"--period {args.period:g}: must be above 0")
    clock = SystemClock()
    with contextlib.ExitStack() as stack, contextlib.suppress(KeyboardInterrupt):
        readers = [(place[0], stack.enter_context(SharedStateReader(*place))) for place in _places(args)]
        while True:
            for instance, reader in readers:
                row = _row(instance, reader.read(), clock.now_ns())
                print(json.dumps(row) if args.json else _line(row), flush=True)
            if args.once:
                break
            clock.block(args.period)
    return 0


def _places(args: argparse.Namespace) -> list[tuple[str, str]]:
    places = attachable()
    wanted = [p for p in places if args.instance in (None, p[0]) and (not args.bay or p[1] in args.bay)]
    if not wanted:
        there = ", ".join(f"{instance}/{bay}" for instance, bay in places)
        raise LinkError(
            f"nothing like that; live here: {there}"
            if there
            else "no gateway is running on this machine (of this user's view)"
        )
    if len({instance for instance, _ in wanted}) > 1:
        names = ", ".join(sorted({instance for instance, _ in wanted}))
        raise ConfigError(f"gateway state: several gateways run here; use --instance, one of: {names}")
    return wanted


def _row(instance: str, vector: SharedVector, now_ns: int) -> dict[str, object]:
    def value(number: float) -> float | None:
        return None if math.isnan(number) else round(number, 3)

    return {
        "instance": instance,
        "bay": vector.bay,
        "u": value(vector.u_px),
        "v": value(vector.v_px),
        "r": value(vector.radius_px),
        "z_mm": value(vector.distance_mm),
        "tau_ns": vector.t_ns,
        "d": vector.d,
        "stop": vector.stop,
        "may_move": vector.may_move,
        "in_place": vector.in_place,
        "moved": vector.moved.name.lower(),
        "reason": vector.reason.name.lower(),
        "vision": vector.vision_quality.name.lower(),
        "range": vector.range_quality.name.lower(),
        "age_ms": round((now_ns - vector.t_ns) / NS_PER_MS, 1),
        "vision_age_ms": round((now_ns - vector.t_vision_ns) / NS_PER_MS, 1),
        "range_age_ms": round((now_ns - vector.t_range_ns) / NS_PER_MS, 1),
        "frame_id": vector.frame_id,
        "seq": vector.seq,
        "pid": vector.pid,
    }


def _line(row: dict[str, object]) -> str:
    def shown(name: str, width: int, digits: int) -> str:
        value = row[name]
        return f"{value:{width}.{digits}f}" if isinstance(value, float) else "–".rjust(width)

    x = f"u {shown('u', 7, 2)}  v {shown('v', 7, 2)}  R {shown('r', 7, 2)} px  Z {shown('z_mm', 6, 0)} mm"
    ages = f"age {row['age_ms']:>5} ms (vision {row['vision_age_ms']}, range {row['range_age_ms']})"
    allowed = "may move" if row["may_move"] else "may not move"  # that stop is off allows nothing
    verdict = "STOP in place" if row["in_place"] else f"STOP {row['reason']}" if row["stop"] else allowed
    return f"{row['bay']}  x = [{x}]  {ages}  {row['vision']}/{row['range']}  {verdict}"
