"""Orders: Tasks that the tool itself gives to whoever drives the arm, and whose end it waits for.

The tool plans, another performer (the ROS bridge, say) drives: they meet in the broker like everybody else.
An order is taken out of the broker once it has ended: the Task that a person sees is the tool's own.
"""

import asyncio
import uuid
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from datamodels.entities import RequestedStatus, Task, TaskStatus
from datamodels.times import iso
from handover.broker import BrokerClient, BrokerError, BrokerUnavailable, NotFound
from handover.messages import message, text_of
from handover.settings import Settings
from handover.task_life import FINISHED
from handover.telemetry import get_logger
from services.trajectory_tool.robot import RobotFault

log = get_logger(__name__)

TAKEN_UP_WITHIN_S = 10.0
GIVEN_UP_WITHIN_S = 10.0
LOOK_EVERY_S = 1.0
"""Notifications are hints: the broker is asked so often as well."""


@dataclass(frozen=True, slots=True)
class Ended:
    """How an order ended, and what was told with it."""

    completed: bool
    outputs: Mapping[str, Any]

    @property
    def cancelled(self) -> bool:
        """Say whether it ended because it was not wanted any more."""
        return not self.completed and self.outputs.get("reason") == "cancelled"

    @property
    def reason(self) -> str:
        """Return why it failed."""
        return str(self.outputs.get("reason", "it failed without saying why"))


class Orders:
    """Gives orders to the performer of `resource` (a URN), one at a time; `name` begins their ids."""

    def __init__(self, name: str, resource: str, settings: Settings, broker: BrokerClient) -> None:
        self.resource = resource
        self.prefix = settings.entity_id("Task", f"{name}-order-")
        self._settings = settings
        self._broker = broker
        self._news = asyncio.Event()
        self._task: Task | None = None

    def wake(self) -> None:
        """Take the hint that an order may have moved."""
        self._news.set()

    def subscription(self, endpoint: Mapping[str, Any]) -> dict[str, Any]:
        """Return the subscription by which the broker tells how orders stand."""
        return {
            "id": self._settings.entity_id("Subscription", f"{self.prefix.rsplit(':', 1)[-1]}s"),
            "type": "Subscription",
            "description": f"Orders for {self.resource}",
            "entities": [{"type": Task.ngsi_type(), "idPattern": f"^{self.prefix}.*"}],
            "watchedAttributes": ["status"],
            "notification": {"endpoint": endpoint},
        }

    async def give(self, operation: str, **parameters: Any) -> str:
        """Give an order and return its id. Raises `RobotFault` when the broker does not take it."""
        task = self._order(operation, parameters)
        try:
            await self._broker.create(task)
        except BrokerError as error:
            raise RobotFault(
                message(
                    "robot.order_refused",
                    "the order to {resource} could not be given: {error}",
                    resource=self.resource,
                    error=text_of(error),
                )
            ) from error
        self._task = task
        return task.id

    async def end_of(self, order: str, within_s: float) -> Ended:
        """Wait for the end of `order`.

        Raises `RobotFault` when nobody takes it up, or when it does not end `within_s`; it is withdrawn then.
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
                raise RobotFault(
                    message(
                        "robot.motion_overdue",
                        "the motion of {resource} did not end within {within_s} s",
                        resource=self.resource,
                        within_s=f"{within_s:.0f}",
                    )
                )
            waits = self._task is None or self._task.status.value is TaskStatus.PENDING
            if waits and clock() - given_s > TAKEN_UP_WITHIN_S:
                await self._withdraw(order)
                raise RobotFault(
                    message(
                        "robot.order_not_accepted",
                        "nobody takes up what is asked of {resource}; start the ROS bridge with a "
                        "mapping that does (handover run ros-bridge; HANDOVER_ROS_MAPPING=arm)",
                        resource=self.resource,
                    )
                )
            await self._a_while()

    async def cancel(self, order: str) -> None:
        """Wish for the end of `order`; repeated until the broker has it, `GIVEN_UP_WITHIN_S` at most."""
        wish = {"type": "Property", "value": RequestedStatus.CANCELLED.value, "observedAt": iso(_now())}
        with suppress(TimeoutError):
            async with asyncio.timeout(GIVEN_UP_WITHIN_S):
                while True:
                    try:
                        await self._broker.append(order, {"requestedStatus": wish})
                    except BrokerUnavailable as error:
                        log.warning("broker away, the wish to stop waits", order=order, error=str(error))
                        await asyncio.sleep(0.1)
                    except BrokerError as error:
                        log.info("an order could not be cancelled", order=order, error=str(error))
                        return
                    else:
                        return

    async def end_old(self) -> None:
        """End what an earlier run of the tool has left under way. Raises `BrokerError`, `RobotFault`."""
        for old in await self._broker.find(Task, id_pattern=f"^{self.prefix}.*"):
            log.info("an order of an earlier run is ended", order=old.id)
            self._task = old
            await self.cancel(old.id)
            await self.end_of(old.id, GIVEN_UP_WITHIN_S)

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
        """Return the order as the broker has it; None while the broker cannot be asked."""
        try:
            self._task = await self._broker.get(order, Task)
        except NotFound:
            raise RobotFault(
                message(
                    "robot.order_deleted",
                    "the order {order} was deleted by somebody else",
                    order=order,
                )
            ) from None
        except BrokerError as error:
            log.info("the broker cannot be asked for an order", order=order, error=str(error))
            return None
        return self._task

    async def _a_while(self) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(LOOK_EVERY_S):
                await self._news.wait()
        self._news.clear()

    async def _withdraw(self, order: str) -> None:
        await self.cancel(order)
        await self._remove(order)

    async def _remove(self, order: str) -> None:
        with suppress(BrokerError):
            await self._broker.delete(order)


def _now() -> datetime:
    return datetime.now(UTC)
