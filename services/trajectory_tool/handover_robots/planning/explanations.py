"""Why there is no motion, in words for people: what touches, what is out of reach, what is free nearby."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handover.messages import Message, message
from handover_robots.model.poses import Pose
from handover_robots.planning.arm import Array, se3_of
from handover_robots.planning.collision import Clearance, Collisions
from handover_robots.planning.inverse import Inverse
from handover_robots.planning.motions import Motions
from handover_robots.planning.straight import Obstructed

CLEARANCE_SEARCH_M = 0.3


@dataclass(frozen=True, slots=True)
class Explanations:
    """Explains for an arm in a world; nearer than `least_margin_m` counts as touching."""

    inverse: Inverse
    collisions: Collisions
    least_margin_m: float

    def contact(self, joints: Array, margin_m: float) -> Message:
        """Return the pair that is nearer than a margin, or else the closest one."""
        near = self.collisions.contacts(joints, margin_m) or [self.collisions.closest(joints)]
        return _pair(near[0])

    def unreachable(self, pose: Pose, near: Array) -> Message:
        """Return that the tool does not reach a pose, and the nearest that it reaches."""
        nearest = self.inverse.nearest(pose, near)
        if nearest.distance_m < 0.001:
            return message(
                "robot.orientation_unreachable",
                "the tool reaches ({position}) m, but not with this orientation; the nearest one is turned "
                "by {angle} degrees: [{orientation}]",
                position=_numbers(pose.position),
                angle=f"{math.degrees(nearest.angle_rad):.0f}",
                orientation=_numbers(nearest.pose.orientation),
            )
        return message(
            "robot.pose_unreachable",
            "the tool cannot be at ({position}) m: the nearest it reaches is ({nearest}) m, "
            "{distance} m away",
            position=_numbers(pose.position),
            nearest=_numbers(nearest.pose.position),
            distance=f"{nearest.distance_m:.3f}",
        )

    def touching_at(self, pose: Pose, near: Array, touching: list[Array]) -> Message:
        """Return what touches at a pose where all joint positions do, and a free pose behind it."""
        least = max(touching, key=lambda joints: self.collisions.closest(joints).distance_m)
        pair = self.contact(least, self.least_margin_m)
        back = self._nearest_free_behind(pose, near)
        if back is None:
            return message(
                "robot.pose_blocked",
                "the tool cannot be at ({position}) m: {pair}; choose another pose",
                position=_numbers(pose.position),
                pair=pair,
            )
        return message(
            "robot.pose_blocked_free_behind",
            "the tool cannot be at ({position}) m: {pair}; free is ({free}) m, "
            "{distance} m back along the tool",
            position=_numbers(pose.position),
            pair=pair,
            free=_numbers(back.position),
            distance=f"{pose.distance_m(back):.2f}",
        )

    def _nearest_free_behind(self, pose: Pose, near: Array) -> Pose | None:
        placement = se3_of(pose)
        axis = placement.rotation[:, 2]
        motions = Motions(self.collisions, self.least_margin_m)
        for back_m in np.arange(0.01, CLEARANCE_SEARCH_M, 0.01).tolist():
            x, y, z = (placement.translation - back_m * axis).tolist()
            moved = Pose((x, y, z), pose.orientation)
            if self.inverse.several(moved, near, 1, motions.is_state_free):
                return moved
        return None

    def blocked(self, motions: Motions, start: Array, goal: Array, timeout_s: float) -> Message:
        """Return what is on the straight way, where no other way was found."""
        touch = motions.first_contact([start, goal])
        pair = "" if touch is None else self.contact(touch, motions.margin_m)
        return message(
            "robot.no_way_around",
            "no way to the target was found in {timeout} s; on the straight way {pair}",
            timeout=f"{timeout_s:g}",
            pair=pair,
        )

    def obstructed(self, line: Obstructed, pose: Pose, start: Array) -> Message:
        """Return why the tool cannot move straight to a pose."""
        reached = self.inverse.arm.tool_pose(line.joints)
        if line.is_singular:
            return message(
                "robot.line_singular",
                "the tool cannot move straight to ({position}) m: it passes a singularity at ({reached}) m; "
                "use moveTo, or start from another position of the arm",
                position=_numbers(pose.position),
                reached=_numbers(reached.position),
            )
        if self.inverse.solve(pose, start) is None:
            return self.unreachable(pose, start)
        return message(
            "robot.line_limit",
            "the tool cannot move straight to ({position}) m: the joints end at ({reached}) m; use moveTo, "
            "or start from another position of the arm",
            position=_numbers(pose.position),
            reached=_numbers(reached.position),
        )


def _pair(near: Clearance) -> Message:
    if near.distance_m <= 0:
        return message("robot.touches", "{first} touches {second}", first=near.first, second=near.second)
    return message(
        "robot.too_near",
        "{first} is {distance} mm from {second}",
        first=near.first,
        second=near.second,
        distance=f"{1000 * near.distance_m:.1f}",
    )


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.3f}" for value in values)
