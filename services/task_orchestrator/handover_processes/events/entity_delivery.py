"""Entity delivery: brings entities of the broker, as messages, signals and conditions, to processes.

A message goes to one process of each definition: the one that waits for it and started first, else a new
one. A signal goes to everyone. A condition is evaluated for each entity and occurs when it becomes true for
it. What was seen is part of the same step as its consequences, so each event has them once.
"""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from handover.errors import Problem
from handover.telemetry import get_logger
from handover_bpmn.execution.queries import EntityWait
from handover_bpmn.execution.state import RunFailed, WaitType
from handover_bpmn.languages.base import ExpressionError
from handover_bpmn.model import ConditionalEvent, Definition, EntityFilter, Kind, MessageEvent, entity_filter
from handover_datamodels.forms import to_key_values
from handover_processes.events.correlation import EventStart
from handover_processes.events.entity_matching import (
    BASELINE,
    CONTACT,
    SeenEntities,
    digest_of,
    is_correlated,
)
from handover_processes.events.event_delivery import EventDelivery, ProcessStarter
from handover_processes.process.process import Process
from handover_processes.records.entities import definition_id
from handover_processes.records.step import Step
from handover_processes.settings import OrchestratorSettings

log = get_logger(__name__)

MAX_KEY_LENGTH = 200
"""Characters of a business key."""

Entity = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Watched:
    """A filter that is in use; `messages` are messages and signals."""

    on: EntityFilter
    messages: bool
    conditions: bool


@dataclass(frozen=True, slots=True)
class _EntityStart:
    """A start event of the latest version of a definition."""

    definition: Definition
    event: str
    on: EntityFilter
    message: str | None
    """The name of the message; None for a signal or condition."""
    condition: ConditionalEvent | None

    @property
    def key(self) -> str:
        """Return the key under which the entities are stored for which the condition holds."""
        text = None if self.condition is None else self.condition.condition.text
        return digest_of([self.definition.name, self.event, self.on.key, text])


