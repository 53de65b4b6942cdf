"""How a Task lives: legal moves, and which news counts."""

from datetime import UTC, datetime, timedelta

from hypothesis import given
from hypothesis import strategies as st

from handover.tasks.task_life import FINISHED, is_legal, is_news, is_reachable, performers_of, type_of
from handover_datamodels.entities import Task, TaskStatus

NOON = datetime(2026, 1, 1, 12, tzinfo=UTC)
statuses = st.sampled_from(list(TaskStatus))


def a_task(status: TaskStatus, at_s: float | None = 0) -> Task:
    observed = {} if at_s is None else {"observedAt": (NOON + timedelta(seconds=at_s)).isoformat()}
    return Task.from_ngsild(
        {
            "id": "urn:ngsi-ld:Task:demo:t",
            "type": "Task",
            "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:d"},
            "status": {"type": "Property", "value": status.value, **observed},
        }
    )


@given(statuses, statuses, st.floats(-5, 5))
def test_a_finished_task_never_reopens(end: TaskStatus, later: TaskStatus, at_s: float) -> None:
    if end in FINISHED:
        assert not is_legal(end, later)
        assert not is_news(a_task(end), a_task(later, at_s))


@given(statuses, statuses, st.floats(-1e6, 1e6))
def test_clocks_that_differ_refuse_nothing(known: TaskStatus, seen: TaskStatus, at_s: float) -> None:
    same_or_later = known is seen or is_reachable(known, seen)
    assert is_news(a_task(known), a_task(seen, at_s)) is (same_or_later and known not in FINISHED)


def test_an_observer_may_have_missed_steps() -> None:
    assert is_news(a_task(TaskStatus.PENDING), a_task(TaskStatus.COMPLETED, 1))
    assert is_reachable(TaskStatus.PENDING, TaskStatus.PAUSED)


@given(statuses)
def test_nothing_becomes_pending_again(status: TaskStatus) -> None:
    assert not is_reachable(status, TaskStatus.PENDING)


def test_a_task_is_paused_and_goes_on() -> None:
    assert is_legal(TaskStatus.IN_PROGRESS, TaskStatus.PAUSED)
    assert is_legal(TaskStatus.PAUSED, TaskStatus.IN_PROGRESS)
    assert not is_legal(TaskStatus.PAUSED, TaskStatus.COMPLETED)


def test_the_first_observation_of_a_task_is_accepted_also_without_a_time() -> None:
    assert is_news(None, a_task(TaskStatus.PENDING))
    assert is_news(a_task(TaskStatus.PENDING, None), a_task(TaskStatus.ASSIGNED, None))


def test_materials_and_assets_perform_nothing() -> None:
    robot, person = "urn:ngsi-ld:Device:demo:ur10-1", "urn:ngsi-ld:Person:demo:ann"
    part, tool = "urn:ngsi-ld:Material:demo:gear-1", "urn:ngsi-ld:Asset:demo:hammer"
    assert performers_of([part, robot, tool, person]) == [robot, person]
    assert performers_of([part, tool]) == []
    assert type_of(part) == "Material"
    assert type_of("urn:epc:id:sgtin:1") is None
