"""Counts: what is counted for one process is what the database counts for all of them."""

from collections.abc import Iterator
from dataclasses import replace
from datetime import timedelta
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlalchemy import delete

from datamodels.entities import TaskStatus
from handover.database import connect
from services.task_orchestrator.records import ProcessRecord, Step, TaskRecord
from services.task_orchestrator.storage import schema
from services.task_orchestrator.storage.counts import ElementCount, VersionCount, count_elements
from services.task_orchestrator.storage.store import Store
from tests.unit.task_orchestrator.drawing import NOW

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


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(drawn=TASKS)
def test_the_database_counts_as_we_do(store: Store, drawn: list[dict[str, Any]]) -> None:
    engine = store._engine
    with engine.begin() as connection:
        for table in (schema.tasks, schema.processes):
            connection.execute(delete(table))
    listed = [task(n, **values) for n, values in enumerate(drawn)]
    step = Step(1, tasks={each.id: each for each in listed}, new={each.id for each in listed})
    for name in ("p-0", "p-1"):
        step.processes[name] = replace(PROCESS, id=name)
        step.new.add(name)
    store.write(step)
    assert store.counts("p", 2) == VersionCount(2, 0, 0, count_elements(listed))


def test_other_versions_and_definitions_are_not_counted(store: Store) -> None:
    with store._engine.begin() as connection:
        for table in (schema.tasks, schema.processes):
            connection.execute(delete(table))
    others = [
        PROCESS,
        replace(PROCESS, id="p-1", status=TaskStatus.COMPLETED),
        replace(PROCESS, id="p-2", status=TaskStatus.FAILED),
        replace(PROCESS, id="p-3", version=1),
        replace(PROCESS, id="q-1", definition="q"),
    ]
    listed = [task(1, "scan", "completed", 5, process=other.id) for other in others]
    step = Step(1, processes={other.id: other for other in others})
    step.tasks = {each.id: each for each in listed}
    step.new = {*step.tasks, *step.processes}
    store.write(step)
    counts = store.counts("p", 2)
    assert (counts.running, counts.completed, counts.failed) == (1, 1, 1)
    assert counts.elements == {"scan": ElementCount(completed=3, last_ms=5, median_ms=5)}
    assert store.counts("p", 7) == VersionCount(0, 0, 0, {})
