"""The port `gains`: by how much the joints of each chain are stiffer and more damped than in the model.

Shares of the gains of the model, by chain. They stay in force until others are written, also when the process
that wrote them has ended. Shares outside of the limits that the model declares are moved to the limits. Every
change is gradual (100 % in `CHANGE_S`), so that the torque of no joint jumps.
"""

from typing import Final

import numpy as np

from handover.runtime.control_cycle import runs_in_cycle
from handover_humanoid.model.humanoid import Humanoid
from handover_humanoid.model.kinematics import Array

CHANGE_S: Final = 1.0
"""How long a change by 100 % takes."""
KINDS: Final = ("stiffness", "damping")


def gain_fields(humanoid: Humanoid) -> tuple[str, ...]:
    """Return the names of the values of the port, and of the shares in the state."""
    return tuple(f"{chain}.{kind}" for chain in humanoid.gain_limits for kind in KINDS)


class GainTransition:
    """The shares that the joints have now, which move to those that are wanted. Not thread-safe."""

    def __init__(self, humanoid: Humanoid) -> None:
        joints, limits = len(humanoid.joints), humanoid.gain_limits
        self.stiffness, self.damping = np.ones(joints), np.ones(joints)
        """Of each joint, (n,)."""
        self.values = np.ones(2 * len(limits))
        """As `gain_fields` names them."""
        self._wanted = np.ones(2 * len(limits))
        bounds = [bound for limit in limits.values() for bound in (limit.stiffness, limit.damping)]
        self._lowest, self._highest = np.array(bounds).reshape(-1, 2).T
        self._joints = [list(humanoid.tunable[chain]) for chain in limits]

    @runs_in_cycle
    def want(self, values: Array | None) -> None:
        """Take the values of the port; None changes nothing."""
        if values is not None and len(values) == len(self._wanted):
            np.clip(values, self._lowest, self._highest, out=self._wanted)

    @runs_in_cycle
    def step(self, dt_s: float) -> None:
        """Move towards what is wanted."""
        if np.array_equal(self.values, self._wanted):
            return
        most = dt_s / CHANGE_S
        self.values += np.clip(self._wanted - self.values, -most, most)
        for index, joints in enumerate(self._joints):
            self.stiffness[joints] = self.values[2 * index]
            self.damping[joints] = self.values[2 * index + 1]
