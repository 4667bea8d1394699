"""What becomes of a lost link inside a task group."""

import contextlib
from collections.abc import Iterator

from gateway.errors import LinkError


@contextlib.contextmanager
def plain_link_error() -> Iterator[None]:
    """A task group wraps what its tasks raise; a lost link is told as the one LinkError it is."""
    try:
        yield
    except BaseExceptionGroup as group:
        links, others = group.split(LinkError)
        if links is None or others is not None:
            raise
        raise LinkError(str(_first(links))) from _first(links)


def _first(error: BaseException) -> BaseException:
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error
