"""Broker and gateway killed at random moments while stop flips: is any transition lost, or out of order?

    python -m bench.mqtt_store_forward                  20,000 transitions, 1,000 broker kills, 200 gateway kills
    python -m bench.mqtt_store_forward --transitions 2000 --broker-kills 100 --gateway-kills 20

Needs mosquitto. Prints one JSON object; exit code 1 where something was lost or out of order.
"""

import argparse
import json
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from rich.progress import Progress

from tests.e2e.store_and_forward import Report, run


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--transitions", type=int, default=20_000)
    parser.add_argument("--broker-kills", type=int, default=1_000)
    parser.add_argument("--gateway-kills", type=int, default=200)
    parser.add_argument("--per-s", type=float, default=80.0, help="transitions a second")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    with Progress(disable=not sys.stderr.isatty()) as progress, tempfile.TemporaryDirectory() as folder:
        rows = {
            name: progress.add_task(name, total=total)
            for name, total in (
                ("transitions", args.transitions),
                ("broker_kills", args.broker_kills),
                ("gateway_kills", args.gateway_kills),
            )
        }

        def show(report: Report) -> None:
            for name, row in rows.items():
                progress.update(row, completed=getattr(report, name))

        report = run(
            Path(folder),
            transitions=args.transitions,
            broker_kills=args.broker_kills,
            gateway_kills=args.gateway_kills,
            per_s=args.per_s,
            seed=args.seed,
            progress=show,
        )
    print(json.dumps(asdict(report)))
    return int(bool(report.lost or report.out_of_order))


if __name__ == "__main__":
    sys.exit(main())
