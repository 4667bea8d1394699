"""Is the fast way to the paper's method really the same? Random and adversarial frames against the plain pipeline.

    python -m bench.vision_exact                          10,000 frames and 200 sequences, with the kernel and without
    python -m bench.vision_exact --frames 50000 --seed 7  more, and others

Every field of the Detection is compared, to the last bit. The test suite runs a smaller share of the same. Exit code 1
at the first difference, with the seed and the number that show it again.
"""

import argparse
import sys
from collections import Counter
from dataclasses import replace

import cv2
import numpy as np
from rich.progress import track

from gateway.vision.detect.paper import pipeline
from gateway.vision.detect.paper.exact import kernel
from gateway.vision.detect.paper.exact.kernel import Kernel
from gateway.vision.detect.paper.exact.search import ExactSearch
from gateway.vision.detect.paper.exact.tracker import ExactTracker
from tests.vision_frames import PAPER, Things, frames
from tests.vision_promise import check_promise

SEQUENCE = 50  # frames


def compare_frames(seed: int, count: int) -> Counter[str]:
    """Frames compared, by their kind; ends the program at a difference."""
    loaded: dict[str, Kernel | None] = {}
    seen: Counter[str] = Counter()
    quiet = not sys.stderr.isatty()
    for n, (kind, image, params) in enumerate(track(frames(seed, count), "frames", total=count, disable=quiet)):
        key = params.model_dump_json()
        if key not in loaded:
            loaded[key] = kernel.load(params)
        plain = replace(pipeline.detect(image, params), stage_ns=())
        if (how := loaded[key]) is None:
            continue
        found = replace(ExactSearch(params, kernel=how)(image), stage_ns=())
        if found != plain:
            sys.exit(f"seed {seed}, frame {n} ({kind}): {found} is not {plain}")
        seen[kind] += 1
        seen["with a marker"] += plain.circle is not None
    return seen


def follow_sequences(seed: int, count: int, compiled: Kernel) -> tuple[int, int]:
    """Frames with a larger thing elsewhere, not known yet, and frames searched in full. AssertionError: worse."""
    errors = full = 0
    for n in track(range(count), "sequences", disable=not sys.stderr.isatty()):
        tracker = ExactTracker(PAPER, kernel=compiled)
        more = check_promise(tracker, Things(np.random.default_rng([seed, 99, n])), SEQUENCE)
        errors, full = errors + more[0], full + more[1]
    return errors, full


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--sequences", type=int, default=200, help=f"of {SEQUENCE} frames, tracked")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    if (compiled := kernel.load(PAPER)) is None:
        sys.exit("the kernel is not built: ./dev kernel")
    seen = compare_frames(args.seed, args.frames)
    print(f"{args.frames} frames, 0 differences: {dict(seen)}")
    errors, full = follow_sequences(args.seed, args.sequences, compiled)
    total = args.sequences * SEQUENCE
    print(f"{args.sequences} sequences, {total} frames, tracked: {full} searched in full; promise kept in all of them;")
    print(f"{errors} frames reported a marker while a larger thing elsewhere was not known yet")


if __name__ == "__main__":
    main()
