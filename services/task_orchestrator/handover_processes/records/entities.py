"""Entities: definitions, processes and Tasks as normalized NGSI-LD."""

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any

from handover.files.content_digest import with_digest
from handover.messages import message, with_code
from handover.settings import Settings
from handover.tasks.specification import MAX_COMMAND_ID
from handover.tasks.task_life import is_for_people, type_of
from handover_bpmn.model import Activity, Definition
from handover_bpmn.references import is_reference
from handover_datamodels.entities import RequestedStatus, TaskStatus
from handover_datamodels.times import iso
from handover_processes.allocation.hints import due_of, follow_up_of, given_priority
from handover_processes.records.processes import ProcessRecord
from handover_processes.records.tasks import TaskRecord
from handover_processes.references import resource_id

Entity = dict[str, Any]
MAX_LISTED_TASKS = 200
"""The Process entity lists so many of its Tasks, the last ones; the service lists all."""


def definition_id(settings: Settings, definition: Definition) -> str:
    """Return the id of the ProcessDefinition: the entity that it was deployed from, or that of ours."""
    return definition.source or settings.entity_id("ProcessDefinition", definition.name)


def definition_entities(settings: Settings, definition: Definition, version: int, url: str) -> list[Entity]:
    """Return the ProcessDefinition and the TaskDefinitions of its activities; `url` is that of the file.

    A definition that was deployed from an entity of another system has its ProcessDefinition already.
    """
    process_definition = definition_id(settings, definition)
    process: Entity = {
        "id": process_definition,
        "type": "ProcessDefinition",
        "name": _property(definition.title),
        "version": _property(definition.label or str(version)),
        "bpmn": _property(url),
    }
    if definition.description:
        process["description"] = _property(definition.description)
    tasks: dict[str, Entity] = {}
    for activity in definition.activities().values():
        if activity.definition.startswith("urn:"):
            continue  # it names the TaskDefinition of another system
        entity = _task_definition(settings, activity, process_definition)
        copy = tasks.setdefault(entity["id"], entity)
        if (
            not activity.handles_outcomes
        ):  # one activity that does not handle outcomes decides for the whole TaskDefinition
            copy.pop("handlesOutcomes", None)
        if activity.require_pin:  # one that demands it decides as well
            copy["requirePin"] = _property(True)
    ours = tasks.values() if definition.source is not None else (process, *tasks.values())
    return [with_digest(entity) for entity in ours]


def _task_definition(settings: Settings, activity: Activity, process_definition: str) -> Entity:
    entity: Entity = {
        "id": settings.entity_id("TaskDefinition", activity.definition),
        "type": "TaskDefinition",
        "name": _property(activity.name),
        "isPartOf": {"type": "Relationship", "object": process_definition},
    }
    if activity.description:
        entity["description"] = _property(activity.description)
    for name in ("gesture", "commandId"):
        parameter = activity.parameters.get(name)
        if parameter is not None and parameter.expression is None and not _is_too_large(parameter.literal):
            entity[name] = _property(parameter.literal)
    if activity.skills:
        entity["requiredSkills"] = _property(list(activity.skills))
    if activity.handles_outcomes:
        entity["handlesOutcomes"] = _property(True)
    if activity.inputs_schema is not None:
        entity["workParametersSchema"] = _property(activity.inputs_schema)
    form = activity.parameters.get("form")
    if form is not None and isinstance(form.literal, Mapping) and "properties" in form.literal:
        entity["outputParametersSchema"] = _property(form.literal)
    return entity


def _is_too_large(literal: Any) -> bool:
    """Return whether some brokers would change a number; the parameters of the Task have it in any case."""
    return isinstance(literal, int) and abs(literal) > MAX_COMMAND_ID


def process_entity(
    settings: Settings,
    process_id: str,
    defined_by: str,
    *,
    status: TaskStatus,
    at: datetime,
    parameters: Mapping[str, Any],
    tasks: Iterable[str],
    outputs: Mapping[str, Any] | None,
) -> Entity:
    """Return the Process; `defined_by` is its ProcessDefinition, `at` the `observedAt` of its status."""
    entity: Entity = {
        "id": settings.entity_id("Process", process_id),
        "type": "Process",
        "isDefinedBy": {"type": "Relationship", "object": defined_by},
        "status": status_property(status, at),
        "workParameters": _property(dict(parameters)),
    }
    composed = [{"type": "Relationship", "object": task} for task in tasks]
    if composed:
        entity["isComposedOf"] = _property(composed)
    if outputs is not None:
        entity["outputParameters"] = outputs_property(outputs, at)
    return entity


def task_entity(
    settings: Settings,
    task_id: str,
    activity: Activity,
    variables: Mapping[str, Any],
    *,
    at: datetime,
    deadline: datetime,
    data: Mapping[str, Any] | None = None,
    candidates: Mapping[str, Any] | None = None,
    part_of: tuple[str, str] | None = None,
) -> Entity:
    """Return the `pending` Task of `activity` with the present process variables and data objects.

    `candidates` describe the people that a Task of people is offered to. Such a Task has the attributes that
    a tasklist shows, and a deadline only if the file gives one; `part_of` are the URN of its Process and the
    element.

    Raises `ExpressionError` when a variable is missing, `ValueError` when a reference is invalid.
    """
    entity: Entity = {
        "id": task_id,
        "type": "Task",
        "isDefinedBy": {
            "type": "Relationship",
            "object": settings.entity_id("TaskDefinition", activity.definition),
        },
        "status": status_property(TaskStatus.PENDING, at),
        "involves": _property(_involved(settings, activity, variables)),
        "workParameters": _property({**(data or {}), **_work_parameters(activity, variables)}),
        "deadline": _property({"@type": "DateTime", "@value": iso(deadline)}),
    }
    entity |= _schedule(activity, variables)
    if candidates is not None:
        entity["workParameters"]["value"]["candidates"] = dict(candidates)
    if part_of is not None and is_for_people(link["object"] for link in entity["involves"]["value"]):
        entity |= _tasklist_attributes(activity, *part_of)
        if activity.deadline is None:
            del entity["deadline"]  # it waits in the tasklist until a person claims it
    places = [
        _place(settings, place.location.value(variables), place.function, activity)
        for place in activity.happens_at
    ]
    if places:
        entity["happensAt"] = _property(places)
    return entity


