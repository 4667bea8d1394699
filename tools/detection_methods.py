"""The detection methods' stages, settings and codes as tables, for docs/vision.md and docs/vision-robust.md. Pure."""

from collections.abc import Callable, Mapping, Sequence

from gateway.vision.detect.paper import method as paper
from gateway.vision.detect.robust import method as robust
from gateway.vision.detect.robust.decision import POWERS

SHARE_MEANING: dict[str, str] = {
    "support": "of the rim in the picture and not under a crust, how much shows an edge on the ellipse",
    "round": "how little these edges scatter about the ellipse",
    "coverage": "of the rim in the picture, how much is red inside and not outside, another red, or a crust's end",
    "sealed": "1 less the share where the red continues outside as if there were no rim",
    "clear": "contrast across the rim, against its scatter from ray to ray",
    "fill": "of the inside, how much is red",
    "aspect": "semi-minor by semi-major axis; 1 from 0.85 on",
    "contrast": "fall of redness across the rim; 1 from 0.45 on in clear air, from less in haze",
    "colour": "e to the power of -d; d: distance from the marker's colour, 0 within its tolerance, 1 at the gate",
}


def paper_stages() -> str:
    rows = [(f"`{stage.name}`", stage.equation or "–", stage.meaning) for stage in paper.STAGES]
    return _table(("stage", "equation", "what it does"), rows)


def _robust_stages() -> str:
    return _table(("stage", "what it does"), [(f"`{stage.name}`", stage.meaning) for stage in robust.STAGES])


def _robust_weights() -> str:
    rows = [(name, f"{POWERS[name]:g}", meaning) for name, meaning in SHARE_MEANING.items()]
    return _table(("share", "power", "meaning"), rows)


def _robust_rejections() -> str:
    return _table(("`why`", "meaning"), [(f"`{code}`", meaning) for code, meaning in robust.REJECTIONS.items()])


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    lines = [" | ".join(head), " | ".join("---" for _ in head), *(" | ".join(row) for row in rows)]
    return "\n".join(f"| {line} |" for line in lines) + "\n"


ROBUST_BLOCKS: Mapping[str, Callable[[], str]] = {
    "stages": _robust_stages,
    "weights": _robust_weights,
    "rejections": _robust_rejections,
}
