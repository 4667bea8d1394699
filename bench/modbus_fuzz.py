"""A million frames against a live server: no crash, no hang, no wrong answer.

    python -m bench.modbus_fuzz [--frames 1000000] [--seed 1]

Frames are made from requests that are right, nearly right and random; sent pipelined, cut and run together at random,
over connections of some hundred frames each, a part of which end in the middle of a frame or with an impossible length.
Every byte that comes back is compared with tests/modbus_oracle.py, which is the specification's table and shares
nothing with the server. The first difference ends the run with an error.
"""

import argparse
import logging
import sys
import time

from gateway import event_loop
from tests.modbus_fuzzing import fuzz


def progress(frames: int) -> None:
    if sys.stderr.isatty():
        print(f"\r{frames:>9} frames", end="", file=sys.stderr)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    logging.disable()
    begun = time.monotonic()
    seen = event_loop.run(fuzz(args.frames, args.seed, progress))
    took = time.monotonic() - begun
    print(f"seed {args.seed}: {seen['frames']} frames in {took:.0f} s, every answer as the specification says")
    for what, count in sorted(seen.items()):
        print(f"  {what:<22} {count:>8}")


if __name__ == "__main__":
    main()
