"""Lines cut out of a stream, however it is chopped up, and plain numbers in them."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glove_sdk_bridge.errors import BadLine
from glove_sdk_bridge.lines import Lines, five_numbers


@given(st.lists(st.binary(max_size=30)), st.lists(st.integers(1, 20)))
def test_lines_are_the_same_however_the_stream_is_chopped_up(pieces: list[bytes], cuts: list[int]) -> None:
    stream = b"\n".join(pieces)
    at_once = Lines()
    expected = [*at_once.feed(stream), *at_once.end()]
    chopped, seen, place = Lines(), [], 0
    for cut in cuts:
        seen += chopped.feed(stream[place : place + cut])
        place += cut
    seen += [*chopped.feed(stream[place:]), *chopped.end()]
    assert seen == expected
    assert [line for line in seen if line] == [
        stripped for piece in stream.split(b"\n") if (stripped := piece.rstrip(b"\r"))
    ]


@given(st.integers(1, 5000))
def test_a_line_that_is_too_long_is_counted_once_and_the_next_is_read(chunk: int) -> None:
    lines = Lines(limit=100)
    stream = b"x" * 1000 + b"\nshort\n" + b"y" * 101 + b"\nlast\n"
    seen = [line for place in range(0, len(stream), chunk) for line in lines.feed(stream[place:][:chunk])]
    assert seen == [b"short", b"last"]
    assert lines.too_long == 2


def test_a_line_without_end_does_not_fill_the_memory() -> None:
    lines = Lines(limit=100)
    for _ in range(1000):
        assert not list(lines.feed(b"z" * 1000))
    assert lines.too_long == 1
    assert not list(lines.end())


@given(st.text(max_size=60))
def test_any_text_is_five_numbers_or_refused(text: str) -> None:
    with suppress(BadLine):
        assert len(five_numbers(text)) == 5


@given(st.lists(st.integers(0, 4095) | st.floats(0, 1).map(lambda x: round(x, 6)), min_size=5, max_size=5))
def test_five_numbers_are_read_as_written(values: list[float]) -> None:
    assert (
        list(five_numbers(", ".join(f"{value:f}" if value % 1 else str(value) for value in values))) == values
    )


@pytest.mark.parametrize(
    "text", ["1,2,3,4", "1,2,3,4,5,6", "1,2,3,4,nan", "1,2,3,4,1_0", "1,2,3,4,", "1 2 3 4 5"]
)
def test_what_is_not_five_numbers_is_refused(text: str) -> None:
    with pytest.raises(BadLine):
        five_numbers(text)
