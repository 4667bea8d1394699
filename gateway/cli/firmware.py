"""Put the gateway's firmware on an Arduino Uno.

Through its boot loader, as the Arduino IDE does; read back afterwards. What is on the board now is overwritten. No
gateway may have the port open meanwhile.

example:
  gateway firmware flash /dev/ttyACM0
"""

import argparse
import sys

from gateway.clock import SystemClock
from gateway.ranger import flashing


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("action", choices=["flash"])
    parser.add_argument("port", metavar="PORT", help="serial port of the board")


def main(args: argparse.Namespace) -> int:

    def progress(done: float) -> None:
        print(f"\r{done:4.0%}", end="", file=sys.stderr, flush=True)

    try:
        flashing.flash(args.port, flashing.image(), SystemClock(), progress)
    finally:
        print(file=sys.stderr)
    print(f"{args.port}: the firmware is written, and read back equal")
    return 0
