"""Which parameters of a test run in `./dev test`, and which in `./dev test --all` only."""

from collections.abc import Iterable
from typing import Any

import pytest


def mostly_long(values: Iterable[Any], short: int = 1) -> list[Any]:
    """For `parametrize` and for `params` of a fixture: all but the first `short` are marked `long`."""
    return [
        value if n < short else pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=pytest.mark.long)
        for n, value in enumerate(values)
    ]
