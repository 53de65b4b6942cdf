"""Temporal queries and provided evolutions: any input is parsed or refused."""

from collections.abc import Callable
from typing import Any, TypeVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem
from handover_broker.model.validation import MICROS
from handover_broker.temporal.evolution_parser import parse_evolution
from handover_broker.temporal.history import SCOPE, RowContent
from handover_broker.temporal.query import TemporalQuery, temporal_query
from handover_datamodels.contexts import HANDOVER_URL, TermMap

TERMS = TermMap(HANDOVER_URL)
TIMES = st.sampled_from(
    ["2026-01-01T00:00:00Z", "2026-01-01T00:00:00.5Z", "0001-01-01T00:00:00Z", "noon", ""]
)
PARAMETERS = st.fixed_dictionaries(
    {},
    optional={
        "timerel": st.sampled_from(["before", "after", "between", "during"]),
        "timeAt": TIMES,
        "endTimeAt": TIMES,
        "timeproperty": st.sampled_from(["observedAt", "createdAt", "modifiedAt", "deletedAt", "now"]),
        "lastN": st.sampled_from(["1", "0", "-1", "99999999999", "٣", ""]),
        "aggrMethods": st.sampled_from(["avg", "avg,max", "median", ""]),
        "aggrPeriodDuration": st.sampled_from(["PT1H", "P1M", "PT0S", "1h", ""]),
    },
)


Read = TypeVar("Read")


def read(act: Callable[[], Read]) -> Read | None:
    """Return the parsed input; None if it was refused with a reason. Anything else is a defect."""
    try:
        return act()
    except Problem as problem:
        if problem.status == 400 and problem.detail:
            return None
        raise


@given(PARAMETERS, st.booleans())
def test_any_temporal_query_is_parsed_or_refused(parameters: dict[str, str], aggregates: bool) -> None:
    query = read(lambda: temporal_query(parameters, aggregates=aggregates))
    if query is None:
        return
    condition, values = query.condition()
    assert condition.count("?") == len(values)
    assert (query.start is None) is (parameters.get("timerel") in {None, "before"})
    assert (query.end is None) is (parameters.get("timerel") in {None, "after"})


MEMBERS = st.sampled_from(["type", "value", "object", "observedAt", "datasetId", "languageMap", "x"])
PLAIN = (
    st.none()
    | st.booleans()
    | st.integers(-3, 3)
    | st.sampled_from(
        [
            "Property",
            "Relationship",
            "LanguageProperty",
            "urn:ngsi-ld:null",
            "urn:x:1",
            "2026-01-01T00:00:00Z",
            "/a",
            "a",
        ]
    )
)
ANYTHING = st.recursive(
    PLAIN,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(MEMBERS, inner, max_size=4),
    max_leaves=12,
)


@given(ANYTHING, ANYTHING)
def test_any_temporal_input_is_stored_or_refused(attribute: Any, scope: Any) -> None:
    document = {"id": "urn:x:1", "type": "Car", "speed": attribute, "scope": scope}
    provided = read(lambda: parse_evolution(document, TERMS))
    if provided is None:
        return
    assert isinstance(provided.scopes, tuple)
    stamped = provided.stamped("2026-01-01T00:00:00.000000Z").attributes
    change = RowContent({name: [*several] for name, several in stamped.items()})
    kept = RowContent.restored(change.stored())
    instances = list(kept.instances(0))
    assert len(instances) == sum(len(several) for several in provided.attributes.values())
    assert all(one["createdAt"] == one["modifiedAt"] for _, _, one in instances)
    for name, position, _ in instances:
        assert kept.without(name, position)
        assert not kept.without(name, position)
    assert kept.is_empty()


def test_a_list_of_instances_is_several_and_a_list_of_values_is_one() -> None:
    document = {
        "speed": [{"value": 1}, {"value": 2}, {"type": "Property", "value": 3}],
        "sizes": [1, 2, 3],
        "scope": [{"type": "Property", "value": ["/a", "/b"]}, {"value": "/c"}],
    }
    provided = parse_evolution(document, TERMS)
    found = {
        TERMS.compact(name): [one["value"] for one in several]
        for name, several in provided.attributes.items()
    }
    assert found == {"speed": [1, 2, 3], "sizes": [[1, 2, 3]], "scope": [["/a", "/b"], "/c"]}
    assert provided.scopes == ("/c",)
    assert SCOPE in provided.attributes


@pytest.mark.parametrize(
    ("relation", "inside"),
    [("before", [0, 9]), ("after", [10, 11, 19, 20, 21]), ("between", [10, 11, 19])],
)
def test_start_and_end_of_a_range(relation: str, inside: list[int]) -> None:
    start, end = {"before": (None, 10), "after": (10, None), "between": (10, 20)}[relation]
    query = TemporalQuery(
        relation,
        None if start is None else start * MICROS,
        None if end is None else end * MICROS,
        "observedAt",
    )
    seconds = [0, 9, 10, 11, 19, 20, 21]
    found = [s for s in seconds if query.time_of({"observedAt": f"1970-01-01T00:00:{s:02}Z"}) is not None]
    assert found == inside


def test_without_a_range_each_instance_has_its_own_time() -> None:
    query = TemporalQuery()
    assert (
        query.time_of({"observedAt": "1970-01-01T00:00:01Z", "modifiedAt": "1970-01-01T00:00:02Z"}) == MICROS
    )
    assert query.time_of({"modifiedAt": "1970-01-01T00:00:02.5Z"}) == 2.5 * MICROS
    assert query.time_of({"deletedAt": "1970-01-01T00:00:02Z"}) is None
