"""Pages that are one file."""

import re


def fetches_nothing(text: str) -> bool:
    """Whether a page refers to nothing outside itself, and runs nothing: a block of JSON is data."""
    return re.search(r"""(?i)(?:src|href)\s*=\s*["'](?!data:|\#)|url\(|@import|<script(?! type="application/json" id="\w+">)""", text) is None
