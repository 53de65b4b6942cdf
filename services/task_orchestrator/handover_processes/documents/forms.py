"""Documents of forms."""

from types import SimpleNamespace
from typing import Annotated, Any, NotRequired

from typing_extensions import TypedDict

from handover_bpmn.forms.fields import Field, FieldKind
from handover_bpmn.forms.form_js import Resolved
from handover_processes.documents.definitions import BpmnWarning
from handover_processes.documents.document import From, Moment, document


class FormOption(TypedDict):
    """A value that can be chosen in a field."""

    value: Any
    label: str


class FormColumn(TypedDict):
    """A column of a table."""

    key: str
    label: str


def _columns(field: Field) -> list[SimpleNamespace]:
    return [SimpleNamespace(key=key, label=label) for key, label in field.columns]


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
    columns: Annotated[list[FormColumn], From(_columns)]


class TaskForm(TypedDict):
    """The form of a Task for the present data; with `isDynamic` it is asked for again when a value changes.

    `id` and `version` are those of a deployed form. Without fields the form is not deployed.
    """

    id: str | None
    version: int | None
    isDynamic: bool
    fields: list[FormField]


class FormView(TypedDict):
    """A version of a form; `warnings` are the components that are not shown."""

    id: str
    version: int
    title: str
    file: str | None
    deployedAt: Moment
    created: NotRequired[bool]
    warnings: NotRequired[list[str]]


class DeployedFiles(TypedDict):
    """The definitions and forms of a deployment of several files."""

    definitions: list[dict[str, Any]]
    forms: list[FormView]
    warnings: list[BpmnWarning]
    created: bool


def form_view(name: str | None, version: int | None, resolved: Resolved) -> TaskForm:
    """Return a form with its fields."""
    return document(TaskForm, resolved, id=name, version=version)
