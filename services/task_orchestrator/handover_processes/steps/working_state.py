"""Working state: what the orchestrator has in memory of its database, and how a step changes it.

A step changes processes while it is collected; everything else changes in `apply`, once the step is written.
"""

import asyncio
import secrets
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

from handover.errors import HandoverError, Problem
from handover_bpmn.model import Definition
from handover_datamodels.entities import TaskStatus
from handover_processes import metrics
from handover_processes.allocation.allocator import Allocator
from handover_processes.allocation.mapping import MappingTable
from handover_processes.definitions.definition_registry import DefinitionRegistry
from handover_processes.definitions.offer_rules import Offers
from handover_processes.events.correlation import EventStart
from handover_processes.events.entity_delivery import EntityDelivery
from handover_processes.events.entity_matching import SeenEntities
from handover_processes.events.event_delivery import EventDelivery
from handover_processes.events.stored_messages import StoredMessages
from handover_processes.process.process import Process
from handover_processes.records.definitions import DefinitionHold, DefinitionRecord, HoldKind
from handover_processes.records.processes import ProcessRecord
from handover_processes.records.step import Step
from handover_processes.records.timers import StartTimer
from handover_processes.settings import OrchestratorSettings
from handover_processes.steps.active_processes import ActiveProcesses
from handover_processes.storage.store import Store

MAX_ALLOCATION_ROUNDS = 20
"""Rounds of the search for performers in one step; the next round is in the next step."""

Clock = Callable[[], datetime]


def utc_now() -> datetime:
    """Return the present time."""
    return datetime.now(UTC)


