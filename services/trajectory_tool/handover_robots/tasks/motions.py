"""Operations that move: to joint positions, to poses, and home."""

import math
from typing import Any

from handover.messages import text_of
from handover.performer import TaskFailed
from handover_robots.model.faults import NoPath, Unreachable
from handover_robots.model.joints import Joints
from handover_robots.model.poses import Pose
from handover_robots.planning import is_available
from handover_robots.tasks.parameters import (
    GivenTilt,
    Home,
    MoveLinear,
    MoveTo,
    Target,
)
from handover_robots.tasks.work import Work

Result = dict[str, Any]


async def home(work: Work, _: Home) -> Result:
    """Move to the home position."""
    return await _move(work, work.unit.home)


async def move_to(work: Work, asked: MoveTo) -> Result:
    """Move to joint angles or to a pose of the tool."""
    targets = []
    here = work.unit.joints
    for number, waypoint in enumerate(asked.through):
        here = await joints_of(work, waypoint, here, f'parameter "through.{number}" of moveTo')
        targets.append(here)
    targets.append(await joints_of(work, asked, here, "moveTo"))
    tilt = None if asked.tilt is None else _tilt(asked.tilt)
    if len(targets) == 1:
        return await _move(work, targets[0], tilt)
    work.intend(*targets)
    await work.go_through(targets, tilt)
    return {"joints": [round(angle, 6) for angle in work.unit.joints]}


async def joints_of(work: Work, target: Target, near: Joints, where: str) -> Joints:
    """Return the joint positions of a target. Raises `TaskFailed` that names it."""
    model = work.unit.model
    prefix = f'parameter "{{}}" of {where}' if not where.startswith("parameter") else where
    if target.pose is not None:
        return await reach(work, target.pose.pose, near, prefix.format("pose"))
    if target.named is not None:
        return _named(work, target.named, prefix.format("named"))
    try:
        return model.allow(target.joints or ())
    except Unreachable as why:
        raise TaskFailed.translated(
            "robot.target_unreachable", "{target}: {why}", target=prefix.format("joints"), why=text_of(why)
        ) from None


def _named(work: Work, name: str, where: str) -> Joints:
    unit = work.unit
    positions = {**unit.model.poses, "home": unit.home}
    if name not in positions:
        raise TaskFailed.translated(
            "robot.unknown_named_position",
            '{target}: {robot} has no position "{name}"; it has {known}',
            target=where,
            robot=unit.model.name,
            name=name,
            known=", ".join(positions),
        )
    return positions[name]


def _tilt(tilt: GivenTilt) -> Any:
    if not is_available():
        raise TaskFailed.translated(
            "robot.tilt_needs_planning", 'parameter "tilt" of moveTo needs the extra "motion"'
        )
    from handover_robots.planning.tilt import Tilt  # noqa: PLC0415 - needs the extra

    return Tilt(tilt.axis, tilt.direction, math.radians(tilt.max_angle_deg))


async def move_linear(work: Work, request: MoveLinear) -> Result:
    """Move the tool on a straight line to a pose."""
    await work.go_straight(request.pose.pose, request.tool_speed)
    return {
        "joints": [round(angle, 6) for angle in work.unit.joints],
        "pose": work.unit.tool_pose.written(),
    }


async def _move(work: Work, target: Joints, tilt: Any = None) -> Result:
    work.intend(target)
    await work.go(target, tilt)
    return {"joints": [round(angle, 6) for angle in work.unit.joints]}


async def reach(work: Work, pose: Pose, near: Joints, what: str) -> Joints:
    """Return joints with the tool at a pose. Raises `TaskFailed` that says `what` is out of reach."""
    unit = work.unit
    try:
        if unit.planning.avoids_obstacles:
            return await work.plan(lambda planner: planner.nearest_free(pose, near))
        return unit.model.reach(pose, near)
    except (Unreachable, NoPath) as why:
        raise TaskFailed.translated(
            "robot.target_unreachable", "{target}: {why}", target=what, why=text_of(why)
        ) from None
