"""The Eclipse Sparkplug TCK, edge node profile, against `gateway simulate` on mosquitto.

    python -m bench.sparkplug_tck --tck DIR
    python -m bench.sparkplug_tck --tck DIR --test SendData --mqtt 5 --out FOLDER

DIR holds three repositories, each in a folder of its name; they are no part of this project:

    git clone https://github.com/eclipse-sparkplug/sparkplug
    git clone https://github.com/hivemq/hivemq-extension-sdk
    git clone https://github.com/eclipse/paho.mqtt.java

Needs mosquitto, a JDK of 17 or later, and from Debian: {packages}.

The TCK is an extension of the broker HiveMQ. java/ loads it without HiveMQ, before mosquitto. Each test is run with
MQTT 3.1.1 and with MQTT 5, as some assertions are about one of them. A test has passed when no assertion failed, and
each was reached in one of the runs, but for those that bench/reports/sparkplug.md lists as not applicable. Prints a
table and exits with 1 if a test has not passed.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from bench.sparkplug_tck import build, results
from bench.sparkplug_tck.runs import CASES, run

PAGE = Path(__file__).resolve().parents[2] / "bench" / "reports" / "sparkplug.md"
VERSIONS = ("3.1.1", "5")


def main() -> int:
    text = (__doc__ or "").format(packages=build.PACKAGES)
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tck", type=Path, required=True, metavar="DIR", help="the three repositories")
    parser.add_argument("--test", action="append", choices=[case.name for case in CASES], help="only this one")
    parser.add_argument(
        "--mqtt", action="append", choices=VERSIONS, help="only this version; assertions about the other stay open"
    )
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="keep the logs of gateway, broker and TCK there")
    args = parser.parse_args()
    excused = results.not_applicable(PAGE.read_text(encoding="utf-8"))
    verdicts = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = args.out or Path(temporary)
        try:
            class_path = build.build(args.tck, Path(temporary))
        except build.BuildError as error:
            print(error, file=sys.stderr)
            return 2
        for case in CASES:
            if args.test and case.name not in args.test:
                continue
            outcomes = {}
            for version in args.mqtt or VERSIONS:
                own = folder / f"{case.name}-{version}"
                own.mkdir(parents=True)
                outcomes[version], problems = run(case, version, class_path, own)
                print(f"{case.name}, MQTT {version}: {outcomes[version].overall or 'no summary'}", file=sys.stderr)
                for problem in problems:
                    print(f"  {problem}", file=sys.stderr)
            verdicts.append(results.verdict(case.name, outcomes, excused))
    print(results.markdown(verdicts))
    for verdict in verdicts:
        print(verdict)
    return int(not all(verdict.passed for verdict in verdicts))


if __name__ == "__main__":
    sys.exit(main())
