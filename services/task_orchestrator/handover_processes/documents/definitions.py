"""Documents of definitions and of their deployment."""

from typing import Any, NotRequired

from typing_extensions import TypedDict

from handover.errors import HandoverError
from handover_bpmn.model import Definition
from handover_processes.definitions.definition_registry import DefinitionRegistry
from handover_processes.documents.document import Moment, document, documents
from handover_processes.records.definitions import DefinitionRecord, HoldKind


class DefinitionParameter(TypedDict):
    """A parameter of a process definition."""

    name: str
    required: bool
    default: Any


class DefinitionHoldView(TypedDict):
    """That a definition is paused (its start timers wait) or suspended (no process of it starts)."""

    kind: HoldKind
    by: str
    why: str | None
    at: Moment
    verified: bool


class DefinitionView(TypedDict):
    """A version of a definition; `unusable` is the reason why this release cannot run it.

    `translations` are the texts of its file in other languages: by language, then by the text of the file.
    """

    name: str
    version: int
    label: str | None
    title: str
    deployedAt: Moment
    parameters: list[DefinitionParameter]
    holds: list[DefinitionHoldView]
    deletedVersions: list[int]
    translations: dict[str, dict[str, str]]
    unusable: NotRequired[str]


class DefinitionActivity(TypedDict):
    """An activity of a definition."""

    id: str
    name: str
    definition: str | None
    lane: str | None
    description: str | None


class DefinitionWithActivities(DefinitionView):
    """A version of a definition with its activities, in the order of the file, and who gets them now."""

    activities: list[DefinitionActivity]
    allocation: list["ActivityAllocation"]


class BpmnWarning(TypedDict):
    """A part of a BPMN file that has no effect; the page translates `message` by its code and parameters."""

    element: str | None
    name: str | None
    line: int | None
    message: str
    messageCode: NotRequired[str]
    messageParameters: NotRequired[dict[str, Any]]


class ActivityAllocation(TypedDict):
    """The performer of an activity as far as it is known before a process runs, the reason, and a warning."""

    process: str
    element: str
    name: str
    definition: str | None
    performer: str | None
    reason: str
    reasonCode: NotRequired[str]
    reasonParameters: NotRequired[dict[str, Any]]
    warning: str | None
    warningCode: NotRequired[str]
    warningParameters: NotRequired[dict[str, Any]]


class Deployment(DefinitionView):
    """The definitions of a deployed file; the first of them is also the response itself."""

    definitions: list[DefinitionView]
    warnings: list[BpmnWarning]
    allocation: list[ActivityAllocation]


class CheckedDefinition(TypedDict):
    """A definition of a checked file; `created` is false if this version is deployed already."""

    name: str
    version: int
    title: str
    created: bool


class DeploymentCheck(CheckedDefinition):
    """The result that a deployment would have; the first definition is also the response itself."""

    definitions: list[CheckedDefinition]
    warnings: list[BpmnWarning]
    allocation: list[ActivityAllocation]


def definition_view(registry: DefinitionRegistry, record: DefinitionRecord) -> DefinitionView:
    """Return a version of a definition and its parameters."""
    content: dict[str, Any] = {"parameters": [], "translations": {}}
    try:
        definition = registry.plan_of(record).definition
    except HandoverError as error:
        content["unusable"] = str(error)
    else:
        content["parameters"] = parameter_views(definition)
        translations = definition.translations
        content["translations"] = {language: dict(texts) for language, texts in translations.items()}
    return document(
        DefinitionView,
        record,
        holds=documents(DefinitionHoldView, registry.holds_of(record.name)),
        deletedVersions=sorted(registry.deleted_versions(record.name)),
        **content,
    )


def parameter_views(definition: Definition) -> list[DefinitionParameter]:
    """Return the parameters of a definition."""
    return documents(DefinitionParameter, definition.parameters.values())


def activity_views(definition: Definition) -> list[DefinitionActivity]:
    """Return the activities of a definition."""
    return documents(DefinitionActivity, definition.activities().values())
