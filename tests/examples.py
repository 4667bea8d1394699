"""How many examples a property test searches: its own number, by the profile's share (see tests/conftest.py)."""

from hypothesis import settings

USUAL = 100  # of the profile "steady"


def examples(count: int) -> int:
    """For `settings(max_examples=...)`, where the profile's number is not enough or too much."""
    return max(5, count * settings().max_examples // USUAL)
