"""Random histories of many moves, for the depth that a search in breadth does not reach (tests/interlock_search.py).

A walk begins at one of the roots. It either takes moves by chance alone, or plays a truck's visit again and again: a
beat is a picture, a distance, a write and a tick with the values of one phase, some beats long, and moves are put in
between by chance. What fails is reported with the fewest moves that still bring the same complaint.
"""

import random
import re
from collections.abc import Iterator, Sequence
from itertools import islice

from tests.interlock_search import Found, Node, Space, complaints, root, situations, taken

# Camera, ranger and PLC of one phase after another; a space without one of the moves leaves it out.
ROUND = (
    ("away", "away", "idle"),
    ("rolled", "rolled", "idle"),
    ("mark", "mark", "idle"),
    ("mark", "mark", "idle"),
    ("no_target", "mark", "idle"),
    ("mark", "mark", "idle"),
    ("mark", "mark", "release"),
    ("mark", "mark", "idle"),
    ("rolled", "rolled", "release"),
    ("rolled", "rolled", "idle"),
    ("rolled", "rolled", "reset"),
    ("away", "away", "release"),
    ("no_target", "no_echo", "idle"),
)
ODD = (0.0, 0.05, 0.15, 0.4, 1.0)  # share of moves by chance: of each walk one of these


def walk(
    space: Space,
    roots: Sequence[Sequence[str]],
    *,
    walks: int,
    moves: int = 200,
    seed: int = 0,
    most_faults: int = 5,
) -> Found:
    """So many walks of so many moves; of the result, `transitions`, `reached` and `faults` count."""
    found, kinds = Found(), set[str]()
    starts = [(list(names), played(space, names)) for names in roots]
    for number in range(walks):
        chance = random.Random(f"{space.name} {seed} {number}")
        names, node = chance.choice(starts)
        history = list(names)
        for move in islice(_moves(space, chance), moves):
            node = taken(space, node, space.moves[move])
            history.append(space.moves[move].name)
            found.transitions += 1
            for situation in situations(node.state):
                found.reached[situation] = found.reached.get(situation, 0) + 1
            complaint = next(complaints(space, node), None)
            if complaint is None:
                continue
            if kind(complaint) not in kinds:
                kinds.add(kind(complaint))
                found.faults.append(shrunk(space, history, complaint))
            break
        if len(found.faults) >= most_faults:
            break
    return found


def played(space: Space, names: Sequence[str]) -> Node:
    """The node at the end of a history."""
    node = root(space)
    for name in names:
        node = taken(space, node, space.moves[space.named(name)])
    return node


def kind(complaint: str) -> str:
    """A complaint without its numbers: a shorter history may bring it with others."""
    return re.sub(r"[0-9.]+", "#", complaint)


def shrunk(space: Space, history: list[str], complaint: str) -> tuple[str, list[str]]:
    """The complaint, and the history without every part that it does not need."""
    size = len(history)
    while size >= 1:
        at = 0
        while at < len(history):
            found = _failed(space, history[:at] + history[at + size :], kind(complaint))
            if found is None:
                at += size
            else:
                complaint, history = found
        size //= 2
    return complaint, history


def _failed(space: Space, names: list[str], wanted: str) -> tuple[str, list[str]] | None:
    """The first complaint of that kind, and the moves up to it."""
    node = root(space)
    for number, name in enumerate(names, 1):
        node = taken(space, node, space.moves[space.named(name)])
        for complaint in complaints(space, node):
            if kind(complaint) == wanted:
                return complaint, names[:number]
    return None


def _moves(space: Space, chance: random.Random) -> Iterator[int]:
    """Without end."""
    number = {move.name: n for n, move in enumerate(space.moves)}
    odd = chance.choice(ODD)
    at = chance.randrange(len(ROUND))
    while True:
        camera, ranger, plc = ROUND[at]
        beat = [number.get(name) for name in (f"camera:{camera}", f"ranger:{ranger}", f"plc:{plc}", "tick")]
        for _ in range(chance.randint(1, 4) * max(1, 300 // space.step_ms)):
            for move in beat:
                if chance.random() < odd:
                    yield chance.randrange(len(space.moves))
                if move is not None and odd < 1.0:
                    yield move
        at = (at + 1) % len(ROUND) if chance.random() < 0.8 else chance.randrange(len(ROUND))
