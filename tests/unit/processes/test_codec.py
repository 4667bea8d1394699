"""Messages between processes are data: whatever the bytes, only the records of the schema come out, and at once."""

import ast
import contextlib
import itertools
import pickle
import resource
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gateway
from gateway.config import VisionConfig
from gateway.core.plc import Writer
from gateway.core.state import FunctionCheck
from gateway.errors import ProtocolError
from gateway.processes import child
from gateway.processes.channel import Failed
from gateway.processes.codec import COMPRESSED, MAX_MESSAGE_BYTES, MAX_UNPACKED_BYTES, Codec, record_of, record_packed
from gateway.vision.transport.messages import FROM_VISION
from gateway.web.ipc.messages import FROM_WEB, ApplySettings, Command, SetFunctionCheck, StateRequest, SystemStatus
from tests.unit.web.links import full

ANNA = Writer("127.0.0.1", "anna", "technician")
GOOD = Codec.packed(StateRequest(1, ("bay1",), 7, links=True))
NESTED = b"\x91" * (MAX_MESSAGE_BYTES - 1) + b"\xc0"


def tuples(depth: int) -> object:
    """2 to the `depth` elements, in a few bytes of a pickle: hashing it never ends."""
    made: object = ()
    for _ in range(depth):
        made = (made, made)
    return made


def check(mode: object) -> bytes:
    return Codec.packed(["Command", 1, ANNA, ["SetFunctionCheck", "bay1", mode]])


def settings(vision: object) -> bytes:
    return Codec.packed(["Command", 1, ANNA, ["ApplySettings", "bay1", vision, None]])


HOSTILE: dict[str, bytes] = {
    "nothing": b"",
    "tuples in tuples whose hash takes for ever": pickle.dumps(("StateRequest", 1, (tuples(45),))),
    "a class whose attributes are set": b"\x80\x04cgateway.core.state\nFunctionCheck\nN}\x8c\x03OFFK\x00s\x86b.",
    "a function to be called": b"\x80\x04cposix\nsystem\n\x8c\x04true\x85R.",
    "lists in lists": NESTED,
    "lists in lists in the place of a name": b"\x95\xacStateRequest\x01" + NESTED,
    "maps in maps, as deep as a message can": b"\x81" * MAX_MESSAGE_BYTES,
    "maps whose keys are lists": b"\x95\xacStateRequest\x01\x81\x92\x01\x02\x03\x00\xc3",
    "a stated length of 4 billion names": b"\x95\xacStateRequest\x01\xdd\xff\xff\xff\xff",
    "a stated length of 4 GB of text": b"\x95\xacStateRequest\x01\x91\xdb\xff\xff\xff\xff",
    "more bays than are answered": Codec.packed(["StateRequest", 1, ["bay1"] * 7, 0, True]),
    "another type than the field's": Codec.packed(["StateRequest", "1", ["bay1"], 0, True]),
    "a field too many": Codec.packed(["StateRequest", 1, ["bay1"], 0, True, {"function_check": 0}]),
    "a record of another kind": Codec.packed(["StateReply", 1, 2, 3, []]),
    "a number that is no mode": check(3),
    "a reading in the place of a mode": Codec.packed(
        ["Command", 1, ANNA, ["SetFunctionCheck", "bay1", {"t_ns": 1, "quality": 0}]]
    ),
    "settings out of their range": Codec.packed(
        ["Command", 1, ANNA, ["ApplySettings", "bay1", '{"deadline_s": 1e9}', None]]
    ),
    "settings with an unknown key": Codec.packed(
        ["Command", 1, ANNA, ["ApplySettings", "bay1", '{"__class__": 1}', None]]
    ),
    "settings as lists in lists": settings("[" * 60_000),
    "settings as a map": settings({"method": "paper"}),
    "something compressed": COMPRESSED + zlib.compress(GOOD),
    "a complete message and more": GOOD + GOOD,
    "half a message": GOOD[:-3],
}


@pytest.mark.parametrize("data", [Codec.packed(["StateRequest", 1, ["bay1"], 0, True]), check(1), settings("{}")])
def test_what_the_hostile_messages_are_made_of_is_accepted(data: bytes) -> None:
    FROM_WEB.unpacked(data)


