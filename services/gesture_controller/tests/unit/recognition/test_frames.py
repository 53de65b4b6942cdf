"""What a glove sends is a frame or a hello, complete and finite, or it is refused with a reason."""

import math
from typing import Any

import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_gloves.recognition.frames import (
    BadFrame,
    BadHello,
    Frame,
    Hello,
    parse_frame,
    parse_hello,
)

GOOD: dict[str, Any] = {
    "type": "frame",
    "seq": 17,
    "t": 1712.345,
    "bend": [1012, 640, 598, 701, 850],
    "pressure": [0, 0, 0, 0, 0],
}
HELLO: dict[str, Any] = {
    "type": "hello",
    "version": 1,
    "glove": "glove-1",
    "hand": "left",
    "token": "secret",
    "sensors": ["thumb", "index", "middle", "ring", "little"],
}


def test_a_frame_is_read() -> None:
    assert parse_frame(orjson.dumps(GOOD)) == Frame(1712.345, [1012, 640, 598, 701, 850])


def test_a_frame_may_end_with_a_carriage_return() -> None:
    assert parse_frame(orjson.dumps(GOOD) + b"\r").t_s == 1712.345


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"garbage", "not JSON"),
        (b'{"type":"frame","t":1,"bend":[1,2,3', "not JSON"),
        (b'{"type":"frame","t":1,"bend":[1,2,NaN,4,5]}', "not JSON"),
        (b'{"type":"frame","t":1,"bend":[1,2,Infinity,4,5]}', "not JSON"),
        (b"\xff\xfe", "not JSON"),
        (b"[" * 5000, "not JSON"),
        (b"[1,2,3]", "not a frame"),
        (b'"frame"', "not a frame"),
        (b'{"type":"hello"}', "not a frame"),
        (b'{"type":"frame","bend":[1,2,3,4,5]}', "no time"),
        (b'{"type":"frame","t":"1","bend":[1,2,3,4,5]}', "no time"),
        (b'{"type":"frame","t":true,"bend":[1,2,3,4,5]}', "no time"),
        (b'{"type":"frame","t":1}', "no bend values"),
        (b'{"type":"frame","t":1,"bend":{"thumb":1}}', "no bend values"),
        (b'{"type":"frame","t":1,"bend":[1,2,3,4]}', "missing fingers"),
        (b'{"type":"frame","t":1,"bend":[]}', "missing fingers"),
        (b'{"type":"frame","t":1,"bend":[1,2,3,4,5,6]}', "too many fingers"),
        (b'{"type":"frame","t":1,"bend":[1,2,null,4,5]}', "not a number"),
        (b'{"type":"frame","t":1,"bend":[1,2,"3",4,5]}', "not a number"),
        (b'{"type":"frame","t":1,"bend":[1,2,false,4,5]}', "not a number"),
    ],
)
def test_what_is_no_frame_is_refused_with_its_reason(line: bytes, reason: str) -> None:
    with pytest.raises(BadFrame) as refused:
        parse_frame(line)
    assert refused.value.reason == reason


@given(st.binary(max_size=300))
def test_no_bytes_whatever_make_anything_but_a_frame_or_a_refusal(line: bytes) -> None:
    try:
        frame = parse_frame(line)
    except BadFrame:
        return
    assert math.isfinite(frame.t_s)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**60), 2**60) | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=6) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=8,
)


@given(t=JSON, bend=JSON | st.lists(JSON, min_size=5, max_size=5))
def test_a_frame_that_is_read_has_a_time_and_five_finite_values(t: Any, bend: Any) -> None:
    try:
        frame = parse_frame(orjson.dumps({"type": "frame", "t": t, "bend": bend}))
    except BadFrame:
        return
    assert type(frame.t_s) in {int, float}
    assert len(frame.bend) == 5
    assert all(type(value) in {int, float} and math.isfinite(value) for value in [*frame.bend, frame.t_s])


@given(st.floats(-1e9, 1e9), st.lists(st.floats(-1e6, 1e6) | st.integers(0, 4095), min_size=5, max_size=5))
def test_every_good_frame_comes_through_as_it_was_sent(t: float, bend: list[float]) -> None:
    assert parse_frame(orjson.dumps({"type": "frame", "t": t, "bend": bend})) == Frame(t, bend)


def test_a_hello_is_read() -> None:
    assert parse_hello(orjson.dumps(HELLO)) == Hello("glove-1", "left", "secret")


def test_fingers_in_another_order_are_put_right() -> None:
    sensors = ["little", "ring", "middle", "index", "thumb"]
    hello = parse_hello(orjson.dumps({**HELLO, "sensors": sensors}))
    frame = parse_frame(b'{"type":"frame","t":1,"bend":[5,4,3,2,1]}', hello.order)
    assert frame.bend == [1, 2, 3, 4, 5]


def test_a_hello_that_is_passed_on_keeps_the_token_to_itself() -> None:
    line = parse_hello(orjson.dumps(HELLO)).line()
    assert b"secret" not in line
    assert parse_hello(line) == Hello("glove-1", "left")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"type": "frame"}, "not a hello"),
        ({"version": 2}, "version 2 is not supported"),
        ({"version": None}, "version None"),
        ({"glove": ""}, "1 to 64 letters"),
        ({"glove": "../../etc"}, "1 to 64 letters"),
        ({"glove": ".."}, "1 to 64 letters"),
        ({"glove": "g" * 65}, "1 to 64 letters"),
        ({"glove": 7}, "1 to 64 letters"),
        ({"hand": "third"}, "left"),
        ({"hand": ["left"]}, "left"),
        ({"token": 5}, "must be a text"),
        ({"sensors": ["thumb", "index"]}, "middle, ring, little missing"),
        ({"sensors": ["thumb", "index", "middle", "ring", "little", "little"]}, "one sensor a finger"),
        ({"sensors": "all"}, "a list of fingers"),
        ({"sensors": [1, 2, 3, 4, 5]}, "a list of fingers"),
    ],
)
def test_an_invalid_hello_gets_the_reason(change: dict[str, Any], words: str) -> None:
    with pytest.raises(BadHello, match=words):
        parse_hello(orjson.dumps({**HELLO, **change}))


@pytest.mark.parametrize("line", [b"", b"GET / HTTP/1.1", b"\x16\x03\x01", b"[]", b"null"])
def test_another_protocol_gets_the_hint_to_send_a_hello(line: bytes) -> None:
    with pytest.raises(BadHello, match="hello"):
        parse_hello(line)
