"""The Device entity of the robot: kept current in the broker, without ever holding up a motion.

It is written when the state of the robot changes, with where the robot stands then; not while it moves.
"""

import asyncio
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any, Self

from datamodels.entities import DeviceState
from datamodels.times import iso
from handover.broker import BrokerClient, BrokerError, BrokerUnavailable
from handover.telemetry import get_logger
from services.trajectory_tool.cell import Cell
from services.trajectory_tool.metrics import UNTOLD

log = get_logger(__name__)

FIRST_RETRY_S, LAST_RETRY_S = 0.1, 2.0


class RobotDevice:
    """The Device `device_id`; an asynchronous context manager while it is written."""

    def __init__(self, device_id: str, cell: Cell, broker: BrokerClient) -> None:
        self.id = device_id
        self.state = DeviceState.IDLE
        self._cell = cell
        self._broker = broker
        self._untold: dict[str, Any] | None = None
        self._something_to_tell = asyncio.Event()
        self._writer: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        self._writer = asyncio.create_task(self._write())
        self.tell(self.state)
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._writer is not None:
            self._writer.cancel()
            with suppress(asyncio.CancelledError):
                await self._writer

    def tell(self, state: DeviceState) -> None:
        """Have the robot's state written soon; nobody waits for it, and only the newest is kept."""
        self.state = state
        self._untold = self._entity()
        self._something_to_tell.set()

    async def _write(self) -> None:
        retry_s = FIRST_RETRY_S
        while True:
            await self._something_to_tell.wait()
            self._something_to_tell.clear()
            entity = self._untold
            if entity is None:
                continue
            try:
                await self._broker.upsert([entity])
                retry_s = FIRST_RETRY_S
            except BrokerUnavailable as error:
                log.warning("broker away, the robot's state waits", device=self.id, error=str(error))
                self._something_to_tell.set()
                await asyncio.sleep(retry_s)
                retry_s = min(2 * retry_s, LAST_RETRY_S)
            except BrokerError:
                UNTOLD.inc()
                log.exception("broker refused the robot's state", device=self.id)

    def _entity(self) -> dict[str, Any]:
        cell, now = self._cell, iso(datetime.now(UTC))
        value = {
            "joints": [round(angle, 4) for angle in cell.joints],
            "pose": cell.tool_pose.written(),
            "gripper": "closed" if cell.robot.gripper_closed else "open",
            "holds": cell.held or "nothing",
        }
        return {
            "id": self.id,
            "type": "Device",
            "category": {"type": "Property", "value": ["robot"]},
            "controlledProperty": {"type": "Property", "value": ["pose"]},
            "deviceState": {"type": "Property", "value": self.state.value, "observedAt": now},
            "value": {"type": "Property", "value": value, "observedAt": now},
        }
