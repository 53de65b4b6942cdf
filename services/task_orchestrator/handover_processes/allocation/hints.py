"""Hints: what an activity says of people: candidates, priority, due date and follow-up date.

Hints are texts of the dialects; an expression in them is evaluated when the Task is posted.
"""

from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

from handover_bpmn.languages.base import ExpressionError, Variables
from handover_bpmn.languages.feel import read_feel
from handover_bpmn.languages.juel import read_template
from handover_bpmn.languages.times import read_datetime, read_duration, read_now, shift
from handover_bpmn.model import Activity
from handover_datamodels.numbers import MAX_INTEGER, MIN_INTEGER
from handover_processes.allocation.choice import DEFAULT_PRIORITY
from handover_processes.allocation.mapping import NameKind

HINT_KINDS: Mapping[NameKind, tuple[str, ...]] = {
    NameKind.CLASS: ("class", "delegateExpression", "expression", "connector"),
    NameKind.TOPIC: ("topic",),
    NameKind.JOB_TYPE: ("jobType",),
    NameKind.ASSIGNEE: ("assignee",),
    NameKind.CANDIDATE_GROUP: ("candidateGroups",),
}
CODE_HINTS = frozenset(HINT_KINDS[NameKind.CLASS])
"""Hints whose text is the name of code, even if it is written as an expression."""


def hint_values(activity: Activity, name: str, variables: Variables | None) -> list[str]:
    """Return the names in a hint; without `variables`, before it runs, an expression stands for itself.

    Raises `ExpressionError` that names the hint if its expression cannot be evaluated.
    """
    text = activity.hints.get(name, "").strip()
    if not text:
        return []
    value: Any = text
    if variables is not None and name not in CODE_HINTS:
        try:
            if text.startswith("="):
                value = read_feel(text).value(variables)
            elif "${" in text or "#{" in text:
                value = read_template(text).value(variables)
        except ExpressionError as error:
            raise ExpressionError(f"{name}: {error}") from None
    if isinstance(value, list):
        return [str(person).strip() for person in value if person is not None]
    if value is text and (text.startswith("=") or "${" in text or "#{" in text):
        return [text]
    is_list = name in {"candidateGroups", "candidateUsers"}
    names = str(value).split(",") if is_list else [str(value)]
    return [part.strip() for part in names if part.strip() and value is not None]


def given_priority(activity: Activity, variables: Variables) -> int | None:
    """Return the priority that the activity gives, limited to 32 bits; None if it gives none."""
    for name in ("priority", "taskPriority"):
        for text in hint_values(activity, name, variables):
            with suppress(ValueError):
                return min(max(int(text), MIN_INTEGER), MAX_INTEGER)
    return None


def priority_of(activity: Activity, variables: Variables) -> int:
    """Return the priority of an activity."""
    priority = given_priority(activity, variables)
    return DEFAULT_PRIORITY if priority is None else priority


def due_of(activity: Activity, variables: Variables, name: str = "dueDate") -> datetime | None:
    """Return the moment of a hint: a date, or a duration from now."""
    texts = hint_values(activity, name, variables)
    if not texts:
        return None
    moment = read_datetime(texts[0])
    if moment is None:
        duration = read_duration(texts[0])
        if duration is None:
            return None
        with suppress(ExpressionError):
            return shift(read_now(variables), duration)
        return None
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment


def follow_up_of(activity: Activity, variables: Variables) -> datetime | None:
    """Return the moment before which nobody needs to look at the Task."""
    return due_of(activity, variables, "followUpDate")


def candidates_of(activity: Activity, variables: Variables | None) -> dict[str, Any]:
    """Return the groups and persons that a Task of people is offered to."""
    candidates: dict[str, Any] = {
        "groups": hint_values(activity, "candidateGroups", variables),
        "users": hint_values(activity, "candidateUsers", variables),
        "assignee": next(iter(hint_values(activity, "assignee", variables)), None),
        "lane": activity.lane,
    }
    return {name: value for name, value in candidates.items() if value}
