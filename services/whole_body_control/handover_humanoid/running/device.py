"""The Device of the humanoid in the broker, its ResourceSpecification, and the SpeedLimit that acts on it.

Nothing waits for the broker: the latest state is written in the background, once a second.
"""

import asyncio
from datetime import UTC, datetime, timedelta
from typing import Any, Final

from handover.broker import BrokerClient
from handover.broker.latest_value_writer import LatestValueWriter
from handover.control.robot_entities import robot_device, robot_specification
from handover_datamodels.entities import DeviceState
from handover_datamodels.times import iso
from handover_humanoid.running.humanoid_control import HumanoidControl
from handover_humanoid.settings import WholeBodySettings

WRITE_EVERY_S: Final = 1.0
VALID_S: Final = 10.0
OPERATIONS: Final = ("juggle", "walkAssisted")


class HumanoidDevice:
    """Writes the entities of the humanoid."""

    def __init__(
        self,
        settings: WholeBodySettings,
        control: HumanoidControl,
        broker: BrokerClient,
        writer: LatestValueWriter,
    ) -> None:
        self.id = settings.entity_id("Device", settings.humanoid_name)
        self.specification_id = settings.entity_id("ResourceSpecification", control.model.name)
        self.is_busy = False
        """Whether a session or a Task runs."""
        self._settings, self._model = settings, control.model
        self._motion, self._links = control.motion, control.links
        self._broker, self._writer = broker, writer

    async def run(self) -> None:
        """Write until cancelled."""
        specification = self._specification()
        self._writer.put(self.specification_id, lambda: self._broker.upsert([specification]))
        while True:
            for entity in (self._device(), self._limit()):
                self._writer.put(entity["id"], lambda entity=entity: self._broker.upsert([entity]))  # type: ignore[misc]
            await asyncio.sleep(WRITE_EVERY_S)

    @property
    def state(self) -> DeviceState:
        """The state of the Device."""
        if not self._links.is_live:
            return DeviceState.ERROR
        if self._motion.stopped is not None:
            return DeviceState.PAUSED
        is_walking = any(self._motion.velocity)
        return DeviceState.BUSY if self.is_busy or is_walking else DeviceState.IDLE

    def _device(self) -> dict[str, Any]:
        values = self._links.values
        place = {axis: round(values[f"base.{axis}"], 3) for axis in "xyz" if f"base.{axis}" in values}
        value = {"behaviour": self._motion.behaviour.name.lower(), "base": place, "simulated": True}
        return robot_device(self.id, self.specification_id, self.state, value)

    def _limit(self) -> dict[str, Any]:
        limit, now = self._motion.limit, datetime.now(UTC)
        until = {"@type": "DateTime", "@value": iso(now + timedelta(seconds=VALID_S))}
        return {
            "id": self._settings.entity_id("SpeedLimit", f"{self._settings.humanoid_name}-body"),
            "type": "SpeedLimit",
            "refRobot": {"type": "Relationship", "object": self.id},
            "fraction": {"type": "Property", "value": round(limit.fraction, 4), "observedAt": iso(now)},
            "reason": {"type": "Property", "value": str(limit.reason)[:200] or "no limit"},
            "validUntil": {"type": "Property", "value": until},
        }

    def _specification(self) -> dict[str, Any]:
        model = self._model
        parameters = {
            "model": model.name,
            "degreesOfFreedom": len(model.joints),
            "joints": [
                {
                    "name": joint.name,
                    "type": joint.kind,
                    "lower": joint.lower,
                    "upper": joint.upper,
                    "maxVelocity": joint.max_velocity,
                }
                for joint in model.joints
            ],
            "chains": {chain.name: list(chain.joints) for chain in model.chains.values()},
            "urdf": f"{self._settings.whole_body}/model/urdf",
            "simulated": True,
        }
        return robot_specification(self.specification_id, model.name, parameters, OPERATIONS)
