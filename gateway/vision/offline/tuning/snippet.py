"""A proposal in the words of the configuration. Pure."""

from collections.abc import Mapping, Sequence

from gateway.vision.offline.tuning.thresholds import Margin, Red


def toml(red: Red, margins: Sequence[Margin], gates: Mapping[str, float], examples: int) -> str:
    """`[vision]` to paste; each bound with the range in which it does as well."""
    room = {margin.name: f"{margin.low} to {margin.high} do as well" for margin in margins}
    keys = red.keys()
    high = {m.name: f"{180 - m.high} to {180 - m.low} do as well" for m in margins}["hue_low"]
    notes = {
        "red_low_1": f"S: {room['s_min']}; V: {room['v_min']}",
        "red_high_1": f"H: {room['hue_high']}",
        "red_low_2": f"H: {high}",
        "red_high_2": "",
    }
    lines = [
        f'# Proposed from {examples} marker{"" if examples == 1 else "s"}; for vision.method = "paper".',
        "[vision]",
    ]
    for key, value in keys.items():
        note = f"  # {notes[key]}" if notes[key] else ""
        lines.append(f"{key} = {list(value)}{note}")
    lines += [f"{key} = {value:g}" for key, value in gates.items()]
    return "\n".join(lines) + "\n"
