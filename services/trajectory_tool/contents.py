"""Contents: which part lies where at the moment, and which one the gripper holds.

Pure: every act gives the contents as they are after it.
"""

from dataclasses import dataclass, replace

from services.trajectory_tool.poses import Pose
from services.trajectory_tool.scene import Scene

SAME_NEST_M = 0.01


@dataclass(frozen=True, slots=True)
class Lying:
    """A part that lies in a bin or a fixture (`place`), or just somewhere (None)."""

    part: str
    place: str | None
    pose: Pose


@dataclass(frozen=True, slots=True)
class Contents:
    """All parts of the cell; `numbered` is how many there have ever been, for their names."""

    lying: tuple[Lying, ...] = ()
    held: str | None = None
    numbered: int = 0

    def in_place(self, place: str) -> list[Lying]:
        """Return the parts in a bin or a fixture, the topmost first."""
        return [one for one in self.lying if one.place == place]

    def find(self, part: str) -> Lying | None:
        """Return where a part lies; None if it does not lie anywhere."""
        return next((one for one in self.lying if one.part == part), None)

    def between_fingers(self, tool: Pose, opening_m: float) -> str | None:
        """Return the part that a gripper at `tool` would hold if it closed; None if there is none."""
        near = [one for one in self.lying if one.pose.distance_m(tool) <= opening_m]
        return min(near, key=lambda one: one.pose.distance_m(tool)).part if near else None

    def gripped(self, part: str) -> "Contents":
        """Return the contents once the gripper holds `part`."""
        return replace(self, lying=tuple(one for one in self.lying if one.part != part), held=part)

    def freed(self) -> "Contents":
        """Return the contents once a person has taken the part out of the gripper and away."""
        return replace(self, held=None)

    def released(self, place: str | None, pose: Pose) -> "Contents":
        """Return the contents once the part that was held lies at `pose`."""
        if self.held is None:
            return self
        return replace(self, lying=(*self.lying, Lying(self.held, place, pose)), held=None)

    def filled(self, scene: Scene, bin_name: str) -> "Contents":
        """Return the contents once a bin has been filled with new parts."""
        new = tuple(
            Lying(f"part-{number}", bin_name, spot.pose)
            for number, spot in enumerate(scene.bins[bin_name].parts, self.numbered + 1)
        )
        return replace(self, lying=self.lying + new, numbered=self.numbered + len(new))

    def emptied(self, place: str) -> "Contents":
        """Return the contents once the parts in a fixture have been taken away."""
        return replace(self, lying=tuple(one for one in self.lying if one.place != place))

    def free_nest(self, scene: Scene, fixture: str) -> Pose | None:
        """Return the first nest of a fixture in which no part lies."""
        for nest in scene.fixtures[fixture].nests:
            if self.between_fingers(nest.pose, SAME_NEST_M) is None:
                return nest.pose
        return None


def fresh(scene: Scene) -> Contents:
    """Return the contents of the cell on its first day."""
    contents = Contents()
    for name in scene.bins:
        contents = contents.filled(scene, name)
    return contents
