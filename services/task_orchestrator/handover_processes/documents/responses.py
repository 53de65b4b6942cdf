"""The responses of the REST interface. The page's TypeScript types are generated from them.

The routes return JSON without a validation by these types, which would cost time in long lists. The
integration tests validate every response.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NotRequired

from pydantic_core import to_json
from starlette.responses import Response
from typing_extensions import TypedDict

from handover_bpmn.execution.queries import ScopeKind
from handover_bpmn.execution.state import TokenState
from handover_datamodels.entities import TaskStatus
from handover_processes.allocation.mapping import NameKind
from handover_processes.records.definitions import HoldKind
from handover_processes.records.messages import MessageOutcome
from handover_processes.records.offers import OfferStatus
from handover_processes.records.processes import ActKind, ReservationState


def json_response(content: Mapping[str, Any] | Sequence[Mapping[str, Any]]) -> Response:
    """Return `content` as JSON."""
    return Response(to_json(content, inf_nan_mode="null"), media_type="application/json")


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
    at: str
    verified: bool


class DefinitionView(TypedDict):
    """A version of a definition; `unusable` is the reason why this release cannot run it.

    `translations` are the texts of its file in other languages: by language, then by the text of the file.
    """

    name: str
    version: int
    label: str | None
    title: str
    deployedAt: str
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


class ElementCounts(TypedDict):
    """The counts of a BPMN activity; durations are from creation to end."""

    running: int
    completed: int
    failed: int
    lastMs: int | None
    medianMs: int | None


class ProcessCounts(TypedDict):
    """The number of processes by state."""

    running: int
    completed: int
    failed: int


class VersionStatistics(TypedDict):
    """The statistics of a version."""

    name: str
    version: int
    processes: ProcessCounts
    elements: dict[str, ElementCounts]


class PeriodStatistics(ProcessCounts):
    """The statistics of a period."""

    medianMs: int | None


class Durations(TypedDict):
    """The durations of what was completed: the mean is exact, the percentiles are within 9 %."""

    medianMs: int | None
    p90Ms: int | None
    meanMs: int | None


class DefinitionTimes(Durations):
    """The processes of a definition: `running` and `withIncidents` now, all others in the period."""

    definition: str
    title: str
    running: int
    withIncidents: int
    started: int
    completed: int
    failed: int


class ElementTimes(Durations):
    """The Tasks of an element: `waiting`, `working` and `paused` are open now, others ended in the period.

    The means of the time until a performer began, of the work and of pauses add up to the mean duration.
    """

    element: str
    name: str
    waiting: int
    working: int
    paused: int
    completed: int
    failed: int
    cancelled: int
    waitingMs: int | None
    workingMs: int | None
    pausedMs: int | None


class ElementsView(TypedDict):
    """The statistics of a definition and its elements; `version` null: of all versions."""

    since: str
    until: str
    version: int | None
    processes: DefinitionTimes
    elements: list[ElementTimes]


class ThroughputPoint(TypedDict):
    """The processes that started and ended in an hour or on a day (UTC)."""

    at: str
    started: int
    completed: int
    failed: int


class ThroughputView(TypedDict):
    """The throughput of a period."""

    since: str
    until: str
    points: list[ThroughputPoint]


class CauseView(TypedDict):
    """Open incidents with the same cause at the same element; `processes` names the latest of them."""

    definition: str
    version: int
    title: str
    element: str
    name: str
    reason: str
    reasonCode: str | None
    reasonParameters: dict[str, Any] | None
    count: int
    since: str
    processes: list[str]


class ResourceTimes(TypedDict):
    """The working time of a resource, and its share of the time in which it was available.

    Available is the time of its shifts, or all time, times its capacity.
    """

    resource: str
    workingMs: int
    availableMs: int
    utilisation: float | None


class ResourcesView(TypedDict):
    """The utilisation of resources in a period, until now at most."""

    since: str
    until: str
    resources: list[ResourceTimes]


class Reason(TypedDict):
    """A reason; the page translates it by its code and parameters."""

    reason: str | None
    reasonCode: NotRequired[str]
    reasonParameters: NotRequired[dict[str, Any]]


class KnownReason(TypedDict):
    """A reason that is never absent."""

    reason: str
    reasonCode: NotRequired[str]
    reasonParameters: NotRequired[dict[str, Any]]


class IncidentView(KnownReason):
    """A token that cannot continue at `element`; `task` is the failed Task if one is the reason.

    `element` is the path `call.element` in a called process. `code` is the error code of the performer.
    """

    token: str
    element: str
    name: str
    since: str
    task: str | None
    code: str | None


class UnallocatedView(KnownReason):
    """An open activity without a Task, because no performer can take it now."""

    token: str
    element: str
    name: str
    since: str


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
    due: str


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
    startedAt: str
    endedAt: str | None
    archivedAt: str | None
    waiting: list[str]
    incidents: list[IncidentView]
    unallocated: list[UnallocatedView]
    retries: list[RetryView]
    retry: str | None


class NextActivity(TypedDict):
    """An activity that may follow; `involves` has the URNs of the resources that are known."""

    element: str
    name: str
    description: str | None
    lane: str | None
    involves: list[str]


class StatusChange(TypedDict):
    """A status of a Task, and when it was reached."""

    status: TaskStatus
    at: str


class Allocated(TypedDict):
    """The reason why the performer of a Task was chosen."""

    allocated: str | None
    allocatedCode: NotRequired[str]
    allocatedParameters: NotRequired[dict[str, Any]]


class TaskView(Reason, Allocated):
    """A Task of a process.

    Until `deadline` a performer accepts it, null if people may at any time; until `dueDate` it should be
    completed.
    """

    id: str
    element: str
    name: str
    visit: int
    description: str | None
    status: TaskStatus
    involves: list[str]
    workParameters: Mapping[str, Any]
    outputParameters: Mapping[str, Any] | None
    createdAt: str
    deadline: str | None
    priority: int | None
    dueDate: str | None
    followUpDate: str | None
    endedAt: str | None
    cancelled: bool
    history: list[StatusChange]


class ActView(TypedDict):
    """An action of a person on a process; `verified`: `by` is the name of who was signed in.

    `to` is the element that a token was moved to, or the version that the process was migrated to; `values`
    are the variables that were set, `mapping` the elements that have another id in the new version.
    """

    at: str
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
    since: str
    askedAt: str
    heldAt: str | None
    agents: list[str]
    uses: list[str]
    isShared: bool


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
    variables: Mapping[str, Any]


class ProcessView(ProcessSummary):
    """A process with all details; `done` of its `activities` were completed at least once.

    `tokens` and `scopes` are those of a running process, the first 1000 of each.
    """

    parameters: Mapping[str, Any]
    variables: Mapping[str, Any]
    next: list[NextActivity]
    done: int
    activities: int
    elements: dict[str, ElementCounts]
    acts: list[ActView]
    reservations: list[ReservationView]
    tokens: list[TokenView]
    scopes: list[ScopeView]
    tasks: list[TaskView]


class MappedName(TypedDict):
    """An entry of the mapping: a name in process files, and its resource, its role or its skills."""

    kind: NameKind
    name: str
    resource: NotRequired[str]
    role: NotRequired[str]
    skills: NotRequired[list[str]]
    definition: NotRequired[str]
    parameters: NotRequired[dict[str, Any]]


class MappingView(TypedDict):
    """A version of the mapping; `verified`: `by` is the name of who was signed in."""

    version: int
    by: str | None
    verified: bool
    why: str | None
    at: str | None
    entries: list[MappedName]


class NamedActivity(TypedDict):
    """An activity of the latest version of a definition."""

    definition: str
    element: str
    name: str


class UsedNameView(TypedDict):
    """A name in deployed definitions that the mapping can relate to a performer.

    `performer` is null without an entry: then people of the tasklist get the work.
    """

    kind: NameKind
    name: str
    performer: str | None
    activities: list[NamedActivity]


class MissingSkills(TypedDict):
    """An entry of the mapping whose role or skills no agent has."""

    kind: NameKind
    name: str
    warning: str
    warningCode: NotRequired[str]
    warningParameters: NotRequired[dict[str, Any]]


class MappingUse(TypedDict):
    """How the mapping and the deployed definitions fit together."""

    names: list[UsedNameView]
    missing: list[MissingSkills]


class ShiftView(TypedDict):
    """A time of a weekday (Monday is 1) in which an agent works."""

    weekday: int
    begins: str
    ends: str
    zone: str


class AgentTask(TypedDict):
    """An open Task of an agent, and why the agent got it."""

    id: str
    process: str
    element: str
    name: str
    status: TaskStatus
    since: str
    allocated: str | None
    allocatedCode: NotRequired[str]
    allocatedParameters: NotRequired[dict[str, Any]]


class SkillView(TypedDict):
    """How well an agent has a skill."""

    level: float
    cost: float
    speed: float


class AgentView(TypedDict):
    """A Device or Person that performs Tasks; `tasks` are its open ones, without cancelled ones.

    A `capacity` of null is unlimited. `position` is in metres, or longitude and latitude in degrees if
    `isGeographic`. `reservedBy` is the process that has reserved it.
    """

    id: str
    isPerson: bool
    skills: dict[str, SkillView]
    roles: list[str]
    capacity: int | None
    unavailable: str | None
    isOnShift: bool
    shifts: list[ShiftView]
    position: list[float] | None
    isGeographic: bool
    tasks: list[AgentTask]
    reservedBy: str | None


class SentMessage(TypedDict):
    """The outcome of a message, and the process that it reached or started."""

    outcome: MessageOutcome
    process: str | None


class SentSignal(TypedDict):
    """The processes that a signal reached or started."""

    processes: list[str]


class MigrationFinding(KnownReason):
    """What differs at an element; an obstacle prevents the migration.

    `token` is the token there and `task` its open Task; `target` is the element of the new version, if it has
    another id.
    """

    element: str
    name: str
    target: str | None
    token: str | None
    task: str | None
    obstacle: bool


class MigrationView(TypedDict):
    """The result of a migration or of its check: it is possible if no finding is an obstacle."""

    process: str
    source: int
    target: int
    possible: bool
    migrated: bool
    findings: list[MigrationFinding]


class MigrationOfAllView(TypedDict):
    """The result of the migration of the processes of a version, or of its check.

    A process that ended meanwhile is not among them.
    """

    definition: str
    source: int
    target: int
    migrated: int
    refused: int
    processes: list[MigrationView]


class PausedProcesses(TypedDict):
    """The processes that were paused or resumed."""

    processes: list[str]


class DeployedVersion(TypedDict):
    """A version of a definition that was deployed from an offer."""

    name: str
    version: int


class OfferDecision(TypedDict):
    """A decision about an offer; `by` is the name that was given."""

    at: str
    status: OfferStatus
    by: str
    verified: bool
    why: str | None
    deployed: list[DeployedVersion]


class OfferedChange(TypedDict):
    """An element of a process, or an attribute of an entity, that the acceptance would change."""

    process: str | None
    element: str
    name: str | None
    change: Literal["added", "removed", "changed"]
    before: Any
    after: Any


class OfferView(TypedDict):
    """A definition of another system; `definitions`, `changes` and `allocation` are of open offers only."""

    id: str
    entity: str
    type: str
    name: str
    status: OfferStatus
    foundAt: str
    times: int
    inForce: bool
    hasFile: bool
    attributes: dict[str, Any]
    faults: list[BpmnWarning]
    warnings: list[BpmnWarning]
    decisions: list[OfferDecision]
    definitions: list[CheckedDefinition]
    changes: list[OfferedChange]
    allocation: list[ActivityAllocation]
