"""Pages that are one file."""

import re


def fetches_nothing(text: str) -> bool:
    """Whether a page refers to nothing outside itself."""
    return re.search(r"""(?i)(?:src|href)\s*=\s*["'](?!data:|\#)|url\(|@import|<script""", text) is None
