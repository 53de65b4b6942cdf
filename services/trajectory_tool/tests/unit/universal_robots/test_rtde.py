"""RTDE packages: round trips, split streams, and what a hostile peer may send."""

import itertools
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_ur import rtde
from handover_ur.rtde import (
    Package,
    PackageReader,
    PackageType,
    ProtocolError,
    Recipe,
    RecipeError,
    Severity,
    TextMessage,
)

TYPES = {
    "BOOL": st.booleans(),
    "UINT8": st.integers(0, 2**8 - 1),
    "UINT32": st.integers(0, 2**32 - 1),
    "UINT64": st.integers(0, 2**64 - 1),
    "INT32": st.integers(-(2**31), 2**31 - 1),
    "DOUBLE": st.floats(allow_nan=False),
    "VECTOR3D": st.tuples(*[st.floats(allow_nan=False)] * 3),
    "VECTOR6D": st.tuples(*[st.floats(allow_nan=False)] * 6),
    "VECTOR6INT32": st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 6),
    "VECTOR6UINT32": st.tuples(*[st.integers(0, 2**32 - 1)] * 6),
}
packages = st.lists(st.builds(Package, st.integers(0, 255), st.binary(max_size=200)), max_size=8)


def encoded(package: Package) -> bytes:
    return rtde.HEADER.pack(rtde.HEADER.size + len(package.payload), package.kind) + package.payload


@given(packages, st.lists(st.integers(0, 2000), max_size=10))
def test_packages_arrive_whole_however_the_stream_is_split(sent: list[Package], cuts: list[int]) -> None:
    stream = b"".join(map(encoded, sent))
    reader = PackageReader()
    received: list[Package] = []
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    for begin, end in itertools.pairwise(edges):
        received += reader.feed(stream[begin:end])
    assert received == sent


@given(packages, st.data())
def test_a_truncated_stream_gives_only_complete_packages(sent: list[Package], data: st.DataObject) -> None:
    stream = b"".join(map(encoded, sent))
    kept = data.draw(st.integers(0, len(stream)))
    received = PackageReader().feed(stream[:kept])
    assert received == sent[: len(received)]
    assert sum(len(encoded(package)) for package in received) <= kept


@given(st.binary(max_size=500))
def test_arbitrary_bytes_give_packages_or_a_protocol_error(hostile: bytes) -> None:
    try:
        received = PackageReader().feed(hostile)
    except ProtocolError:
        return
    for package in received:
        for parse in (rtde.parse_accepted, rtde.parse_version, rtde.parse_text_message, rtde.parse_names):
            try:
                parse(package.payload)
            except ProtocolError:
                continue


@pytest.mark.parametrize("size", [0, 1, 2])
def test_a_package_smaller_than_its_header_is_an_error(size: int) -> None:
    with pytest.raises(ProtocolError, match="smaller than its header"):
        PackageReader().feed(struct.pack(">HB", size, PackageType.START))


@given(size=st.integers(rtde.MAX_RECEIVED_BYTES + 1, 0xFFFF), sent=packages)
def test_a_package_too_large_for_any_report_is_an_error_at_its_header(size: int, sent: list[Package]) -> None:
    """Its rest may never come, and nothing after it would be read."""
    reader = PackageReader()
    assert reader.feed(b"".join(map(encoded, sent))) == sent
    with pytest.raises(ProtocolError, match=f"{size} bytes is larger"):
        reader.feed(struct.pack(">HB", size, PackageType.DATA_PACKAGE))


@given(st.lists(st.sampled_from(sorted(TYPES)), min_size=1, max_size=12), st.data())
def test_a_data_package_is_decoded_as_it_was_encoded(types: list[str], data: st.DataObject) -> None:
    names = [f"variable_{number}" for number in range(len(types))]
    recipe = Recipe(7, names, types)
    values = {name: data.draw(TYPES[kind]) for name, kind in zip(names, types, strict=True)}
    (received,) = PackageReader().feed(recipe.encode(values))
    assert received.kind == PackageType.DATA_PACKAGE
    assert recipe.decode(received.payload) == values


@given(st.binary(max_size=120))
def test_a_data_package_of_the_wrong_size_or_recipe_is_an_error(payload: bytes) -> None:
    recipe = Recipe(1, ["actual_q", "robot_mode"], ["VECTOR6D", "INT32"])
    if len(payload) == recipe.size_bytes + 1 and payload[0] == 1:
        assert recipe.decode(payload).keys() == {"actual_q", "robot_mode"}
        return
    with pytest.raises(ProtocolError):
        recipe.decode(payload)


def test_a_recipe_names_the_variables_that_the_controller_does_not_offer() -> None:
    with pytest.raises(RecipeError, match=r"speed \(NOT_FOUND\), input_int_register_24 \(IN_USE\)"):
        rtde.parse_recipe(
            b"\x00NOT_FOUND,IN_USE,DOUBLE", ["speed", "input_int_register_24", "input_double_register_24"]
        )
    with pytest.raises(RecipeError, match="1 types for 2 variables"):
        rtde.parse_recipe(b"\x01DOUBLE", ["one", "two"])


@given(st.text(max_size=300), st.text(max_size=300), st.sampled_from(Severity))
def test_text_messages_survive_their_encoding(text: str, source: str, severity: Severity) -> None:
    (received,) = PackageReader().feed(rtde.text_message(TextMessage(text, source, severity)))
    parsed = rtde.parse_text_message(received.payload)
    assert parsed.severity is severity
    if len(text.encode()) < 256:
        assert parsed.text == text


def test_the_series_of_the_controller_gives_its_control_frequency() -> None:
    cb3 = rtde.parse_version(struct.pack(">IIII", 3, 15, 8, 1))
    e_series = rtde.parse_version(struct.pack(">IIII", 5, 15, 0, 1))
    assert (cb3.frequency_hz, e_series.frequency_hz) == (125.0, 500.0)
    assert str(e_series) == "5.15.0.1"


@pytest.mark.parametrize(
    ("version", "is_supported"),
    [
        ((3, 10, 0, 1), True), ((3, 15, 8, 1), True), ((5, 4, 0, 1), True), ((5, 21, 0, 1), True),
        ((3, 9, 1, 1), False), ((5, 3, 9, 1), False), ((1, 8, 0, 1), False), ((4, 20, 0, 1), False),
        ((10, 7, 0, 1), False), ((0, 0, 0, 0), False),
    ],
)  # fmt: skip
def test_versions_for_which_the_driver_is_not_made_are_known(
    version: tuple[int, ...], is_supported: bool
) -> None:
    assert rtde.parse_version(struct.pack(">IIII", *version)).is_supported == is_supported
