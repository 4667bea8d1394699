"""From a picture to the one candidate that is the marker, and the others with the reasons why they are not. Pure."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import zip_longest

from gateway.core.detection import Circle, Ellipse
from gateway.vision.detect.geometry import crosses, encloses, same_candidate, same_ellipse
from gateway.vision.detect.robust import candidates, constants, measurement, proposer, rings, veil
from gateway.vision.detect.robust.burnt import of_the_legible
from gateway.vision.detect.robust.candidates import Seed
from gateway.vision.detect.robust.clearest_rim import CLEARLY, quality, rim_behind_veil
from gateway.vision.detect.robust.decision import (
    BLUR,
    COLOUR,
    SHAPE,
    Candidate,
    Limits,
    candidate,
    chosen,
    circle_of,
    confidence,
    failed_gate,
    hopeless,
    partly_hidden,
    priority,
    weight,
)
from gateway.vision.detect.robust.evidence import Evidence
from gateway.vision.detect.robust.facets import cornered
from gateway.vision.detect.robust.own_colour import is_glow, is_red_itself
from gateway.vision.detect.robust.redness import BLACK, PyramidLevel, pyramid
from gateway.vision.detect.robust.rim_fine import Rim
from gateway.vision.detect.robust.veil import Veil
from gateway.vision.detect.stage_timer import StageTimer
from gateway.vision.pixels import Colours
from gateway.vision.track.distractors import SIZE

Rejected = tuple[float, Circle, str]  # how near to acceptance it was, where it is, why it was not taken

SEEDS = 24  # measured
RIMS = 5  # whose rim is refined
REJECTED = 5  # reported
SURE = 0.9  # confidence from which on a marker in clear air ends the search
FINEST_PX = 10.0  # radius of the smallest disc on the finest level, px of it, at least
COARSEST_PX = 8  # side of the coarsest level
FLAT = 0.8  # semi-minor by semi-major axis below which a circle is tried, too
HIDDEN_REACH = 0.2  # how far off the rim of a disc in part hidden is searched for, of its radius
EXPECTED_REACH = 0.25  # how far off a prediction's rim is searched for, of its radius


def search_frame(image: Colours, limits: Limits, timer: StageTimer) -> tuple[Candidate | None, int, list[Rejected]]:
    """The marker, how many candidates there were, and the best few of the others.

    In thick dust the levels are searched as they are and, unless that shows the marker in clear air, less the veil: an
    even wall looks like dust, but what stands before it does not.
    """
    levels = levels_of(image, limits)
    dust = veil.over(levels)
    timer.ended("pyramid")
    learned = _learned(levels, limits)  # the net sees through a veil by itself
    seeds = _proposed(levels, learned, limits)
    timer.ended("candidates")
    measured = measurement.gather(levels, seeds)
    timer.ended("evidence")
    refined, rejected = _refined(image, levels, seeds, measured, limits)
    timer.ended("rim")
    seen_clearly = dust is None or any(_share_at(dust, levels[0], found.rim.ellipse) == 0 for found in refined)
    taken, others = _decided(image, levels, refined, limits) if seen_clearly else (None, [])
    timer.ended("decision")
    if dust is not None and not _in_clear_air(taken, dust, levels[0]):
        clear = veil.unveiled(levels, dust)
        behind = _proposed(clear, learned, limits)
        more, no_rims = _refined(image, clear, behind, measurement.gather(clear, behind), limits)
        taken, others = _decided(image, levels, [*refined, *more], limits)
        others = _once_each([*others, *rejected, *no_rims], taken)
        rejected, seeds = [], list({*seeds, *behind})
        taken = None if taken is None else replace(taken, veil=_share_at(dust, levels[0], taken.rim.ellipse))
    timer.ended("veil")
    return taken, len(seeds), sorted([*rejected, *others], key=_nearness)[:REJECTED]


def _nearness(entry: Rejected) -> float:
    return -entry[0]


def _once_each(rejected: Sequence[Rejected], taken: Candidate | None) -> list[Rejected]:
    """Without what was taken, and each other place once, as nearest to acceptance: both kinds of level showed it."""
    places = [] if taken is None else [circle_of(taken.rim.ellipse)]
    kept: list[Rejected] = []
    for entry in sorted(rejected, key=_nearness):
        if not any(same_candidate(entry[1], place) for place in places):
            places.append(entry[1])
            kept.append(entry)
    return kept


def _in_clear_air(taken: Candidate | None, dust: Veil, level: PyramidLevel) -> bool:
    """Whether a sure marker is itself darker than a veil would let it be."""
    return taken is not None and confidence(taken) >= SURE and _share_at(dust, level, taken.rim.ellipse) == 0


def search_expected(image: Colours, expected: Circle, limits: Limits) -> Candidate | None:
    """The marker if it is where it is expected and passes every gate; None: look everywhere."""
    radius = expected.radius_px
    if not (radius > 0 and all(map(math.isfinite, (radius, expected.u_px, expected.v_px)))):
        return None
    seed = Ellipse(expected.u_px, expected.v_px, radius, radius, 0.0)
    found = next(
        (found for found, why in _measured_at(image, seed, EXPECTED_REACH * radius, limits) if why is None), None
    )
    if found is None or not rings.red_beyond(image, found.rim.ellipse, found.evidence.redness):
        return found
    level = pyramid(image, _factor(found.rim.ellipse.semi_major_px), max(image.shape[:2]))
    outer, why = _outer(image, level, found, limits) or (found, None)
    return outer if why is None else found


def _measured_at(
    image: Colours, seed: Ellipse, reach_px: float, limits: Limits
) -> Iterator[tuple[Candidate, str | None]]:
    """The rim near there with its evidence, as it is and less the veil; and why it is not the marker."""
    factor = _factor(seed.semi_major_px)
    if min(image.shape[:2]) < 2 * factor:
        return
    levels = pyramid(image, factor, max(image.shape[:2]))
    dust = veil.over(levels)
    share = _share_at(dust, levels[0], seed)
    rim = rim_behind_veil(image, seed, share, reach_px)
    if rim is None:
        return
    yield from _judged(image, levels, rim, share, limits)
    if dust is not None:
        yield from _judged(image, veil.unveiled(levels, dust), rim, share, limits)


def _factor(radius_px: float) -> int:
    """Of the level on which the evidence for such a rim is measured."""
    return int(2 ** max(0, math.floor(math.log2(max(radius_px, 1.0) / constants.EVIDENCE_RADIUS_PX))))


def _judged(
    image: Colours, levels: Sequence[PyramidLevel], rim: Rim, share: float, limits: Limits
) -> Iterator[tuple[Candidate, str | None]]:
    (evidence,) = measurement.of_ellipses(levels, [rim.ellipse])
    if evidence is not None:
        found = _candidate(image, levels, rim, evidence, limits, share)
        yield found, _refused(image, found, limits)


def _refused(image: Colours, found: Candidate, limits: Limits) -> str | None:
    """The code of the first gate that it does not pass; of what passes all but the last, the corners are looked for."""
    why = _failed(image, found, limits)
    return SHAPE if why in (None, SIZE) and cornered(image, found.rim) else why


def _failed(image: Colours, found: Candidate, limits: Limits) -> str | None:
    """The code of the first gate that it does not pass. What was found less a veil must be red in the picture, too:
    before a cyan wall, taken for dust, the subtraction makes a grey disc red."""
    why = failed_gate(found, limits)
    if why not in (None, SIZE):
        return why
    if found.airlight != BLACK and not is_red_itself(image, found.rim.ellipse):
        return COLOUR
    return BLUR if is_glow(image, found.rim.ellipse) else why


def levels_of(image: Colours, limits: Limits) -> list[PyramidLevel]:
    """The pyramid that a search in the picture starts from."""
    return pyramid(image, max(1, int(limits.min_radius_px // FINEST_PX)), COARSEST_PX)


def proposed(levels: Sequence[PyramidLevel], limits: Limits) -> list[Seed]:
    """The places worth measuring: the net's first, where it is asked; then at most SEEDS others."""
    return _proposed(levels, _learned(levels, limits), limits)


