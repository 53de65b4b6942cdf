"""Documents of Tasks of people, their forms, comments and history."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NotRequired

from typing_extensions import TypedDict

from handover.messages import message_in, with_code
from handover.tasks.task_life import PASSIVE_TYPES, type_of
from handover_bpmn.forms import form
from handover_bpmn.forms.form_js import Resolved
from handover_bpmn.model import Activity
from handover_datamodels.entities import TaskStatus
from handover_datamodels.times import iso
from handover_processes.allocation.choice import DEFAULT_PRIORITY
from handover_processes.deployed_forms import FormRegistry
from handover_processes.documents.document import From, Moment, OptionalMoment, document, documents
from handover_processes.documents.forms import TaskForm, form_view
from handover_processes.documents.requests import TaskListQuery
from handover_processes.documents.tasks import (
    deadline_of,
    description_of,
    due_date_of,
    follow_up_date_of,
    inputs_of,
    name_of,
    priority_of,
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


def _groups(task: TaskRecord) -> list[str]:
    """Return the groups that a Task is offered to, and the lane of its activity."""
    candidates = inputs_of(task).get("candidates")
    if not isinstance(candidates, Mapping):
        return []
    lane = candidates.get("lane")
    return list(dict.fromkeys([*candidates.get("groups", []), *([lane] if lane else [])]))


def _inputs(task: TaskRecord) -> dict[str, Any]:
    inputs = {name: value for name, value in inputs_of(task).items() if name not in _NO_INPUTS}
    return {**_used(task), **inputs}


def _used(task: TaskRecord) -> dict[str, list[str]]:
    """Return the names of the Materials and Assets that a Task uses, by type in lower case."""
    paths: dict[str, list[str]] = {}
    for link in task.entity["involves"]["value"]:
        type_ = type_of(link["object"])
        if type_ in PASSIVE_TYPES:
            paths.setdefault(f"{type_.lower()}s", []).append(link["object"].rpartition(":")[2])
    return paths


class TaskComment(TypedDict):
    """A comment on a Task or process; `verified`: `by` is the name of who was signed in."""

    id: str
    task: str | None
    by: str
    verified: bool
    at: Moment
    text: Annotated[str, From(lambda act: act.text or "")]


class TaskHistoryEntry(TypedDict):
    """What became of a Task: created, offered, an act of a person, or another status.

    `offeredTo` are the persons and groups of an offer, `text` the reason.
    """

    at: str
    kind: TaskActKind | Literal["created", "offered", "status"]
    by: str | None
    verified: bool
    status: NotRequired[TaskStatus]
    offeredTo: NotRequired[list[str]]
    text: str | None
    textCode: NotRequired[str]
    textParameters: NotRequired[dict[str, Any]]


class TasklistEntry(TypedDict):
    """A Task of people as an element of a list.

    `person` is the one that it was given to; `persons` and `groups` those that it is offered to.
    `processName` is the name of its process for people.
    """

    id: str
    process: str
    processName: str
    element: str
    name: Annotated[str, From(name_of)]
    status: TaskStatus
    person: Annotated[str | None, From(performer_of)]
    persons: Annotated[list[str], From(lambda task: offer_of(task).persons)]
    groups: Annotated[list[str], From(_groups)]
    claimedBy: str | None
    declinedBy: list[str]
    isClaimable: Annotated[bool, From(is_claimable)]
    createdAt: Moment
    dueDate: Annotated[str | None, From(due_date_of)]
    followUpDate: Annotated[str | None, From(follow_up_date_of)]
    priority: Annotated[int | None, From(priority_of)]


class TaskDetails(TasklistEntry):
    """A Task of people with all details; `inputs` are its parameters, `outputs` its result."""

    processTitle: str
    processKey: str | None
    definition: str
    version: int
    description: str | None
    deadline: Annotated[str | None, From(deadline_of)]
    requirePin: Annotated[bool, From(requires_pin)]
    endedAt: OptionalMoment
    inputs: Annotated[dict[str, Any], From(_inputs)]
    inputsSchema: dict[str, Any] | None
    outputs: dict[str, Any] | None
    form: TaskForm | None
    comments: list[TaskComment]
    history: list[TaskHistoryEntry]


def tasklist_entry(task: TaskRecord, process_name: str) -> TasklistEntry:
    """Return a Task of people as an element of a list; `process_name` is the name of its process."""
    return document(TasklistEntry, task, processName=process_name)


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
    return document(
        TaskDetails,
        task,
        processName=process_name,
        processTitle=title,
        processKey=process.key,
        definition=process.definition,
        version=process.version,
        description=description_of(task, activity),
        inputsSchema=None if activity is None else activity.inputs_schema,
        outputs=None if task.outputs is None else dict(task.outputs),
        form=resolved,
        comments=documents(TaskComment, (act for act in acts if act.kind is TaskActKind.COMMENT)),
        history=list(history),
    )


def resolved_form(task: TaskRecord, forms: FormRegistry, data: Mapping[str, Any]) -> TaskForm | None:
    """Return the form of a Task for `data`; None if it has none."""
    name, version, schema = form_of(task, forms)
    if name is None and schema is None:
        return None
    resolved = Resolved((), is_dynamic=False) if schema is None else form.resolve(schema, data)
    return form_view(name, version, resolved)


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
