"""What the main process takes from the web process: named records and nothing else. Pure.

The web process talks to strangers' browsers. Whoever got hold of it must not get hold of the control path, too, and an
ordinary pickle may name any function there is. So only these classes are ever looked up; whether what is in them makes
sense is for `feed` to see.
"""

import io
import pickle
import pickletools
from enum import Enum

from gateway.children.link import PICKLE, Codec
from gateway.children.words import Failed
from gateway.config import Intrinsics, VisionConfig
from gateway.hmi.alarms.records import Deed
from gateway.hmi.alarms.states import Cue
from gateway.hmi.orders import Apply, Ask, Check, Order
from gateway.model import FunctionCheck
from gateway.plc import Writer

SPOKEN = (Ask, Order, Check, Apply, Deed, Writer, FunctionCheck, Cue, VisionConfig, Intrinsics, Failed)
MOST_REMEMBERED = 10_000  # objects in one message
_CLASSES = {(spoken.__module__, spoken.__qualname__): spoken for spoken in SPOKEN}


class _Narrow(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> object:
        if (found := _CLASSES.get((module, name))) is not None:
            return found
        if (module, name) == ("builtins", "getattr"):  # so some versions of Python name a member of an Enum
            return _member
        raise pickle.UnpicklingError(f"the web process may not speak of {module}.{name}")


def _member(kind: object, name: object) -> object:
    if isinstance(kind, type) and issubclass(kind, Enum) and isinstance(name, str) and name in kind.__members__:
        return kind[name]
    raise pickle.UnpicklingError("the web process may not ask for attributes")


def _unpacked(data: bytes) -> object:
    """Raises whatever unpickling raises, for anything but the records above."""
    for opcode, place, _ in pickletools.genops(data):
        # Memory is taken for all places up to the one named: ten bytes could ask for 64 GB.
        if opcode.name in ("PUT", "BINPUT", "LONG_BINPUT") and (place or 0) > MOST_REMEMBERED:
            raise pickle.UnpicklingError(f"the web process may not have {place} objects in one message")
    return _Narrow(io.BytesIO(data)).load()


CODEC = Codec(PICKLE.packed, _unpacked)
"""The main process's end; the web process trusts the main process, and has plain pickles."""
