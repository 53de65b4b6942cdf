"""Documents of processes."""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any

from typing_extensions import TypedDict

from handover.errors import HandoverError
from handover_bpmn.execution.queries import ScopeKind
from handover_bpmn.execution.run import Run
from handover_bpmn.execution.state import TokenState
from handover_bpmn.languages.base import ExpressionError
from handover_bpmn.lookahead import activities_after_next, upcoming_activities
from handover_bpmn.model import Activity, Definition
from handover_bpmn.references import is_reference
from handover_datamodels.entities import TaskStatus
from handover_processes.allocation.allocator import Allocator
from handover_processes.definitions.definition_registry import DefinitionRegistry
from handover_processes.documents.document import From, Moment, OptionalMoment, coded, document, documents
from handover_processes.documents.reasons import KnownReason, Reason
from handover_processes.documents.statistics import ElementCounts, element_views
from handover_processes.documents.tasks import TaskView, task_view
from handover_processes.records.processes import (
    ActKind,
    ProcessRecord,
    ReservationRecord,
    ReservationState,
    Retry,
)
from handover_processes.records.tasks import Move, TaskRecord
from handover_processes.references import resource_id
from handover_processes.settings import OrchestratorSettings
from handover_processes.storage.counts import count_elements

_MADE_BY_PAGE = re.compile(r"[lm][0-9a-z]{7}-[0-9a-z]{7,8}|\S+ by \S+ after \S+", re.ASCII)
"""Business keys that the page makes, so that a double press starts one process; they name nothing."""


class IncidentView(KnownReason):
    """A token that cannot continue at `element`; `task` is the failed Task if one is the reason.

    `element` is the path `call.element` in a called process. `code` is the error code of the performer.
    """

    token: str
    element: str
    name: str
    since: Moment
    task: str | None
    code: str | None


class UnallocatedView(KnownReason):
    """An open activity without a Task, because no performer can take it now."""

    token: str
    element: str
    name: str
    since: Moment


class RetryView(KnownReason):
    """An activity whose Task `task` has failed and is posted again at `due`.

    `failed` of at most `attempts` attempts have failed.
    """

    token: str
    element: str
    name: str
    task: str
    failed: int
    attempts: int
    due: Moment


def _postponed(record: ProcessRecord) -> list[Retry]:
    return [retry for retry in record.retries if retry.due is not None]


def _failed_task(record: ProcessRecord) -> str | None:
    return next((incident.task for incident in record.incidents if incident.task is not None), None)


class ProcessSummary(Reason):
    """A process as an element of a list; `retry` is the first failed Task among the incidents.

    `name` is its name for people: the title that its definition gives it, else `title` (of the definition)
    with the business key `key` or with `number`, which no other process of the definition ever has.
    """

    id: str
    entity: str
    name: str
    definition: str
    version: int
    title: str
    number: int
    key: str | None
    status: TaskStatus
    startedAt: Moment
    endedAt: OptionalMoment
    archivedAt: OptionalMoment
    waiting: list[str]
    incidents: list[IncidentView]
    unallocated: list[UnallocatedView]
    retries: Annotated[list[RetryView], From(_postponed)]
    retry: Annotated[str | None, From(_failed_task)]


class NextActivity(TypedDict):
    """An activity that may follow; `involves` has the URNs of the resources that are known."""

    element: Annotated[str, From(lambda activity: activity.id)]
    name: str
    description: str | None
    lane: str | None
    involves: list[str]


class ActView(TypedDict):
    """An action of a person on a process; `verified`: `by` is the name of who was signed in.

    `to` is the element that a token was moved to, or the version that the process was migrated to; `values`
    are the variables that were set, `mapping` the elements that have another id in the new version.
    """

    at: Moment
    by: str | None
    verified: bool
    act: ActKind
    task: str | None
    element: str | None
    to: str | None
    why: str | None
    values: Mapping[str, Any] | None
    mapping: Mapping[str, str] | None


