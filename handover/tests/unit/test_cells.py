"""An id says of which cell an entity is; what has another form is of none."""

import re
from typing import Any

import pytest
import re2
from hypothesis import example, given
from hypothesis import strategies as st

from handover.broker.cells import MAX_PATTERN_LENGTH, cell_of, ids_without
from handover.settings import Settings

names = st.from_regex(r"[A-Za-z0-9_.-]{1,12}", fullmatch=True)


@given(cell=names, kind=st.sampled_from(["Task", "Device", "Alert"]), name=st.text(min_size=1, max_size=20))
def test_the_cell_is_found_in_every_id_that_the_settings_make(cell: str, kind: str, name: str) -> None:
    made = Settings(factory=cell, _env_file=None).entity_id(kind, name)
    assert cell_of(made) == (None if name.startswith("urn:") else cell)


@given(st.sampled_from(["urn:ngsi-ld:Device:lamp-1", "urn:ngsi-ld", "https://example.org/a:b:c:d:e", ""]))
def test_an_id_of_another_form_is_of_no_cell(entity: str) -> None:
    assert cell_of(entity) is None


similar = st.text("ab-.", min_size=1, max_size=4)
ids = st.one_of(
    st.builds("urn:ngsi-ld:Task:{}:{}".format, similar, st.text("ab:.", max_size=3)),
    st.builds("urn:ngsi-ld:{}".format, st.text("ab:", max_size=5)),
    st.builds(lambda length, rest: "urn:ngsi-ld:Task:a:b"[:length] + rest, st.integers(0, 20), similar),
    st.sampled_from(["https://plant.example/tasks/1", "urn:uuid:2f"]),
).filter(bool)


def matches(compile_pattern: Any, patterns: list[str], entity: str) -> bool:
    return not patterns or any(compile_pattern(pattern).search(entity) for pattern in patterns)


@given(others=st.sets(similar | names, min_size=1, max_size=8), entity=ids)
@example(others={"a", "ab"}, entity="urn:ngsi-ld:Task:ab:1")
@example(others={"a", "ab"}, entity="urn:ngsi-ld:Task:abb:1")
def test_patterns_select_what_is_of_no_other_cell(others: set[str], entity: str) -> None:
    patterns = ids_without(others)
    for compile_pattern in (re.compile, re2.compile):  # of brokers; the latter has no lookahead
        assert matches(compile_pattern, patterns, entity) is (cell_of(entity) not in others)


@pytest.mark.parametrize("form", ["cell-{:02}", "plant-{}.line", "{}-hall"])
def test_the_patterns_of_many_cells_are_short(form: str) -> None:
    many = {form.format(number * 7919 % 100_003) for number in range(60)}
    patterns = ids_without(many)
    assert len(patterns) > 1
    assert max(map(len, patterns)) <= MAX_PATTERN_LENGTH
    for name in (*many, *(other[:-1] for other in many), *(f"{other}x" for other in many), "", "line"):
        selected = matches(re2.compile, patterns, f"urn:ngsi-ld:Task:{name}:1")
        assert selected is (name not in many)


def test_without_other_cells_or_with_very_many_all_is_selected() -> None:
    assert ids_without(set()) == ids_without({f"{number * 7919 % 100_003}" for number in range(5000)}) == []