class WorkingState:
    """Definitions, running processes, agents, and what is waited for.

    `on_disk` runs a blocking action of the store in the one thread that may.
    """

    def __init__(
        self,
        settings: OrchestratorSettings,
        store: Store,
        on_disk: Callable[..., Awaitable[Any]],
        clock: Clock,
    ) -> None:
        self.settings = settings
        self.store = store
        self.on_disk = on_disk
        self.clock = clock
        self.registry = DefinitionRegistry(settings)
        self.allocator = Allocator(settings)
        self.offers = Offers()
        self.active_processes = ActiveProcesses(settings, self.registry, store, on_disk, self.allocator)
        self.events = EventDelivery(
            self.active_processes.processes,
            self.start_by_event,
            settings.message_ttl_s,
            self.registry.is_startable,
        )
        self.entities = EntityDelivery(
            settings, self.active_processes.processes, self.events, self.start_by_event
        )
        self.active_processes.on_loaded = self.events.add_process
        self.start_timers: dict[str, tuple[StartTimer, ...]] = {}
        self._numbers: dict[str, int] = {}
        """The last number that was given to a process of each definition."""
        self.due_changed = asyncio.Event()
        self.on_entity_waits: Callable[[], None] = lambda: None
        """Called when there may be new filters of entities, or new waits for a condition about them."""

    async def load(self) -> None:
        """Load everything from the database."""
        await self.on_disk(self.store.migrate)
        self.registry.add(await self.on_disk(self.store.definitions))
        holds: list[DefinitionHold] = await self.on_disk(self.store.definition_holds)
        self.registry.holds = {(hold.definition, hold.kind): hold for hold in holds}
        self.registry.add_deleted(await self.on_disk(self.store.deleted_versions))
        self.allocator.forms.add(await self.on_disk(self.store.forms))
        table: MappingTable | None = await self.on_disk(self.store.mapping)
        if table is not None:
            self.allocator.rules.mapping = table
        self.offers = Offers(await self.on_disk(self.store.offers))
        self.allocator.rules.task_kinds = self.offers.task_kinds()
        for record in self.registry.latest():
            if not record.is_event_driven:
                continue
            await self.registry.prepare(record)
            with suppress(HandoverError):  # such a version cannot be started
                self._add_events(self.registry.plan_of(record).definition)
        self._numbers = await self.on_disk(self.store.process_numbers)
        await self.active_processes.load_unfinished()
        self.start_timers = await self.on_disk(self.store.start_timers)
        self.events.stored = StoredMessages(await self.on_disk(self.store.stored_messages))
        self.entities.seen = SeenEntities(await self.on_disk(self.store.entities_seen))
        metrics.register_open_tasks(self.active_processes.open_tasks, self.clock)

    def urn(self, process_id: str) -> str:
        """Return the id of the entity of a process."""
        return self.settings.entity_id("Process", process_id)

    def start(
        self,
        step: Step,
        deployed: DefinitionRecord,
        variables: Mapping[str, Any],
        *,
        key: str | None = None,
        process_id: str | None = None,
        partner: str | None = None,
        at: str | None = None,
        results: Mapping[str, Any] | None = None,
    ) -> str:
        """Start a process in a step and return its id; raise `Problem` if that is impossible."""
        self.registry.require_startable(deployed.name, deployed.version)
        now = self.clock()
        number = 1 + step.numbers.get(deployed.name, self._numbers.get(deployed.name, 0))
        record = ProcessRecord(
            id=process_id or f"{deployed.name}-{secrets.token_hex(6)}",
            definition=deployed.name,
            version=deployed.version,
            key=key,
            status=TaskStatus.IN_PROGRESS,
            parameters=variables,
            variables=variables,
            waiting=(),
            reason=None,
            started_at=now,
            ended_at=None,
            revision=1,
            state=None,
            partner=partner,
            number=number,
        )
        plan = self.registry.plan_of(deployed)
        process = Process.start(
            self.settings,
            plan,
            record,
            step,
            now,
            library=self.registry,
            allocator=self.allocator,
            at=at,
            results=results,
        )
        step.numbers[deployed.name] = number
        self.active_processes.add(process)
        return record.id

    def start_by_event(
        self,
        step: Step,
        start: EventStart,
        variables: Mapping[str, Any],
        *,
        partner: str | None,
        key: str | None = None,
    ) -> str:
        """Start a process at an event that brings `variables`; those that are parameters set them."""
        deployed = self.registry.record(start.definition)
        definition = self.registry.plan_of(deployed).definition
        parameters = {name: value for name, value in variables.items() if name in definition.parameters}
        return self.start(
            step,
            deployed,
            definition.arguments(parameters),
            key=key,
            partner=partner,
            at=start.event,
            results=variables,
        )

    def find_process(self, process_id: str) -> Process:
        """Return a process in memory; raise `Problem` 409 if there is none."""
        process = self.active_processes.processes.get(process_id)
        if process is None:
            reason = f"this release cannot read {process_id}; the log says why"
            raise Problem(409, "Process cannot be resumed", reason)
        return process

    async def require_process(self, process_id: str) -> ProcessRecord:
        """Return a process as the database has it; raise `Problem` 404 if there is none."""
        records: list[ProcessRecord] = await self.on_disk(self.store.processes, [process_id])
        if not records:
            raise Problem.translated(
                404,
                "No such process",
                "process.unknown",
                'there is no process "{process_id}"',
                process_id=process_id,
            )
        return records[0]

    def settle(self, step: Step) -> None:
        """Apply the consequences of a change for other processes, in the same step."""
        self._allocate_waiting(step)
        self.events.settle(step, self.clock())

    def apply(self, step: Step) -> None:
        """Take over what a step has written to the database."""
        self._apply_holds(step)
        self.registry.add_deleted(step.deleted_versions)
        self._numbers |= step.numbers
        self._add_definitions(step.definitions)
        for table in step.mappings:
            self.allocator.rules.mapping = table
        if step.offers or step.offers_deleted:
            self.offers.apply(step)
            self.allocator.rules.task_kinds = self.offers.task_kinds()
        self.allocator.forms.add(step.forms)
        self.active_processes.apply(step)
        self.events.apply(step)
        self.entities.seen.apply(step.entities_seen)
        if step.definitions or self.events.entity_index.new_conditions:
            self.on_entity_waits()
        self.start_timers |= step.start_timers
        self.due_changed.set()

    def _apply_holds(self, step: Step) -> None:
        for (definition, kind), hold in step.holds.items():
            if hold is None:
                self.registry.holds.pop((definition, kind), None)
                continue
            self.registry.holds[definition, kind] = hold
            if kind is HoldKind.DELETED:
                self.events.remove_definition(definition)
                self.entities.remove_definition(definition)
                self.on_entity_waits()

    def _allocate_waiting(self, step: Step) -> None:
        """Try again to find performers for waiting activities, if agents or their Tasks have changed."""
        for _ in range(MAX_ALLOCATION_ROUNDS):
            if not self.allocator.has_changed:
                return
            self.allocator.has_changed = False
            for process_id in self.allocator.waiting():
                process = self.active_processes.processes.get(process_id)
                if process is not None:
                    process.allocate(step, self.clock())

    def _add_definitions(self, definitions: Sequence[DefinitionRecord]) -> None:
        self.registry.add(definitions)
        for record in definitions:
            self._add_events(self.registry.plan_of(record).definition)

    def _add_events(self, definition: Definition) -> None:
        self.events.add_definition(definition)
        self.entities.add_definition(definition)
