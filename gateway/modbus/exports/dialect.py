"""From the common language of logic.py to that of a tool, and to plain ASCII. Pure."""

import re

_PLAIN = {"×": "x", "–": "-", "°": "deg", "±": "+-", "µ": "u"}


def iec(text: str) -> str:
    """SCL's local names and quoted function names as plain IEC identifiers. Typed literals keep their `#`."""
    return re.sub(r'"(\w+)"', r"\1", re.sub(r"(?<!\w)#(?=[A-Za-z_])", "", text))


def ascii_only(text: str) -> str:
    """PLC tools disagree on encodings; the few signs that are not ASCII have a plain spelling."""
    for sign, plain in _PLAIN.items():
        text = text.replace(sign, plain)
    return text.encode("ascii", "replace").decode("ascii")
