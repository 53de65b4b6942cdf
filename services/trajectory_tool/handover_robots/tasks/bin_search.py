"""The search for a part in a bin: the topmost one that the robot can grip and reach, or why there is none."""

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from handover.messages import Message, message
from handover_robots.cell.robot_unit import RobotUnit
from handover_robots.scene.contents import Lying
from handover_robots.scene.vision import SeenGrasp, Sighting

if TYPE_CHECKING:
    from handover_robots.planning.planner import Planner

SAME_GRASP_M = 0.006
"""A grasp this near to one that failed is not tried again."""

MAX_TRIED = 60
"""Grasps of one image for which the way of the arm is checked."""


async def search(unit: RobotUnit, bin_name: str, view: int) -> tuple[Lying | None, str]:
    """Look into a bin from a view; return a part, or None and the reason."""
    vision = unit.robot.vision
    if vision is None:
        return unit.look_into(bin_name), f"no part lies free in {bin_name}"
    if view == 0:
        if bin_name in unit.to_stir and unit.scene.bins[bin_name].refilled:
            await vision.stir(bin_name)
            unit.missed.clear()
        unit.to_stir.discard(bin_name)
    sightings = await vision.look(bin_name, view)
    chosen = await _first_reachable(unit, sightings)
    ordered = sorted(sightings, key=lambda sighting: chosen is None or sighting is not chosen[0])
    seen = [
        (chosen[1].tool, chosen[1].grip) if chosen and sighting is chosen[0] else (sighting.part, None)
        for sighting in ordered
    ]
    unit.contents = unit.contents.observed(bin_name, seen)
    if chosen is not None:
        unit.to_stir.discard(bin_name)
        topmost = unit.parts_in(bin_name)[0]
        unit.seen = topmost.part
        return topmost, ""
    unit.to_stir.add(bin_name)
    return None, _why_none(bin_name, sightings)


async def _first_reachable(
    unit: RobotUnit, sightings: Sequence[Sighting]
) -> tuple[Sighting, SeenGrasp] | None:
    """Return the best grasp that the arm reaches, of the topmost part that has one."""
    candidates = [
        (sighting, grasp)
        for sighting in sightings
        for grasp in sighting.grasps
        if all(grasp.tool.distance_m(missed) > SAME_GRASP_M for missed in unit.missed)
    ][:MAX_TRIED]
    approach_m = unit.scene.gripper.approach_m

    def choose(planner: "Planner") -> tuple[Sighting, SeenGrasp] | None:
        return next(
            (
                (sighting, grasp)
                for sighting, grasp in candidates
                if planner.is_approachable(unit.joints, grasp.tool.raised(approach_m), grasp.tool)
            ),
            None,
        )

    return await unit.planning.plan(choose)


def _why_none(bin_name: str, sightings: Sequence[Sighting]) -> str:
    if not sightings:
        return f"no part was seen in {bin_name}"
    reasons = sorted(str(sighting.reason or "the arm does not reach its grasps") for sighting in sightings)
    counted = (f"{len(list(same))}: {reason}" for reason, same in itertools.groupby(reasons))
    return f"no part lies free in {bin_name}: of {len(sightings)} that are seen, {'; '.join(counted)}"


def unknown_bin(operation: str, name: str, bins: Mapping[str, Any]) -> Message:
    """Return that there is no such bin, and the names of those that there are."""
    return message(
        "robot.unknown_bin",
        'parameter "bin" of {operation}: there is no bin "{bin}"; the cell has {known}',
        operation=operation,
        bin=name,
        known=", ".join(bins) or "none",
    )
