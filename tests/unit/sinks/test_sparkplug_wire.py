"""What is encoded and what is read of commands, against code that the Protocol Buffers compiler made."""

import contextlib
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.sinks.sparkplug.wire import DataType, Metric, Payload, QualityCode, WireError, booleans, encode
from tests.e2e.sparkplug_plant import schema
from tests.examples import examples

UINT64 = st.integers(0, 2**64 - 1)
TEXT = st.text(max_size=40)
VALUES: dict[DataType, st.SearchStrategy[Any]] = {
    DataType.INT32: st.integers(-(2**31), 2**31 - 1),
    DataType.INT64: st.integers(-(2**63), 2**63 - 1),
    DataType.DOUBLE: st.floats(allow_nan=False),
    DataType.BOOLEAN: st.booleans(),
    DataType.STRING: TEXT,
    DataType.DATETIME: UINT64,
}


@st.composite
def metrics(draw: st.DrawFn) -> Metric:
    datatype = draw(st.sampled_from(DataType))
    return Metric(
        name=draw(TEXT),
        timestamp_ms=draw(UINT64),
        datatype=datatype,
        value=draw(st.none() | VALUES[datatype]),
        historical=draw(st.booleans()),
        quality=draw(st.sampled_from(QualityCode)),
        unit=draw(TEXT),
    )


PAYLOADS = st.builds(
    Payload,
    timestamp_ms=UINT64,
    metrics=st.lists(metrics(), max_size=5).map(tuple),
    seq=st.none() | st.integers(0, 255),
)


def shown(value: Any, datatype: DataType) -> Any:
    """As the specification puts it on the wire: a negative number as its two's complement."""
    masks = {DataType.INT32: 0xFFFF_FFFF, DataType.INT64: 0xFFFF_FFFF_FFFF_FFFF}
    return value & masks[datatype] if datatype in masks and value is not None else value


@pytest.mark.long
@pytest.mark.one_interpreter
@given(PAYLOADS)
@settings(max_examples=examples(200), deadline=None)
def test_what_we_write_the_compilers_code_reads(payload: Payload) -> None:
    found = schema().Payload.FromString(encode(payload))
    assert found.timestamp == payload.timestamp_ms
    assert (found.seq if found.HasField("seq") else None) == payload.seq
    assert len(found.metrics) == len(payload.metrics)
    for read, wrote in zip(found.metrics, payload.metrics, strict=True):
        assert (read.name, read.timestamp, read.datatype) == (wrote.name, wrote.timestamp_ms, wrote.datatype)
        assert read.is_historical == wrote.historical
        assert read.is_null == (wrote.value is None)
        if wrote.value is not None:
            assert getattr(read, read.WhichOneof("value")) == shown(wrote.value, wrote.datatype)
        properties = dict(zip(read.properties.keys, read.properties.values, strict=True))
        quality = properties.get("Quality")
        assert (quality.int_value if quality else 192) == wrote.quality
        assert (properties["engUnit"].string_value if "engUnit" in properties else "") == wrote.unit


@given(PAYLOADS)
@settings(max_examples=examples(50), deadline=None)
def test_without_types_only_the_types_are_missing(payload: Payload) -> None:
    bare, whole = (schema().Payload.FromString(encode(payload, typed=typed)) for typed in (False, True))
    assert not any(metric.HasField("datatype") for metric in bare.metrics)
    for metric in whole.metrics:
        metric.ClearField("datatype")
    assert bare == whole


@pytest.mark.long
@pytest.mark.one_interpreter
@given(PAYLOADS)
@settings(max_examples=examples(200), deadline=None)
def test_what_the_compilers_code_writes_we_read(payload: Payload) -> None:
    theirs = schema().Payload.FromString(encode(payload)).SerializeToString()
    assert booleans(theirs) == {
        (metric.name, metric.value) for metric in payload.metrics if isinstance(metric.value, bool)
    }


@pytest.mark.long
@pytest.mark.one_interpreter
@given(st.binary(max_size=300) | st.builds(lambda payload, at: encode(payload)[:at], PAYLOADS, st.integers(0, 400)))
@settings(max_examples=examples(700), deadline=None)
def test_any_bytes_are_a_payload_or_a_wire_error(data: bytes) -> None:
    with contextlib.suppress(WireError):
        assert all(isinstance(name, str) for name, _ in booleans(data))


def test_fields_that_are_not_used_are_skipped() -> None:
    theirs = schema().Payload(uuid="x", body=b"y")
    theirs.metrics.add(name="f", float_value=0.5, is_transient=True, alias=7)
    theirs.metrics.add(name="b", boolean_value=True, is_transient=True, alias=8)
    assert booleans(theirs.SerializeToString()) == {("b", True)}


def test_not_a_number_is_no_value_of_ours() -> None:
    assert math.isnan(schema().Payload.FromString(
        encode(Payload(1, (Metric("x", 1, DataType.DOUBLE, math.nan),)))
    ).metrics[0].double_value)  # fmt: skip
