"""Orders: Tasks that the tool posts for the performer that drives the arm.

The tool plans, and another performer, such as the ROS bridge, drives the arm. An order is deleted from the
broker after its end: people see only the Task of the tool.
"""

import asyncio
import uuid
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable, NotFound
from handover.messages import text_of
from handover.runtime.retry import Backoff, retry
from handover.settings import Settings
from handover.tasks.task_life import FINISHED
from handover.telemetry import get_logger
from handover_datamodels.entities import RequestedStatus, Task, TaskStatus
from handover_datamodels.times import iso
from handover_robots.model.faults import RobotFault, UnknownOutcome

log = get_logger(__name__)

ACCEPT_TIMEOUT_S = 10.0
CANCEL_TIMEOUT_S = 10.0
CANCEL_RETRY_S = 0.1
QUERY_EVERY_S = 1.0
"""Notifications are hints, so the broker is queried as well."""


@dataclass(frozen=True, slots=True)
class Ended:
    """The end of an order with its outputParameters."""

    completed: bool
    outputs: Mapping[str, Any]

    @property
    def cancelled(self) -> bool:
        """Return whether it ended because of its cancellation."""
        return not self.completed and self.outputs.get("reason") == "cancelled"

    @property
    def reason(self) -> str:
        """Return why it failed."""
        return str(self.outputs.get("reason", "it failed without a reason"))


class Orders:
    """Posts orders for `resource` (a URN), one at a time; `name` is the prefix of their ids."""

    def __init__(self, name: str, resource: str, settings: Settings, broker: BrokerClient) -> None:
        self.resource = resource
        self.prefix = settings.entity_id("Task", f"{name}-order-")
        self.id_pattern = f"^{self.prefix.replace('.', '[.]')}.*"
        """Matches the ids of these orders only: names of cells and robots may have dots."""
        self._settings = settings
        self._broker = broker
        self._changed = asyncio.Event()
        self._task: Task | None = None

    def wake(self) -> None:
        """Check the order soon: a notification says that it may have changed."""
        self._changed.set()

    def subscription(self, endpoint: Mapping[str, Any]) -> dict[str, Any]:
        """Return the subscription to changes of orders."""
        return {
            "id": self._settings.entity_id("Subscription", f"{self.prefix.rsplit(':', 1)[-1]}s"),
            "type": "Subscription",
            "description": f"Orders for {self.resource}",
            "entities": [{"type": Task.ngsi_type(), "idPattern": self.id_pattern}],
            "watchedAttributes": ["status"],
            "notification": {"endpoint": endpoint},
        }

    async def give(self, operation: str, **parameters: Any) -> str:
        """Post an order and return its id. Raises `RobotFault` when the broker rejects it."""
        task = self._order(operation, parameters)
        try:
            await self._broker.create(task)
        except BrokerError as error:
            raise RobotFault.translated(
                "robot.order_refused",
                "the order for {resource} was not posted: {error}",
                resource=self.resource,
                error=text_of(error),
            ) from error
        self._task = task
        return task.id

    async def end_of(self, order: str, within_s: float) -> Ended:
        """Wait for the end of `order`.

        Raises `RobotFault` when no performer accepts it, and `UnknownOutcome` when it does not end
        `within_s`; it is then cancelled.
        """
        clock = asyncio.get_running_loop().time
        given_s = clock()
        while True:
            task = await self._look(order)
            if task is not None and task.status.value in FINISHED:
                await self._remove(order)
                outputs = task.output_parameters.value if task.output_parameters is not None else None
                done = task.status.value is TaskStatus.COMPLETED
                return Ended(done, outputs if isinstance(outputs, Mapping) else {})
            if clock() - given_s > within_s:
                await self._withdraw(order)
                raise UnknownOutcome.translated(
                    "robot.motion_overdue",
                    "the motion of {resource} did not end within {within_s} s",
                    resource=self.resource,
                    within_s=f"{within_s:.0f}",
                )
            waits = self._task is None or self._task.status.value is TaskStatus.PENDING
            if waits and clock() - given_s > ACCEPT_TIMEOUT_S:
                await self._withdraw(order)
                raise RobotFault.translated(
                    "robot.order_not_accepted",
                    "no performer accepts orders for {resource}; start the ROS bridge with a "
                    "mapping that does (handover run ros-bridge; HANDOVER_ROS_MAPPING=arm)",
                    resource=self.resource,
                )
            await self._wait_for_change()

    async def cancel(self, order: str) -> None:
        """Request the cancellation of `order`; repeated for at most `CANCEL_TIMEOUT_S`."""
        requested = {"type": "Property", "value": RequestedStatus.CANCELLED.value, "observedAt": iso(_now())}
        try:
            async with asyncio.timeout(CANCEL_TIMEOUT_S):
                await retry(
                    lambda: self._broker.append(order, {"requestedStatus": requested}),
                    on=BrokerUnavailable,
                    backoff=Backoff(CANCEL_RETRY_S, CANCEL_RETRY_S),
                )
        except (BrokerError, TimeoutError) as error:
            log.warning("order not cancelled", order=order, error=str(error))

    async def end_old(self) -> None:
        """End the orders of an earlier run of the tool. Raises `BrokerError`, `RobotFault`."""
        for old in await self._broker.find(Task, id_pattern=self.id_pattern):
            log.info("order of an earlier run cancelled", order=old.id)
            self._task = old
            await self.cancel(old.id)
            await self.end_of(old.id, CANCEL_TIMEOUT_S)

    def _order(self, operation: str, parameters: Mapping[str, Any]) -> Task:
        definition = self._settings.entity_id("TaskDefinition", operation)
        return Task.from_ngsild(
            {
                "id": f"{self.prefix}{uuid.uuid4().hex[:12]}",
                "type": "Task",
                "isDefinedBy": {"type": "Relationship", "object": definition},
                "status": {"type": "Property", "value": TaskStatus.PENDING.value, "observedAt": iso(_now())},
                "involves": {
                    "type": "Property",
                    "value": [{"type": "Relationship", "object": self.resource}],
                },
                "workParameters": {"type": "Property", "value": {"operation": operation, **parameters}},
            }
        )

    async def _look(self, order: str) -> Task | None:
        """Return the order as the broker has it; None while the broker is unavailable."""
        try:
            self._task = await self._broker.get(order, Task)
        except NotFound:
            raise UnknownOutcome.translated(
                "robot.order_deleted", "another client has deleted the order {order}", order=order
            ) from None
        except BrokerError as error:
            log.info("order not read", order=order, error=str(error))
            return None
        return self._task

    async def _wait_for_change(self) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(QUERY_EVERY_S):
                await self._changed.wait()
        self._changed.clear()

    async def _withdraw(self, order: str) -> None:
        await self.cancel(order)
        await self._remove(order)

    async def _remove(self, order: str) -> None:
        with suppress(BrokerError):
            await self._broker.delete(order)


def _now() -> datetime:
    return datetime.now(UTC)
