"""Contents: the poses of all parts that lie in the cell.

The values are immutable: every action returns the contents after it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from handover_robots.model.poses import Pose, Vector
from handover_robots.scene.scene import Scene, Spot

SAME_NEST_M = 0.01
SAME_PART_M = 0.02
"""A part that is seen this near to a known one is that part."""


@dataclass(frozen=True, slots=True)
class Grip:
    """How a gripper holds a part: `part` is its middle in the frame of the tip, `size` its lengths."""

    part: Pose
    size: Vector

    @property
    def below_m(self) -> float:
        """Return how far the part reaches beyond the tips."""
        rows = self.part.frame().rotation
        reach = sum(abs(share) * side / 2 for share, side in zip(rows[2], self.size, strict=True))
        return self.part.position[2] + reach


@dataclass(frozen=True, slots=True)
class Lying:
    """A part in a bin or a fixture (`place`), or elsewhere (None).

    `pose` is that of a tool that grips it, and `grip` how the tool then holds it, if that is known.
    """

    part: str
    place: str | None
    pose: Pose
    grip: Grip | None = None

    @property
    def middle(self) -> Vector:
        """Return where the part is."""
        if self.grip is None:
            return self.pose.position
        return (self.pose.frame() @ self.grip.part.frame()).position


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

    def named(self) -> "tuple[Contents, str]":
        """Return the contents after a part that was unknown got a name, and that name."""
        number = self.numbered + 1
        return replace(self, numbered=number), f"part-{number}"

    def released(self, part: str, place: str | None, pose: Pose, grip: Grip | None = None) -> "Contents":
        """Return the contents after a gripper that was at `pose` released `part`."""
        return replace(self, lying=(*self.lying, Lying(part, place, pose, grip)))

    def filled(self, scene: Scene, bin_name: str) -> "Contents":
        """Return the contents after a bin was filled with new parts."""
        new = tuple(
            Lying(f"part-{number}", bin_name, spot.pose)
            for number, spot in enumerate(scene.bins[bin_name].parts, self.numbered + 1)
        )
        return replace(self, lying=self.lying + new, numbered=self.numbered + len(new))

    def observed(self, bin_name: str, seen: Sequence[tuple[Pose, Grip | None]]) -> "Contents":
        """Return the contents after a look into a bin; parts near to known ones keep their names."""
        unseen = self.in_place(bin_name)
        in_bin: list[Lying] = []
        numbered = self.numbered
        for pose, grip in seen:
            near = [part for part in unseen if part.pose.distance_m(pose) < SAME_PART_M]
            same = min(near, key=lambda part: part.pose.distance_m(pose), default=None)
            if same is None:
                numbered += 1
                in_bin.append(Lying(f"part-{numbered}", bin_name, pose, grip))
            else:
                unseen.remove(same)
                in_bin.append(Lying(same.part, bin_name, pose, grip))
        others = tuple(lying for lying in self.lying if lying.place != bin_name)
        return replace(self, lying=(*in_bin, *others), numbered=numbered)

    def emptied(self, place: str) -> "Contents":
        """Return the contents after the parts of a fixture were removed."""
        return replace(self, lying=tuple(lying for lying in self.lying if lying.place != place))

    def moved(self, before: Scene, after: Scene) -> "Contents":
        """Return the contents after the scene has changed: parts of places that are gone leave the cell.

        A bin that is new, or whose parts are described differently, has its parts as described.
        """
        places = {*after.bins, *after.fixtures}
        new = [name for name, after_bin in after.bins.items() if after_bin.parts != _parts_of(before, name)]
        kept = tuple(
            lying for lying in self.lying if lying.place is None or lying.place in places.difference(new)
        )
        contents = replace(self, lying=kept)
        for name in new:
            contents = contents.filled(after, name)
        return contents

    def free_nest(self, scene: Scene, fixture: str) -> Pose | None:
        """Return the first free nest of a fixture."""
        taken = [lying.middle[:2] for lying in self.lying]
        for nest in scene.fixtures[fixture].nests:
            if all(math.dist(nest.position[:2], other) > SAME_NEST_M for other in taken):
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
