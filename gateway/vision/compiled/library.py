"""The library of compiled loops, loaded: one that is missing, stale or for another machine is not used."""

import ctypes
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from gateway.vision.compiled.build import LIBRARY, source_sum

log = logging.getLogger(__name__)

Kernel = TypeVar("Kernel")


def load(
    make: Callable[[ctypes.CDLL], Kernel],
    agrees: Callable[[Kernel], bool],
    reference: Callable[..., Any],
    library: Path = LIBRARY,
) -> Kernel | None:
    """The kernel that `make` finds in the library; None where there is none, or none of this source.

    `agrees` compares it with what it stands for, its `reference` in NumPy and OpenCV, on a small example; a kernel that
    differs is not used either. The reason is logged.
    """
    if not library.exists():
        return None
    try:
        loaded = ctypes.CDLL(str(library))
        loaded.gateway_source.restype = ctypes.c_uint32
        if loaded.gateway_source() != source_sum():
            log.warning("the vision kernels were built from another source: not used; ./dev kernel builds them anew")
            return None
        kernel = make(loaded)
    except (OSError, AttributeError) as error:
        log.warning("the vision kernels cannot be loaded: not used: %s", error)
        return None
    if not agrees(kernel):
        name = f"{reference.__module__}.{reference.__qualname__}"
        log.error("the vision kernel %s does not agree with %s: not used", type(kernel).__name__, name)
        return None
    return kernel
