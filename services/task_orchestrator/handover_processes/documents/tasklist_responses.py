"""The responses of the REST interface about Tasks of people and their forms."""

from typing import Any, Literal, NotRequired

from typing_extensions import TypedDict

from handover_bpmn.forms.fields import FieldKind
from handover_datamodels.entities import TaskStatus
from handover_processes.documents.responses import BpmnWarning
from handover_processes.records.tasks import TaskActKind


class FormOption(TypedDict):
    """A value that can be chosen in a field."""

    value: Any
    label: str


class FormColumn(TypedDict):
    """A column of a table."""

    key: str
    label: str


class FormField(TypedDict):
    """A field of a form, or a part that is only shown.

    `path` is the place of its value in the result: names joined by dots; within a list it starts at the item.
    `fields` are those of a group, or of each item of a list. The rows of a table are `initial`.
    """

    path: str
    kind: FieldKind
    label: str
    hint: str | None
    isRequired: bool
    isReadOnly: bool
    initial: Any
    options: list[FormOption]
    minimum: float | None
    maximum: float | None
    minLength: int | None
    maxLength: int | None
    pattern: str | None
    textFormat: str | None
    decimals: int | None
    unit: str | None
    isText: bool
    fields: list["FormField"]
    columns: list[FormColumn]


class TaskForm(TypedDict):
    """The form of a Task for the present data; with `isDynamic` it is asked for again when a value changes.

    `id` and `version` are those of a deployed form. Without fields the form is not deployed.
    """

    id: str | None
    version: int | None
    isDynamic: bool
    fields: list[FormField]


class TaskComment(TypedDict):
    """A comment on a Task or process; `verified`: `by` is the name of who was signed in."""

    id: str
    task: str | None
    by: str
    verified: bool
    at: str
    text: str


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
    name: str
    status: TaskStatus
    person: str | None
    persons: list[str]
    groups: list[str]
    claimedBy: str | None
    declinedBy: list[str]
    isClaimable: bool
    createdAt: str
    dueDate: str | None
    followUpDate: str | None
    priority: int | None


class TaskDetails(TasklistEntry):
    """A Task of people with all details; `inputs` are its parameters, `outputs` its result."""

    processTitle: str
    processKey: str | None
    definition: str
    version: int
    description: str | None
    deadline: str | None
    requirePin: bool
    endedAt: str | None
    inputs: dict[str, Any]
    inputsSchema: dict[str, Any] | None
    outputs: dict[str, Any] | None
    form: TaskForm | None
    comments: list[TaskComment]
    history: list[TaskHistoryEntry]


class FormView(TypedDict):
    """A version of a form; `warnings` are the components that are not shown."""

    id: str
    version: int
    title: str
    file: str | None
    deployedAt: str
    created: NotRequired[bool]
    warnings: NotRequired[list[str]]


class DeployedFiles(TypedDict):
    """The definitions and forms of a deployment of several files."""

    definitions: list[dict[str, Any]]
    forms: list[FormView]
    warnings: list[BpmnWarning]
    created: bool
