"""Views of Tasks of people, their forms, comments and history."""

from collections.abc import Mapping, Sequence
from typing import Any

from handover.messages import message_in, with_code
from handover.tasks.task_life import PASSIVE_TYPES, type_of
from handover_bpmn.forms import form
from handover_bpmn.forms.fields import Field
from handover_bpmn.forms.form_js import Resolved
from handover_bpmn.model import Activity
from handover_datamodels.times import iso
from handover_processes.allocation.choice import DEFAULT_PRIORITY
from handover_processes.deployed_forms import FormRecord, FormRegistry
from handover_processes.documents.requests import TaskListQuery
from handover_processes.documents.tasklist_responses import (
    FormField,
    FormView,
    TaskComment,
    TaskDetails,
    TaskForm,
    TaskHistoryEntry,
    TasklistEntry,
)
from handover_processes.people_acts import (
    form_of,
    is_claimable,
    is_named,
    offer_of,
    performer_of,
    requires_pin,
)
from handover_processes.records.processes import ProcessRecord
from handover_processes.records.tasks import Move, TaskAct, TaskActKind, TaskRecord

_NO_INPUTS = frozenset(
    {"description", "form", "candidates", "handlesOutcomes", "requirePin", "specification"}
)
MAX_HISTORY = 1000


def tasklist_entry(task: TaskRecord, process_name: str) -> TasklistEntry:
    """Return a Task of people as an element of a list; `process_name` is the name of its process."""
    offer, candidates = offer_of(task), _inputs(task).get("candidates")
    lane = candidates.get("lane") if isinstance(candidates, Mapping) else None
    groups = candidates.get("groups", []) if isinstance(candidates, Mapping) else []
    return {
        "id": task.id,
        "process": task.process,
        "processName": process_name,
        "element": task.element,
        "name": task.name or task.element,
        "status": task.status,
        "person": performer_of(task),
        "persons": list(offer.persons),
        "groups": list(dict.fromkeys([*groups, *([lane] if lane else [])])),
        "claimedBy": task.claimed_by,
        "declinedBy": list(task.declined_by),
        "isClaimable": is_claimable(task),
        "createdAt": iso(task.created_at),
        "dueDate": _moment(task, "dueDate"),
        "followUpDate": _moment(task, "followUpDate"),
        "priority": task.entity.get("priority", {}).get("value"),
    }


def list_order(entry: TasklistEntry) -> tuple[str, int, str, str]:
    """Return the place of a Task in lists: those that are due first come before others."""
    priority = DEFAULT_PRIORITY if entry["priority"] is None else entry["priority"]
    return entry["dueDate"] or "9", -priority, entry["createdAt"], entry["id"]


def is_listed(entry: TasklistEntry, query: TaskListQuery, key: str | None) -> bool:
    """Return whether a Task of a process with the business key `key` meets the conditions of a list."""
    claimed_by, assignee = entry["claimedBy"], query.assignee
    if query.claimed_by is not None and claimed_by != query.claimed_by:
        return False
    if query.group is not None and query.group not in entry["groups"]:
        return False
    if assignee is not None and not is_named(
        assignee, [*entry["persons"], *([claimed_by] if claimed_by else [])]
    ):
        return False
    texts = (entry["name"], entry["id"], entry["element"], entry["processName"], key or "")
    return query.search is None or any(query.search.casefold() in text.casefold() for text in texts)


def task_details(
    task: TaskRecord,
    process: ProcessRecord,
    title: str,
    activity: Activity | None,
    *,
    process_name: str,
    resolved: TaskForm | None,
    acts: Sequence[TaskAct],
    history: Sequence[TaskHistoryEntry],
) -> TaskDetails:
    """Return a Task of people with all details."""
    inputs = _inputs(task)
    described = inputs.get("description")
    drawn = None if activity is None else activity.description
    return {
        **tasklist_entry(task, process_name),
        "processTitle": title,
        "processKey": process.key,
        "definition": process.definition,
        "version": process.version,
        "description": described if isinstance(described, str) else drawn,
        "deadline": iso(task.deadline) if "deadline" in task.entity else None,
        "requirePin": requires_pin(task),
        "endedAt": None if task.ended_at is None else iso(task.ended_at),
        "inputs": {
            **_used(task),
            **{name: value for name, value in inputs.items() if name not in _NO_INPUTS},
        },
        "inputsSchema": None if activity is None else activity.inputs_schema,
        "outputs": None if task.outputs is None else dict(task.outputs),
        "form": resolved,
        "comments": [comment_view(act) for act in acts if act.kind is TaskActKind.COMMENT],
        "history": list(history),
    }


def _inputs(task: TaskRecord) -> Mapping[str, Any]:
    inputs: Mapping[str, Any] = task.entity["workParameters"]["value"]
    return inputs