@pytest.fixture
def little_memory() -> Iterator[None]:
    """Half a gigabyte more than there is now, for a reader that trusts a false length."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + (512 << 20), before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


@pytest.mark.parametrize("codec", [FROM_WEB, FROM_VISION], ids=["from the web process", "from a vision process"])
@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.timeout(10)
def test_a_message_made_to_harm_is_refused_and_nothing_else_happens(
    codec: Codec, name: str, little_memory: None
) -> None:
    modes = dict(vars(FunctionCheck))
    with pytest.raises(ProtocolError, match="not a message that is taken here"):
        codec.unpacked(HOSTILE[name])
    assert dict(vars(FunctionCheck)) == modes


@given(st.binary(max_size=300))
def test_any_bytes_are_a_message_or_refused(data: bytes) -> None:
    with contextlib.suppress(ProtocolError):
        FROM_WEB.unpacked(data)


def test_a_message_with_any_byte_changed_is_a_command_or_refused() -> None:
    data = Codec.packed(Command(1, ANNA, SetFunctionCheck("bay1", FunctionCheck.MAY_MOVE_OFF)))
    taken = 0
    for place, byte in itertools.product(range(len(data)), range(256)):
        try:
            order = FROM_WEB.unpacked(data[:place] + bytes([byte]) + data[place + 1 :])
        except ProtocolError:
            continue
        taken += 1
        assert type(order) is Command
        assert type(order.action) is SetFunctionCheck
        assert (type(order.number), type(order.who), type(order.action.mode)) == (int, Writer, FunctionCheck)
    assert 256 < taken < 10_000  # other letters in names, another number, another mode


def test_an_error_in_settings_does_not_quote_them() -> None:
    data = Codec.packed(
        ["Command", 1, ANNA, ["ApplySettings", "bay1", '{"coast_s": "rtsp://anna:secret@camera"}', None]]
    )
    with pytest.raises(ProtocolError) as refused:
        FROM_WEB.unpacked(data)
    assert "a VisionConfig out of its range" in str(refused.value)
    assert "secret" not in str(refused.value)
    assert refused.value.__cause__ is None


def test_settings_keep_which_keys_were_set() -> None:
    order = Command(2, ANNA, ApplySettings("bay1", VisionConfig(method="paper", coast_s=0.3), VisionConfig()))
    again = FROM_WEB.unpacked(Codec.packed(order))
    assert again == order
    assert again.action.vision.model_fields_set == {"method", "coast_s"}


def test_a_message_that_would_not_fit_is_compressed_and_a_bomb_is_refused() -> None:
    names = tuple(f"bay{n}" for n in range(20_000))
    reader = Codec(tuple[str, ...], compressed=True)
    packed = Codec.packed(names)
    assert packed.startswith(COMPRESSED)
    assert len(packed) < MAX_MESSAGE_BYTES
    assert reader.unpacked(packed) == names
    with pytest.raises(ProtocolError):
        reader.unpacked(COMPRESSED + zlib.compress(b"\xc6\x7f\xff\xff\xff" + bytes(2 * MAX_UNPACKED_BYTES)))
    with pytest.raises(ProtocolError):
        reader.unpacked(COMPRESSED + b"no zlib")


def test_a_number_of_numpy_is_read_as_a_number() -> None:
    numbers = (np.float64(1.5), np.int64(3), np.bool_(True))
    again = Codec(tuple[float, int, bool]).unpacked(Codec.packed(numbers))
    assert (again, [type(one) for one in again]) == ((1.5, 3, True), [float, int, bool])
    with pytest.raises(NotImplementedError, match="ndarray is no data"):
        Codec.packed(np.zeros(1))


def test_a_final_message_with_a_path_that_is_not_utf_8_is_still_a_message() -> None:
    failed = Failed(child.shown("LinkError: /films/\udcfc.avi: gone"))
    assert FROM_WEB.unpacked(Codec.packed(failed)) == Failed(r"LinkError: /films/\udcfc.avi: gone")
    assert len(child.shown("x" * 10_000)) == child.MAX_CHARACTERS


def test_only_data_can_be_packed() -> None:
    with pytest.raises(NotImplementedError, match="object is no data"):
        Codec.packed(object())


def test_a_status_of_the_system_is_read_as_it_was_written() -> None:
    links = full()
    assert record_of(SystemStatus, record_packed(links)) == links


CODE_IN_MESSAGES = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "copyreg", "multiprocessing", "pickletools"}


def imported(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        match node:
            case ast.Import(names=names):
                yield from (name.name for name in names)
            case ast.ImportFrom(module=str(module)):
                yield module
            case ast.Call(
                func=ast.Name(id="__import__") | ast.Attribute(attr="import_module"), args=[ast.Constant(value)]
            ):
                yield str(value)


@pytest.mark.one_interpreter
def test_no_module_of_the_gateway_imports_what_makes_code_of_bytes() -> None:
    root = Path(gateway.__file__).parent
    found = {
        f"{path.relative_to(root)}: {name}"
        for path in root.rglob("*.py")
        if any(name in path.read_text() for name in CODE_IN_MESSAGES)
        for name in imported(path)
        if name.split(".")[0] in CODE_IN_MESSAGES
    }
    assert found == set()
