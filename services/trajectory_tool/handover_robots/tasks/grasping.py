"""Operations of the gripper: pick, place, and hand a part over.

Each can be restarted after a power cut: an action that the gripper has performed for the Task is not
repeated. While the outcome of an action is unknown, nothing is picked or placed.
"""

from handover.messages import message, text_of
from handover.performer import TaskFailed
from handover.tasks.outcomes import outcome_unknown
from handover_robots.model.faults import NoPath, Unreachable
from handover_robots.model.joints import Joints
from handover_robots.model.poses import NO_TURN, Frame, Pose
from handover_robots.tasks.bin_search import unknown_bin
from handover_robots.tasks.motions import Result, joints_of, reach
from handover_robots.tasks.parameters import (
    Approaching,
    HandOver,
    Pick,
    Place,
)
from handover_robots.tasks.work import Work

AT_THE_SPOT_M = 0.01
"""Within this distance the tool is still at the pose of the gripper's action."""


async def pick(work: Work, request: Pick) -> Result:
    """Grip a part: approach from above, move down, close, move up."""
    _require_known_outcome(work)
    unit = work.unit
    if unit.held is not None:
        return await _already_picked(work, request, unit.held)
    spot = _where_to_pick(work, request)
    above, at = await _from_above(work, request, spot, "the part")
    if unit.robot.gripper_closed:
        await work.release(None)
    work.intend(above, at, unit.scene.gripper.acts_in_s, above)
    await work.go(above)
    await _go_near(work, spot, at)
    before = unit.contents
    part = await work.grip()
    if part is not None and request.part not in {None, part}:
        lay = before.find(part)
        await work.release(lay.place if lay else None)
        await _retreat(work, request, spot, above)
        raise TaskFailed.translated(
            "robot.other_part_there",
            '"{part}" lies at {position} where "{asked}" was requested; '
            "scan the bin again and give the part and the pose of the result",
            part=part,
            position=_position(spot),
            asked=request.part,
        )
    await _retreat(work, request, spot, above)
    await _require_held(work)
    if part is None:
        raise TaskFailed.translated(
            "robot.no_part_there",
            "there was no part at {position}; scan the bin again and give the pose of the result",
            position=_position(spot),
        )
    return {"part": part, "gripped": True}


async def place(work: Work, request: Place) -> Result:
    """Put the held part down: approach from above, move down, open, move up."""
    _require_known_outcome(work)
    unit = work.unit
    if unit.held is None:
        return await _already_placed(work, request)
    part = unit.held
    await _require_held(work)
    spot = await _where_to_place(work, request)
    above, at = await _from_above(work, request, spot, "the place")
    work.intend(above, at, unit.scene.gripper.acts_in_s, above)
    await work.go(above)
    await _require_held(work)
    await _go_near(work, spot, at)
    await work.release(request.location)
    await _retreat(work, request, spot, above)
    return _placed(part, request.location, spot)


async def hand_over(work: Work, request: HandOver) -> Result:
    """Go to the pose of the hand-over, wait for the person, and open or close the gripper; then rest."""
    _require_known_outcome(work)
    unit = work.unit
    done = work.done_before()
    if done is not None:
        return _handed_over(request, done.part)
    gives = request.direction == "give"
    if gives and unit.held is None:
        raise TaskFailed.translated("robot.nothing_to_give", "the gripper is empty; pick a part to hand over")
    if not gives and unit.held is not None:
        raise TaskFailed.translated(
            "robot.gripper_full",
            'the gripper holds "{part}"; place it, or take it out by hand, before another part is picked',
            part=unit.held,
        )
    by_contact = request.confirmation == "contact"
    if by_contact and unit.robot.wrist_force_n() is None:
        raise TaskFailed.translated(
            "robot.no_wrist_force",
            'parameter "confirmation" of handOver: this robot has no force sensor; use "person"',
        )
    target = await joints_of(work, request, unit.joints, "handOver")
    if not gives and unit.robot.gripper_closed:
        await work.release(None)
    work.intend(target, 0.0, unit.scene.gripper.acts_in_s)
    await work.go(target)
    if not await work.wait_for_confirmation(request.timeout_s, request.contact_n if by_contact else None):
        raise TaskFailed.translated(
            "robot.hand_over_not_confirmed",
            "nobody confirmed the hand-over within {timeout} s; the gripper is unchanged",
            timeout=f"{request.timeout_s:g}",
        )
    part = unit.held or request.part or f"part of {work.task.rsplit(':', 1)[-1]}"
    if gives:
        await work.give()
    elif not await work.take(part):
        raise TaskFailed.translated(
            "robot.nothing_taken", "nothing was between the fingers; the gripper is open again"
        )
    return _handed_over(request, part)


