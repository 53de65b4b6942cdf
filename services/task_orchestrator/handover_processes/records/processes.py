"""Processes: their stored state, what cannot continue in them, and what people did with them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import Any

from handover_datamodels.entities import TaskStatus


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
