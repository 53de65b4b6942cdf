"""Step: the unit of work, all changes of one transaction.

It collects received changes of Tasks, the state of processes, new Tasks and the messages to the broker.
Either all are written or none.
"""

from dataclasses import dataclass, field
from typing import Any

from handover.security.audit_trail import AuditedRequest
from handover_bpmn.execution.machine import Effect
from handover_processes.allocation.mapping import MappingTable
from handover_processes.deployed_forms import FormRecord
from handover_processes.records.definitions import DefinitionHold, DefinitionRecord, DeletedVersion, HoldKind
from handover_processes.records.messages import Message, MessageKind, MessageRecord
from handover_processes.records.offers import OfferRecord
from handover_processes.records.processes import ProcessRecord
from handover_processes.records.tasks import Move, TaskAct, TaskRecord
from handover_processes.records.timers import StartTimer
from handover_processes.tally import Tally


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