def _handed_over(request: HandOver, part: str) -> Result:
    return {"part": part, "direction": request.direction, "handedOver": True}


def _require_known_outcome(work: Work) -> None:
    """Raise `TaskFailed` if nobody knows whether the gripper has gripped or released a part."""
    begun = work.unit.begun
    if begun is None:
        return
    if begun.kind == "grip":
        why = message(
            "robot.grip_interrupted",
            "the trajectory tool stopped while the gripper closed for {task}; look what it holds, then free "
            "it on the page of the robot, and put the part back",
            task=begun.task,
        )
    else:
        why = message(
            "robot.release_interrupted",
            "the trajectory tool stopped while the gripper opened for {task}; look whether it holds the "
            "part, then free it on the page of the robot, and put the part in its place",
            task=begun.task,
        )
    raise TaskFailed(outcome_unknown(why) if begun.task == work.task else why)


async def _already_picked(work: Work, request: Pick, held_part: str) -> Result:
    done = work.done_before()
    if done is None and request.part != held_part:
        raise TaskFailed.translated(
            "robot.gripper_full",
            'the gripper holds "{part}"; place it, or take it out by hand, before another part is picked',
            part=held_part,
        )
    await _leave(work, request)
    return {"part": held_part, "gripped": True}


async def _already_placed(work: Work, request: Place) -> Result:
    done = work.done_before()
    if done is None or done.kind != "released":
        raise TaskFailed.translated(
            "robot.gripper_empty", "the gripper is empty; pick a part before one is placed"
        )
    await _leave(work, request)
    return _placed(done.part, done.place, done.pose)


async def _leave(work: Work, request: Approaching) -> None:
    """Move up from the pose of the gripper's action if the arm is still there after an interruption."""
    unit = work.unit
    act = unit.last_act
    if act is None or unit.tool_pose.distance_m(act.pose) > AT_THE_SPOT_M:
        return
    raised = _before(work, request, act.pose, request.retreat_m)
    above = await reach(work, raised, unit.joints, "the way up")
    work.intend(above)
    await _go_near(work, raised, above)


def _where_to_pick(work: Work, request: Pick) -> Pose:
    unit = work.unit
    if request.pose is not None:
        return request.pose.pose
    if request.part is None and request.bin is not None:
        if request.bin not in unit.scene.bins:
            raise TaskFailed(unknown_bin("pick", request.bin, unit.scene.bins))
        parts = unit.parts_in(request.bin)
        if not parts:
            raise TaskFailed.translated(
                "robot.bin_empty", "{bin} is empty; fill it before a part is picked from it", bin=request.bin
            )
        return parts[0].pose
    part = request.part or unit.seen
    if part is None:
        raise TaskFailed.translated(
            "robot.no_part_seen",
            'no part has been seen yet; scan a bin first, or give pick a "part", "pose" or "bin"',
        )
    lying = unit.contents.find(part)
    if lying is None:
        raise TaskFailed.translated(
            "robot.unknown_part",
            'no part "{part}" lies in the cell; scan a bin and give the part of the result',
            part=part,
        )
    return lying.pose


