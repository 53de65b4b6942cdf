"""Views: a process as people look at it over HTTP."""

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from datamodels.times import iso
from services.task_orchestrator.records import Move, ProcessRecord, TaskRecord
from services.task_orchestrator.settings import OrchestratorSettings
from services.task_orchestrator.store import Store


def process_summary(settings: OrchestratorSettings, record: ProcessRecord) -> dict[str, Any]:
    """Return a process in a line."""
    return {
        "id": record.id,
        "entity": settings.entity_id("Process", record.id),
        "definition": record.definition,
        "version": record.version,
        "key": record.key,
        "status": record.status.value,
        "reason": record.reason,
        "startedAt": iso(record.started_at),
        "endedAt": _iso(record.ended_at),
        "waiting": list(record.waiting),
    }


def process_view(settings: OrchestratorSettings, store: Store, process_id: str) -> dict[str, Any] | None:
    """Return all there is to see of a process; None if there is no such process."""
    records = store.processes(ids=[process_id])
    if not records:
        return None
    moves: dict[str, list[Move]] = {}
    for move in store.moves(process_id):
        moves.setdefault(move.task, []).append(move)
    return {
        **process_summary(settings, records[0]),
        "parameters": records[0].parameters,
        "variables": records[0].variables,
        "tasks": [_task_view(task, moves.get(task.id, [])) for task in store.tasks(process_id)],
    }


def _task_view(task: TaskRecord, moves: list[Move]) -> Mapping[str, Any]:
    return {
        "id": task.id,
        "element": task.element,
        "visit": task.visit,
        "status": task.status.value,
        "createdAt": iso(task.created_at),
        "deadline": iso(task.deadline),
        "endedAt": _iso(task.ended_at),
        "cancelled": task.cancelled_at is not None,
        "outputParameters": task.outputs,
        "history": [
            {"status": move.status.value, "at": iso(move.observed_at or move.heard_at)} for move in moves
        ],
    }


def _iso(moment: datetime | None) -> str | None:
    return None if moment is None else iso(moment)
