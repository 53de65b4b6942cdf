"""Records: the stored state of definitions, processes and Tasks, and the changes of one step.

A `Step` collects all changes of one transaction: received changes of Tasks, the state of processes, new Tasks
and the messages to the broker. Either all are written or none.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from enum import StrEnum
from typing import Any

from handover.security.audit_trail import AuditedRequest
from handover.tasks.task_life import FINISHED, performers_of
from handover_bpmn.execution.machine import Effect
from handover_bpmn.model import Fault
from handover_datamodels.entities import TaskStatus
from handover_processes.allocation.mapping import MappingTable
from handover_processes.deployed_forms import FormRecord
from handover_processes.tally import Tally, elapsed_ms


@dataclass(frozen=True, slots=True)
class DefinitionRecord:
    """A deployed version of a BPMN file; versions of a name count from 1."""

    name: str
    version: int
    digest: str
    title: str
    label: str | None
    xml: bytes
    deployed_at: datetime
    source: str | None = None
    """The ProcessDefinition of another system that it was deployed from."""
    is_event_driven: bool = True
    """Whether its start events and filters of entities are needed at start-up; else it is read when used."""


class HoldKind(StrEnum):
    """What is withheld from a definition."""

    PAUSED = "paused"
    """Its timer start events wait."""
    SUSPENDED = "suspended"
    """No process of it starts, by whatever means."""
    DELETED = "deleted"
    """Likewise, and it is not listed; processes of it that have ended can be read."""


EVERY_DEFINITION = "*"
"""The name under which all definitions are paused."""


@dataclass(frozen=True, slots=True)
class DefinitionHold:
    """That a definition is paused, suspended or deleted, with the person who has decided it."""

    definition: str
    kind: HoldKind
    by: str
    why: str | None
    at: datetime
    verified: bool = False


@dataclass(frozen=True, slots=True)
class DeletedVersion:
    """That a version of a definition is deleted: nothing starts it; processes of it can be read."""

    definition: str
    version: int
    by: str
    why: str | None
    at: datetime
    verified: bool = False


class OfferStatus(StrEnum):
    """What has become of an offer."""

    OPEN = "open"
    ACCEPTED = "accepted"
    REJECTED = "rejected"
    SUPERSEDED = "superseded"
    WITHDRAWN = "withdrawn"


@dataclass(frozen=True, slots=True)
class Decision:
    """An engineer has accepted or rejected an offer; `verified`: `by` is the name of who was signed in."""

    at: datetime
    status: OfferStatus
    by: str
    why: str | None = None
    deployed: tuple[tuple[str, int], ...] = ()
    """Name and version of the definitions that were deployed."""
    verified: bool = False


@dataclass(frozen=True, slots=True)
class OfferRecord:
    """A definition of another system in the broker, offered to an engineer.

    An offer is one content of one entity; the same content that returns is the same offer.
    """

    id: str
    entity: str
    type: str
    name: str
    status: OfferStatus
    found_at: datetime
    content: Mapping[str, Any] = field(repr=False)
    """The entity in simplified form; the BPMN file is stored separately."""
    faults: tuple[Fault, ...] = ()
    warnings: tuple[Fault, ...] = ()
    has_file: bool = False
    times: int = 1
    """How often the entity has had this content."""
    decisions: tuple[Decision, ...] = ()
    in_force: bool = False
    """Whether it is the content of its entity that was accepted last."""

    @property
    def is_decided(self) -> bool:
        """Return whether an engineer has decided about it."""
        return bool(self.decisions)


class ActKind(StrEnum):
    """An action of a person on a process."""

    CANCEL = "cancel"
    RETRY = "retry"
    SKIP = "skip"
    MOVE = "move"
    CANCEL_BRANCH = "cancelBranch"
    SET_VARIABLES = "setVariables"
    PAUSE = "pause"
    RESUME = "resume"
    MIGRATE = "migrate"
    RELEASE = "release"


@dataclass(frozen=True, slots=True)
class Act:
    """An action of a person on a process: what, when, at which element and why.

    `by` is the name that was given; `verified`: it is the name of who was signed in. `values` are variables
    that were set.
    """

    at: datetime
    act: ActKind
    by: str | None = None
    task: str | None = None
    element: str | None = None
    to: str | None = None
    """The element to which a token was moved, or the version to which the process was migrated."""
    why: str | None = None
    values: Mapping[str, Any] | None = None
    mapping: Mapping[str, str] | None = None
    """The elements that a migration has mapped to elements of another id."""
    verified: bool = False


@dataclass(frozen=True, slots=True)
class IncidentRecord:
    """A token of a process that cannot continue; `task` is the failed Task, if one is the reason."""

    token: str
    element: str
    name: str
    reason: str
    since: datetime
    task: str | None = None
    code: str | None = None
    """The error code that the performer reported."""


@dataclass(frozen=True, slots=True)
class Unallocated:
    """An open activity without a Task, because no performer can take it now."""

    token: str
    visit: int
    element: str
    name: str
    reason: str
    since: datetime


class ReservationState(StrEnum):
    """What a reservation does."""

    WAITING = "waiting"
    HELD = "held"
    IMPOSSIBLE = "impossible"
    """What it needs is unknown, or cannot be had while another one is held; its activities are incidents."""
    RELEASED = "released"
    """A person has released it; the next activity within it reserves again."""
    ENDED = "ended"


@dataclass(frozen=True, slots=True)
class ReservationRecord:
    """The resources of spans (`handover:reserve`), reserved together while a token is within."""

    key: str
    element: str
    name: str
    state: ReservationState
    since: datetime
    """When its state began."""
    asked_at: datetime
    reason: str
    """Why it waits or is impossible, or what was reserved."""
    spans: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """The reserved agents of each span."""
    used: tuple[str, ...] = ()
    """The agents beside them that nobody else reserves meanwhile."""
    held_at: datetime | None = None
    outer: str | None = None
    """The key of the reservation of a calling process that has reserved everything already."""

    @property
    def agents(self) -> tuple[str, ...]:
        """Return the reserved agents."""
        return tuple(dict.fromkeys(agent for agents in self.spans.values() for agent in agents))


@dataclass(frozen=True, slots=True)
class Retry:
    """The attempts of an open activity: `failed` ones, of which `task` was the last.

    At `due` its Task is posted again; None while the next attempt is under way.
    """

    token: str
    visit: int
    element: str
    name: str
    task: str
    failed: int
    attempts: int
    reason: str
    due: datetime | None


@dataclass(frozen=True, slots=True)
class ProcessRecord:
    """The stored state of a process.

    `state` is the serialized state of the engine; it is deleted at the end of the process.
    """

    id: str
    definition: str
    version: int
    key: str | None
    status: TaskStatus
    parameters: Mapping[str, Any]
    variables: Mapping[str, Any]
    waiting: tuple[str, ...]
    reason: str | None
    started_at: datetime
    ended_at: datetime | None
    revision: int
    state: bytes | None = field(repr=False)
    incidents: tuple[IncidentRecord, ...] = ()
    partner: str | None = None
    """The process whose message has started it."""
    acts: tuple[Act, ...] = ()
    archived_at: datetime | None = None
    """When the deletion of its entities from the broker was decided; None before."""
    unallocated: tuple[Unallocated, ...] = ()
    retries: tuple[Retry, ...] = ()
    declined: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """The agents that have declined an open activity, by token and element."""
    reservations: tuple[ReservationRecord, ...] = ()
    """Those that are waited for or held, and the last ones that have ended."""
    number: int = 0
    """Its number among the processes of its definition, from 1; no other one ever has it."""
    title: str | None = None
    """The title that its definition gives it (`handover:process title`), once that can be evaluated."""


SPECIFICATION = "specification"
"""The work parameter that names the row of the Task in the specification database."""


@dataclass(frozen=True, slots=True)
class TaskRecord:
    """The last known state of a Task of the orchestrator; `entity` is as it was posted."""

    id: str
    process: str
    element: str
    visit: int
    token: str
    status: TaskStatus
    observed_at: datetime | None
    moves: int
    created_at: datetime
    deadline: datetime
    ended_at: datetime | None = None
    cancelled_at: datetime | None = None
    alerted: bool = False
    lost: int = 0
    outputs: Mapping[str, Any] | None = None
    entity: Mapping[str, Any] = field(default_factory=dict, repr=False)
    name: str = ""
    """The name of the activity as it is drawn."""
    allocated: str | None = None
    """Why its performer got it."""
    escalates_at: datetime | None = None
    """When the next level of its escalation is due; the due date is the first one."""
    escalated: int = 0
    """How many levels were reached."""
    chosen: bool = False
    """Whether its performer was chosen among several, so that another may get it."""
    status_since: datetime | None = None
    """When the orchestrator learned of its status; None: at its creation."""
    working_ms: int = 0
    """The time in progress, without the present status."""
    paused_ms: int = 0
    """The time paused, without the present status."""
    claims: int = 0
    """How often a person has claimed it in the tasklist."""
    claimed_by: str | None = None
    """The person who has claimed it and not returned it."""
    declined_by: tuple[str, ...] = ()
    """The persons who have declined it, while it is open for others."""
    unreadable: str | None = None
    """The rule that the entity in the broker breaks, so that its status there is not known."""

    @property
    def specification(self) -> str | None:
        """Return the id of its row in the specification database, if it has one."""
        parameters = self.entity.get("workParameters")
        row = parameters["value"].get(SPECIFICATION) if parameters is not None else None
        return row if isinstance(row, str) else None

    @property
    def stream(self) -> str:
        """Return the stream of the messages about it.

        That of the process; its own one if it waits for the specification database, which then delays
        nothing else.
        """
        return self.process if self.specification is None else self.id

    @property
    def finished(self) -> bool:
        """Return whether it is completed or failed."""
        return self.status in FINISHED

    @property
    def took_ms(self) -> int | None:
        """Return the time from its creation to its end, as the statistics count it."""
        return None if self.ended_at is None else elapsed_ms(self.created_at, self.ended_at)

    @property
    def involved(self) -> tuple[str, ...]:
        """Return the URNs of the resources that it involves."""
        links = self.entity.get("involves", {}).get("value", ())
        return tuple(str(link["object"]) for link in links)

    @property
    def performer(self) -> str:
        """Return who performs it; empty for a Task that people claim."""
        return next(iter(performers_of(self.involved)), "")

    def changed(self, **changes: Any) -> "TaskRecord":
        """Return the record with `changes`."""
        return replace(self, **changes)


class TaskActKind(StrEnum):
    """What a person does with a Task, or says of a Task or process."""

    CLAIM = "claim"
    RETURN = "return"
    DECLINE = "decline"
    COMPLETE = "complete"
    COMMENT = "comment"


@dataclass(frozen=True, slots=True)
class TaskAct:
    """What a person did with a Task, or a comment on a Task or process.

    `by` is the name that was given; `verified`: it is the name of who was signed in.
    """

    id: str
    process: str
    task: str | None
    kind: TaskActKind
    by: str
    at: datetime
    text: str | None = None
    verified: bool = False


@dataclass(frozen=True, slots=True)
class Move:
    """A change of the status of a Task, the `nth` from 1; the inbox stores each once."""

    task: str
    nth: int
    status: TaskStatus
    observed_at: datetime | None
    received_at: datetime


class MessageKind(StrEnum):
    """The kinds of writes to the broker; each is idempotent."""

    CREATE = "create"
    SPECIFY = "specify"
    """Write a row of the specification database, then create its Task, if it has one; or delete the row."""
    UPSERT = "upsert"
    DEFINE = "define"
    APPEND = "append"
    RAISE = "raise"
    CLEAR = "clear"
    DELETE = "delete"


@dataclass(frozen=True, slots=True)
class Message:
    """A message of the outbox; messages of one `stream` are delivered in the order of `seq`."""

    seq: int
    stream: str
    kind: MessageKind
    subject: str
    body: Any


class MessageOutcome(StrEnum):
    """What became of a message to a process."""

    DELIVERED = "delivered"
    STARTED = "started"
    STORED = "stored"
    DISCARDED = "discarded"


@dataclass(frozen=True, slots=True)
class MessageRecord:
    """A message to a process that nobody waited for yet."""

    id: str
    name: str
    key: Any
    variables: Mapping[str, Any]
    sender: str | None
    """The process that has sent it."""
    sent_at: datetime
    expires_at: datetime
    process: str | None = None
    """The only process that may get it; None: any that waits for it, or that it starts."""


class TimerKind(StrEnum):
    """What a timer is for."""

    EVENT = "event"
    RETRY = "retry"
    ESCALATION = "escalation"
    DEADLINE = "deadline"
    GRACE = "grace"


@dataclass(frozen=True, slots=True)
class StartTimer:
    """A timer start event of the latest version of a definition; `text` is the cycle of a repeating one."""

    definition: str
    event: str
    due: datetime
    text: str | None = None
    count: int = 0
    """How often it was due."""


@dataclass(frozen=True, slots=True)
class Timer:
    """A moment at which a process has to act; `subject` is the id of a Task, a token, or empty."""

    kind: TimerKind
    subject: str
    due: datetime


@dataclass
class Step:
    """The changes of one transaction."""

    next_seq: int
    definitions: list[DefinitionRecord] = field(default_factory=list)
    mappings: list[MappingTable] = field(default_factory=list)
    """New versions of the mapping."""
    processes: dict[str, ProcessRecord] = field(default_factory=dict)
    numbers: dict[str, int] = field(default_factory=dict)
    """The highest number of a process of each definition that has started one."""
    tasks: dict[str, TaskRecord] = field(default_factory=dict)
    new: set[str] = field(default_factory=set)
    """Ids of processes and Tasks that are not in the database yet."""
    touched: set[str] = field(default_factory=set)
    """Processes that were changed, or whose change failed."""
    ended: set[str] = field(default_factory=set)
    """Processes that have ended in this step."""
    moves: list[Move] = field(default_factory=list)
    task_acts: list[TaskAct] = field(default_factory=list)
    forms: list[FormRecord] = field(default_factory=list)
    """New versions of forms."""
    start_timers: dict[str, tuple[StartTimer, ...]] = field(default_factory=dict)
    """All start timers of definitions that have changed."""
    messages: list[Message] = field(default_factory=list)
    delivered: list[int] = field(default_factory=list)
    effects: list[tuple[str, Effect]] = field(default_factory=list)
    """Messages and signals that processes have thrown, each with the id of the process."""
    to_index: dict[str, None] = field(default_factory=dict)
    """Processes that may wait for other messages and signals than before."""
    messages_stored: dict[str, MessageRecord] = field(default_factory=dict)
    messages_taken: set[str] = field(default_factory=set)
    """Stored messages that were delivered or have expired."""
    entities_seen: dict[tuple[str, str], str | None] = field(default_factory=dict)
    """Digests of entities by filter and id; None: forgotten."""
    offers: dict[str, OfferRecord] = field(default_factory=dict)
    """Offers that are new or have changed."""
    offer_files: dict[str, bytes] = field(default_factory=dict)
    """BPMN files of offers."""
    offers_deleted: set[str] = field(default_factory=set)
    holds: dict[tuple[str, HoldKind], DefinitionHold | None] = field(default_factory=dict)
    """Holds of definitions that begin; None: that end."""
    deleted_versions: list[DeletedVersion] = field(default_factory=list)
    archived: list[ProcessRecord] = field(default_factory=list)
    """Ended processes, as read from the database, that get `archived_at` now."""
    tally: Tally = field(default_factory=Tally)
    """What the step adds to the statistics."""
    requests: list[AuditedRequest] = field(default_factory=list)
    """The requests that cause the step, for the audit log."""
    signed_in: str | None = None
    """The name of who is signed in and requests the change that is applied now; None for anybody else."""

    def is_verified(self, by: str | None) -> bool:
        """Return whether `by` is the name of who is signed in."""
        return by is not None and by == self.signed_in

    def enqueue(self, stream: str, kind: MessageKind, subject: str, body: Any) -> None:
        """Put a message into the outbox."""
        self.messages.append(Message(self.next_seq, stream, kind, subject, body))
        self.next_seq += 1

    def __bool__(self) -> bool:
        """Return whether there is anything to write."""
        return bool(
            self.definitions
            or self.mappings
            or self.processes
            or self.tasks
            or self.messages
            or self.delivered
            or self.task_acts
            or self.forms
            or self.messages_stored
            or self.messages_taken
            or self.start_timers
            or self.entities_seen
            or self.holds
            or self.deleted_versions
            or self.offers
            or self.offers_deleted
            or self.requests
        )
