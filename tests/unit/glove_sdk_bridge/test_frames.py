"""Frames on the wire: what is written is read again, and nothing else is taken for a frame."""

import json
import math
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glove_sdk_bridge.errors import BadLine
from glove_sdk_bridge.frames import (
    FINGERS,
    HANDS,
    MAX_LINE_BYTES,
    Frame,
    Hello,
    five,
    parse_frame,
    parse_hello,
)

numbers = st.integers(-4096, 65_535) | st.floats(-1e6, 1e6, allow_nan=False)
hands = st.tuples(numbers, numbers, numbers, numbers, numbers)
frames = st.builds(
    Frame,
    t_s=st.integers(0, 10**12).map(lambda microseconds: microseconds / 1e6),
    bend=hands,
    seq=st.integers(0, 10**9),
    pressure=st.none() | hands,
    battery=st.none() | st.floats(0, 1),
)
names = st.from_regex(r"[A-Za-z0-9_.-]{1,64}", fullmatch=True).filter(lambda name: name.strip("."))
hellos = st.builds(
    Hello,
    glove=names,
    hand=st.sampled_from(HANDS),
    token=st.text(max_size=40),
    sensors=st.permutations(FINGERS).map(tuple),
)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=6) | st.dictionaries(st.text(max_size=6), inner, max_size=4),
    max_leaves=12,
)
FRAME: dict[str, Any] = {"type": "frame", "seq": 17, "t": 1712.345, "bend": [1012, 640, 598, 701, 850]}
HELLO: dict[str, Any] = {"type": "hello", "version": 1, "glove": "glove-1"}


@given(frames)
def test_a_frame_that_is_written_is_read_again(frame: Frame) -> None:
    line = frame.encode()
    assert line.endswith(b"\n")
    assert line.count(b"\n") == 1
    assert len(line) < MAX_LINE_BYTES
    assert parse_frame(line) == frame


@given(hellos)
def test_a_hello_that_is_written_is_read_again(hello: Hello) -> None:
    line = hello.encode()
    assert line.count(b"\n") == 1
    assert parse_hello(line) == hello


@given(st.binary(max_size=200) | st.text(max_size=200) | json_values.map(json.dumps))
def test_any_other_line_is_refused_with_a_rule_and_never_crashes(line: bytes | str) -> None:
    for parse in (parse_frame, parse_hello):
        with suppress(BadLine):
            parse(line)
            pytest.fail("taken for a frame or a hello")


@given(json_values, st.sampled_from(["t", "bend", "seq", "pressure", "battery"]))
def test_a_frame_with_any_value_in_any_place_is_read_or_refused(value: Any, place: str) -> None:
    try:
        frame = parse_frame(json.dumps({**FRAME, place: value}))
    except BadLine:
        return
    assert len(frame.bend) == 5
    assert all(math.isfinite(number) for number in (*frame.bend, frame.t_s))


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"bend": [1, 2, 3, 4]}, "one a finger"),
        ({"bend": [1, 2, 3, 4, 5, 6]}, "one a finger"),
        ({"bend": [1, 2, 3, 4, True]}, "finite"),
        ({"bend": [1, 2, 3, 4, math.nan]}, "finite"),
        ({"bend": [1, 2, 3, 4, math.inf]}, "finite"),
        ({"bend": [1, 2, 3, 4, 10**300]}, "finite"),
        ({"bend": "12345"}, "list"),
        ({"t": None}, "time"),
        ({"t": "1"}, "time"),
        ({"seq": -1}, "seq"),
        ({"battery": 2}, "battery"),
        ({"type": "fame"}, "type"),
    ],
)
def test_the_rule_that_is_broken_is_named(change: dict[str, Any], rule: str) -> None:
    with pytest.raises(BadLine, match=rule):
        parse_frame(json.dumps({**FRAME, **change}))


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"version": 2}, "version 1"),
        ({"glove": "a glove"}, "letters"),
        ({"glove": ".."}, "letters"),
        ({"hand": "middle"}, "right"),
        ({"token": 5}, "text"),
        ({"sensors": ["thumb"]}, "each once"),
        ({"sensors": ["thumb", "thumb", "index", "middle", "ring"]}, "each once"),
        ({"sensors": [1, 2, 3, 4, 5]}, "each once"),
    ],
)
def test_the_rule_that_a_hello_breaks_is_named(change: dict[str, Any], rule: str) -> None:
    with pytest.raises(BadLine, match=rule):
        parse_hello(json.dumps({**HELLO, **change}))


def test_a_line_nested_too_deeply_is_refused() -> None:
    with pytest.raises(BadLine, match="not JSON"):
        parse_frame("[" * 50_000)


@given(st.permutations(FINGERS), hands)
def test_fingers_in_another_order_are_put_thumb_first(order: list[str], hand: tuple[float, ...]) -> None:
    sent = [hand[FINGERS.index(finger)] for finger in order]
    assert five(sent, "bend", tuple(order)) == hand


def test_the_token_is_not_shown_when_a_hello_is_printed() -> None:
    assert "s3cret" not in repr(Hello("glove-1", token="s3cret"))