def _used(task: TaskRecord) -> dict[str, list[str]]:
    """Return the names of the Materials and Assets that a Task uses, by type in lower case."""
    paths: dict[str, list[str]] = {}
    for link in task.entity["involves"]["value"]:
        type_ = type_of(link["object"])
        if type_ in PASSIVE_TYPES:
            paths.setdefault(f"{type_.lower()}s", []).append(link["object"].rpartition(":")[2])
    return paths


def _moment(task: TaskRecord, name: str) -> str | None:
    attribute = task.entity.get(name)
    return None if attribute is None else str(attribute["value"]["@value"])


def resolved_form(task: TaskRecord, forms: FormRegistry, data: Mapping[str, Any]) -> TaskForm | None:
    """Return the form of a Task for `data`; None if it has none."""
    name, version, schema = form_of(task, forms)
    if name is None and schema is None:
        return None
    resolved = Resolved((), is_dynamic=False) if schema is None else form.resolve(schema, data)
    return form_view(name, version, resolved)


def form_view(name: str | None, version: int | None, resolved: Resolved) -> TaskForm:
    """Return a form with its fields."""
    return {
        "id": name,
        "version": version,
        "isDynamic": resolved.is_dynamic,
        "fields": [field_view(field) for field in resolved.fields],
    }


def field_view(field: Field) -> FormField:
    """Return a field of a form."""
    return {
        "path": field.path,
        "kind": field.kind,
        "label": field.label,
        "hint": field.hint,
        "isRequired": field.is_required,
        "isReadOnly": field.is_read_only,
        "initial": field.initial,
        "options": [{"value": option.value, "label": option.label} for option in field.options],
        "minimum": field.minimum,
        "maximum": field.maximum,
        "minLength": field.min_length,
        "maxLength": field.max_length,
        "pattern": field.pattern,
        "textFormat": field.text_format,
        "decimals": field.decimals,
        "unit": field.unit,
        "isText": field.is_text,
        "fields": [field_view(inner_field) for inner_field in field.fields],
        "columns": [{"key": key, "label": label} for key, label in field.columns],
    }


def comment_view(act: TaskAct) -> TaskComment:
    """Return a comment."""
    return {
        "id": act.id,
        "task": act.task,
        "by": act.by,
        "verified": act.verified,
        "at": iso(act.at),
        "text": act.text or "",
    }


def task_history(
    task: TaskRecord, earlier: Sequence[TaskRecord], moves: Sequence[Move], acts: Sequence[TaskAct]
) -> list[TaskHistoryEntry]:
    """Return what became of a Task, the earliest first; `earlier` are those that others have declined."""
    declines = {act.task: act for act in acts if act.kind is TaskActKind.DECLINE}
    entries = [
        entry
        for earlier_task in earlier
        for entry in _declined_by_performer(earlier_task, declines.get(earlier_task.id))
    ]
    offer = offer_of(task)
    offered: TaskHistoryEntry = {
        **_entry(iso(task.created_at), "offered"),
        "offeredTo": [*offer.persons, *offer.groups],
    }
    if task.allocated is not None:
        offered |= with_code("text", task.allocated)  # type: ignore[typeddict-item]  # a text and its code
    entries += [_entry(iso(task.created_at), "created"), offered]
    later = [*map(_move_entry, moves)]
    own = [act for act in acts if act.task == task.id]
    later += [_act_entry(act) for act in own if act.kind is not TaskActKind.COMMENT]
    later.sort(key=lambda entry: (entry["at"], entry["kind"] == "status"))
    return [*entries, *later][-MAX_HISTORY:]


def _move_entry(move: Move) -> TaskHistoryEntry:
    return {**_entry(iso(move.received_at), "status"), "status": move.status}


def _act_entry(act: TaskAct) -> TaskHistoryEntry:
    return {**_entry(iso(act.at), act.kind.value), "by": act.by, "verified": act.verified, "text": act.text}


def _declined_by_performer(task: TaskRecord, decline: TaskAct | None) -> list[TaskHistoryEntry]:
    """Return who got the activity before and has declined it, in an act of the tasklist or otherwise."""
    outputs = task.outputs or {}
    if outputs.get("declined") is not True or task.ended_at is None:
        return []
    entry = _entry(iso(task.ended_at), TaskActKind.DECLINE.value)
    entry["by"] = str(outputs.get("operator") or (performer_of(task) or "").rpartition(":")[2]) or None
    entry["verified"] = decline is not None and decline.verified and decline.by == entry["by"]
    reason = message_in(outputs, "reason")
    if reason is not None:
        entry |= with_code("text", reason)  # type: ignore[typeddict-item]  # a text and its code
    return [entry]


def _entry(at: str, kind: str) -> TaskHistoryEntry:
    return {"at": at, "kind": kind, "by": None, "verified": False, "text": None}  # type: ignore[typeddict-item]


def form_record_view(record: FormRecord) -> FormView:
    """Return a version of a form."""
    return {
        "id": record.id,
        "version": record.version,
        "title": record.title,
        "file": record.file,
        "deployedAt": iso(record.deployed_at),
    }
