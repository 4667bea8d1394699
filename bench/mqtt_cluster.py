"""Nodes of a cluster of brokers killed, paused, cut off, emptied: is any event lost, or out of order?

    python -m bench.mqtt_cluster                10,000 events to the cluster, 10,000 over a site's broker and its bridge
    python -m bench.mqtt_cluster --events 1000 --faults killed,paused
    python -m bench.mqtt_cluster --defaults                 max_ack_pending and ack_wait as nats-server has them

Three nats-servers (of the tests' environment) and mosquitto. One JSON object a run; exit code 1 where something was
lost or out of order.
"""

import argparse
import json
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from rich.progress import Progress, TaskID

from tests.e2e.cluster_faults import FAULTS, IN_ORDER, ClusterReport, run


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--events", type=int, default=10_000, help="at least so many in each run")
    parser.add_argument("--faults", default=",".join(FAULTS), help="each is done to every node")
    parser.add_argument("--hold-s", type=float, nargs=2, default=(4.0, 12.0), help="how long one lasts: from, to")
    parser.add_argument("--per-s", type=float, default=25.0, help="events a second")
    parser.add_argument("--defaults", action="store_true", help="not one message in flight to a subscriber, but 1024")
    parser.add_argument("--only", choices=("direct", "bridged"), help="one of the two runs")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    faults = [name for name in args.faults.split(",") for _ in range(3)]
    failed = False
    for bridged in (False, True):
        if args.only == ("direct" if bridged else "bridged"):
            continue
        with Progress(disable=not sys.stderr.isatty()) as progress, tempfile.TemporaryDirectory() as folder:
            rows = {
                "events": progress.add_task("events", total=args.events),
                "faults": progress.add_task("faults", total=len(faults)),
            }

            def show(report: ClusterReport, progress: Progress = progress, rows: dict[str, TaskID] = rows) -> None:
                progress.update(rows["events"], completed=report.events)
                progress.update(rows["faults"], completed=sum(report.faults.values()))

            report = run(
                Path(folder), events=args.events, faults=faults, hold_s=tuple(args.hold_s), per_s=args.per_s,
                seed=args.seed, bridged=bridged, options=() if args.defaults else IN_ORDER, progress=show,
            )  # fmt: skip
        print(json.dumps(asdict(report)), flush=True)
        failed |= bool(report.lost or report.out_of_order)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
