"""Views: definitions and processes as the REST interface returns them."""

import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any, cast

from handover.errors import HandoverError
from handover.messages import message_in, with_code
from handover_bpmn.execution.queries import InnerScope
from handover_bpmn.execution.run import Run
from handover_bpmn.languages.native import ExpressionError
from handover_bpmn.lookahead import upcoming_activities
from handover_bpmn.model import Activity, Definition
from handover_bpmn.notation.comparison import ElementChange
from handover_bpmn.notation.faults import as_json
from handover_bpmn.references import is_reference
from handover_datamodels.entities import TaskStatus
from handover_datamodels.forms import to_key_values
from handover_datamodels.times import iso
from handover_processes.allocation.agents import UNLIMITED
from handover_processes.allocation.allocator import Allocator
from handover_processes.allocation.assignment import performer_of
from handover_processes.allocation.mapping import MappingEntry, MappingTable
from handover_processes.allocation.report import mapped_names, nobody_has
from handover_processes.definitions.definition_registry import DefinitionRegistry
from handover_processes.documents.responses import (
    ActView,
    AgentTask,
    AgentView,
    Allocated,
    BpmnWarning,
    DefinitionActivity,
    DefinitionParameter,
    DefinitionView,
    ElementCounts,
    IncidentView,
    KnownReason,
    MappedName,
    MappingUse,
    MappingView,
    MigrationOfAllView,
    MigrationView,
    MissingSkills,
    NextActivity,
    OfferedChange,
    OfferView,
    PeriodStatistics,
    ProcessSummary,
    ProcessView,
    Reason,
    ReservationView,
    RetryView,
    ScopeView,
    TaskView,
    TokenView,
    VersionStatistics,
)
from handover_processes.process.interventions import MigrationReport
from handover_processes.records.definitions import DefinitionRecord
from handover_processes.records.offers import OfferRecord
from handover_processes.records.processes import (
    Act,
    IncidentRecord,
    ProcessRecord,
    ReservationRecord,
    ReservationState,
    Retry,
)
from handover_processes.records.tasks import Move, TaskRecord
from handover_processes.references import resource_id
from handover_processes.settings import OrchestratorSettings
from handover_processes.storage.counts import ElementCount, PeriodCount, VersionCount, count_elements

_MADE_BY_PAGE = re.compile(r"[lm][0-9a-z]{7}-[0-9a-z]{7,8}|\S+ by \S+ after \S+", re.ASCII)
"""Business keys that the page makes, so that a double press starts one process; they name nothing."""


def mapping_view(table: MappingTable) -> MappingView:
    """Return a version of the mapping."""
    return {
        "version": table.version,
        "by": table.by,
        "verified": table.verified,
        "why": table.why,
        "at": _iso(table.at),
        "entries": [_mapped_name(entry) for entry in table.entries],
    }


def _mapped_name(entry: MappingEntry) -> MappedName:
    return cast("MappedName", entry.model_dump(mode="json", exclude_defaults=True))


def agent_views(allocator: Allocator, tasks: Iterable[TaskRecord], now: datetime) -> list[AgentView]:
    """Return the agents with their open Tasks."""
    by_agent: dict[str, list[AgentTask]] = {}
    for task in tasks:
        if task.cancelled_at is None and task.performer:
            by_agent.setdefault(task.performer, []).append(_agent_task(task))
    return [
        {
            "id": agent.id,
            "isPerson": agent.is_person,
            "skills": {
                name: {"level": skill.level, "cost": skill.cost, "speed": skill.speed}
                for name, skill in agent.skills.items()
            },
            "roles": sorted(agent.roles),
            "capacity": None if agent.capacity >= UNLIMITED else agent.capacity,
            "unavailable": agent.unavailable,
            "isOnShift": agent.works_at(now),
            "shifts": [
                {
                    "weekday": shift.weekday,
                    "begins": f"{shift.begins:%H:%M}",
                    "ends": f"{shift.ends:%H:%M}",
                    "zone": shift.zone.key,
                }
                for shift in agent.shifts
            ],
            "position": None if agent.position is None else list(agent.position.coordinates),
            "isGeographic": agent.position is not None and agent.position.is_geographic,
            "tasks": by_agent.get(agent.id, []),
            "reservedBy": None
            if (hold := allocator.reservations.holding(agent.id)) is None
            else hold.holder[0],
        }
        for agent in allocator.rules.agents.by_id.values()
    ]


def _agent_task(task: TaskRecord) -> AgentTask:
    return {
        "id": task.id,
        "process": task.process,
        "element": task.element,
        "name": task.name or task.element,
        "status": task.status,
        "since": iso(task.status_since or task.created_at),
        **_allocated(task.allocated),
    }


