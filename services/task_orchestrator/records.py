"""Records: the stored state of definitions, processes and Tasks, and the changes of one step.

A `Step` collects all changes of one transaction: received changes of Tasks, the state of processes, new Tasks
and timers, and the messages to the broker. Either all are written or none.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from enum import StrEnum
from typing import Any

from datamodels.entities import TaskStatus
from handover.task_life import FINISHED


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


class ActKind(StrEnum):
    """An action of a person on a process."""

    CANCEL = "cancel"
    RETRY = "retry"


@dataclass(frozen=True, slots=True)
class Act:
    """An action of a person on a process: who (if known), what, when, and on which Task."""

    at: datetime
    act: ActKind
    by: str | None = None
    task: str | None = None


@dataclass(frozen=True, slots=True)
class ProcessRecord:
    """The stored state of a process.

    `state` is the serialized state of the engine. It is deleted at the end of the process, unless the Task
    `failed_by` has ended it: that Task may be retried.
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
    failed_by: str | None = None
    acts: tuple[Act, ...] = ()
    archived_at: datetime | None = None
    """When the deletion of its entities from the broker was decided; None before."""


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

    @property
    def finished(self) -> bool:
        """Return whether it is completed or failed."""
        return self.status in FINISHED

    @property
    def took_ms(self) -> int | None:
        """Return the time from its creation to its end."""
        if self.ended_at is None:
            return None
        return round((self.ended_at - self.created_at).total_seconds() * 1000)

    def changed(self, **changes: Any) -> "TaskRecord":
        """Return the record with `changes`."""
        return replace(self, **changes)


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
    UPSERT = "upsert"
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


class TimerKind(StrEnum):
    """What a timer is for."""

    EVENT = "event"
    DEADLINE = "deadline"
    GRACE = "grace"


@dataclass(frozen=True, slots=True)
class Timer:
    """A moment at which a process has to act; `subject` is the id of a Task, or empty."""

    kind: TimerKind
    subject: str
    due: datetime


@dataclass
class Step:
    """The changes of one transaction."""

    next_seq: int
    definitions: list[DefinitionRecord] = field(default_factory=list)
    processes: dict[str, ProcessRecord] = field(default_factory=dict)
    tasks: dict[str, TaskRecord] = field(default_factory=dict)
    new: set[str] = field(default_factory=set)
    """Ids of processes and Tasks that are not in the database yet."""
    touched: set[str] = field(default_factory=set)
    """Processes that were changed, or whose change failed."""
    ended: set[str] = field(default_factory=set)
    """Processes that have ended in this step."""
    moves: list[Move] = field(default_factory=list)
    timers: dict[str, tuple[Timer, ...]] = field(default_factory=dict)
    messages: list[Message] = field(default_factory=list)
    delivered: list[int] = field(default_factory=list)
    archived: list[ProcessRecord] = field(default_factory=list)
    """Ended processes, as read from the database, that get `archived_at` now."""

    def enqueue(self, stream: str, kind: MessageKind, subject: str, body: Any) -> None:
        """Put a message into the outbox."""
        self.messages.append(Message(self.next_seq, stream, kind, subject, body))
        self.next_seq += 1

    def __bool__(self) -> bool:
        """Return whether there is anything to write."""
        return bool(self.definitions or self.processes or self.tasks or self.messages or self.delivered)
