"""The robust method's stages, gates and rejection codes as tables, for docs/vision-robust.md. Pure."""

from collections.abc import Callable, Mapping, Sequence

from gateway.vision.detect.robust.decision import POWERS
from gateway.vision.detect.robust.detect import STAGES
from gateway.vision.detect.robust.rejections import REJECTION_MEANING

SHARE_MEANING: dict[str, str] = {
    "support": "of the rim in the picture, how much shows an edge that lies on the ellipse, at full resolution",
    "round": "how little these edges scatter about the ellipse",
    "coverage": "of the rim in the picture, how much is red inside and not outside, or another red",
    "sealed": "1 less the share where the red goes on outside as if there were no rim",
    "clear": "contrast across the rim, against its scatter from ray to ray",
    "fill": "of the inside, how much is red",
    "aspect": "semi-minor by semi-major axis; 1 from 0.85 on",
    "contrast": "fall of redness across the rim; 1 from 0.45 on in clear air, from less in haze",
}


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    lines = [" | ".join(head), " | ".join("---" for _ in head), *(" | ".join(row) for row in rows)]
    return "\n".join(f"| {line} |" for line in lines) + "\n"


def stages() -> str:
    return _table(("stage", "what it does"), [(f"`{name}`", meaning) for name, meaning in STAGES])


def weights() -> str:
    rows = [(name, f"{POWERS[name]:g}", meaning) for name, meaning in SHARE_MEANING.items()]
    return _table(("share", "power", "meaning"), rows)


def rejections() -> str:
    return _table(("`why`", "meaning"), [(f"`{code}`", meaning) for code, meaning in REJECTION_MEANING.items()])


BLOCKS: Mapping[str, Callable[[], str]] = {"stages": stages, "weights": weights, "rejections": rejections}
