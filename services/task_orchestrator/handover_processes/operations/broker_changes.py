"""Broker changes: Tasks and agents as the broker has them."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from prometheus_client import Counter

from handover.messages import message, with_code
from handover.security.caller import InvalidToken
from handover.security.keys_in_force import KeysInForce
from handover.security.proofs.performer_proof import PERFORMER_MEMBER, require_proven_performer
from handover.security.proofs.pin_check import proven_person
from handover.tasks.task_life import FINISHED
from handover.telemetry import get_logger
from handover_datamodels.entities import Task, TaskStatus
from handover_processes.allocation.agents import Agents
from handover_processes.operations.device_leases import DeviceLeases
from handover_processes.people_acts import requires_pin
from handover_processes.process import task_troubles
from handover_processes.process.process import Process
from handover_processes.records.messages import Message, MessageKind
from handover_processes.records.step import Step
from handover_processes.records.tasks import TaskRecord
from handover_processes.steps.step_writer import StepWriter
from handover_processes.steps.working_state import WorkingState

log = get_logger(__name__)

MAX_FAULT_CHARS = 1_000

RECEIVED = Counter(
    "handover_orchestrator_task_changes_total", "Changes of Tasks that were received, by result", ["result"]
)


class BrokerChanges:
    """Applies what the broker reports to the processes."""

    def __init__(self, state: WorkingState, writer: StepWriter, leases: DeviceLeases) -> None:
        self._state = state
        self._writer = writer
        self._leases = leases
        self._keys = KeysInForce(state.settings.security_folder)
        self.on_unowned: Callable[[], None] = lambda: None
        """Called when the broker shows an unfinished Task that no running process waits for."""

    async def receive(self, entities: Iterable[Mapping[str, Any]]) -> int:
        """Apply Tasks as the broker has them; return how many had changed. Foreign Tasks are ignored."""
        by_process: dict[str, list[_Seen]] = {}
        for seen in self._changed_tasks(entities):
            owner = self._state.active_processes.owner(seen.id)
            if owner is not None:
                by_process.setdefault(owner.record.id, []).append(seen)

        def applying(tasks: list[_Seen]) -> Callable[[Step], int]:
            return lambda step: self._apply(tasks, step)

        answers = await self._writer.apply_each({name: applying(tasks) for name, tasks in by_process.items()})
        return sum(answers.values())

    async def wait_until_written(self) -> None:
        """Wait until all changes that are applied by now are in the database."""
        await self._writer.apply(lambda _: None)

    def changed_ids(self, entities: Iterable[Mapping[str, Any]]) -> list[str]:
        """Return the ids of the Tasks of the orchestrator among `entities` with another status than known.

        Only `id` and `status` are looked at.
        """
        return [str(entity["id"]) for entity in self._select_changed(entities)]

    def awaited(self) -> list[str]:
        """Return the ids of the open Tasks that the broker must have.

        Tasks of a step that is not written yet are none of them.
        """
        tasks = self._state.active_processes.task_ids()
        return [task_id for task_id in tasks if not self._writer.outbox.is_pending(task_id)]

    async def missing(self, task_ids: Iterable[str]) -> None:
        """Handle that the broker does not have these Tasks of the orchestrator."""

        def handling(task_id: str) -> Callable[[Step], None]:
            def act(step: Step) -> None:
                owner = self._state.active_processes.owner(task_id)
                if owner is not None:
                    task_troubles.missing(owner, task_id, step, self._state.clock())

            return act

        await self._writer.apply_each({task_id: handling(task_id) for task_id in task_ids})

    async def reject(self, message: Message, reason: str) -> None:
        """Handle that a message of the outbox was rejected."""
        owner = self._state.active_processes.owner(message.subject)
        if message.kind in {MessageKind.CREATE, MessageKind.SPECIFY} and owner is not None:
            await self._writer.apply(
                lambda step: task_troubles.reject(owner, message.subject, reason, step, self._state.clock())
            )

    async def set_agents(self, agents: Agents) -> None:
        """Take the agents of the broker, and try again to find performers for waiting activities."""
        allocator = self._state.allocator

        def act(_: Step) -> None:
            allocator.rules.agents = agents
            allocator.has_changed = True

        if agents != allocator.rules.agents or allocator.has_waiting:
            await self._writer.apply(act)

    def _changed_tasks(self, entities: Iterable[Mapping[str, Any]]) -> list["_Seen"]:
        changed = []
        for entity in self._select_changed(entities):
            seen = _as_seen(entity)
            owner = self._state.active_processes.owner(seen.id)
            if owner is not None and seen.is_news(owner):
                changed.append(seen)
            else:
                RECEIVED.labels("known").inc()
        return changed

    def _select_changed(self, entities: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
        changed, foreign, unchanged = [], 0, 0
        for entity in entities:
            task_id = str(entity.get("id"))
            owner = self._state.active_processes.owner(task_id)
            if owner is None:
                foreign += 1
                if not _is_finished(entity):
                    self.on_unowned()  # an ended Task of the orchestrator may have reappeared
                continue
            record = owner.tasks.get(task_id)  # none while the step that ends it is written
            if record is None or (record.unreadable is None and _status(entity) == record.status.value):
                unchanged += 1
            else:
                changed.append(entity)
        RECEIVED.labels("foreign").inc(foreign)
        RECEIVED.labels("known").inc(unchanged)
        return changed

    def _apply(self, changed: Iterable["_Seen"], step: Step) -> int:
        now = self._state.clock()
        applied = 0
        for seen in changed:
            owner, task = self._state.active_processes.owner(seen.id), seen.task
            if owner is None:
                continue
            if task is None:
                self._report_unreadable(owner, seen, step)
                continue
            task_troubles.readable(owner, task.id, step)
            if self._refuse_without_pin(owner, task, step):
                continue
            if owner.receive(self._without_unproven_performer(task), step, now):
                applied += 1
                RECEIVED.labels("applied").inc()
                log.info("task moved", task=task.id, status=task.status.value.value, process=owner.record.id)
        return applied

    def _report_unreadable(self, owner: Process, seen: "_Seen", step: Step) -> None:
        writer = self._writer_of(owner.tasks.get(seen.id))
        if task_troubles.unreadable(owner, seen.id, writer, seen.fault, step):
            RECEIVED.labels("unreadable").inc()
            log.warning("task does not match the data model", task=seen.id, writer=writer, error=seen.fault)

    def _writer_of(self, task: TaskRecord | None) -> str | None:
        """Return who performs a Task: the holder of the lease, or the announced performer, or None."""
        if task is None:
            return None
        lease = self._leases.last(task.performer)
        if lease is not None and not lease.is_released:
            return f"{lease.holder.performer} on {lease.holder.host}"
        agent = self._state.allocator.rules.agents.by_id.get(task.performer)
        return None if agent is None else agent.performer

    def _refuse_without_pin(self, owner: Process, seen: Task, step: Step) -> bool:
        """Let a Task fail that demands a PIN and was completed by somebody who has not proved it.

        A broker without our rules accepts such a change from any program that reaches it.
        """
        record = owner.tasks.get(seen.id)
        if record is None or seen.status.value is not TaskStatus.COMPLETED or not requires_pin(record):
            return False
        reported = seen.output_parameters
        outputs = reported.value if reported is not None and isinstance(reported.value, Mapping) else {}
        try:
            person = proven_person(self._keys, seen.id, outputs)
            if outputs.get(PERFORMER_MEMBER) == person:
                return False
            why = "performedBy names another person"
        except InvalidToken as error:
            why = str(error)
        log.warning("task completed without its PIN", task=seen.id, reason=why)
        reason = message(
            "task.pin_not_proved",
            "the Task demands a PIN, and was completed without proof that it was given: {why}; let the "
            "person answer it on the page Tasks or Work",
            why=why,
        )
        RECEIVED.labels("refused").inc()
        owner.report(seen.id, [TaskStatus.FAILED], with_code("reason", reason), step, self._state.clock())
        return True

    def _without_unproven_performer(self, seen: Task) -> Task:
        """Return the Task without `performedBy`, unless `accounts` has proved it.

        A broker without our rules accepts it from any program that reaches it.
        """
        reported, keys = seen.output_parameters, self._keys.keys()
        if keys is None or reported is None or PERFORMER_MEMBER not in reported.value:
            return seen
        try:
            require_proven_performer(keys, seen.id, reported.value)
        except InvalidToken as error:
            log.warning("performedBy is ignored", task=seen.id, reason=str(error))
            outputs = {name: value for name, value in reported.value.items() if name != PERFORMER_MEMBER}
            return seen.model_copy(
                update={"output_parameters": reported.model_copy(update={"value": outputs})}
            )
        return seen


@dataclass(frozen=True, slots=True)
class _Seen:
    """A Task as the broker has it: `task`, or None with the `fault` if it breaks a rule of the data model."""

    id: str
    task: Task | None
    fault: str = ""

    def is_news(self, owner: Process) -> bool:
        """Return whether it differs from what its process knows."""
        record = owner.tasks.get(self.id)
        unreadable = None if record is None else record.unreadable
        if self.task is None:
            return record is not None and unreadable != self.fault
        return unreadable is not None or owner.is_news(self.task)


def _as_seen(entity: Mapping[str, Any]) -> _Seen:
    task_id = str(entity["id"])
    try:
        return _Seen(task_id, Task.from_ngsild(entity))
    except ValueError as error:
        fault = str(error).removeprefix(f"{task_id} is no valid Task: ").replace("\0", "")
        return _Seen(task_id, None, fault[:MAX_FAULT_CHARS])


def _is_finished(entity: Mapping[str, Any]) -> bool:
    return _status(entity) in FINISHED


def _status(entity: Mapping[str, Any]) -> str | None:
    status = entity.get("status")
    value = status.get("value") if isinstance(status, Mapping) else None
    return value if isinstance(value, str) else None
