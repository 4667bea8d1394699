"""Lines for the log that a scanner can't multiply: one of a kind at a time, with the number held back since. Pure."""

PERIOD_S = 10.0
MAX_KINDS = 64  # remembered; more can only come where kinds are made of what peers say


class Teller:
    """`tell` gives the line to log, or None while one of its kind was given less than PERIOD_S ago."""

    def __init__(self, period_s: float = PERIOD_S) -> None:
        self._period_s = period_s
        self._told: dict[object, tuple[float, int]] = {}  # kind -> (when last, held back since)

    def tell(self, kind: object, line: str, now_s: float) -> str | None:
        when_s, held_back = self._told.get(kind, (float("-inf"), 0))
        if now_s - when_s < self._period_s:
            self._told[kind] = (when_s, held_back + 1)
            return None
        if kind not in self._told and len(self._told) >= MAX_KINDS:
            del self._told[min(self._told, key=lambda known: self._told[known][0])]
        self._told[kind] = (now_s, 0)
        return f"{line} ({held_back} more of these since the last such line)" if held_back else line
