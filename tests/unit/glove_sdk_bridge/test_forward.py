"""Frames piped in by another program."""

import json
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glove_sdk_bridge.errors import BadLine
from glove_sdk_bridge.forward import Forward, parse_forwarded
from glove_sdk_bridge.frames import Frame, Hello

hands = st.tuples(*[st.integers(0, 4095)] * 5)


@contextmanager
def piped(data: bytes) -> Iterator[int]:
    """The reading end of a pipe into which `data` is written and which is closed then."""
    reader, writer = os.pipe()

    def write() -> None:
        with os.fdopen(writer, "wb") as pipe:
            pipe.write(data)

    program = threading.Thread(target=write)
    program.start()
    try:
        yield reader
    finally:
        program.join()
        os.close(reader)


@given(hands, st.sampled_from(["json", "frame", "numbers"]))
def test_each_way_to_write_a_frame_gives_the_same_frame(hand: tuple[int, ...], way: str) -> None:
    line = {
        "json": json.dumps({"bend": hand}),
        "frame": json.dumps({"type": "frame", "seq": 5, "t": 12.5, "bend": hand}),
        "numbers": ",".join(map(str, hand)),
    }[way]
    assert parse_forwarded(line.encode(), 12.5) == Frame(12.5, hand)


@given(st.binary(max_size=200))
def test_any_line_is_a_frame_or_refused(line: bytes) -> None:
    with suppress(BadLine):
        frame = parse_forwarded(line, 1.0)
        assert frame is None or len(frame.bend) == 5


def test_a_frame_keeps_its_own_time_pressure_and_battery() -> None:
    line = b'{"type":"frame","t":3.25,"bend":[1,2,3,4,5],"pressure":[5,4,3,2,1],"battery":0.5}'
    assert parse_forwarded(line, 99.0) == Frame(3.25, (1, 2, 3, 4, 5), 0, (5, 4, 3, 2, 1), 0.5)


def test_a_piped_recording_begins_with_a_hello_which_is_not_a_frame_and_not_a_fault() -> None:
    assert parse_forwarded(Hello("glove-1").encode(), 0.0) is None


@pytest.mark.parametrize("time", ["null", '"now"', "true", "1e999"])
def test_a_time_that_is_no_number_is_refused(time: str) -> None:
    with pytest.raises(BadLine, match="time"):
        parse_forwarded(f'{{"bend":[1,2,3,4,5],"t":{time}}}'.encode(), 0.0)


def test_garbage_between_frames_is_counted_and_the_last_line_needs_no_end() -> None:
    said: list[str] = []
    lines = [
        b"1,2,3,4,5",
        b"garbage",
        b"more garbage",
        b"",
        b'{"bend":[1,2]}',
        b"x" * 70_000,
        b'{"bend":[9,8,7,6,5]}',
    ]
    with piped(b"\n".join(lines)) as stdin:
        forward = Forward(say=said.append, stdin=stdin, clock=lambda: 7.0)
        frames = list(forward.frames())
    assert frames == [Frame(7.0, (1, 2, 3, 4, 5)), Frame(7.0, (9, 8, 7, 6, 5))]
    assert sorted(forward.dropped.by_rule.values()) == [1, 1, 2]
    assert len(forward.dropped) == 4
    assert len(said) == 3  # the first of each kind


def test_a_byte_order_mark_at_the_beginning_does_no_harm() -> None:
    with piped(b"\xef\xbb\xbf1,2,3,4,5\r\n6,7,8,9,10\r\n") as stdin:
        forward = Forward(say=pytest.fail, stdin=stdin)
        assert [frame.bend for frame in forward.frames()] == [(1, 2, 3, 4, 5), (6, 7, 8, 9, 10)]