def mapping_use(allocator: Allocator, definitions: Iterable[Definition]) -> MappingUse:
    """Return the names in definitions with their performers, and the entries that nobody can serve."""
    missing: list[MissingSkills] = []
    for entry in allocator.rules.mapping.entries:
        warning = nobody_has(allocator.rules, entry)
        if warning is not None:
            view = {"kind": entry.kind, "name": entry.name, **with_code("warning", warning)}
            missing.append(cast("MissingSkills", view))
    return {
        "names": [
            {
                "kind": used.kind,
                "name": used.name,
                "performer": None if used.entry is None else performer_of(used.entry),
                "activities": [
                    {"definition": definition, "element": element, "name": name}
                    for definition, element, name in used.activities
                ],
            }
            for used in mapped_names(allocator.rules, definitions)
        ],
        "missing": missing,
    }


def definition_view(registry: DefinitionRegistry, record: DefinitionRecord) -> DefinitionView:
    """Return a version of a definition and its parameters."""
    view: DefinitionView = {
        "name": record.name,
        "version": record.version,
        "label": record.label,
        "title": record.title,
        "deployedAt": iso(record.deployed_at),
        "parameters": [],
        "holds": [
            {"kind": hold.kind, "by": hold.by, "why": hold.why, "at": iso(hold.at), "verified": hold.verified}
            for hold in registry.holds_of(record.name)
        ],
        "deletedVersions": sorted(registry.deleted_versions(record.name)),
        "translations": {},
    }
    try:
        definition = registry.plan_of(record).definition
    except HandoverError as error:
        return {**view, "unusable": str(error)}
    translations = {language: dict(texts) for language, texts in definition.translations.items()}
    return {**view, "parameters": parameter_views(definition), "translations": translations}


def parameter_views(definition: Definition) -> list[DefinitionParameter]:
    """Return the parameters of a definition."""
    return [
        {"name": parameter.name, "required": parameter.required, "default": parameter.default}
        for parameter in definition.parameters.values()
    ]


def activity_views(definition: Definition) -> list[DefinitionActivity]:
    """Return the activities of a definition."""
    return [
        {
            "id": activity.id,
            "name": activity.name,
            "definition": activity.definition,
            "lane": activity.lane,
            "description": activity.description,
        }
        for activity in definition.activities().values()
    ]


def statistics_view(record: DefinitionRecord, counts: VersionCount) -> VersionStatistics:
    """Return the statistics of a version."""
    return {
        "name": record.name,
        "version": record.version,
        "processes": {"running": counts.running, "completed": counts.completed, "failed": counts.failed},
        "elements": {element: _count_view(count) for element, count in counts.elements.items()},
    }


def period_view(counts: PeriodCount) -> PeriodStatistics:
    """Return the statistics of a period."""
    return {
        "running": counts.running,
        "completed": counts.completed,
        "failed": counts.failed,
        "medianMs": counts.median_ms,
    }


def process_name(registry: DefinitionRegistry, record: ProcessRecord) -> str:
    """Return the name of a process for people."""
    if record.title is not None:
        return record.title
    title = registry.record(record.definition, record.version).title
    if record.key is None or _MADE_BY_PAGE.fullmatch(record.key):
        return f"{title} {record.number}"
    return f"{title} · {record.key}"


def process_summary(
    settings: OrchestratorSettings, registry: DefinitionRegistry, record: ProcessRecord
) -> ProcessSummary:
    """Return a process as an element of a list."""
    return {
        "id": record.id,
        "entity": settings.entity_id("Process", record.id),
        "name": process_name(registry, record),
        "definition": record.definition,
        "version": record.version,
        "title": registry.record(record.definition, record.version).title,
        "number": record.number,
        "key": record.key,
        "status": record.status,
        **_reason(record.reason),
        "startedAt": iso(record.started_at),
        "endedAt": _iso(record.ended_at),
        "archivedAt": _iso(record.archived_at),
        "waiting": list(record.waiting),
        "incidents": [_incident_view(incident) for incident in record.incidents],
        "unallocated": [
            {
                "token": activity.token,
                "element": activity.element,
                "name": activity.name,
                **_known_reason(activity.reason),
                "since": iso(activity.since),
            }
            for activity in record.unallocated
        ],
        "retries": [_retry_view(retry, retry.due) for retry in record.retries if retry.due is not None],
        "retry": next((incident.task for incident in record.incidents if incident.task is not None), None),
    }