def _learned(levels: Sequence[PyramidLevel], limits: Limits) -> list[Seed]:
    return [] if limits.proposals == "classical" else proposer.shipped()(levels)


def _proposed(levels: Sequence[PyramidLevel], learned: list[Seed], limits: Limits) -> list[Seed]:
    others = [] if limits.proposals == "learned" else _seeds(levels, limits)
    return candidates.distinct([*learned, *others], SEEDS + len(learned))


def _seeds(levels: Sequence[PyramidLevel], limits: Limits) -> list[Seed]:
    """Votes and blobs in turn, the strongest first."""
    smallest, largest = limits.min_radius_px, limits.max_radius_px
    # Levels finer than the smallest disc needs serve close measurement only: most of the time would be spent there.
    finer = sum(level.factor * candidates.RADII[0] <= smallest for level in levels) - 1
    voting = levels[max(0, finer) :]
    planes = [candidates.red_plane(level) for level in voting]
    voted = [seed for level, plane in zip(voting, planes, strict=True) for seed in candidates.votes(level, plane)]
    voted = [seed for seed in voted if 0.75 * smallest <= seed.radius_px <= 1.3 * largest]
    blobs = candidates.blobs(voting[0], planes[0], (smallest, largest)) if voting else []
    voted.sort(key=lambda seed: -seed.weight)
    blobs.sort(key=lambda seed: -seed.radius_px)
    return [seed for pair in zip_longest(voted, blobs) for seed in pair if seed is not None]


