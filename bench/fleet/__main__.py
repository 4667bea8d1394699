"""A fleet in one command: 100 gateways without cameras, a cluster of three nats-servers with TLS, the fleet page,
VictoriaMetrics. While stops are published, all certificates are renewed, a node is killed and another hangs.

    python -m bench.fleet                          100 gateways; two cores, 3 GB
    python -m bench.fleet --gateways 20 --calm-s 5

Needs victoria-metrics (Debian). The last line counts the changes of stop; exit code 1 where an event was lost or came
out of order, or the fleet is not as it should be in the end.
"""

import argparse
import json
import signal
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

from bench.fleet import rollout
from bench.fleet.demonstration import Settings, run


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m bench.fleet", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--gateways", type=int, default=100)
    parser.add_argument("--calm-s", type=float, default=20.0, help="before and after what happens")
    parser.add_argument("--hang-s", type=float, default=20.0, help="how long a node hangs; 0: none does")
    parser.add_argument(
        "--period-s", type=float, default=5.0, help="between two states of a bay, by MQTT and Sparkplug"
    )
    parser.add_argument("--late-ms", type=float, default=1000.0, help="a change of stop that arrives later is late")
    parser.add_argument("--no-renewal", action="store_true", help="of certificates")
    parser.add_argument("--sparkplug", action="store_true", help="too; each edge node has two subscriptions of QoS 1")
    parser.add_argument("--no-roll-out", action="store_true", help="of a bad configuration, by Ansible")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    args = parser.parse_args()
    roll_out = not args.no_roll_out and rollout.possible()
    settings = Settings(
        args.gateways,
        args.calm_s,
        args.hang_s,
        args.period_s,
        args.late_ms,
        not args.no_renewal,
        args.sparkplug,
        roll_out,
    )
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # the programs that were started end, too
    begun = time.monotonic()

    def say(text: str) -> None:
        print(f"{time.monotonic() - begun:6.1f} s  {text}", file=sys.stderr, flush=True)

    if not roll_out:
        say("nothing is rolled out" + ("" if args.no_roll_out else ": no ansible-core, or no packaging/ansible"))
    with tempfile.TemporaryDirectory(prefix="fleet-") as folder:
        report = run(Path(folder), settings, say)
    for fault in report.faults:
        say(f"FAULT: {fault}")
    if args.json:
        args.json.write_text(json.dumps(asdict(report) | {"settings": asdict(settings)}, indent=1) + "\n")
    print(report.verdict)
    return 0 if report.good else 1


if __name__ == "__main__":
    sys.exit(main())
