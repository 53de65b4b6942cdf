"""Tasks of devices: a Task that involves a registered device becomes a command.

The command's name is the `operation` of the workParameters, else the last part of the TaskDefinition's id.
Its id is computed from that of the Task: after a crash the Task finds its command and waits for it again, and
the device receives it once. What the device reports is the Task's progress and result.
"""

import asyncio
import hashlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, Final

from sqlalchemy.exc import SQLAlchemyError

from handover.broker import BrokerClient
from handover.database.outage import database_reason
from handover.errors import Problem
from handover.performer import Job, Performer, RequestedAction, TaskFailed
from handover.runtime.retry import Backoff
from handover.tasks.outcomes import outcome_unknown
from handover.telemetry import get_logger
from handover_devices.commands.command import Command, CommandState
from handover_devices.commands.dispatcher import Dispatcher
from handover_devices.gateway import DeviceGateway
from handover_devices.registry.entities import SOURCE, device_id
from handover_devices.settings import GatewaySettings

log = get_logger(__name__)

MAX_TIMEOUT_S: Final = 86_400.0
WAIT_S: Final = 0.5
"""Period in which a running command is compared with the requests of clients."""
_NOT_PARAMETERS: Final = frozenset({"operation", "timeoutS", "description"})


@dataclass(frozen=True, slots=True)
class _Order:
    """The command of a Task."""

    device: str
    name: str
    parameters: Mapping[str, Any]
    timeout_s: float
    identifier: str


def _command_id(job: Job) -> str:
    return f"task-{hashlib.sha256(job.task.id.encode()).hexdigest()[:32]}"


def _shared_holder(settings: GatewaySettings) -> str | None:
    """Return the holder of leases of all replicas on a database server, of which that lets one lead."""
    if not settings.database_url:
        return None
    return f"{SOURCE} {hashlib.sha256(settings.database_url.encode()).hexdigest()[:32]}"


class DeviceTasks(Performer):
    """Performs the Tasks of all registered devices that take commands."""

    def __init__(
        self, settings: GatewaySettings, broker: BrokerClient, gateway: DeviceGateway, dispatcher: Dispatcher
    ) -> None:
        super().__init__(
            SOURCE,
            settings,
            broker,
            notify_url=f"{settings.device_gateway}/notifications",
            holder=_shared_holder(settings),
        )
        self._gateway = gateway
        self._dispatcher = dispatcher
        self._timeout_s = settings.device_task_timeout_s
        self._names: dict[str, str] = {}

    async def follow(self, name: str) -> None:
        """Act for a device if it takes commands."""
        resource = device_id(self.settings, name)
        device = self._gateway.devices.get(name)
        if device is not None and device.stored.description.commands:
            self._names[resource] = name
            await self.act_for(resource)
        elif self.stop_acting_for(resource):
            self._names.pop(resource, None)

    async def may_repeat(self, job: Job) -> bool:
        """Return whether this gateway knows the command of a Task that was started: it is sent once."""
        try:
            await self._dispatcher.find(self._names[job.resource], _command_id(job))
        except (Problem, KeyError):
            return job.begun_here
        return True

    async def perform(self, job: Job) -> Mapping[str, Any] | None:
        """Send the command of a Task and wait for its end."""
        parameters = job.parameters
        operation = str(parameters.get("operation") or job.task.is_defined_by.object.rpartition(":")[2])
        timeout_s = parameters.get("timeoutS", self._timeout_s)
        if (
            isinstance(timeout_s, bool)
            or not isinstance(timeout_s, int | float)
            or not 0 < timeout_s <= 86_400
        ):
            raise TaskFailed("timeoutS must be a number of seconds, more than 0 and at most 86400")
        order = _Order(
            self._names[job.resource],
            operation,
            {name: value for name, value in parameters.items() if name not in _NOT_PARAMETERS},
            float(timeout_s),
            _command_id(job),
        )
        command = await self._ordered(job, order)
        command = await self._follow_to_end(job, command)
        return self._outputs(command)

    async def _ordered(self, job: Job, order: "_Order") -> Command:
        """Order a command until it is stored; raise `TaskFailed` if it is refused.

        A database that restarts concerns the moment and not the command, of which nothing was sent. Its id
        is that of the Task, so a command that was stored all the same is not given twice.
        """
        backoff = Backoff()
        while True:
            try:
                return await self._order_once(job, order)
            except Problem as problem:
                if problem.status < HTTPStatus.INTERNAL_SERVER_ERROR:
                    raise TaskFailed(problem.detail) from None
                reason = problem.detail
            except SQLAlchemyError as error:
                reason = database_reason(error)
            log.warning("command not stored yet", device=order.device, command=order.name, reason=reason)
            with suppress(TimeoutError):
                async with asyncio.timeout(backoff.next_delay_s()):
                    await job.changed(since=job.requested_action)
            await job.checkpoint()

    async def _order_once(self, job: Job, order: "_Order") -> Command:
        """Order a command; if the Task is cancelled before it is stored, it is not sent."""
        device = self._gateway.device(order.device)
        ordering = asyncio.create_task(
            self._dispatcher.order(
                device.name,
                device.stored.description,
                order.name,
                order.parameters,
                timeout_s=order.timeout_s,
                identifier=order.identifier,
            )
        )
        try:
            while not ordering.done():
                changing = asyncio.create_task(job.changed(since=job.requested_action))
                await asyncio.wait({ordering, changing}, return_when=asyncio.FIRST_COMPLETED)
                changing.cancel()
                if job.requested_action is RequestedAction.CANCEL and not ordering.done():
                    with suppress(Problem, SQLAlchemyError):
                        await self._dispatcher.cancel(device.name, order.identifier)
            return await ordering
        finally:
            ordering.cancel()

    async def _follow_to_end(self, job: Job, command: Command) -> Command:
        dispatcher = self._dispatcher
        cancelled = False
        while command.is_open:
            if command.progress is not None:
                job.report_progress(command.progress)
            if job.requested_action is RequestedAction.CANCEL and not cancelled:
                cancelled = True
                command = await dispatcher.cancel(command.device, command.id)
                continue
            command = await dispatcher.wait(command.device, command.id, command, WAIT_S)
        if cancelled and command.state is CommandState.CANCELLED:
            await job.checkpoint()  # raises TaskCancelled
        return command

    @staticmethod
    def _outputs(command: Command) -> Mapping[str, Any]:
        if command.state is CommandState.DONE:
            return {**(command.result or {}), "progress": 1.0}
        reason = command.reason or f"the command ended as {command.state}"
        if command.state is CommandState.UNKNOWN or (
            command.state is CommandState.EXPIRED and command.boot is not None
        ):
            raise TaskFailed(outcome_unknown(reason))
        raise TaskFailed(reason)
