"""The Device entity of the robot: kept current in the broker without delaying a motion.

It is written when the state of the robot changes, with the joints at that time; not during a motion.
"""

from datetime import UTC, datetime
from typing import Any, Self

from datamodels.entities import DeviceState
from datamodels.times import iso
from handover.broker import BrokerClient
from handover.latest_value_writer import LatestValueWriter
from services.trajectory_tool.cell import Cell
from services.trajectory_tool.metrics import DEVICE_WRITES_REJECTED


class RobotDevice:
    """The Device `device_id`; an asynchronous context manager while it is written."""

    def __init__(self, device_id: str, cell: Cell, broker: BrokerClient) -> None:
        self.id = device_id
        self.state = DeviceState.IDLE
        self._cell = cell
        self._broker = broker
        self._writer = LatestValueWriter(on_rejected=lambda _: DEVICE_WRITES_REJECTED.inc())

    async def __aenter__(self) -> Self:
        await self._writer.__aenter__()
        self.set_state(self.state)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._writer.__aexit__()

    def set_state(self, state: DeviceState) -> None:
        """Write the robot's state in the background; the latest state replaces a waiting one."""
        self.state = state
        entity = self._entity()
        self._writer.put(self.id, lambda: self._broker.upsert([entity]))

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
