"""The contract that every source of frames keeps. `specs` names the sources there are.

A source lives in the camera process: it may block, and when it hangs, the process is replaced.
"""

from dataclasses import dataclass
from typing import Protocol

from gateway.clock import Clock
from gateway.vision.pixels import Image


@dataclass(frozen=True, slots=True)
class Frame:
    """One picture and the moment it was taken, as far as its source knows."""

    image: Image
    t_capture_ns: int


class Source(Protocol):
    """An opened source of frames."""

    lossless: bool
    """True: every frame is wanted, so wait for a free slot (files as fast as possible). False: newest frame wins."""
    may_repeat: bool
    """True: equal pictures are new ones all the same (files, drawings). False: a sensor's noise makes them differ."""
    finite: bool
    """True: it ends, and opened again it would show the same once more, which nobody may take for now: it is not."""

    def read(self) -> Frame:
        """The next frame; blocks until there is one. Raises LinkError when the source ended or was lost."""

    def close(self) -> None:
        """Give the device back; may be called more than once. For a process that lives on: the camera process ends."""


class SourceSpec(Protocol):
    """What is sent to the camera process instead of a source: a small dataclass that knows how to open one there. Its
    fields are data: numbers, texts, settings, and records of these."""

    @property
    def label(self) -> str:
        """For messages: no passwords in it."""

    def open(self, clock: Clock) -> Source:
        """Open the source. Raises LinkError where it cannot be had, ConfigError where it never could."""
