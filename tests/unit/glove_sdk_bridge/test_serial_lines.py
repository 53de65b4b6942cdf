"""Lines of serial gloves: the OpenGloves protocol and plain numbers."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glove_sdk_bridge.errors import BadLine
from glove_sdk_bridge.serial_lines import parse_serial_line

hands = st.tuples(*[st.integers(0, 65_535)] * 5)
other_keys = st.lists(
    st.builds("{}{}".format, st.sampled_from("FGHIJKLMNOPQ"), st.integers(0, 4095) | st.just(""))
    | st.builds("({}){}".format, st.sampled_from(["AB", "BC", "AAB"]), st.integers(0, 4095)),
    max_size=8,
).map("".join)


@given(hands, other_keys, st.sampled_from(["", "\r", " "]))
def test_opengloves_lines_are_read_with_any_other_values(
    hand: tuple[int, ...], others: str, end: str
) -> None:
    line = "".join(f"{key}{value}" for key, value in zip("ABCDE", hand, strict=True)) + others + end
    assert parse_serial_line(line.encode()) == hand


@given(hands)
def test_plain_numbers_are_read(hand: tuple[int, ...]) -> None:
    assert parse_serial_line(",".join(map(str, hand)).encode()) == hand


@given(st.binary(max_size=120) | st.from_regex(rb"[A-H(]([A-Z0-9()]{0,8}){0,8}", fullmatch=True))
def test_garbage_never_crashes(line: bytes) -> None:
    with suppress(BadLine):
        assert len(parse_serial_line(line)) == 5


@pytest.mark.parametrize(
    "line",
    [
        b"A1B2C3D4",
        b"A1B2C3D4E",
        b"A1B2C3D4E5A6",
        b"B2C3D4E5F6",
        b"A1B2C3D4E5!",
        b"A1,B2,C3,D4,E5",
        b"A-1B2C3D4E5",
        b"A99999999999999999999B2C3D4E5",
        "A١B2C3D4E5".encode(),
        b"1,2,3,4",
        b"\xff\xfe",
        b"",
    ],
)
def test_a_line_without_exactly_five_values_is_refused(line: bytes) -> None:
    with pytest.raises(BadLine):
        parse_serial_line(line)
