"""One line of an examination: what was tried, what came back, what to do. Pure."""

from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    OK = "ok"
    WARNING = "warning"
    FAULT = "fault"


@dataclass(frozen=True, slots=True)
class Finding:
    """`part`: what kind of thing, as `camera`; `name`: which one, empty where there is one. `remedy`: empty if OK."""

    part: str
    name: str
    verdict: Verdict
    tried: str
    result: str
    remedy: str = ""

    @property
    def line(self) -> str:
        subject = f"{self.part} {self.name}".rstrip()
        remedy = f" -> {self.remedy}" if self.remedy else ""
        return f"{self.verdict:8} {subject}: {self.tried}: {self.result}{remedy}"
