"""Event delivery: brings messages and signals to the processes that wait for them, within one step.

A message that nobody waits for is stored until somebody does, or until it expires.
"""

import secrets
from collections.abc import Callable, Mapping
from datetime import datetime, timedelta
from typing import Any, Protocol

from handover.errors import Problem
from handover.telemetry import get_logger
from handover_bpmn.execution.machine import ThrownMessage, ThrownSignal
from handover_bpmn.execution.state import WaitType
from handover_bpmn.model import Definition
from handover_processes.events.correlation import (
    EventStart,
    Name,
    Receiver,
    WaitIndex,
    event_starts,
    matches_key,
    receivers,
)
from handover_processes.events.entity_matching import EntityIndex
from handover_processes.events.stored_messages import StoredMessages
from handover_processes.process.process import Process
from handover_processes.records.messages import MessageOutcome, MessageRecord
from handover_processes.records.step import Step

log = get_logger(__name__)

MAX_DELIVERIES = 1_000
"""Deliveries in one step; what processes throw beyond them waits for the next step."""


class ProcessStarter(Protocol):
    """Starts a process at one of its start events, in a step."""

    def __call__(
        self,
        step: Step,
        start: EventStart,
        variables: Mapping[str, Any],
        *,
        partner: str | None,
        key: str | None = None,
    ) -> str:
        """Start the process and return its id; raise `Problem` if it cannot be started."""
        ...


