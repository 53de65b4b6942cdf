"""Records: what the orchestrator keeps of definitions, processes and Tasks, and what one step changes.

A `Step` gathers everything that must become true at once: the news taken in, the process moved on, the
Tasks and timers that follow, and what the broker is to be told. It is written in one transaction or not at
all.
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
    """What somebody did with a process."""

    CANCEL = "cancel"
    RETRY = "retry"


@dataclass(frozen=True, slots=True)
class Act:
    """Something a person did with a process: who (if told), what, when, and with which Task."""

    at: datetime
    act: ActKind
    by: str | None = None
    task: str | None = None


@dataclass(frozen=True, slots=True)
class ProcessRecord:
    """A process as it is kept.

    `state` is the engine's. It goes when the process has ended, unless a failed Task, `failed_by`, was the
    end of it: then somebody may retry that.
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
    """When the deletion of its entities from the broker was decided; None while they belong there."""


@dataclass(frozen=True, slots=True)
class TaskRecord:
    """A Task of ours as last heard of; `entity` is as it was posted."""

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
        """Say whether it is completed or failed."""
        return self.status in FINISHED

    @property
    def took_ms(self) -> int | None:
        """Return how long it took from being handed out to its end."""
        if self.ended_at is None:
            return None
        return round((self.ended_at - self.created_at).total_seconds() * 1000)

    def changed(self, **changes: Any) -> "TaskRecord":
        """Return the record with `changes`."""
        return replace(self, **changes)


@dataclass(frozen=True, slots=True)
class Move:
    """News of a Task that was taken in: its `nth`, counted from 1. The inbox keeps each once."""

    task: str
    nth: int
    status: TaskStatus
    observed_at: datetime | None
    heard_at: datetime


class Saying(StrEnum):
    """What the broker, or whoever reads Alerts, is to be told; every one may be told twice."""

    CREATE = "create"
    UPSERT = "upsert"
    APPEND = "append"
    RAISE = "raise"
    CLEAR = "clear"
    DELETE = "delete"


@dataclass(frozen=True, slots=True)
class Message:
    """A line of the outbox. Messages of one `stream` are told in the order of `seq`."""

    seq: int
    stream: str
    saying: Saying
    subject: str
    body: Any


class TimerKind(StrEnum):
    """What a timer is for."""

    EVENT = "event"
    DEADLINE = "deadline"
    GRACE = "grace"


@dataclass(frozen=True, slots=True)
class Timer:
    """Something of a process that is due at a moment; `subject` is a Task's id, or empty."""

    kind: TimerKind
    subject: str
    due: datetime


@dataclass
class Step:
    """All that one transaction writes."""

    next_seq: int
    definitions: list[DefinitionRecord] = field(default_factory=list)
    processes: dict[str, ProcessRecord] = field(default_factory=dict)
    tasks: dict[str, TaskRecord] = field(default_factory=dict)
    new: set[str] = field(default_factory=set)
    """Ids of processes and Tasks that are not in the database yet."""
    touched: set[str] = field(default_factory=set)
    """Processes that were, or were to be, moved."""
    ended: set[str] = field(default_factory=set)
    """Processes that have ended in this step."""
    moves: list[Move] = field(default_factory=list)
    timers: dict[str, tuple[Timer, ...]] = field(default_factory=dict)
    messages: list[Message] = field(default_factory=list)
    delivered: list[int] = field(default_factory=list)
    archived: list[ProcessRecord] = field(default_factory=list)
    """Ended processes, as read from the database, that get `archived_at` now."""

    def say(self, stream: str, saying: Saying, subject: str, body: Any) -> None:
        """Put a message into the outbox."""
        self.messages.append(Message(self.next_seq, stream, saying, subject, body))
        self.next_seq += 1

    def __bool__(self) -> bool:
        """Say whether there is anything to write."""
        return bool(self.definitions or self.processes or self.tasks or self.messages or self.delivered)
