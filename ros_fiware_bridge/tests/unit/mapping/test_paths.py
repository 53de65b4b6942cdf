"""Paths: parsing and reading."""

import contextlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_ros.mapping import paths
from handover_ros.mapping.paths import Each, FieldStep, Index, InvalidPath, MissingValue, Path, Where

JOINTS = {
    "header": {"stamp": {"sec": 5, "nanosec": 0}, "frame_id": "base"},
    "name": ["elbow_joint", "wrist.1"],
    "position": np.array([0.5, 1.5]),
}
TREE = {"transforms": [{"child": "tool0", "z": 1}, {"child": "tool 1", "z": 2}], "name": ["a"]}

names = st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,8}", fullmatch=True)
steps = st.one_of(
    st.builds(Index, st.integers(0, 999)),
    st.builds(Where, names, st.from_regex(r"[a-z .=/0-9]{1,8}", fullmatch=True)),
)
groups = st.tuples(st.builds(FieldStep, names), st.lists(steps, max_size=2))


@given(st.lists(groups, min_size=1, max_size=5), st.booleans())
def test_a_path_round_trips(parts: list[tuple[FieldStep, list[Any]]], over: bool) -> None:
    made: list[Any] = [step for field, more in parts for step in (field, *more)]
    path = Path((*made, Each()) if over else tuple(made))
    assert paths.parse(str(path)) == path


@given(st.text(max_size=30))
def test_any_text_is_a_path_or_refused(text: str) -> None:
    read: str | None = None
    with contextlib.suppress(InvalidPath):
        read = str(paths.parse(text))
    assert read in {None, text}


@pytest.mark.parametrize(
    ("path", "message", "value"),
    [
        ("header.stamp.sec", JOINTS, 5),
        ("position[1]", JOINTS, 1.5),
        ("position[name=wrist.1]", JOINTS, 1.5),
        ("transforms[child=tool 1].z", TREE, 2),
        (".", TREE, TREE),
    ],
)
def test_a_path_reads_its_value(path: str, message: Any, value: Any) -> None:
    assert paths.getter(paths.parse(path))(message) == value


@pytest.mark.parametrize(
    ("path", "message", "why"),
    [
        ("header.seq", JOINTS, "no header.seq"),
        ("header.stamp.sec.x", JOINTS, "no header.stamp.sec.x"),
        ("position[2]", JOINTS, r"no position\[2\]: its length is 2"),
        ("position[name=shoulder]", JOINTS, "no element has name shoulder"),
        ("transforms[child=no].z", TREE, "no element has child no"),
        ("header[0]", JOINTS, r"no header\[0\]"),
    ],
)
def test_a_missing_value_is_named(path: str, message: Any, why: str) -> None:
    with pytest.raises(MissingValue, match=why):
        paths.getter(paths.parse(path))(message)


@pytest.mark.parametrize(
    "text", ["", "a..b", "a.", ".a", "a[-1]", "[0]", "a[]b", "a[][]", "9a", "a b", "a" * 201]
)
def test_an_invalid_path_is_refused(text: str) -> None:
    with pytest.raises(InvalidPath):
        paths.parse(text)


def test_a_path_with_each_is_split_at_its_element() -> None:
    split = paths.parse("status[].values[key=temp].value").split()
    assert split is not None
    assert list(map(str, split)) == ["status", "values[key=temp].value"]
    assert paths.parse("header.stamp").split() is None