def _worth_a_rim(seeds: Sequence[Seed], measured: Sequence[Evidence | None]) -> tuple[list[Evidence], list[Rejected]]:
    """The most promising, each rim once; and those that are nothing for sure."""
    rejected: list[Rejected] = []
    with_rim: list[Evidence] = []
    for seed, found in zip(seeds, measured, strict=True):
        if found is None:
            rejected.append((0.0, Circle(seed.u_px, seed.v_px, seed.radius_px), "rim"))
        else:
            with_rim.append(found)
    kept: list[Evidence] = []
    for found in sorted(with_rim, key=lambda found: -priority(found)):
        if len(kept) < RIMS and not any(same_ellipse(found.ellipse, other.ellipse) for other in kept):
            kept.append(found)
    return kept, rejected


def _refined(
    image: Colours,
    levels: Sequence[PyramidLevel],
    seeds: Sequence[Seed],
    evidence: Sequence[Evidence | None],
    limits: Limits,
) -> tuple[list[Candidate], list[Rejected]]:
    """The rims of the most promising at full resolution and the evidence on these; and what has no rim."""
    worth, rejected = _worth_a_rim(seeds, evidence)
    rims: list[Rim] = []
    for found in worth:
        why = hopeless(found, limits)
        near = list(_rims_near(image, found)) if why is None else []
        if not near:
            rejected.append((priority(found), circle_of(found.ellipse), why or "rim"))
        rims += [rim for rim in near if not any(same_ellipse(rim.ellipse, other.ellipse) for other in rims)]
    measured = measurement.of_ellipses(levels, [rim.ellipse for rim in rims])
    return [
        _candidate(image, levels, rim, found, limits) for rim, found in zip(rims, measured, strict=True) if found
    ], rejected


def _candidate(
    image: Colours, levels: Sequence[PyramidLevel], rim: Rim, found: Evidence, limits: Limits, share: float = 0.0
) -> Candidate:
    airlight = levels[0].airlight
    return candidate(*of_the_legible(image, rim, found, airlight), limits, airlight, share)


def _share_at(dust: Veil | None, level: PyramidLevel, place: Ellipse) -> float:
    if dust is None:
        return 0.0
    return replace(level, veil=dust.share).veil_at(place.u_px, place.v_px)


def _rims_near(image: Colours, found: Evidence) -> Iterator[Rim]:
    """The rim near the one seen in redness; of a disc in part hidden also that near a circle, from farther off."""
    rim = _rim_near(image, found.ellipse, found.veil)
    if rim is None:
        return
    yield rim
    if partly_hidden(found):
        e = rim.ellipse
        circle = Ellipse(e.u_px, e.v_px, e.semi_major_px, e.semi_major_px, 0.0)
        wider = rim_behind_veil(image, circle, found.veil, HIDDEN_REACH * e.semi_major_px)
        if wider is not None:
            yield wider


