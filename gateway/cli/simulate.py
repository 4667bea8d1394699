"""A loading bay with no hardware at all: rendered frames, real serial bytes, the real gateway behind them.

The simulated camera and ranger are handed to the same program that `gateway run` starts; poll it with any Modbus
client, open its pages in a browser, or connect it to an MQTT broker. Without --mqtt-url it runs without one.

examples:
  gateway simulate                                    the default approach, watched in the terminal
  gateway simulate --modbus-port 5020 --duration 20   end after 20 s
  gateway simulate --scenario faults --speed 2        a scenario of config/scenarios/, twice as fast
  gateway simulate --scenario rusty --method paper    where the paper's own method fails
  gateway simulate --scenario head-lamp --exposure marker     exposure time and gain follow the light on the marker
  gateway simulate --trials 10                        the paper's Table II, its figures beside ours
  gateway simulate --bays 4 --modbus-port 0 --json    four bays, a free port, JSON lines for programs
  gateway simulate --rangers 3 --scenario rangers     one of three is missing or off, then two contradict each other
  gateway simulate --vehicle shunter                  a PLC program moves the vehicle, by a simulated drive's registers
  gateway simulate --ranger firmware                  the Arduino's compiled firmware in an emulated Uno
poll it:
  mbpoll -0 -B -a 1 -r 0 -c 8 -p 5020 127.0.0.1       (gateway registers lists their meanings)
"""

import argparse
from pathlib import Path

from gateway.cli import simulation


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--scenario", default=None, metavar="NAME|FILE", help="a scenario (default: approach)")
    parser.add_argument("--list", action="store_true", help="list the scenarios supplied with the gateway")
    parser.add_argument("--config", type=Path, metavar="FILE", help="gateway settings (default: config/simulate.toml)")
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        metavar="X",
        help="simulated seconds a second (default 1); a small machine keeps up to about 5",
    )
    parser.add_argument("--duration", type=float, metavar="S", help="end after so many simulated seconds")
    parser.add_argument("--seed", type=int, metavar="N", help="of everything random (default: the scenario's)")
    parser.add_argument(
        "--bays", type=int, metavar="N", help="so many bays, unit ids 1 to N (default: as in the settings, 1)"
    )
    parser.add_argument(
        "--rangers", type=int, metavar="N", help="so many rangers a bay (default: as in the settings, 1)"
    )
    parser.add_argument(
        "--modbus-port", type=int, metavar="PORT", help="default 5020 or, where that is taken, a free one"
    )
    parser.add_argument(
        "--hmi-port", type=int, metavar="PORT", help="of the pages, default 8080 or, where that is taken, a free one"
    )
    parser.add_argument("--no-hmi", action="store_true", help="without the pages")
    parser.add_argument(
        "--mqtt-url", metavar="URL", help="publish to this broker: mqtt[s]://[user[:password]@]host[:port]"
    )
    parser.add_argument(
        "--state-dir",
        metavar="FOLDER",
        help="keep the bay files and the outbox there, as `gateway run` does (default: nothing outlives the run)",
    )
    parser.add_argument(
        "--world-start-ns",
        type=int,
        metavar="NS",
        help="world time 0 is at this time of CLOCK_BOOTTIME, also a past one: a simulation that is started again "
        "finds its truck where it is by then (default: 2 s after the start)",
    )
    parser.add_argument("--method", metavar="NAME", help="robust or paper (default: as in the settings, robust)")
    parser.add_argument(
        "--exposure",
        choices=("camera", "marker"),
        help="who sets the simulated camera's exposure; marker: the gateway (default: as in the settings, camera)",
    )
    parser.add_argument(
        "--vehicle",
        choices=("shunter", "winch", "tractor"),
        help="instead of the scenario's truck, from its start: what a PLC program moves through a simulated drive, a "
        "Modbus server on a free port of loopback that is printed; nobody writes: it stands",
    )
    parser.add_argument("--trials", type=int, metavar="N", help="run N alignment trials and print Table II (paper: 10)")
    parser.add_argument(
        "--ranger",
        choices=("simulated", "firmware"),
        default="simulated",
        help="what is on the serial line: the simulated ranger, or the real firmware in an emulator",
    )
    parser.add_argument(
        "--ranger-log", type=Path, metavar="FILE", help="with --ranger firmware: what its sensor played, JSON lines"
    )
    parser.add_argument(
        "--json", action="store_true", help="JSON lines on stdout: started, state with truth, event, summary"
    )
    parser.add_argument("--quiet", action="store_true", help="no live view; print events only")


def main(args: argparse.Namespace) -> int:

    if args.list:
        simulation.print_scenarios()
        return 0
    return simulation.simulate(args)