def _involved(settings: Settings, activity: Activity, variables: Mapping[str, Any]) -> list[Entity]:
    """Return the performers of a Task, then the Materials and Assets that it uses, each once."""
    links = [_link(settings, resource.value(variables), activity) for resource in activity.involves]
    for type_, values in (("Material", activity.materials), ("Asset", activity.assets)):
        for value in values:
            used = value.value(variables)
            listed = used if isinstance(used, list) else [used]
            links += [_used(settings, reference, type_, activity) for reference in listed]
    return list({link["object"]: link for link in links}.values())


def _used(settings: Settings, reference: Any, type_: str, activity: Activity) -> Entity:
    """Return the link to an entity of a type; it is a reference, or an entity as a variable has it."""
    link = _link(settings, reference.get("id") if isinstance(reference, Mapping) else reference, activity)
    if type_of(link["object"]) not in {type_, None}:
        raise ValueError(
            message(
                "process.wrong_used_type",
                '"{entity}" is no {type} for "{element}"',
                entity=link["object"],
                type=type_,
                element=activity.id,
            )
        )
    return link


def _tasklist_attributes(activity: Activity, process: str, element: str) -> Entity:
    return {
        "name": _property(activity.name),
        "element": _property(element),
        "isPartOf": {"type": "Relationship", "object": process},
    }


def _schedule(activity: Activity, variables: Mapping[str, Any]) -> Entity:
    """Return the priority, due date and follow-up date that an activity gives."""
    attributes: Entity = {}
    priority = given_priority(activity, variables)
    if priority is not None:
        attributes["priority"] = _property(priority)
    for name, moment in (
        ("dueDate", due_of(activity, variables)),
        ("followUpDate", follow_up_of(activity, variables)),
    ):
        if moment is not None:
            attributes[name] = _property({"@type": "DateTime", "@value": iso(moment)})
    return attributes


def _work_parameters(activity: Activity, variables: Mapping[str, Any]) -> dict[str, Any]:
    parameters = {name: parameter.value(variables) for name, parameter in activity.parameters.items()}
    if activity.handles_outcomes:
        parameters["handlesOutcomes"] = True
    if activity.require_pin:
        parameters["requirePin"] = True
    return parameters


def _place(settings: Settings, reference: Any, function: str | None, activity: Activity) -> Entity:
    link = _link(settings, reference, activity)
    return {**link, "locationFunction": _property(function)} if function else link


def _link(settings: Settings, reference: Any, activity: Activity) -> Entity:
    if not is_reference(reference):
        raise ValueError(f'"{reference}" names no entity for "{activity.id}"; it is Type:id or a URN')
    return {"type": "Relationship", "object": resource_id(settings, reference)}


def status_request(requested: RequestedStatus, at: datetime) -> Entity:
    """Return the attribute that requests another status of a Task."""
    return {"requestedStatus": {**_property(requested.value), "observedAt": iso(at)}}


def final_attributes(task: TaskRecord) -> Entity:
    """Return the final attributes of a Task as the orchestrator has recorded them."""
    at = task.observed_at or task.ended_at or task.created_at
    return {
        "status": status_property(task.status, at),
        "outputParameters": outputs_property(task.outputs or {}, at),
    }


def status_property(status: TaskStatus, at: datetime) -> Entity:
    """Return `status` as a Property with `observedAt`."""
    return {**_property(status.value), "observedAt": iso(at)}


def outputs_property(outputs: Mapping[str, Any], at: datetime) -> Entity:
    """Return outputParameters without null values, since NGSI-LD has no null."""
    return {
        **_property({name: value for name, value in outputs.items() if value is not None}),
        "observedAt": iso(at),
    }


def _property(value: Any) -> Entity:
    return {"type": "Property", "value": value}


def entity_of(
    settings: Settings, record: ProcessRecord, defined_by: str, composed: Sequence[str], now: datetime
) -> Entity:
    """Return the Process entity of `record`; of its Tasks, `composed`, the last ones are listed."""
    outputs: dict[str, Any] | None = None
    if record.status is TaskStatus.COMPLETED:
        outputs = {n: v for n, v in record.variables.items() if n not in record.parameters}
    elif record.status is TaskStatus.FAILED:
        outputs = with_code("reason", record.reason or "")
    elif record.acts:
        outputs = {}  # a retried process has none, whatever was written before
    return process_entity(
        settings,
        record.id,
        defined_by,
        status=record.status,
        at=record.ended_at or now,
        parameters=record.parameters,
        tasks=composed[-MAX_LISTED_TASKS:],
        outputs=outputs,
    )


def execution_properties(settings: Settings, record: ProcessRecord, definition: Definition) -> Entity:
    """Return the properties of `execution` in JUEL."""
    return {
        "processInstanceId": record.id,
        "processBusinessKey": record.key,
        "businessKey": record.key,
        "processDefinitionId": definition_id(settings, definition),
    }