class ReservationView(KnownReason):
    """Agents that are reserved, or waited for, while a token is within `element` (`handover:reserve`).

    `reason` is why it waits or is impossible, or what was reserved; `since` is when its state began, `heldAt`
    when it was acquired. `agents` are reserved; nobody else reserves those of `uses` meanwhile. One that
    shares the agents of a calling process cannot be released by itself.
    """

    key: str
    element: str
    name: str
    state: ReservationState
    since: Moment
    askedAt: Moment
    heldAt: OptionalMoment
    agents: list[str]
    uses: Annotated[list[str], From(lambda reservation: reservation.used)]
    isShared: Annotated[bool, From(lambda reservation: reservation.outer is not None)]


class TokenView(TypedDict):
    """A token; `task` is its open Task, `instance` says which one of a multi-instance activity it is."""

    token: str
    element: str
    name: str
    state: TokenState
    instance: str
    task: str | None


class ScopeView(TypedDict):
    """The variables that only a part of a process sees; `outer` is the scope around it, null for the process.

    A part is a subprocess, an instance of a loop, a called process, or an activity with mapped inputs.
    """

    scope: str
    outer: str | None
    kind: ScopeKind
    element: str
    name: str
    instance: str
    variables: Annotated[Mapping[str, Any], From(lambda scope: dict(scope.variables))]


class ProcessView(ProcessSummary):
    """A process with all details; `done` of its `activities` were completed at least once.

    `afterNext` are the activities that may follow the first of `next`, the most likely first. `tokens` and
    `scopes` are those of a running process, the first 1000 of each.
    """

    parameters: Mapping[str, Any]
    variables: Mapping[str, Any]
    next: list[NextActivity]
    afterNext: list[NextActivity]
    done: int
    activities: int
    elements: dict[str, ElementCounts]
    acts: list[ActView]
    reservations: list[ReservationView]
    tokens: list[TokenView]
    scopes: list[ScopeView]
    tasks: list[TaskView]


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
    return document(ProcessSummary, record, **_identity(settings, registry, record))


def _identity(
    settings: OrchestratorSettings, registry: DefinitionRegistry, record: ProcessRecord
) -> dict[str, Any]:
    return {
        "entity": settings.entity_id("Process", record.id),
        "name": process_name(registry, record),
        "title": registry.record(record.definition, record.version).title,
        **coded("reason", record.reason or None),
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
    upcoming, following = (
        (find(definition, record.waiting, record.variables) if definition is not None else ())
        for find in (upcoming_activities, activities_after_next)
    )
    return document(
        ProcessView,
        record,
        **_identity(settings, registry, record),
        next=_next(settings, record, upcoming),
        afterNext=_next(settings, record, following),
        done=sum(count.completed > 0 for count in counts.values()),
        activities=len(activities),
        elements=element_views(counts),
        reservations=[_reservation_view(held, record, allocator) for held in record.reservations],
        tokens=[] if run is None else _token_views(run, tasks),
        scopes=[] if run is None else documents(ScopeView, run.inner_scopes()),
        tasks=[task_view(task, activities.get(task.element), history.get(task.id, [])) for task in tasks],
    )


def _token_views(run: Run, tasks: Sequence[TaskRecord]) -> list[TokenView]:
    open_tasks = {(task.token, task.visit): task.id for task in tasks if task.ended_at is None}
    return [
        document(TokenView, token, task=open_tasks.get((token.token, token.visit))) for token in run.tokens()
    ]


def _reservation_view(
    reservation: ReservationRecord, record: ProcessRecord, allocator: Allocator
) -> ReservationView:
    reason = reservation.reason
    if reservation.state is ReservationState.WAITING:
        # who holds it changes often, so it is not stored each time
        reason = allocator.waits_for((record.id, reservation.key)) or reason
    return document(ReservationView, reservation, **coded("reason", reason))


def _definition(registry: DefinitionRegistry, record: ProcessRecord) -> Definition | None:
    """Return the definition of a process; None if this release cannot read it."""
    try:
        return registry.plan_of(registry.record(record.definition, record.version)).definition
    except HandoverError:
        return None


def _next(
    settings: OrchestratorSettings, record: ProcessRecord, activities: Iterable[Activity]
) -> list[NextActivity]:
    return [
        document(NextActivity, activity, involves=_involved(settings, activity, record.variables))
        for activity in activities
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
