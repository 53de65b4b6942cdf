"""Escalations: the levels of a Task that has not ended in time, and the group that may claim it as well."""

from collections.abc import Iterable, Mapping
from datetime import datetime
from typing import Any

from handover_bpmn.model import Activity, Escalation


def escalation_times(
    activity: Activity, due: datetime | None, posted_at: datetime
) -> list[tuple[datetime, Escalation | None]]:
    """Return when each level of a Task is due; the first one is its due date, if it has one."""
    since = posted_at if due is None else due
    levels: list[tuple[datetime, Escalation | None]] = [] if due is None else [(due, None)]
    for escalation in activity.escalations:
        try:
            levels.append((escalation.after.after(since), escalation))
        except OverflowError:
            break  # after the year 9999
    return levels


def due_in(entity: Mapping[str, Any]) -> datetime | None:
    """Return the due date of a Task entity."""
    due = entity.get("dueDate")
    return None if due is None else datetime.fromisoformat(due["value"]["@value"])


def with_groups(entity: Mapping[str, Any], groups: Iterable[str]) -> dict[str, Any] | None:
    """Return the attribute that lets groups claim the Task as well; None if it is not claimed by people."""
    if entity["involves"]["value"]:
        return None
    parameters = dict(entity["workParameters"]["value"])
    candidates = dict(parameters.get("candidates") or {})
    all_groups = [*candidates.get("groups", ()), *groups]
    parameters["candidates"] = {**candidates, "groups": list(dict.fromkeys(all_groups))}
    return {"workParameters": {**entity["workParameters"], "value": parameters}}