async def _require_held(work: Work) -> None:
    """Raise `TaskFailed` if the gripper measures that it has lost its part."""
    unit = work.unit
    if unit.held is None or unit.robot.is_holding is not False:
        return
    part = await unit.lose()
    raise TaskFailed.translated(
        "robot.part_slipped",
        '"{part}" slipped out of the gripper near {position}; scan the bin, or take the part away',
        part=part,
        position=_position(unit.tool_pose),
    )


async def _where_to_place(work: Work, request: Place) -> Pose:
    if request.pose is not None:
        return request.pose.pose
    fixtures = work.unit.scene.fixtures
    name = request.location or ""
    if name not in fixtures:
        raise TaskFailed.translated(
            "robot.unknown_fixture",
            'parameter "location" of place: there is no fixture "{fixture}"; the cell has {known}',
            fixture=name,
            known=", ".join(fixtures) or "none",
        )
    nest = await work.unit.nest_in(name)
    if nest is None:
        raise TaskFailed.translated(
            "robot.fixture_full",
            "all nests of {fixture} are full; take parts out of it or place the part elsewhere",
            fixture=name,
        )
    return _with_grip(work, nest)


def _with_grip(work: Work, nest: Pose) -> Pose:
    """Return the pose of the tool with the held part in a nest, if it is known how the part is held."""
    grip, size = work.unit.grip_of_part, work.unit.scene.gripper.part_size_m
    if grip is None or size is None:
        return nest
    x, y, _ = grip.part.position
    aside = Pose.of(nest.frame() @ Frame(NO_TURN, (-x, -y, 0.0)))
    return aside.raised(grip.below_m - size[2] / 2)


async def _from_above(work: Work, request: Approaching, spot: Pose, what: str) -> tuple[Joints, Joints]:
    """Return joints above a spot and at it; in a cell with obstacles, a straight motion connects them."""
    unit, before = work.unit, _before(work, request, spot, request.approach_m)
    if not unit.planning.avoids_obstacles:
        above = await reach(work, before, unit.joints, f"above {what}")
        return above, await reach(work, spot, above, what)
    try:
        there, down = await work.plan(lambda planner: planner.approach(unit.joints, before, spot))
    except (Unreachable, NoPath) as why:
        raise TaskFailed.translated(
            "robot.target_unreachable", "{target}: {why}", target=what, why=text_of(why)
        ) from None
    return there.target, down.target


def _before(work: Work, request: Approaching, spot: Pose, distance_m: float | None) -> Pose:
    """Return the pose from which the tool moves straight to a spot, or to which it leaves."""
    back_m = distance_m or work.unit.scene.gripper.approach_m
    if request.along == "vertical":
        return spot.raised(back_m)
    return Pose.of(spot.frame() @ Pose((0.0, 0.0, -back_m), (0.0, 0.0, 0.0, 1.0)).frame())


async def _retreat(work: Work, request: Approaching, spot: Pose, above: Joints) -> None:
    """Leave a spot straight: to `above`, where the tool came from, or as far as the Task says."""
    raised = _before(work, request, spot, request.retreat_m or request.approach_m)
    is_way_back = request.retreat_m in {None, request.approach_m}
    joints = above if is_way_back else await reach(work, raised, work.unit.joints, "the way up")
    await _go_near(work, raised, joints)


async def _go_near(work: Work, pose: Pose, joints: Joints) -> None:
    """Move to or from a part: straight where obstacles are known, else to `joints`."""
    if work.unit.planning.avoids_obstacles:
        await work.go_straight(pose)
    else:
        await work.go(joints)


def _placed(part: str, location: str | None, pose: Pose) -> Result:
    where = {"location": location} if location is not None else {}
    return {"part": part, **where, "pose": pose.written()}


def _position(pose: Pose) -> str:
    return "(" + ", ".join(f"{value:.3f}" for value in pose.position) + ") m"