def _rim_near(image: Colours, seen: Ellipse, share: float = 0.0) -> Rim | None:
    """The rim at full resolution near the one seen in redness; from a circle, too, where that one is flat.

    A disc before a red band has no edge of redness where it hides the band: the ellipse through the others is drawn out
    along it. Brightness shows the rim there, if it is searched for where a round disc has it.
    """
    rim = rim_behind_veil(image, seen, share)
    if rim is None or seen.semi_minor_px >= FLAT * seen.semi_major_px:
        return rim
    mean_px = math.sqrt(seen.semi_major_px * seen.semi_minor_px)
    other = rim_behind_veil(image, Ellipse(seen.u_px, seen.v_px, mean_px, mean_px, 0.0), share)
    return other if other is not None and quality(other) > quality(rim) + CLEARLY else rim


def _decided(
    image: Colours, levels: Sequence[PyramidLevel], refined: Sequence[Candidate], limits: Limits
) -> tuple[Candidate | None, list[Rejected]]:
    """The marker, and the others with the reason."""
    rejected: list[Rejected] = []
    discs: list[tuple[Candidate, str | None]] = []  # of any size; each once, as the level that shows it best has it
    judged = [(found, _failed(image, found, limits)) for found in sorted(refined, key=weight, reverse=True)]
    signs = [c.rim.ellipse for c, why in judged if why in (None, SIZE) and cornered(image, c.rim)]
    for found, gate in judged:
        on_a_sign = gate in (None, SIZE) and any(encloses(sign, found.rim.ellipse) for sign in signs)
        why = SHAPE if on_a_sign else gate  # the sign itself, or the inside of a letter on it
        if why is not None and why != SIZE:
            rejected.append((1 + confidence(found), circle_of(found.rim.ellipse), why))
        elif not any(_same_disc(found, other) for other, _ in discs):
            discs.append((found, why))
    for inner, _ in tuple(discs):
        outer = _outer(image, levels, inner, limits)
        if outer is not None and not any(same_ellipse(outer[0].rim.ellipse, other.rim.ellipse) for other, _ in discs):
            discs.append(outer)
    discs = [(disc, why if _of_one_paint(image, disc, discs) else COLOUR) for disc, why in discs]
    taken, others = chosen([disc for disc, why in discs if why is None])
    others += [(disc, why) for disc, why in discs if why is not None]
    rejected += [(2 + confidence(disc), circle_of(disc.rim.ellipse), why) for disc, why in others]
    return taken, rejected


def _of_one_paint(image: Colours, disc: Candidate, discs: Sequence[tuple[Candidate, str | None]]) -> bool:
    """Whether it is as red near its rim as every smaller disc within it."""
    outer = disc.rim.ellipse
    within = (inner.rim.ellipse for inner, _ in discs if encloses(outer, inner.rim.ellipse))
    return all(
        rings.of_its_paint(image, outer, rim)
        for rim in within
        if rim.semi_major_px < outer.semi_minor_px and not crosses(outer, rim)
    )


def _same_disc(found: Candidate, surer: Candidate) -> bool:
    """One rim fitted twice, or one that crosses a sure one."""
    ours, other = found.rim.ellipse, surer.rim.ellipse
    return same_ellipse(ours, other) or (confidence(surer) >= SURE and crosses(ours, other))


def _outer(
    image: Colours, levels: Sequence[PyramidLevel], inner: Candidate, limits: Limits
) -> tuple[Candidate, str | None] | None:
    """The outermost rim round a disc that is one's, too; None: the disc's own."""
    if not measurement.may_have_outer(levels, inner.rim.ellipse):
        return None
    for near in rings.around(image, levels, inner.rim.ellipse):
        for found, why in _measured_at(near.image, near.seed, 0.0, limits):
            e = found.rim.ellipse
            if why in (None, SIZE) and e.semi_minor_px > inner.rim.ellipse.semi_minor_px:
                ellipse = replace(e, u_px=e.u_px + near.left, v_px=e.v_px + near.top)
                return replace(found, rim=replace(found.rim, ellipse=ellipse)), why
    return None
