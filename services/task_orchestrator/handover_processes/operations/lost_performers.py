"""Lost performers: Tasks that were accepted, and whose performer has no lease of the Device any more.

When the lease ends, an Alert says so; it is cleared when a performer has the lease again, or when the Task
ends. A performer that comes back decides about the Task itself: it continues it, or it fails it with an
unknown outcome. If none has come after the grace period, `onPerformerLost` of the activity decides: `ask` (a
person, by an incident), `retry` (the Task is posted again, for work that may be done twice), or `wait`.

A Task of a Device that never had a lease, as in a cell without leases, is not watched.
"""

import asyncio
from collections.abc import Callable, Iterator

from handover.errors import Problem
from handover.runtime.background_tasks import BackgroundTasks
from handover.telemetry import get_logger
from handover_datamodels.entities import TaskStatus
from handover_processes.operations.device_leases import DeviceLeases
from handover_processes.process import task_troubles
from handover_processes.records.step import Step
from handover_processes.records.tasks import TaskRecord
from handover_processes.steps.step_writer import StepWriter
from handover_processes.steps.working_state import WorkingState

log = get_logger(__name__)

CHECK_EVERY_S = 1.0


class LostPerformers:
    """Watches the leases of the Devices of accepted Tasks; an asynchronous context manager while it does."""

    def __init__(self, state: WorkingState, writer: StepWriter, leases: DeviceLeases) -> None:
        self._state = state
        self._writer = writer
        self._leases = leases
        self._alerted: dict[str, str] = {}
        """The Device of each Task with an Alert."""
        self._tasks = BackgroundTasks("lost performers")

    async def __aenter__(self) -> "LostPerformers":
        for task in self._state.active_processes.open_tasks():
            if task.alerted and task.status is not TaskStatus.PENDING:
                self._alerted[task.id] = task.performer
        await self._tasks.__aenter__()
        self._tasks.start_restarting(self._run)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._tasks.__aexit__()

    async def check(self) -> None:
        """Raise and clear Alerts, and end Tasks whose performer has not come back in time."""
        acts: dict[str, Callable[[Step], None]] = {}
        unheld_s = self._leases.unheld()
        for task_id, device in tuple(self._alerted.items()):
            owner = self._state.active_processes.owner(task_id)
            if owner is None or task_id not in owner.tasks:
                del self._alerted[task_id]
            elif device not in unheld_s:
                acts[task_id] = self._clearing(task_id)
                del self._alerted[task_id]
        for device, since_s in unheld_s.items():
            for task in self._accepted(device):
                if not task.alerted:
                    acts[task.id] = self._alerting(task.id, device)
                    self._alerted[task.id] = device
                elif since_s >= self._state.settings.performer_grace_s:
                    acts[task.id] = self._ending(task.id)
        if acts:
            await self._writer.apply_each(acts)

    def _accepted(self, device: str) -> Iterator[TaskRecord]:
        for task_id in self._state.allocator.tasks_of(device):
            owner = self._state.active_processes.owner(task_id)
            task = None if owner is None else owner.tasks.get(task_id)
            if task is None or task.status is TaskStatus.PENDING or task.claims or task.claimed_by:
                continue  # a person performs it on a screen
            yield task

    async def _run(self) -> None:
        while True:
            await asyncio.sleep(CHECK_EVERY_S)
            try:
                await self.check()
            except Problem as problem:
                log.warning("tasks of lost performers not changed yet", error=str(problem))

    def _alerting(self, task_id: str, device: str) -> Callable[[Step], None]:
        lease = self._leases.last(device)
        holder = "" if lease is None else f"{lease.holder.performer} on {lease.holder.host}"

        def act(step: Step) -> None:
            owner = self._state.active_processes.owner(task_id)
            if owner is not None:
                task_troubles.performer_lost(owner, task_id, holder, step)

        return act

    def _clearing(self, task_id: str) -> Callable[[Step], None]:
        def act(step: Step) -> None:
            owner = self._state.active_processes.owner(task_id)
            if owner is not None:
                task_troubles.performer_found(owner, task_id, step)

        return act

    def _ending(self, task_id: str) -> Callable[[Step], None]:
        def act(step: Step) -> None:
            owner = self._state.active_processes.owner(task_id)
            if owner is not None:
                task_troubles.end_lost(owner, task_id, step, self._state.clock())

        return act
