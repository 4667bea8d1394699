"""Every state that the real control step can reach in a bounded space: no permit while one of its conditions fails.

    python -m bench.exhaustive                          one minute of each space
    python -m bench.exhaustive --seconds 3600 --jobs 2  an hour of each space, two at a time
    python -m bench.exhaustive --space core --seconds 3600
    python -m bench.exhaustive --walks 10000            and 10,000 random histories of 200 moves in each space
    python -m bench.exhaustive --space core --replay "camera:mark ranger:mark tick"

A space is one configuration and a list of moves: readings of camera and ranger with one of a few values, writes of a
PLC, a function check, a restart, and a tick that lets some ms pass. Any move may follow any other. After each move
gateway/core/interlock.py decides, and tests/stated_conditions.py, which knows the moves and shares no code with it,
lists each condition of docs/visit.md, docs/handshake.md and docs/registers.md that fails. The registers are compared
with the decision, and once more after the ticks have ended.

States that have the same future are searched once (tests/interlock_search.py). Of some of them that is tested: with
--compare 0.01 one in a hundred is compared with the next that was taken for it, move by move.

Histories deeper than a search in breadth comes are drawn by chance (tests/interlock_walks.py): --walks.

Printed for each space: states, transitions, the depth in moves up to which the search is complete from its roots (the
phases of a visit), and what is left; with 0 left the space is searched completely, histories of any length included.
The exit status is 1 if a condition failed; then the shortest history is printed, of a walk one without a move too many,
and the command that replays it.
"""

import argparse
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict

from tests.interlock_search import Found, Space, complaints, root, search, spaces, taken, visits
from tests.interlock_walks import walk

EVERY_S = 10.0  # between two lines of progress


def run(
    name: str, seconds: float, transitions: int, compare: float, seed: int, walks: int, moves: int
) -> tuple[str, float, Found, Found]:
    """Search one space for this time, then walk in it."""
    space, begun = spaces()[name], time.monotonic()
    due = begun + EVERY_S

    def progress(found: Found) -> None:
        nonlocal due
        now = time.monotonic()
        if now >= due:
            due = now + EVERY_S
            print(
                f"{name}: {now - begun:5.0f} s, {found.states:,} states, {found.transitions:,} transitions, "
                f"depth {found.depth}, {found.left:,} left",
                file=sys.stderr,
                flush=True,
            )
        if now - begun >= seconds:
            raise StopIteration

    found = search(space, visits(space), transitions=transitions, compare=compare, seed=seed, progress=progress)
    taken_s = time.monotonic() - begun
    return name, taken_s, found, walk(space, visits(space), walks=walks, moves=moves, seed=seed)


def report(space: Space, seconds: float, found: Found, walked: Found) -> None:
    """As text, for people."""
    complete = "searched completely" if not found.left else f"complete to depth {found.depth - 1}, {found.left:,} left"
    print(f"\n{space.name}: {space.why}")
    print(
        f"  {found.states:,} states, {found.transitions:,} transitions in {seconds:.0f} s, "
        f"{len(space.moves)} moves, steps of {space.step_ms} ms; {complete}"
    )
    print("  " + ", ".join(f"{what} {count:,}" for what, count in sorted(found.reached.items())))
    if found.compared:
        print(f"  {found.compared:,} pairs of states that were taken for one compared: {len(found.unlike)} differ")
    for line in found.unlike[:5]:
        print(f"  differ: {line}")
    if walked.transitions:
        print(f"  walks: {walked.transitions:,} transitions, {len(walked.faults)} kinds of failed conditions")
    for complaint, history in found.faults + walked.faults:
        print(f"  FAILED: {complaint}")
        print(f'    python -m bench.exhaustive --space {space.name} --replay "{" ".join(history)}"')
    if not found.faults + walked.faults:
        print("  no state with may_move or in_place on while one of its stated conditions fails")


def replay(space: Space, history: str) -> int:
    """Print each state on the way, and what fails there."""
    node, failed = root(space), 0
    for name in history.split():
        node = taken(space, node, space.moves[space.named(name)])
        state = node.state
        d = "-" if state.d is None else int(state.d)
        print(
            f"{name:<22} D {d}  stop {state.stop:d}  may_move {state.may_move:d}  in_place {state.in_place:d}  "
            f"{state.reason.name.lower():<18} {state.visit.phase.name.lower()}"
        )
        for complaint in complaints(space, node):
            failed += 1
            print(f"    FAILED: {complaint}")
    return failed


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--space", choices=sorted(spaces()), help="only this one")
    parser.add_argument("--seconds", type=float, default=60.0, help="for each space; default 60")
    parser.add_argument("--transitions", type=int, default=10**12, help="for each space at most")
    parser.add_argument("--jobs", type=int, default=1, help="spaces at a time, each in a process; default 1")
    parser.add_argument("--compare", type=float, default=0.001, help="share of states to compare; default 0.001")
    parser.add_argument("--walks", type=int, default=0, help="random histories in each space; default 0")
    parser.add_argument("--moves", type=int, default=200, help="of each walk; default 200")
    parser.add_argument("--seed", type=int, default=0, help="of the walks, and of which states are compared")
    parser.add_argument("--json", action="store_true", help="the figures as JSON, a line for each space")
    parser.add_argument("--replay", metavar="MOVES", help="play this history, print each state")
    args = parser.parse_args()
    chosen = [args.space] if args.space else list(spaces())
    if args.replay is not None:
        return int(replay(spaces()[chosen[0]], args.replay) > 0)
    faults = 0
    with ProcessPoolExecutor(args.jobs) as pool:
        how = (args.seconds, args.transitions, args.compare, args.seed, args.walks, args.moves)
        for job in [pool.submit(run, name, *how) for name in chosen]:
            name, seconds, found, walked = job.result()
            faults += len(found.faults) + len(found.unlike) + len(walked.faults)
            if args.json:
                figures = {"space": name, "seconds": round(seconds, 1)} | asdict(found) | {"walked": asdict(walked)}
                print(json.dumps(figures), flush=True)
            else:
                report(spaces()[name], seconds, found, walked)
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