def process_view(
    settings: OrchestratorSettings,
    registry: DefinitionRegistry,
    record: ProcessRecord,
    tasks: Sequence[TaskRecord],
    moves: Sequence[Move],
    *,
    allocator: Allocator,
    run: Run | None = None,
) -> ProcessView:
    """Return a process with all details; `run` is that of a running one."""
    definition = _definition(registry, record)
    history: dict[str, list[Move]] = {}
    for move in moves:
        history.setdefault(move.task, []).append(move)
    counts = count_elements(tasks)
    activities = definition.activities() if definition is not None else {}
    return {
        **process_summary(settings, registry, record),
        "parameters": record.parameters,
        "variables": record.variables,
        "next": _next(settings, definition, record) if definition is not None else [],
        "done": sum(count.completed > 0 for count in counts.values()),
        "activities": len(activities),
        "elements": {element: _count_view(count) for element, count in counts.items()},
        "acts": [_act_view(act) for act in record.acts],
        "reservations": [
            _reservation_view(reservation, record, allocator) for reservation in record.reservations
        ],
        "tokens": [] if run is None else _token_views(run, tasks),
        "scopes": [] if run is None else [_scope_view(scope) for scope in run.inner_scopes()],
        "tasks": [_task_view(task, activities.get(task.element), history.get(task.id, [])) for task in tasks],
    }


def _token_views(run: Run, tasks: Sequence[TaskRecord]) -> list[TokenView]:
    open_tasks = {(task.token, task.visit): task.id for task in tasks if task.ended_at is None}
    return [
        {
            "token": token.token,
            "element": token.element,
            "name": token.name,
            "state": token.state,
            "instance": token.instance,
            "task": open_tasks.get((token.token, token.visit)),
        }
        for token in run.tokens()
    ]


def _scope_view(inner_scope: InnerScope) -> ScopeView:
    return {
        "scope": inner_scope.scope,
        "outer": inner_scope.outer,
        "kind": inner_scope.kind,
        "element": inner_scope.element,
        "name": inner_scope.name,
        "instance": inner_scope.instance,
        "variables": dict(inner_scope.variables),
    }


def _reservation_view(
    reservation: ReservationRecord, record: ProcessRecord, allocator: Allocator
) -> ReservationView:
    reason = reservation.reason
    if (
        reservation.state is ReservationState.WAITING
    ):  # who holds it changes often, so it is not stored each time
        reason = allocator.waits_for((record.id, reservation.key)) or reason
    return {
        "key": reservation.key,
        "element": reservation.element,
        "name": reservation.name,
        "state": reservation.state,
        **_known_reason(reason),
        "since": iso(reservation.since),
        "askedAt": iso(reservation.asked_at),
        "heldAt": _iso(reservation.held_at),
        "agents": list(reservation.agents),
        "uses": list(reservation.used),
        "isShared": reservation.outer is not None,
    }


def _definition(registry: DefinitionRegistry, record: ProcessRecord) -> Definition | None:
    """Return the definition of a process; None if this release cannot read it."""
    try:
        return registry.plan_of(registry.record(record.definition, record.version)).definition
    except HandoverError:
        return None


def _next(
    settings: OrchestratorSettings, definition: Definition, record: ProcessRecord
) -> list[NextActivity]:
    return [
        {
            "element": activity.id,
            "name": activity.name,
            "description": activity.description,
            "lane": activity.lane,
            "involves": _involved(settings, activity, record.variables),
        }
        for activity in upcoming_activities(definition, record.waiting, record.variables)
    ]


def _involved(settings: OrchestratorSettings, activity: Activity, variables: Mapping[str, Any]) -> list[str]:
    """Return the resources of an activity that the present variables determine."""
    references = []
    for resource in activity.involves:
        try:
            reference = resource.value(variables)
        except ExpressionError:
            continue
        if is_reference(reference):
            references.append(resource_id(settings, reference))
    return references


def _task_view(task: TaskRecord, activity: Activity | None, moves: Sequence[Move]) -> TaskView:
    parameters: Mapping[str, Any] = task.entity["workParameters"]["value"]
    drawn = None if activity is None else activity.description
    described = parameters.get("description")
    outputs = task.outputs or {}
    failed = task.status is TaskStatus.FAILED
    return {
        "id": task.id,
        "element": task.element,
        "name": task.name or task.element,
        "visit": task.visit,
        "description": described if isinstance(described, str) else drawn,
        "status": task.status,
        "involves": [link["object"] for link in task.entity["involves"]["value"]],
        **_allocated(task.allocated),
        "workParameters": parameters,
        "createdAt": iso(task.created_at),
        "deadline": iso(task.deadline) if "deadline" in task.entity else None,
        "priority": task.entity.get("priority", {}).get("value"),
        "dueDate": _moment_of(task, "dueDate"),
        "followUpDate": _moment_of(task, "followUpDate"),
        "endedAt": _iso(task.ended_at),
        "cancelled": task.cancelled_at is not None,
        **_reason(message_in(outputs, "reason") if failed else None),
        "outputParameters": task.outputs,
        "history": [
            {"status": move.status, "at": iso(move.observed_at or move.received_at)} for move in moves
        ],
    }