class EntityDelivery:
    """The processes and start events that wait for entities, and the entities that were seen."""

    def __init__(
        self,
        settings: OrchestratorSettings,
        processes: Mapping[str, Process],
        events: EventDelivery,
        start: ProcessStarter,
    ) -> None:
        self._settings = settings
        self._processes = processes
        self._events = events
        self._start = start
        self._definitions: dict[str, Definition] = {}
        self._starts: dict[str, list[_EntityStart]] = {}
        self.seen = SeenEntities()
        self._failing: dict[tuple[str, str], str] = {}
        """Why the condition of a start event cannot be evaluated, by the key of the start and the entity."""

    # Filters

    def add_definition(self, definition: Definition) -> None:
        """Take the filters and the start events of the latest version of a definition."""
        self.remove_definition(definition.name)
        self._definitions[definition.name] = definition
        for node in definition.scope.nodes.values():
            on = entity_filter(node)
            if node.kind is not Kind.START_EVENT or on is None:
                continue
            event = node.event
            start = _EntityStart(
                definition,
                node.id,
                on,
                _name_of(event) if isinstance(event, MessageEvent) else None,
                event if isinstance(event, ConditionalEvent) else None,
            )
            self._starts.setdefault(on.key, []).append(start)

    def remove_definition(self, name: str) -> None:
        """Remove the filters and start events of a definition."""
        self._definitions.pop(name, None)
        for key, starts in list(self._starts.items()):
            removed = {start.key for start in starts if start.definition.name == name}
            self._failing = {
                failing: why for failing, why in self._failing.items() if failing[0] not in removed
            }
            self._starts[key] = [start for start in starts if start.definition.name != name]

    def user_of(self, key: str) -> tuple[str, str]:
        """Return the ProcessDefinition that uses a filter, and the name of the event as it is drawn."""
        definitions = [
            *self._definitions.values(),
            *(process.plan.definition for process in self._processes.values()),
        ]
        for definition in definitions:
            for node in definition.entity_events():
                on = entity_filter(node)
                if on is not None and on.key == key:
                    return definition_id(self._settings, definition), node.name or node.id
        return self._settings.entity_id("ProcessDefinition", "unknown"), key

    def watched(self) -> dict[str, Watched]:
        """Return the filters of the latest definitions and of running processes, by key.

        A definition counts from its deployment on. So a filter is in use before a process waits for it, and
        an entity that is created just after that is no part of the baseline.
        """
        filters: dict[str, Watched] = {}
        definitions = {
            id(known_definition): known_definition for known_definition in self._definitions.values()
        }
        for process in self._processes.values():
            definitions[id(process.plan.definition)] = process.plan.definition
        for definition in definitions.values():
            for node in definition.entity_events():
                on = entity_filter(node)
                if on is not None:
                    _add(filters, on, is_condition=isinstance(node.event, ConditionalEvent))
        index = self._events.entity_index
        for key, on in index.filters.items():  # those of called processes
            if key not in filters:
                filters[key] = Watched(on, messages=True, conditions=key in index.conditions)
        return filters

    def has_conditions(self, key: str) -> bool:
        """Return whether the condition of a process or start event is evaluated for this filter."""
        starts = any(start.condition is not None for start in self._starts.get(key, ()))
        return starts or key in self._events.entity_index.conditions

    def business_keys(self, key: str, entities: Iterable[Entity]) -> set[str]:
        """Return the business keys of the processes that `entities` could start."""
        business_keys = set()
        for start in self._starts.get(key, ()):
            if start.on.correlation is not None:
                business_keys |= {_business_key(start.on, to_key_values(entity)) for entity in entities}
        return {business_key for business_key in business_keys if business_key is not None}

    # Changes within a step

    def set_baseline(self, step: Step, key: str, entities: Iterable[Entity], *, is_complete: bool) -> None:
        """Store entities that existed when the filter was new: they are no events."""
        for entity in entities:
            step.entities_seen[key, entity["id"]] = digest_of(entity)
        if is_complete:
            step.entities_seen[key, BASELINE] = BASELINE

    def receive(
        self, step: Step, key: str, entities: Iterable[Entity], taken: Mapping[str, str], now: datetime
    ) -> None:
        """Deliver the entities that are new or have changed; `taken` are business keys in use, by key."""
        for entity in entities:
            digest = digest_of(entity)
            if self.seen.digest(key, entity["id"], step.entities_seen) == digest:
                continue
            step.entities_seen[key, entity["id"]] = digest
            if not self.is_own(entity["id"]):
                self._deliver(step, key, to_key_values(entity), taken, now)

    def judge(
        self, step: Step, key: str, entities: Iterable[Entity], taken: Mapping[str, str], now: datetime
    ) -> None:
        """Evaluate the conditions of processes and start events for entities."""
        for entity in entities:
            if self.is_own(entity["id"]):
                continue
            simplified = to_key_values(entity)
            for process, wait in self._waits(step, key):
                if wait.type is WaitType.CONDITION and is_correlated(process, wait, simplified):
                    variables = {wait.on.variable: simplified}
                    self._judge(step, process, wait, now, entity=entity["id"], variables=variables)
            for start in self._starts.get(key, ()):
                if start.condition is not None:
                    self._judge_start(step, start, simplified, taken, now)

    def contact(self) -> str | None:
        """Return the time (ISO 8601) up to which all changes of conditions are known."""
        return self.seen.digest(CONTACT, BASELINE, {})

    def set_contact(self, step: Step, now: datetime) -> None:
        """Store that all changes of conditions are known up to `now`."""
        step.entities_seen[CONTACT, BASELINE] = now.isoformat(timespec="microseconds")

    def forget(self, step: Step, key: str, entities: Iterable[str], now: datetime) -> None:
        """Forget entities that the filter no longer selects: their conditions no longer hold."""
        scopes = [key, *(start.key for start in self._starts.get(key, ()) if start.condition is not None)]
        for entity in entities:
            for scope in scopes:
                self._failing.pop((scope, entity), None)
                if self.seen.digest(scope, entity, step.entities_seen) is not None:
                    step.entities_seen[scope, entity] = None
            for process, wait in self._waits(step, key):
                if wait.type is WaitType.CONDITION and entity in wait.holding:
                    self._judge(step, process, wait, now, entity=entity, variables=None)

    def has_unused(self) -> bool:
        """Return whether there are filters or conditions that are no longer in use."""
        return bool(self._unused())

    def remove_unused(self, step: Step) -> None:
        """Forget everything of filters and conditions that are no longer in use."""
        for key in self._unused():
            for entity in self.seen.entities(key):
                step.entities_seen[key, entity] = None

    def _unused(self) -> set[str]:
        used = {CONTACT, *(key for key, watch in self.watched().items() if watch.messages)}
        for starts in self._starts.values():
            used |= {start.key for start in starts if start.condition is not None}
        return self.seen.keys() - used

    def news(self, key: str, entities: Sequence[Entity]) -> list[Entity]:
        """Return the entities that are new or have changed."""
        present = {entity["id"]: digest_of(entity) for entity in entities}
        news = set(self.seen.news(key, present))
        return [entity for entity in entities if entity["id"] in news]

    def gone(self, key: str, present: Collection[str]) -> set[str]:
        """Return the entities that the filter selected before, or whose conditions hold, and not now."""
        vanished = set(self.seen.gone(key, present))
        for start in self._starts.get(key, ()):
            if start.condition is not None:
                vanished |= set(self.seen.gone(start.key, present))
        for process_id in self._events.entity_index.waiting(key):
            process = self._processes.get(process_id)
            if process is not None and process.run is not None:
                for wait in process.run.entity_waits():
                    if wait.on.key == key:
                        vanished |= set(wait.holding).difference(present)
        return vanished

    # Receivers

    def _waits(self, step: Step, key: str) -> list[tuple[Process, EntityWait]]:
        """Return the waits for a filter, in the order in which their processes started."""
        self._events.update_index(step)
        waiting = [self._processes.get(process_id) for process_id in self._events.entity_index.waiting(key)]
        processes = [process for process in waiting if process is not None and process.run is not None]
        processes.sort(key=lambda process: (process.record.started_at, process.record.id))
        return [
            (process, wait)
            for process in processes
            if process.run is not None
            for wait in process.run.entity_waits()
            if wait.on.key == key
        ]

    def _deliver(self, step: Step, key: str, entity: Entity, taken: Mapping[str, str], now: datetime) -> None:
        reached: set[tuple[str, str]] = set()
        for process, wait in self._waits(step, key):
            receiver = process.record.definition, wait.name
            is_message = wait.type is WaitType.MESSAGE
            if wait.type is WaitType.CONDITION or (is_message and receiver in reached):
                continue
            if not is_correlated(process, wait, entity):
                continue
            if self._hand_over(step, process, wait, entity, now) and is_message:
                reached.add(receiver)
        for start in self._starts.get(key, ()):
            if start.condition is None and (start.definition.name, start.message) not in reached:
                self._start_process(step, start, entity, taken)

    def _hand_over(
        self, step: Step, process: Process, wait: EntityWait, entity: Entity, now: datetime
    ) -> bool:
        if process.run is None or all(
            entity_wait.wait != wait.wait for entity_wait in process.run.entity_waits()
        ):
            return False  # an earlier delivery has ended this wait
        try:
            process.deliver(wait.wait, {wait.on.variable: dict(entity)}, step, now)
        except (RunFailed, Problem) as failure:
            log.warning("entity not delivered", process=process.record.id, error=str(failure))
            return False
        log.info("entity delivered", process=process.record.id, element=wait.element, entity=entity["id"])
        return True

    def _judge(
        self,
        step: Step,
        process: Process,
        wait: EntityWait,
        now: datetime,
        *,
        entity: str,
        variables: Mapping[str, Any] | None,
    ) -> None:
        try:
            if process.judge(wait.wait, entity, variables, step, now):
                self.set_contact(step, now)
        except RunFailed as failure:
            log.warning("condition not processed", process=process.record.id, error=str(failure))

    def _judge_start(
        self,
        step: Step,
        start: _EntityStart,
        entity: Entity,
        taken: Mapping[str, str],
        now: datetime,
    ) -> None:
        assert start.condition is not None  # noqa: S101 - only such a start is judged
        defaults = {parameter.name: parameter.default for parameter in start.definition.parameters.values()}
        try:
            holds = bool(start.condition.condition.value({**defaults, start.on.variable: entity}))
            self._failing.pop((start.key, entity["id"]), None)
        except ExpressionError as error:
            holds = False
            self._report_failing(start, entity["id"], str(error))
        held = self.seen.digest(start.key, entity["id"], step.entities_seen) is not None
        if holds == held:
            return
        step.entities_seen[start.key, entity["id"]] = BASELINE if holds else None
        self.set_contact(step, now)
        if holds:
            self._start_process(step, start, entity, taken)

    def _report_failing(self, start: _EntityStart, entity: str, error: str) -> None:
        """Log once that the condition of a start event cannot be evaluated for an entity, and why."""
        if self._failing.get((start.key, entity)) == error:
            return
        self._failing[start.key, entity] = error
        log.warning(
            "condition of a start event cannot be evaluated",
            definition=start.definition.name,
            element=start.event,
            entity=entity,
            error=error,
        )

    def _start_process(
        self, step: Step, start: _EntityStart, entity: Entity, taken: Mapping[str, str]
    ) -> None:
        name = start.definition.name
        if self._source(entity) == name:
            log.warning("an Alert about a process starts no process of the same definition", definition=name)
            return
        key = None
        if start.on.correlation is not None:
            key = _business_key(start.on, entity)
            if key is None:
                log.warning("entity has no business key", definition=name, entity=entity["id"])
                return
            owner = taken.get(key) or next(
                (
                    running.record.definition
                    for running in self._processes.values()
                    if running.record.key == key
                ),
                None,
            )
            if owner == name:
                return  # its process has started already
            if owner is not None:
                log.warning("business key in use by another definition", definition=name, key=key)
                key = None
        try:
            process = self._start(
                step, EventStart(name, start.event), {start.on.variable: dict(entity)}, partner=None, key=key
            )
        except Problem as problem:
            log.warning("entity starts no process", definition=name, error=str(problem))
        else:
            log.info("entity has started a process", process=process, entity=entity["id"])

    def _source(self, entity: Entity) -> str | None:
        """Return the definition of the process that an Alert is about; None for another entity."""
        source = entity.get("alertSource") if entity.get("type") == "Alert" else None
        return self._definition_of(source) if isinstance(source, str) else None

    def is_own(self, entity_id: str) -> bool:
        """Return whether the orchestrator itself has created an entity, as a Task or Process."""
        return self._definition_of(entity_id) is not None

    def _definition_of(self, entity_id: str) -> str | None:
        for type_, tail in (("Task", "-.+"), ("Process", "")):
            prefix = self._settings.entity_id(type_, "")
            if entity_id.startswith(prefix):
                made = re.fullmatch(f"(.+?)-[0-9a-f]{{12}}{tail}", entity_id.removeprefix(prefix))
                return made[1] if made is not None and made[1] in self._definitions else None
        return None


def _add(watched: dict[str, Watched], on: EntityFilter, *, is_condition: bool) -> None:
    before = watched.get(on.key)
    messages = not is_condition or (before is not None and before.messages)
    conditions = is_condition or (before is not None and before.conditions)
    watched[on.key] = Watched(on, messages, conditions)


def _name_of(event: MessageEvent) -> str | None:
    try:
        return str(event.name.value({}))
    except ExpressionError:
        return None  # a message of its own


def _business_key(on: EntityFilter, entity: Entity) -> str | None:
    try:
        key = on.correlated(entity)
    except ExpressionError:
        return None
    text = None if key is None else str(key)
    return text if text and len(text) <= MAX_KEY_LENGTH and "\0" not in text else None
