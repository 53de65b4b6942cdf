"""Metrics: a Task is counted once; the way from a hand to a robot is measured by the performers' clocks."""

from datetime import datetime, timedelta
from typing import Any

import pytest
from prometheus_client import REGISTRY

from handover_datamodels.entities import TaskStatus
from handover_processes import metrics
from handover_processes.records.step import Step
from handover_processes.records.tasks import Move, TaskRecord
from services.task_orchestrator.tests.unit.drawing import NOW

HAND = {"commandId": 3, "gesture": "Thumbs up"}
ROBOT = {"operation": "pick"}


def task(name: str, status: TaskStatus, asked: dict[str, Any], **more: Any) -> TaskRecord:
    return TaskRecord(
        id=name,
        process="p-1",
        element=name,
        visit=1,
        token=name,
        status=status,
        observed_at=NOW,
        moves=1,
        created_at=more.pop("created_at", NOW),
        deadline=NOW + timedelta(minutes=5),
        entity={"workParameters": {"type": "Property", "value": asked}},
        **more,
    )


def moved(record: TaskRecord, at: datetime) -> Step:
    step = Step(1)
    step.tasks[record.id] = record
    step.moves.append(Move(record.id, record.moves, record.status, at, at))
    return step


def confirmed(**outputs: Any) -> TaskRecord:
    return task("confirm", TaskStatus.COMPLETED, HAND, outputs={"by": "gesture", **outputs})


def measured() -> tuple[float, float]:
    name = "handover_orchestrator_hold_to_robot_seconds"
    return (REGISTRY.get_sample_value(f"{name}_count") or 0, REGISTRY.get_sample_value(f"{name}_sum") or 0)


def test_the_time_from_a_held_gesture_to_the_robot_is_measured() -> None:
    count, total = measured()
    timer = metrics.HandoverTimer()
    timer.observe(moved(confirmed(), NOW))
    timer.observe(moved(task("pick", TaskStatus.ASSIGNED, ROBOT), NOW + timedelta(seconds=0.1)))
    timer.observe(moved(task("pick", TaskStatus.IN_PROGRESS, ROBOT), NOW + timedelta(seconds=0.25)))
    assert measured() == (count + 1, pytest.approx(total + 0.25))
    timer.observe(moved(task("place", TaskStatus.IN_PROGRESS, ROBOT), NOW + timedelta(seconds=9)))
    assert measured()[0] == count + 1, "the robot's second Task does not follow a gesture"


def test_a_button_on_the_screen_and_a_next_task_for_a_person_are_not_measured() -> None:
    count, _ = measured()
    timer = metrics.HandoverTimer()
    timer.observe(moved(confirmed(by="screen"), NOW))
    timer.observe(moved(task("pick", TaskStatus.IN_PROGRESS, ROBOT), NOW + timedelta(seconds=1)))
    timer.observe(moved(confirmed(), NOW))
    timer.observe(moved(task("again", TaskStatus.IN_PROGRESS, HAND), NOW + timedelta(seconds=1)))
    timer.observe(moved(task("pick", TaskStatus.IN_PROGRESS, ROBOT), NOW + timedelta(seconds=2)))
    assert measured()[0] == count


def test_a_clock_that_is_behind_makes_no_negative_time() -> None:
    count, total = measured()
    timer = metrics.HandoverTimer()
    timer.observe(moved(confirmed(), NOW))
    timer.observe(moved(task("pick", TaskStatus.IN_PROGRESS, ROBOT), NOW - timedelta(seconds=1)))
    assert measured() == (count + 1, total)


def test_a_process_that_has_ended_is_forgotten() -> None:
    count, _ = measured()
    timer = metrics.HandoverTimer()
    last = moved(confirmed(), NOW)
    last.ended.add("p-1")
    timer.observe(last)
    timer.observe(moved(task("pick", TaskStatus.IN_PROGRESS, ROBOT), NOW + timedelta(seconds=1)))
    assert measured()[0] == count


def test_open_tasks_are_shown_by_state_and_age() -> None:
    open_tasks = [
        task("a", TaskStatus.PENDING, ROBOT, created_at=NOW - timedelta(seconds=90)),
        task("b", TaskStatus.PENDING, ROBOT, created_at=NOW - timedelta(seconds=30)),
        task("c", TaskStatus.IN_PROGRESS, HAND, created_at=NOW - timedelta(seconds=5)),
    ]
    metrics.register_open_tasks(lambda: open_tasks, lambda: NOW)

    def shown(name: str, status: TaskStatus) -> float | None:
        return REGISTRY.get_sample_value(f"handover_orchestrator_{name}", {"status": status.value})

    assert shown("tasks_open", TaskStatus.PENDING) == 2
    assert shown("oldest_task_age_seconds", TaskStatus.PENDING) == 90
    assert shown("tasks_open", TaskStatus.IN_PROGRESS) == 1
    assert shown("oldest_task_age_seconds", TaskStatus.IN_PROGRESS) == 5
    open_tasks.clear()
    assert shown("tasks_open", TaskStatus.PENDING) == 0
    assert shown("oldest_task_age_seconds", TaskStatus.PENDING) == 0


def test_an_ended_task_is_counted() -> None:
    def ended() -> float:
        return REGISTRY.get_sample_value("handover_orchestrator_tasks_total", {"status": "completed"}) or 0

    before = ended()
    timer = metrics.HandoverTimer()
    timer.observe(moved(task("pick", TaskStatus.IN_PROGRESS, ROBOT), NOW))
    timer.observe(moved(task("pick", TaskStatus.COMPLETED, ROBOT), NOW))
    assert ended() == before + 1
