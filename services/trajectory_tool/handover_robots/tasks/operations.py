"""Operations: the Tasks of the robot by their names, and the search in a bin."""

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any

from handover.performer import TaskFailed
from handover_robots.metrics import SCANS
from handover_robots.tasks import bin_search
from handover_robots.tasks.bin_search import unknown_bin
from handover_robots.tasks.calibration import calibrate_camera
from handover_robots.tasks.grasping import hand_over, pick, place
from handover_robots.tasks.motions import Result, home, move_linear, move_to, reach
from handover_robots.tasks.parameters import (
    CalibrateCamera,
    HandOver,
    Home,
    MoveLinear,
    MoveTo,
    Pick,
    Place,
    Scan,
)
from handover_robots.tasks.work import Work


@dataclass(frozen=True, slots=True)
class Operation:
    """An operation: its parameters and its execution."""

    parameters: type[Home]
    perform: Callable[[Work, Any], Awaitable[Result]]


async def scan(work: Work, request: Scan) -> Result:
    """Look into a bin from above and return the part on top and its pose."""
    unit = work.unit
    if request.bin not in unit.scene.bins:
        raise TaskFailed(unknown_bin("scan", request.bin, unit.scene.bins))
    seen_bin = unit.scene.bins[request.bin]
    views = (seen_bin.view, *seen_bin.more_views)
    if request.view >= len(views):
        raise TaskFailed.translated(
            "robot.unknown_view",
            'parameter "view" of scan: {bin} has {count} views, from 0 to {last}',
            bin=request.bin,
            count=len(views),
            last=len(views) - 1,
        )
    pose = views[request.view].pose.moved(request.offset)
    view = await reach(work, pose, unit.joints, f"the view of {request.bin}")
    work.intend(view, seen_bin.looks_for_s)
    await work.go(view)
    await work.wait(seen_bin.looks_for_s)
    topmost, reason = await bin_search.search(unit, request.bin, request.view)
    looked: Result = {"bin": request.bin}
    if len(views) > 1:
        looked |= {"view": request.view, "nextView": (request.view + 1) % len(views)}
    SCANS.labels(str(topmost is not None).lower()).inc()
    if topmost is not None:
        await unit.remember()
        return {"found": True, "part": topmost.part, "pose": topmost.pose.written(), **looked}
    if not unit.parts_in(request.bin):
        reason = f"{request.bin} is empty"
        await unit.found_empty(request.bin)
        await unit.remember()
    return {"found": False, "reason": reason, **looked}


OPERATIONS: Mapping[str, Operation] = {
    "moveTo": Operation(MoveTo, move_to),
    "moveLinear": Operation(MoveLinear, move_linear),
    "scan": Operation(Scan, scan),
    "pick": Operation(Pick, pick),
    "place": Operation(Place, place),
    "home": Operation(Home, home),
    "handOver": Operation(HandOver, hand_over),
    "calibrateCamera": Operation(CalibrateCamera, calibrate_camera),
}


def operation_named(name: str) -> Operation:
    """Return the operation `name`. Raises `TaskFailed` with the known names."""
    if name not in OPERATIONS:
        raise TaskFailed.translated(
            "robot.unknown_operation",
            'the robot knows no operation "{operation}"; give parameter "operation" as one of {known}',
            operation=name,
            known=", ".join(OPERATIONS),
        )
    return OPERATIONS[name]