def _count_view(count: ElementCount) -> ElementCounts:
    return {
        "running": count.running,
        "completed": count.completed,
        "failed": count.failed,
        "lastMs": count.last_ms,
        "medianMs": count.median_ms,
    }


def _reason(reason: str | None) -> Reason:
    return {"reason": None} if not reason else cast("Reason", with_code("reason", reason))


def _known_reason(reason: str) -> KnownReason:
    return cast("KnownReason", with_code("reason", reason))


def _allocated(reason: str | None) -> Allocated:
    return {"allocated": None} if reason is None else cast("Allocated", with_code("allocated", reason))


def _act_view(act: Act) -> ActView:
    return {
        "at": iso(act.at),
        "by": act.by,
        "verified": act.verified,
        "act": act.act,
        "task": act.task,
        "element": act.element,
        "to": act.to,
        "why": act.why,
        "values": act.values,
        "mapping": act.mapping,
    }


def migration_view(report: MigrationReport, *, dry: bool) -> MigrationView:
    """Return the result of a migration, or of its check."""
    return {
        "process": report.process,
        "source": report.source,
        "target": report.target,
        "possible": report.is_possible,
        "migrated": report.is_possible and not dry,
        "findings": [
            {
                "element": finding.element,
                "name": finding.name,
                "target": finding.target,
                "token": finding.token,
                "task": report.tasks.get(finding.token or ""),
                "obstacle": finding.is_obstacle,
                **_known_reason(finding.reason),
            }
            for finding in report.findings
        ],
    }


def migration_of_all_view(
    definition: str, source: int, target: int, reports: Sequence[MigrationReport], *, dry: bool
) -> MigrationOfAllView:
    """Return the result of the migration of the processes of a version, or of its check."""
    views = [migration_view(report, dry=dry) for report in reports]
    return {
        "definition": definition,
        "source": source,
        "target": target,
        "migrated": sum(view["migrated"] for view in views),
        "refused": sum(not view["possible"] for view in views),
        "processes": views,
    }


def _incident_view(incident: IncidentRecord) -> IncidentView:
    return {
        "token": incident.token,
        "element": incident.element,
        "name": incident.name,
        **_known_reason(incident.reason),
        "since": iso(incident.since),
        "task": incident.task,
        "code": incident.code,
    }


def _retry_view(retry: Retry, due: datetime) -> RetryView:
    return {
        "token": retry.token,
        "element": retry.element,
        "name": retry.name,
        "task": retry.task,
        "failed": retry.failed,
        "attempts": retry.attempts,
        **_known_reason(retry.reason),
        "due": iso(due),
    }


def _moment_of(task: TaskRecord, name: str) -> str | None:
    attribute = task.entity.get(name)
    return None if attribute is None else str(attribute["value"]["@value"])


def _iso(moment: datetime | None) -> str | None:
    return None if moment is None else iso(moment)


def offer_view(record: OfferRecord) -> OfferView:
    """Return an offer, without what its acceptance would change."""
    return {
        "id": record.id,
        "entity": record.entity,
        "type": record.type,
        "name": record.name,
        "status": record.status,
        "foundAt": iso(record.found_at),
        "times": record.times,
        "inForce": record.in_force,
        "hasFile": record.has_file,
        "attributes": _attributes(record),
        "faults": cast("list[BpmnWarning]", as_json(record.faults)),
        "warnings": cast("list[BpmnWarning]", as_json(record.warnings)),
        "decisions": [
            {
                "at": iso(decision.at),
                "status": decision.status,
                "by": decision.by,
                "verified": decision.verified,
                "why": decision.why,
                "deployed": [{"name": name, "version": version} for name, version in decision.deployed],
            }
            for decision in record.decisions
        ],
        "definitions": [],
        "changes": [],
        "allocation": [],
    }


def changed_attributes(before: OfferRecord | None, after: OfferRecord) -> list[OfferedChange]:
    """Return the attributes in which an offer differs from the content in force."""
    old, new = {} if before is None else _attributes(before), _attributes(after)
    return [
        {
            "process": None,
            "element": name,
            "name": None,
            "change": "added" if name not in old else "removed" if name not in new else "changed",
            "before": old.get(name),
            "after": new.get(name),
        }
        for name in {**new, **old}
        if old.get(name) != new.get(name)
    ]


def element_change_view(change: ElementChange) -> OfferedChange:
    """Return an element of a process that would change."""
    return {
        "process": change.process,
        "element": change.element,
        "name": change.name,
        "change": change.change,
        "before": None,
        "after": None,
    }


def _attributes(record: OfferRecord) -> dict[str, Any]:
    values = to_key_values(record.content)
    return {name: value for name, value in values.items() if name not in {"id", "type"}}
