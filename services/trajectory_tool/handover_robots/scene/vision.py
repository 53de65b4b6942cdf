"""What a cell needs of a vision system: parts in a bin with grasps, or why a part cannot be gripped.

A robot driver with a camera of its own implements it; otherwise the cell has the simulated
`Camera`, which knows where the parts lie.
"""

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from handover.messages import Message
from handover_robots.model.poses import Frame, Pose, Vector
from handover_robots.scene.contents import Grip


@dataclass(frozen=True, slots=True)
class SeenGrasp:
    """A pose of the tool that grips a part, and how the gripper then holds it."""

    tool: Pose
    grip: Grip


@dataclass(frozen=True, slots=True)
class Sighting:
    """A part in a bin: where its middle is, its grasps, the best first, or why there is none."""

    part: Pose
    grasps: tuple[SeenGrasp, ...] = ()
    reason: Message | None = None


@dataclass(frozen=True, slots=True)
class SeenBall:
    """The pose of the tip at an image, and the middle of a ball in the frame of the camera."""

    tool: Frame
    ball: Vector


class Vision(Protocol):
    """Looks into bins; `fill`, `stir`, `clear`, `hold_out` and `let_go` are what simulated people do."""

    async def look(self, bin_name: str, view: int = 0) -> Sequence[Sighting]:
        """Return the parts that are seen in a bin, the topmost first.

        `view` numbers the position of the camera. Images from the views before count as well, from view 0 on
        and until something in the cell is moved.
        """

    async def find_ball(self, place: Vector, radius_m: float, camera: str | None = None) -> SeenBall | None:
        """Return the ball that a camera sees near to a place of the cell; None without one.

        By default it is the camera in the hand.
        """

    async def calibrate(self, seen: Sequence[SeenBall]) -> Mapping[str, float]:
        """Store where the camera in the hand is mounted, and return figures for the result of the Task.

        Raises `HandoverError` where the images do not determine it.
        """

    async def calibrate_fixed(
        self, camera: str, places: Sequence[Vector], seen: Sequence[Vector]
    ) -> Mapping[str, float]:
        """Store durably where a fixed camera is mounted, from balls at known places and as it sees them.

        Raises `HandoverError` where they do not determine it, `OSError` when it cannot be stored.
        """

    @property
    def fixed_cameras(self) -> Sequence[str]:
        """Return the cameras of the scene."""

    async def fill(self, bin_name: str) -> None:
        """Have an empty bin filled."""

    async def stir(self, bin_name: str) -> None:
        """Have the parts in a bin moved, after none of them could be gripped."""

    async def clear(self, fixture: str) -> None:
        """Have the parts in a fixture taken away."""

    async def hold_out(self) -> Grip | None:
        """Have a person hold a part between the opened fingers; return how it is held.

        None where people are no part of the simulation, or have no part.
        """

    async def let_go(self) -> None:
        """Have the person let go of that part; then it stays in the gripper, or falls."""


class Camera:
    """A simulated camera above a bin; it detects parts with the probability `detection_rate`.

    A `seed` determines the sequence of results.
    """

    def __init__(self, detection_rate: float, seed: int) -> None:
        self._detection_rate = detection_rate
        self._chance = random.Random(seed)  # noqa: S311 - a simulation that must repeat

    def look(self, parts: Sequence[str]) -> str | None:
        """Return the topmost of `parts`; None if it is not detected."""
        seen = self._chance.random() < self._detection_rate
        return parts[0] if parts and seen else None
