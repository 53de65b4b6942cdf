"""Process filter: what SQL selects is what the same filter selects of the records."""

import operator
from collections.abc import Mapping
from datetime import timedelta
from typing import Any

import orjson
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from sqlalchemy import delete

from handover.errors import Problem
from handover_datamodels.entities import TaskStatus
from handover_processes.records.processes import IncidentRecord
from handover_processes.records.step import Step
from handover_processes.storage import schema
from handover_processes.storage.process_filter import ProcessFilter, read_condition
from handover_processes.storage.store import Store
from services.task_orchestrator.tests.unit.drawing import NOW
from services.task_orchestrator.tests.unit.test_tally import ROBOT, as_new, process, store, task

__all__ = ["store"]

VALUES: tuple[Any, ...] = (
    *(0, 1, -3, 2.5, 1e20, "1", "Acme", "acme ltd", "", "a'b\"c", "50 %"),
    *("nul\0", "\0\0", "no \\u0000", True, False, None),
    *([1], {"total": 5}, {"total": "5"}, {"total": None}),
)
COMPARE = {
    "=": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


def is_met(condition: str, variables: Mapping[str, Any]) -> bool:
    """Evaluate a condition as the documentation says it."""
    wanted = read_condition(condition)
    value: Any = variables
    for part in wanted.path:
        if not isinstance(value, Mapping) or part not in value:
            return False
        value = value[part]
    if wanted.operator is None:
        return True
    if wanted.operator == "~":
        return isinstance(value, str) and "\0" not in value and str(wanted.value).lower() in value.lower()
    kinds = [type_ for type_ in (bool, int | float, str, type(None)) if isinstance(wanted.value, type_)]
    is_same_kind = isinstance(value, kinds[0]) and isinstance(value, bool) == isinstance(wanted.value, bool)
    if not is_same_kind or (isinstance(value, str) and "\0" in value):
        return wanted.operator == "!="
    return bool(COMPARE[wanted.operator](value, wanted.value))


CONDITIONS = (
    *("a", "a=1", 'a="1"', "a!=1", "a>0", "a<=2.5", "a>=1e20", "a=Acme", "a!=Acme", "a~ACME", "a~%", "a~_"),
    *("a=true", "a!=true", "a=false", "a=null", "a!=null", "a.total", "a.total=5", 'a.total>="5"', "b=1"),
    *("a=", "a~'b\"", "a>Acme"),
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow], max_examples=10)
@example(values=list(VALUES))
@given(values=st.lists(st.sampled_from(VALUES), min_size=1, max_size=12))
def test_conditions_on_variables_select_the_same_on_both_databases(store: Store, values: list[Any]) -> None:
    with store.engine.begin() as connection:
        for table in (schema.tasks, schema.processes):
            connection.execute(delete(table))
    records = [process(number, variables={"a": value}) for number, value in enumerate(values)]
    store.write(as_new(*records, process(99)))
    for written in CONDITIONS:
        found = store.page(ProcessFilter(variables=[read_condition(written)]))
        wanted = {each.id for each in records if is_met(written, orjson.loads(orjson.dumps(each.variables)))}
        assert {each.id for each in found} == wanted, written


@pytest.mark.parametrize("written", ["", "=1", "a b=1", "a>true", "a<=null", "1a=2", "a\0=1", "a..b=1"])
def test_bad_conditions_are_refused(written: str) -> None:
    with pytest.raises(Problem) as refused:
        read_condition(written)
    assert refused.value.status == 422


@pytest.fixture
def filled(store: Store) -> Store:
    with store.engine.begin() as connection:
        for table in reversed(schema.processes.metadata.sorted_tables):
            connection.execute(delete(table))
    incident = IncidentRecord("1", "call.grip", "Grip", "jammed", NOW)
    step = Step(1)
    for number in range(12):
        record = process(
            number,
            started_at=NOW + timedelta(hours=number),
            status=TaskStatus.COMPLETED if number % 3 == 0 else TaskStatus.IN_PROGRESS,
            ended_at=NOW + timedelta(hours=number + 1) if number % 3 == 0 else None,
            key=f"order {number}",
            version=1 + number % 2,
            waiting=("scan",) if number % 3 else (),
            incidents=(incident,) if number in {4, 5} else (),
        )
        step.processes[record.id] = record
        step.new.add(record.id)
        if number % 4 == 0:
            listed = task(number, "scan", record.id, record.started_at)
            step.tasks[listed.id] = listed
            step.new.add(listed.id)
    store.write(step)
    return store


@pytest.mark.parametrize(
    ("wanted", "numbers"),
    [
        (ProcessFilter(key="order 3"), [3]),
        (ProcessFilter(search="ORDER 1"), [11, 10, 1]),
        (ProcessFilter(definition="p", version=1, status="completed"), [6, 0]),
        (ProcessFilter(definition="q"), []),
        (ProcessFilter(resource=ROBOT), [8, 4, 0]),
        (ProcessFilter(resource=ROBOT, status="completed"), [0]),
        (ProcessFilter(has_incident=True), [5, 4]),
        (ProcessFilter(has_incident=True, element="call"), [5, 4]),
        (ProcessFilter(has_incident=True, element="scan"), []),
        (ProcessFilter(has_incident=False, element="scan", version=2), [11, 7, 1]),
        (
            ProcessFilter(started_since=NOW + timedelta(hours=9), started_until=NOW + timedelta(hours=11)),
            [10, 9],
        ),
        (ProcessFilter(ended_since=NOW + timedelta(hours=7)), [9, 6]),
        (ProcessFilter(ended_until=NOW + timedelta(hours=7)), [3, 0]),
    ],
)
def test_processes_are_filtered(filled: Store, wanted: ProcessFilter, numbers: list[int]) -> None:
    assert [record.id for record in filled.page(wanted)] == [f"p-{number}" for number in numbers]


def test_filtered_pages_follow_each_other(filled: Store) -> None:
    wanted, found, before = ProcessFilter(resource=ROBOT), [], None
    while page := filled.page(wanted, before=before, limit=2):
        found += [record.id for record in page]
        before = found[-1]
    assert found == ["p-8", "p-4", "p-0"]
