"""The record of the machines in the broker: a Device each, and the SpeedLimit that acts on it.

A machine never waits for the broker: the latest state is written in the background, once a second. Commands
of a real machine do not go this way, see `ros_commands`.
"""

import asyncio
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, Final

from handover.broker import BrokerClient
from handover.broker.latest_value_writer import LatestValueWriter
from handover.settings import Settings
from handover_cases.running.machine_runner import MachineRunner
from handover_datamodels.entities import DeviceState
from handover_datamodels.times import iso

WRITE_EVERY_S: Final = 1.0
VALID_S: Final = 10.0


class MachineRecords:
    """Writes the entities of the machines."""

    def __init__(
        self,
        settings: Settings,
        runners: Sequence[MachineRunner],
        broker: BrokerClient,
        writer: LatestValueWriter,
    ) -> None:
        self._settings = settings
        self._runners = runners
        self._broker = broker
        self._writer = writer

    async def run(self) -> None:
        """Write until cancelled."""
        while True:
            for runner in self._runners:
                if not runner.case.is_own_machine:
                    continue
                for entity in self._entities(runner):
                    self._writer.put(entity["id"], lambda entity=entity: self._broker.upsert([entity]))  # type: ignore[misc]
            await asyncio.sleep(WRITE_EVERY_S)

    def _entities(self, runner: MachineRunner) -> list[dict[str, Any]]:
        case, state, now = runner.case, runner.machine.state(), datetime.now(UTC)
        device = self._settings.entity_id("Device", case.robot)
        is_stopped = runner.allowed.needs_reset
        device_state = DeviceState.BUSY if state.is_moving else DeviceState.IDLE
        value = {
            "state": state.state,
            **{name: round(number, 4) for name, (number, _) in state.values.items()},
        }
        stamp = iso(now)
        return [
            {
                "id": device,
                "type": "Device",
                "category": {"type": "Property", "value": [case.category]},
                "controlledProperty": {"type": "Property", "value": ["speed"]},
                "deviceState": {
                    "type": "Property",
                    "value": (DeviceState.PAUSED if is_stopped else device_state).value,
                    "observedAt": stamp,
                },
                "value": {"type": "Property", "value": value, "observedAt": stamp},
            },
            {
                "id": self._settings.entity_id("SpeedLimit", f"{case.robot}-body"),
                "type": "SpeedLimit",
                "refRobot": {"type": "Relationship", "object": device},
                "fraction": {
                    "type": "Property",
                    "value": round(runner.allowed.fraction, 4),
                    "observedAt": stamp,
                },
                "reason": {"type": "Property", "value": str(runner.allowed.reason)[:200] or "no limit"},
                "validUntil": {
                    "type": "Property",
                    "value": {"@type": "DateTime", "@value": iso(now + timedelta(seconds=VALID_S))},
                },
            },
        ]
