"""Points that are fixed to the moving links of an arm, all computed by one product of matrices."""

from collections.abc import Sequence

import numpy as np

from handover_robots.planning.arm import Arm, Array


class LinkPoints:
    """Points by their joint, from 1, and their place in its frame. Not thread-safe."""

    def __init__(self, arm: Arm, points: Sequence[tuple[int, Array]]) -> None:
        joints = sorted({joint for joint, _ in points})
        # Views of the placements of the joints: forward kinematics changes what they show.
        self._rotations = [arm.data.oMi[joint].rotation.T for joint in joints]
        self._translations = [arm.data.oMi[joint].translation for joint in joints]
        self._frames = np.zeros((len(joints), 4, 4))
        """For each joint the transposed rotation above the translation, as homogeneous coordinates."""
        self._frames[:, 3, 3] = 1.0
        weights = np.zeros((len(points), len(joints), 4))
        for number, (joint, place) in enumerate(points):
            weights[number, joints.index(joint)] = [*place, 1.0]
        self._weights = weights.reshape(len(points), 4 * len(joints))

    def __call__(self) -> Array:
        """Return the points at the last forward kinematics, as rows of x, y, z and 1."""
        self._frames[:, :3, :3] = self._rotations
        self._frames[:, 3, :3] = self._translations
        return np.asarray(self._weights @ self._frames.reshape(-1, 4))
