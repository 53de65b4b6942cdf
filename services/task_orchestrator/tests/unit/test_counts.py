"""Counts: what is counted for one process is what the database counts for all of them."""

from collections.abc import Iterator
from dataclasses import replace
from datetime import timedelta
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlalchemy import delete

from handover.database import connect
from handover_datamodels.entities import TaskStatus
from handover_processes.process.tally import count_end, count_start, count_task
from handover_processes.records.processes import ProcessRecord
from handover_processes.records.step import Step
from handover_processes.records.tasks import TaskRecord
from handover_processes.storage import schema
from handover_processes.storage.counts import (
    ElementCount,
    PeriodCount,
    VersionCount,
    count_elements,
)
from handover_processes.storage.store import Store
from services.task_orchestrator.tests.unit.drawing import NOW

PROCESS = ProcessRecord(
    id="p-0",
    definition="p",
    version=2,
    key=None,
    status=TaskStatus.IN_PROGRESS,
    parameters={},
    variables={},
    waiting=(),
    reason=None,
    started_at=NOW,
    ended_at=None,
    revision=1,
    state=None,
)


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def store(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Store]:
    url = f"sqlite:///{tmp_path_factory.mktemp('counts') / 'counts.db'}"
    if request.param == "postgresql":
        url = request.getfixturevalue("new_database")()
    store = Store(connect(url))
    store.migrate()
    yield store
    store.close()


def task(
    n: int, element: str, status: str, took_ms: int = 0, *, process: str = "p-0", **more: Any
) -> TaskRecord:
    state = TaskStatus(status)
    over = state in {TaskStatus.COMPLETED, TaskStatus.FAILED}
    return TaskRecord(
        id=f"urn:ngsi-ld:Task:demo:{process}-{element}-{n}",
        process=process,
        element=element,
        visit=n,
        token="t",
        status=state,
        observed_at=NOW,
        moves=0,
        created_at=NOW,
        deadline=NOW,
        ended_at=NOW + timedelta(milliseconds=took_ms) if over else None,
        **more,
    )


def test_counts_have_completed_and_failed_tasks_and_their_duration() -> None:
    listed = [
        task(1, "scan", "completed", 4000),
        task(2, "scan", "completed", 1000),
        task(3, "scan", "failed", 9000),
        task(4, "scan", "inProgress"),
        task(1, "pick", "failed", 9000, cancelled_at=NOW),
        task(2, "pick", "assigned", cancelled_at=NOW),
        task(1, "place", "pending"),
    ]
    assert count_elements(listed) == {
        "scan": ElementCount(running=1, completed=2, failed=1, last_ms=4000, median_ms=2500),
        "pick": ElementCount(),
        "place": ElementCount(running=1),
    }


TASKS = st.lists(
    st.builds(
        dict,
        element=st.sampled_from(["scan", "pick"]),
        status=st.sampled_from([status.value for status in TaskStatus]),
        took_ms=st.integers(0, 50),
        process=st.sampled_from(["p-0", "p-1"]),
        cancelled_at=st.sampled_from([None, None, NOW]),
    ),
    max_size=14,
)


def write(store: Store, processes: list[ProcessRecord], listed: list[TaskRecord]) -> None:
    """Write processes and their Tasks as a step does that has brought them to their states."""
    with store.engine.begin() as connection:
        for table in (schema.tasks, schema.processes, schema.statistics):
            connection.execute(delete(table))
    step = Step(1, tasks={each.id: each for each in listed})
    step.processes = {each.id: each for each in processes}
    step.new = {*step.tasks, *step.processes}
    for process in processes:
        count_start(step, process)
        if process.ended_at is not None:
            count_end(step, process)
    for each in listed:
        count_task(step, step.processes[each.process], each)
    store.write(step)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(drawn=TASKS)
def test_the_statistics_count_as_the_tasks_do(store: Store, drawn: list[dict[str, Any]]) -> None:
    listed = [task(n, **values) for n, values in enumerate(drawn)]
    write(store, [replace(PROCESS, id=name) for name in ("p-0", "p-1")], listed)
    found = store.counts("p", 2, NOW + timedelta(minutes=1))
    assert (found.running, found.completed, found.failed) == (2, 0, 0)
    for element, expected in count_elements(listed).items():
        counted = found.elements.get(element, ElementCount())
        assert replace(counted, median_ms=None) == replace(expected, median_ms=None)
        assert (counted.median_ms is None) is (expected.median_ms is None)
        times = sorted(each.took_ms or 0 for each in listed if each.element == element and is_completed(each))
        if times:
            middle = times[-(-len(times) // 2) - 1]
            assert counted.median_ms == pytest.approx(middle, rel=0.0906, abs=1)


def is_completed(each: TaskRecord) -> bool:
    return each.status is TaskStatus.COMPLETED


def test_other_versions_and_definitions_are_not_counted(store: Store) -> None:
    others = [
        PROCESS,
        replace(PROCESS, id="p-1", status=TaskStatus.COMPLETED, ended_at=NOW),
        replace(PROCESS, id="p-2", status=TaskStatus.FAILED, ended_at=NOW),
        replace(PROCESS, id="p-3", version=1),
        replace(PROCESS, id="q-1", definition="q"),
    ]
    write(store, others, [task(1, "scan", "completed", 5, process=other.id) for other in others])
    counts = store.counts("p", 2, NOW)
    assert (counts.running, counts.completed, counts.failed) == (1, 1, 1)
    assert counts.elements == {"scan": ElementCount(completed=3, last_ms=5, median_ms=5)}
    assert store.counts("p", 7, NOW) == VersionCount(0, 0, 0, {})


def test_the_counts_of_a_period_begin_at_its_minute(store: Store) -> None:
    begun = NOW.replace(minute=20)
    ended = [
        replace(PROCESS, id=f"ended-{minutes}", status=status, started_at=begun, ended_at=at)
        for minutes, status in (
            (0, TaskStatus.COMPLETED),
            (10, TaskStatus.COMPLETED),
            (11, TaskStatus.FAILED),
            (60, TaskStatus.COMPLETED),
            (300, TaskStatus.COMPLETED),
            (301, TaskStatus.FAILED),
        )
        for at in [begun + timedelta(minutes=minutes)]
    ]
    write(store, [PROCESS, *ended], [])
    now = begun + timedelta(minutes=400)
    counts = store.counts_since(begun + timedelta(minutes=5), now)
    assert (counts.running, counts.completed, counts.failed) == (1, 3, 2)
    assert counts.median_ms == 60 * 60_000
    assert store.counts_since(NOW.replace(minute=0), now).completed == 4
    for first, last in ((0, 10), (0, 11), (5, 15), (5, 61), (0, 41), (11, 301), (300, 302)):
        counts = store.counts_since(begun + timedelta(minutes=first), now, begun + timedelta(minutes=last))
        at = [process.ended_at for process in ended if process.status is TaskStatus.COMPLETED]
        within = [moment for moment in at if first * 60 <= (moment - begun).total_seconds() < last * 60]
        assert counts.completed == len(within), (first, last)
    assert store.counts_since(NOW.replace(year=2999), now) == PeriodCount(1, 0, 0, None)
