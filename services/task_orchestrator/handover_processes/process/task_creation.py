"""Task creation: the Task of an open activity, as its record and as the entity of the broker."""

from contextlib import suppress
from dataclasses import replace
from datetime import datetime, timedelta
from typing import Any

from handover.tasks.specification import Specification
from handover_bpmn.execution.queries import OpenActivity
from handover_bpmn.execution.state import Library
from handover_bpmn.languages.base import ExpressionError, Variables
from handover_bpmn.model import Activity, FormBinding, FormReference, Value
from handover_bpmn.notation.names import in_urn
from handover_datamodels.entities import TaskStatus
from handover_processes.allocation.assignment import PerformerAssignment
from handover_processes.deployed_forms import FormRegistry
from handover_processes.records.entities import task_entity
from handover_processes.records.processes import ProcessRecord
from handover_processes.records.tasks import SPECIFICATION, TaskRecord
from handover_processes.settings import OrchestratorSettings
from handover_processes.timing.escalations import escalation_times

MAX_TEXT = 1000
"""Characters of a text of a Task that an expression yields."""


def task_id_of(settings: OrchestratorSettings, process: str, element: str, visit: int) -> str:
    """Return the id of the Task of a visit of an element."""
    return settings.entity_id("Task", f"{process}-{in_urn(element)}-{visit}")


def create_task(
    settings: OrchestratorSettings,
    process: ProcessRecord,
    open_: OpenActivity,
    assignment: PerformerAssignment,
    *,
    activity: Activity,
    now: datetime,
) -> tuple[TaskRecord, dict[str, Any] | None]:
    """Return the Task of an open activity, and its row of the specification database if it needs one.

    `activity` is the assigned one with the version of its form.

    Raises `ValueError` or `ExpressionError` if its parameters cannot be evaluated or are invalid.
    """
    activity = _with_texts(activity, open_)
    task_id = task_id_of(settings, process.id, open_.element, open_.visit)
    allowed = timedelta(seconds=settings.task_deadline_s)
    deadline = activity.deadline.after(now) if activity.deadline is not None else now + allowed
    entity = task_entity(
        settings,
        task_id,
        activity,
        open_.variables,
        data=open_.data,
        at=now,
        deadline=deadline,
        candidates=assignment.candidates,
        part_of=(settings.entity_id("Process", process.id), open_.element),
    )
    parameters = entity["workParameters"]["value"]
    if assignment.kind is not None:
        assignment.kind.check(parameters)
    row = _row(activity, task_id, open_.variables)
    if row is not None:
        parameters[SPECIFICATION] = row["id"]
    moments = escalation_times(activity, assignment.due, now)
    task = TaskRecord(
        id=task_id,
        process=process.id,
        element=open_.element,
        visit=open_.visit,
        token=open_.token,
        status=TaskStatus.PENDING,
        observed_at=now,
        moves=0,
        created_at=now,
        deadline=deadline,
        entity=entity,
        name=activity.name,
        allocated=assignment.reason,
        chosen=assignment.request is not None,
        escalates_at=moments[0][0] if moments else None,
    )
    return task, row


def _with_texts(activity: Activity, open_: OpenActivity) -> Activity:
    """Return the activity with the texts that people read: evaluated, and with the instance of a loop.

    A text whose expression cannot be evaluated stays as it is drawn.
    """
    texts: dict[str, str] = {}
    for name, expression in activity.texts.items():
        with suppress(ExpressionError):
            texts[name] = str(expression.value(open_.variables)).replace("\0", "").strip()[:MAX_TEXT]
    parameters = dict(activity.parameters)
    description = parameters.get("description")
    if description is None and "description" in texts:
        parameters["description"] = Value(texts["description"])
    elif (
        description is not None
        and description.expression is None
        and isinstance(description.literal, str)
        and open_.instance
    ):
        parameters["description"] = Value(f"{description.literal} ({open_.instance})")
    name = texts.get("name") or activity.name
    if open_.instance and "name" not in activity.texts:
        name = f"{name} ({open_.instance})"
    return replace(activity, name=" ".join(name.split()), parameters=parameters)


def _row(activity: Activity, task_id: str, variables: Variables) -> dict[str, Any] | None:
    """Return the row of the specification database that a Task needs, with its id; None if it needs none.

    A constant one has the id of the TaskDefinition, one with expressions that of the Task.
    """
    specification = activity.specification
    if specification is None:
        return None
    is_constant = all(value.expression is None for value in specification.values())
    values = Specification.of(
        {field: value.value(variables) for field, value in specification.items()}
    ).as_values()
    return {"id": activity.definition if is_constant else task_id, "values": values}


def with_form_version(
    activity: Activity, process: ProcessRecord, forms: FormRegistry, library: Library, now: datetime
) -> Activity:
    """Return the activity with the version of its form, which a later deployment does not change."""
    if activity.form is None:
        return activity
    deployed_at = library.deployed_at(process.definition, process.version)
    name, version = form_version(activity.form, forms, deployed_at, now)
    form = Value({"id": name, "version": version})
    return replace(activity, parameters={**activity.parameters, "form": form})


def form_version(
    reference: FormReference, forms: FormRegistry, deployed_at: datetime | None, now: datetime
) -> tuple[str, int | None]:
    """Return the id and version of a form for a definition that was deployed at `deployed_at`."""
    name = reference.name
    if reference.is_file:
        named = forms.find_file(name)
        name = name if named is None else named.id
    if reference.version is not None:
        return name, reference.version
    is_bound = reference.binding is FormBinding.DEPLOYMENT
    form = forms.deployed_by(name, deployed_at if is_bound and deployed_at is not None else now)
    return name, None if form is None else form.version
