"""The messages of devices: whatever arrives is a message or is refused with a reason."""

import math
from typing import Any

import orjson
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from handover_devices.protocol.live import live_message
from handover_devices.protocol.messages import (
    MAX_LINE_BYTES,
    MAX_VALUES,
    BadMessage,
    CommandAnswer,
    DeviceEvent,
    StateReport,
    Telemetry,
    parse_hello,
    parse_message,
)
from handover_devices.protocol.relaying import parse_relayed, parse_replica_hello

HELLO = {"type": "hello", "version": 1, "device": "hall-1", "token": "secret"}
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)
MEMBERS = st.sampled_from(
    ["seq", "t", "values", "state", "batteryLevel", "name", "data", "id", "progress", "result", "reason"]
)


def line(**members: Any) -> bytes:
    return orjson.dumps(members)


def refused(**members: Any) -> BadMessage:
    with pytest.raises(BadMessage) as caught:
        parse_message(line(**members))
    return caught.value


@given(st.binary(max_size=200))
@example(b'{"type":"telemetry","values":{"a":NaN}}')
@example(b'{"type":"telemetry","values":{"a":1e999}}')
@example(b"[" * 2000)
def test_any_bytes_are_refused_or_a_message(data: bytes) -> None:
    for parse in (parse_message, parse_hello):
        try:
            parse(data)
        except BadMessage as bad:
            fault = bad
        else:
            continue
        assert fault.code
        assert str(fault)


@given(JSON)
@example([])
@example({})
def test_a_type_that_is_no_text_is_refused(kind: Any) -> None:
    try:
        data = orjson.dumps({"type": kind})
    except TypeError:  # an integer of more than 64 bits
        return
    for parse in (parse_message, parse_hello, parse_relayed):
        with pytest.raises(BadMessage):
            parse(data)
    assert parse_replica_hello(data) is None
    assert live_message(data) is None


@given(
    st.sampled_from(["telemetry", "state", "event", "ack", "error", "hello"]),
    st.dictionaries(MEMBERS, JSON, max_size=6),
)
def test_any_members_are_refused_or_a_message_with_finite_numbers(kind: str, members: dict[str, Any]) -> None:
    try:
        data = orjson.dumps({**members, "type": kind})
    except TypeError:  # an integer of more than 64 bits
        return
    try:
        message = parse_message(data)
    except BadMessage:
        return
    assert isinstance(message, Telemetry | StateReport | DeviceEvent | CommandAnswer)
    if isinstance(message, Telemetry):
        assert message.values
        assert all(math.isfinite(value) for value in message.values.values())
    if isinstance(message, Telemetry | StateReport | DeviceEvent):
        assert message.t is None or math.isfinite(message.t)


@given(
    st.dictionaries(
        st.text(min_size=1, max_size=20),
        st.floats(allow_nan=False, allow_infinity=False) | st.booleans(),
        min_size=1,
        max_size=20,
    ),
    st.integers(0, 2**53),
    st.floats(0, 1e10),
)
def test_values_arrive_as_they_were_sent(values: dict[str, float], seq: int, t: float) -> None:
    message = parse_message(line(type="telemetry", seq=seq, t=t, values=values))
    assert message == Telemetry(seq, t, {name: float(value) for name, value in values.items()})


def test_a_refusal_names_the_rule_and_has_the_seq_of_the_message() -> None:
    bad = refused(type="telemetry", seq=7, values={"temperature": "21"})
    assert (bad.code, bad.seq) == ("badValue", 7)
    assert "temperature" in str(bad)
    assert "NaN" in str(refused_text(b'{"type":"telemetry","values":{"a":NaN}}'))
    assert refused(type="state", seq=1, state="asleep").code == "badState"
    assert refused(type="telemetry", values={}).code == "badValues"
    assert refused(type="telemetry", values={"a": None}).code == "badValue"
    assert refused(type="telemetry", values={str(n): n for n in range(MAX_VALUES + 1)}).code == "badValues"
    assert refused(type="telemetry", t=True, values={"a": 1}).code == "badTime"
    assert refused(type="ack", id="c-1", progress=1.5).code == "badAnswer"
    assert refused(type="ack", state="done").code == "badAnswer"
    assert refused(type="poetry").code == "unknownType"


def refused_text(data: bytes) -> BadMessage:
    with pytest.raises(BadMessage) as caught:
        parse_message(data)
    return caught.value


def test_a_value_of_a_megabyte_is_refused_before_it_is_parsed() -> None:
    assert refused_text(b'"' + b"x" * 1_000_000 + b'"').code == "tooLong"
    assert refused_text(b'"' + b"x" * (MAX_LINE_BYTES - 2) + b'"').code == "notJson"


def test_a_hello_needs_device_token_and_version() -> None:
    hello = parse_hello(line(**HELLO, boot="7f", measures=["temperature"], takes=["home"]))
    assert (hello.device, hello.boot, hello.measures, hello.takes) == (
        "hall-1",
        "7f",
        ("temperature",),
        ("home",),
    )
    assert "secret" not in repr(hello)
    for change in (
        {"version": 2},
        {"version": True},
        {"device": "a b"},
        {"device": None},
        {"token": ""},
        {"token": 5},
        {"boot": "x" * 65},
        {"measures": "temperature"},
        {"takes": [1]},
        {"type": "telemetry"},
    ):
        with pytest.raises(BadMessage):
            parse_hello(line(**{**HELLO, **change}))