class EventDelivery:
    """The messages that wait, the processes and start events that wait for messages and signals."""

    def __init__(
        self,
        processes: Mapping[str, Process],
        start: ProcessStarter,
        ttl_s: float,
        is_startable: Callable[[str], bool],
    ) -> None:
        self._processes = processes
        self._is_startable = is_startable
        self._start = start
        self._ttl = timedelta(seconds=ttl_s)
        self._starts: dict[Name, dict[str, EventStart]] = {}
        self.index = WaitIndex()
        self.entity_index = EntityIndex()
        self.stored = StoredMessages()
        self._awaited: frozenset[Name] = frozenset()
        """The names that processes have begun to wait for since stored messages were last looked at."""

    def add_definition(self, definition: Definition) -> None:
        """Take the start events of the latest version of a definition."""
        self.remove_definition(definition.name)
        for name, start in event_starts(definition):
            self._starts.setdefault(name, {})[definition.name] = start

    def remove_definition(self, definition: str) -> None:
        """Remove the start events of a definition."""
        for starts in self._starts.values():
            starts.pop(definition, None)

    def start_stored(self, step: Step, definition: str) -> None:
        """Bring the stored messages that a definition could not take while it was suspended to its starts."""
        names = [
            name
            for (type_, name), starts in self._starts.items()
            if type_ is WaitType.MESSAGE and definition in starts
        ]
        for record in self.stored.named(names):
            if record.process is None and record.id not in step.messages_taken:
                step.messages_taken.add(record.id)
                start = self._starts[WaitType.MESSAGE, record.name][definition]
                self._start(step, start, record.variables, partner=record.sender)

    def add_process(self, process: Process) -> None:
        """Index a process that was loaded from the database."""
        self._awaited |= self.index.update(process)
        self.entity_index.update(process)

    def record(
        self,
        name: str,
        key: Any,
        variables: Mapping[str, Any],
        now: datetime,
        *,
        sender: str | None = None,
        ttl: timedelta | None = None,
        process: str | None = None,
    ) -> MessageRecord:
        """Return a new message; with `process` no other process gets it, and it starts none."""
        expires_at = now + (self._ttl if ttl is None else ttl)
        return MessageRecord(
            secrets.token_hex(8), name, key, dict(variables), sender, now, expires_at, process
        )

    def publish(self, step: Step, record: MessageRecord, now: datetime) -> tuple[MessageOutcome, str | None]:
        """Bring a message of a client to its receiver; return what became of it, and the process.

        Raises `Problem` 409 if several processes wait for it.
        """
        self.update_index(step)
        candidates = self._receivers(record)
        if len({receiver.process.record.id for receiver in candidates}) > 1:
            raise Problem.translated(
                409,
                "Several processes wait",
                "process.message_ambiguous",
                '{count} processes wait for the message "{name}"; give the key or the process',
                count=len(candidates),
                name=record.name,
            )
        return self._hand_over(step, record, candidates, now)

    def broadcast(self, step: Step, name: str, variables: Mapping[str, Any], now: datetime) -> list[str]:
        """Bring a signal to everyone who waits for it; return the processes that got it or were started."""
        self.update_index(step)
        waiting = self._waiting(WaitType.SIGNAL, name)
        reached: dict[str, None] = {}
        for receiver in receivers(waiting, WaitType.SIGNAL, name, lambda *_: True):
            receiver.process.deliver(receiver.subscription.wait, variables, step, now)
            reached[receiver.process.record.id] = None
        for start in list(self._starts.get((WaitType.SIGNAL, name), {}).values()):
            if not self._is_startable(start.definition):
                continue
            try:
                reached[self._start(step, start, variables, partner=None)] = None
            except Problem as problem:
                log.warning("signal starts no process", definition=start.definition, error=str(problem))
        return list(reached)

    def settle(self, step: Step, now: datetime) -> None:
        """Deliver what the processes of a step have thrown, and stored messages that they now wait for."""
        for _ in range(MAX_DELIVERIES):
            self.update_index(step)
            if step.effects:
                sender, effect = step.effects.pop(0)
                if isinstance(effect, ThrownMessage):
                    thrown = self.record(effect.name, effect.key, effect.variables, now, sender=sender)
                    self._hand_over(step, thrown, self._receivers(thrown), now)
                elif isinstance(effect, ThrownSignal):
                    self.broadcast(step, effect.name, effect.variables, now)
                else:
                    log.info(
                        "escalation not caught", process=sender, element=effect.element, code=effect.code
                    )
            elif not self._deliver_stored(step, now):
                return
        for sender, effect in step.effects:
            if isinstance(effect, ThrownMessage):
                self._store(step, self.record(effect.name, effect.key, effect.variables, now, sender=sender))
        log.error("processes throw messages at each other without end", deliveries=MAX_DELIVERIES)
        step.effects.clear()

    def expire(self, step: Step, now: datetime) -> None:
        """Delete the stored messages whose time to live is over."""
        for record in self.stored.expired(now):
            if record.id not in step.messages_taken:
                log.warning("message expired", name=record.name, key=record.key)
                step.messages_taken.add(record.id)

    def next_expiry(self) -> datetime | None:
        """Return when the next stored message expires."""
        return self.stored.next_expiry()

    def apply(self, step: Step) -> None:
        """Take over what a step has stored, once it is written."""
        for record in step.messages_stored.values():
            self.stored.add(record)
        for taken in step.messages_taken:
            self.stored.remove(taken)
        self.update_index(step)

    def update_index(self, step: Step) -> None:
        """Index the processes that the step has changed since the last call."""
        for process_id in step.to_index:
            process = self._processes.get(process_id)
            if process is None:
                self.index.remove(process_id)
                self.entity_index.remove(process_id)
            else:
                self._awaited |= self.index.update(process)
                self.entity_index.update(process)
        step.to_index.clear()

    def _waiting(self, type_: WaitType, name: str) -> list[Process]:
        processes = (self._processes.get(process_id) for process_id in self.index.waiting(type_, name))
        return [process for process in processes if process is not None]

    def _receivers(self, record: MessageRecord) -> list[Receiver]:
        waiting = self._waiting(WaitType.MESSAGE, record.name)
        if record.process is not None:
            waiting = [process for process in waiting if process.record.id == record.process]
        matching = receivers(
            waiting,
            WaitType.MESSAGE,
            record.name,
            lambda process, waiting: matches_key(process, waiting, record.key),
        )
        return sorted(matching, key=lambda receiver: not self._are_partners(receiver.process, record.sender))

    def _are_partners(self, process: Process, sender: str | None) -> bool:
        if sender is None:
            return False
        other = self._processes.get(sender)
        return process.record.partner == sender or (
            other is not None and other.record.partner == process.record.id
        )

    def _hand_over(
        self, step: Step, record: MessageRecord, candidates: list[Receiver], now: datetime
    ) -> tuple[MessageOutcome, str | None]:
        if candidates:
            process = candidates[0].process
            process.deliver(candidates[0].subscription.wait, record.variables, step, now)
            return MessageOutcome.DELIVERED, process.record.id
        starts = self._starts.get((WaitType.MESSAGE, record.name), {}) if record.process is None else {}
        for start in (candidate for candidate in starts.values() if self._is_startable(candidate.definition)):
            started = self._start(step, start, record.variables, partner=record.sender)
            return MessageOutcome.STARTED, started
        if record.expires_at <= now:
            return MessageOutcome.DISCARDED, None
        self._store(step, record)
        return MessageOutcome.STORED, None

    def _store(self, step: Step, record: MessageRecord) -> None:
        step.messages_stored[record.id] = record

    def _deliver_stored(self, step: Step, now: datetime) -> bool:
        """Deliver one stored message that somebody waits for now; return whether there was one."""
        if not self._awaited:
            return False
        names = {name for type_, name in self._awaited if type_ is WaitType.MESSAGE}
        new = (record for record in step.messages_stored.values() if record.name in names)
        for record in (*self.stored.named(names), *new):
            if record.id in step.messages_taken:
                continue
            candidates = self._receivers(record)
            if candidates:
                step.messages_taken.add(record.id)
                self._hand_over(step, record, candidates, now)
                return True
        self._awaited = frozenset()
        return False
