"""An id says of which cell an entity is; what has another form is of none."""

import re

import pytest
import re2
from hypothesis import example, given
from hypothesis import strategies as st

from handover.cells import cell_of, ids_without
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


@given(others=st.sets(similar | names, min_size=1, max_size=8), entity=ids)
@example(others={"a", "ab"}, entity="urn:ngsi-ld:Task:ab:1")
@example(others={"a", "ab"}, entity="urn:ngsi-ld:Task:abb:1")
def test_a_pattern_selects_what_is_of_no_other_cell(others: set[str], entity: str) -> None:
    pattern = ids_without(others) or ""
    for compile_pattern in (re.compile, re2.compile):  # of brokers; the latter has no lookahead
        selected = compile_pattern(pattern).search(entity) is not None
        assert selected is (cell_of(entity) not in others)


def test_alone_in_a_tenant_no_pattern_is_needed() -> None:
    assert ids_without(set()) is None


@pytest.mark.parametrize(("count", "selects_by_id"), [(50, True), (5000, False)])
def test_a_pattern_stays_short(count: int, selects_by_id: bool) -> None:
    pattern = ids_without({f"plant-{number * 7919 % 100_003}.line" for number in range(count)})
    assert (pattern is not None) is selects_by_id
