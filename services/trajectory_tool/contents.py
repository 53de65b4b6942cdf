"""Contents: the poses of all parts that lie in the cell.

The values are immutable: every action returns the contents after it.
"""

from dataclasses import dataclass, replace

from services.trajectory_tool.poses import Pose
from services.trajectory_tool.scene import Scene, Spot

SAME_NEST_M = 0.01


@dataclass(frozen=True, slots=True)
class Lying:
    """A part in a bin or a fixture (`place`), or elsewhere (None)."""

    part: str
    place: str | None
    pose: Pose


@dataclass(frozen=True, slots=True)
class Contents:
    """The parts of the cell outside of grippers; `numbered` counts all parts so far, for their names."""

    lying: tuple[Lying, ...] = ()
    numbered: int = 0

    def in_place(self, place: str) -> list[Lying]:
        """Return the parts in a bin or a fixture, the topmost first."""
        return [part for part in self.lying if part.place == place]

    def find(self, part: str) -> Lying | None:
        """Return the part `part`; None if it is not in the cell."""
        return next((lying for lying in self.lying if lying.part == part), None)

    def between_fingers(self, tool: Pose, opening_m: float) -> str | None:
        """Return the part that a gripper at `tool` would grip; None if there is none."""
        near = [part for part in self.lying if part.pose.distance_m(tool) <= opening_m]
        return min(near, key=lambda part: part.pose.distance_m(tool)).part if near else None

    def gripped(self, part: str) -> "Contents":
        """Return the contents after a gripper gripped `part`."""
        return replace(self, lying=tuple(lying for lying in self.lying if lying.part != part))

    def released(self, part: str, place: str | None, pose: Pose) -> "Contents":
        """Return the contents after a gripper released `part` at `pose`."""
        return replace(self, lying=(*self.lying, Lying(part, place, pose)))

    def filled(self, scene: Scene, bin_name: str) -> "Contents":
        """Return the contents after a bin was filled with new parts."""
        new = tuple(
            Lying(f"part-{number}", bin_name, spot.pose)
            for number, spot in enumerate(scene.bins[bin_name].parts, self.numbered + 1)
        )
        return replace(self, lying=self.lying + new, numbered=self.numbered + len(new))

    def emptied(self, place: str) -> "Contents":
        """Return the contents after the parts of a fixture were removed."""
        return replace(self, lying=tuple(lying for lying in self.lying if lying.place != place))

    def moved(self, before: Scene, after: Scene) -> "Contents":
        """Return the contents after the scene has changed: parts of places that are gone leave the cell.

        A bin that is new, or whose parts are described differently, has its parts as described.
        """
        places = {*after.bins, *after.fixtures}
        new = [name for name, one in after.bins.items() if one.parts != _parts_of(before, name)]
        kept = tuple(
            lying for lying in self.lying if lying.place is None or lying.place in places.difference(new)
        )
        contents = replace(self, lying=kept)
        for name in new:
            contents = contents.filled(after, name)
        return contents

    def free_nest(self, scene: Scene, fixture: str) -> Pose | None:
        """Return the first free nest of a fixture."""
        for nest in scene.fixtures[fixture].nests:
            if self.between_fingers(nest.pose, SAME_NEST_M) is None:
                return nest.pose
        return None


def _parts_of(scene: Scene, bin_name: str) -> tuple[Spot, ...] | None:
    return scene.bins[bin_name].parts if bin_name in scene.bins else None


def initial(scene: Scene) -> Contents:
    """Return the initial contents of a cell."""
    contents = Contents()
    for name in scene.bins:
        contents = contents.filled(scene, name)
    return contents
