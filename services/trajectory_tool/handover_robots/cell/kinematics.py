"""The kinematics of a robot in a control cycle: by pinocchio where it is installed, which takes a tenth."""

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from handover_robots.model.joints import Joints
from handover_robots.model.poses import Pose
from handover_robots.model.robot_model import RobotModel
from handover_robots.planning import is_available

if TYPE_CHECKING:
    from handover_robots.planning.arm import Arm

Array = NDArray[np.float64]


class Kinematics:
    """The kinematics of a robot; used by one thread at a time."""

    def __init__(self, model: RobotModel) -> None:
        self._model = model

    @cached_property
    def _arm(self) -> "Arm | None":
        if not is_available():
            return None
        from handover_robots.planning.arm import Arm  # noqa: PLC0415 - needs the extra

        return Arm(self._model)

    def prepare(self) -> None:
        """Build what takes long, before a control cycle needs it."""
        _ = self._arm

    def tool_pose(self, joints: Joints) -> Pose:
        """Return the pose of the tool's tip."""
        return self._model.tool_pose(joints) if self._arm is None else self._arm.tool_pose(joints)

    def jacobian(self, joints: Joints) -> Array:
        """Return the Jacobian of the tip (6 rows: linear, angular) in axes of the cell, at the tip."""
        if self._arm is not None:
            return self._arm.jacobian(np.array(joints))
        return np.array([(*linear, *angular) for linear, angular in self._model.jacobian(joints)]).T
