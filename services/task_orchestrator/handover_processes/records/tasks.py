"""Tasks: their last known state, and what people did with them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from enum import StrEnum
from typing import Any

from handover.tasks.task_life import FINISHED, performers_of
from handover_datamodels.entities import TaskStatus
from handover_processes.tally import elapsed_ms

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
