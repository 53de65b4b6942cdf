"""The gripper of an arm behind ROS: Tasks of the bridge operate it."""

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from fastapi import FastAPI, Request, Response

from handover.broker import BrokerClient, BrokerError
from handover.broker.resync import Resync
from handover.subscriptions.notifications import REQUIRES_NOTIFICATION_KEY, NotificationReceiver
from handover.subscriptions.own_subscriptions import OwnSubscriptions
from handover.subscriptions.record import SubscriptionRecord
from handover.tasks.outcomes import is_outcome_unknown
from handover.telemetry import get_logger
from handover_robots.driver_base.context import RobotContext
from handover_robots.drivers.orders import Ended, Orders
from handover_robots.model.faults import RobotFault, UnknownOutcome

log = get_logger(__name__)


class RosGripper:
    """The gripper of `arm`, operated by Tasks of the bridge."""

    def __init__(self, context: RobotContext, broker: BrokerClient, arm: str) -> None:
        settings, robot = context.settings, context.robot_id
        self.is_closed = context.gripper_closed
        self._arm = arm
        self._broker = broker
        self._notify_path = f"/notifications/{robot}/arm"
        self._receiver = NotificationReceiver(f"trajectory-tool-{robot}-arm", settings, broker)
        self._subscriptions = OwnSubscriptions("trajectory-tool", settings, broker)
        self._settings = settings
        self._orders = Orders(robot, arm, settings, broker)
        endpoint = self._receiver.endpoint(f"{settings.trajectory_tool}{self._notify_path}")
        self._subscription: Mapping[str, Any] = self._orders.subscription(endpoint)
        self._within_s = context.gripper_s + 20
        self._resync = Resync(self._try_reconcile, settings.reconcile_s)
        self._task: asyncio.Task[None] | None = None
        self._is_clean = False

    def mount(self, app: FastAPI) -> None:
        """Add the route for notifications."""

        @app.post(
            self._notify_path,
            status_code=204,
            tags=["notifications"],
            dependencies=[REQUIRES_NOTIFICATION_KEY],
        )
        async def notify(request: Request) -> Response:
            """Check changed orders."""
            await self._receiver.receive(request)
            self._orders.wake()
            return Response(status_code=204)

    def record_subscription(self, record: SubscriptionRecord) -> str:
        """Add the subscription to `record` from now on; return its id."""
        self._subscriptions = OwnSubscriptions("trajectory-tool", self._settings, self._broker, record)
        return str(self._subscription["id"])

    async def start(self) -> None:
        """Subscribe to orders, and end old ones."""
        self._receiver.require_key()
        self._task = asyncio.create_task(self._resync.run())

    async def stop(self) -> None:
        """Stop."""
        if self._task is not None:
            self._task.cancel()
            with suppress(asyncio.CancelledError):
                await self._task

    async def close(self) -> bool:
        """Close the gripper; return True when an object stopped it."""
        ended = await self._perform("closeGripper")
        self.is_closed = True
        stalled = ended.outputs.get("stalled") is True
        if not ended.completed and not stalled:
            raise RobotFault.translated(
                "robot.gripper_did_not_close",
                "the gripper of {arm} did not close: {reason}",
                arm=self._arm,
                reason=ended.reason,
            )
        return stalled

    async def open(self) -> None:
        """Open the gripper."""
        ended = await self._perform("openGripper")
        if not ended.completed:
            raise RobotFault.translated(
                "robot.gripper_did_not_open",
                "the gripper of {arm} did not open: {reason}",
                arm=self._arm,
                reason=ended.reason,
            )
        self.is_closed = False

    async def _perform(self, operation: str) -> Ended:
        order = await self._orders.give(operation)
        ended = await self._orders.end_of(order, self._within_s)
        if is_outcome_unknown(ended.outputs):
            raise UnknownOutcome.translated(
                "robot.gripper_unknown",
                "whether the gripper of {arm} has moved is unknown: {reason}; look what it holds, then "
                "free it on the page of the robot",
                arm=self._arm,
                reason=ended.reason,
            )
        return ended

    async def _try_reconcile(self) -> bool:
        try:
            await self._subscriptions.keep(self._subscription)
            if not self._is_clean:
                await self._orders.end_old()
                self._is_clean = True
        except (BrokerError, RobotFault) as error:
            log.warning("orders of the gripper not reconciled", arm=self._arm, error=str(error))
            return False
        return True
