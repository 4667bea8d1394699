"""Pages that are one file."""

import re

FETCHED = r"""(?i)(?:src|href)\s*=\s*["'](?!data:|\#)|url\(|@import"""
RUN = r"""(?i)<script(?! type="application/json" id="\w+">)"""


def fetches_nothing(text: str) -> bool:
    """Whether a page refers to nothing outside itself, and runs nothing: a block of JSON is data."""
    return re.search(FETCHED, text) is None and re.search(RUN, text) is None
