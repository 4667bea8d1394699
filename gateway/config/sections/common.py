"""What several sections share. Pure."""

from typing import Self

from pydantic import Field, model_validator

from gateway.config.strict.placed_error import FieldError
from gateway.config.strict.section import Section


class Reconnect(Section):
    """How a lost link is tried again: exponential backoff with full jitter between the two limits."""

    min_s: float = Field(0.25, ge=0.01, le=60, description="first delay before a lost link is tried again")
    max_s: float = Field(5.0, ge=0.05, le=600, description="longest delay between two tries")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.max_s < self.min_s:
            raise FieldError(f"max_s = {self.max_s} must be at least min_s = {self.min_s}", "max_s")
        return self
