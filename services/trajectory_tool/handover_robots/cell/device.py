"""The Device entity of the robot and its ResourceSpecification, kept current without delaying a motion.

The Device is written when the state of the robot changes, with the joints at that time; not during a motion.
The specification is written at the start: joints with their limits, home, gripper and the URL of the URDF.
"""

from typing import Any, Self

from handover.alerts.reporting_writer import reporting_writer
from handover.broker import BrokerClient
from handover.control.robot_entities import robot_device, robot_specification
from handover_datamodels.entities import DeviceState
from handover_robots.cell.robot_unit import RobotUnit
from handover_robots.metrics import DEVICE_WRITES_REJECTED
from handover_robots.model.poses import Pose
from handover_robots.settings import TrajectorySettings


class RobotDevice:
    """The Device of the robot; an asynchronous context manager while it is written."""

    def __init__(self, settings: TrajectorySettings, unit: RobotUnit, broker: BrokerClient) -> None:
        self.id = settings.entity_id("Device", unit.name)
        self.specification_id = settings.entity_id("ResourceSpecification", unit.name)
        self._urdf_url = f"{settings.trajectory_tool}/robots/{unit.name}/urdf"
        self.state = DeviceState.IDLE
        self._unit = unit
        self._broker = broker
        self._writer = reporting_writer("trajectory-tool", settings, broker, DEVICE_WRITES_REJECTED)

    async def __aenter__(self) -> Self:
        await self._writer.__aenter__()
        specification = self._specification()
        self._writer.put(self.specification_id, lambda: self._broker.upsert([specification]))
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
        unit = self._unit
        value = {
            "joints": [round(angle, 4) for angle in unit.joints],
            "pose": unit.tool_pose.written(),
            "gripper": "closed" if unit.robot.gripper_closed else "open",
            "holds": unit.held or "nothing",
        }
        return robot_device(self.id, self.specification_id, self.state, value)

    def _specification(self) -> dict[str, Any]:
        model = self._unit.model
        parameters = {
            "model": model.name,
            "degreesOfFreedom": len(model.joints),
            "joints": [
                {name: value for name, value in joint.items() if name != "labels"}
                for joint in described_joints(self._unit)
            ],
            "home": list(self._unit.home),
            "gripper": bool(model.fingers),
            "urdf": self._urdf_url,
        }
        return robot_specification(self.specification_id, model.name, parameters)


def described_joints(unit: RobotUnit) -> list[dict[str, Any]]:
    """Return the joints of the robot with their limits as JSON: rad and s, for prismatic joints m and s.

    `lower` and `upper` are null for a continuous joint. The limits of motion are those in force: of the
    settings, or of the robot.
    """
    limits = unit.limits
    return [
        {
            "name": joint.name,
            "type": joint.kind,
            "unit": joint.unit,
            "lower": joint.lower,
            "upper": joint.upper,
            "maxVelocity": limits.velocity[number],
            "maxAcceleration": limits.acceleration[number],
            "maxJerk": limits.jerk[number],
            "labels": dict(joint.labels),
        }
        for number, joint in enumerate(unit.model.joints)
    ]


def description(unit: RobotUnit) -> dict[str, Any]:
    """Return everything that a page needs to show the robot, as JSON."""
    model = unit.model
    return {
        "model": model.name,
        "revision": model.revision,
        "base": Pose.of(model.base).written(),
        "joints": described_joints(unit),
        "home": list(unit.home),
        "tip": model.tip,
        "fingers": [
            {
                "joint": finger.joint,
                "opened": finger.opened,
                "closed": finger.closed,
                "holding": finger.holding,
            }
            for finger in model.fingers
        ],
        "urdf": model.urdf,
    }
