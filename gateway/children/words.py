"""What is said about any child, whatever its work."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Failed:
    """The child's last words."""

    why: str
    config: bool = False  # only the operator can mend it


@dataclass(frozen=True, slots=True)
class Gone:
    """Said by the pool about a child: its process is no more."""

    how: str
