"""Routes of one controller: its state, and what a person may request of it. No route ends a safety stop."""

import time
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

from fastapi import FastAPI
from starlette.requests import HTTPConnection

from handover.errors import Problem
from handover.http.api_description import TaggedRoutes
from handover.messages import text_of
from handover.security.guard import guard_of, require
from handover.security.permissions import Permission
from handover_ur.dashboard import Dashboard, DashboardError
from handover_ur.faults import fault_of, is_connected, why_silent
from handover_ur.options import UrOptions
from handover_ur.shared_memory import Report
from handover_ur.states import RuntimeState, robot_mode, safety_status

T = TypeVar("T")

ControllerView = dict[str, Any]


def view_of(report: Report, options: UrOptions) -> ControllerView:
    """Return the state of the controller as JSON; after `silence_s` without a report, it has a fault."""
    now_s = time.monotonic()
    is_fresh = is_connected(report, now_s, options.silence_s)
    fault = fault_of(report, now_s, options.silence_s, options.host)
    return {
        "connected": is_fresh,
        "reason": None if is_fresh else str(why_silent(report, now_s)),
        "robotMode": robot_mode(report.robot_mode).name,
        "safetyStatus": safety_status(report.safety_status).name,
        "programState": RuntimeState(report.runtime_state).name if report.runtime_state <= 5 else "UNKNOWN",
        "speedSlider": round(report.speed_slider, 4),
        "speedFraction": round(report.speed_fraction, 4),
        "frequencyHz": report.frequency_hz,
        "skippedCycles": report.skipped_cycles,
        "connections": report.connections,
        "fault": None if fault is None else str(fault),
    }


def add_routes(
    app: FastAPI, robot: str, dashboard: Dashboard, report: Callable[[], Report], options: UrOptions
) -> None:
    """Add the routes of the controller of `robot`."""
    routes = TaggedRoutes(app, "controllers")
    path = f"/robots/{robot}/controller"

    def of_robot(connection: HTTPConnection) -> str:
        return guard_of(connection).settings.entity_id("Device", robot)

    of_robot.__doc__ = f"Device `{robot}`"

    @routes.get(path, name=f"controller of {robot}", dependencies=[require(Permission.READ, of_robot)])
    async def state() -> ControllerView:
        """Return connection, robot mode, safety status and speed slider of the controller.

        They are read, not assessed: the safety functions are those of the controller.
        """
        return view_of(report(), options)

    @routes.get(
        f"{path}/identity", name=f"identity of {robot}", dependencies=[require(Permission.READ, of_robot)]
    )
    async def identity() -> dict[str, str]:
        """Return model, serial number and software version; 502 when the dashboard server does not answer."""
        return await _answered(dashboard.describe())

    @routes.post(
        f"{path}/power-on", name=f"power on {robot}", dependencies=[require(Permission.MOVE_ROBOTS, of_robot)]
    )
    async def power_on() -> ControllerView:
        """Power the arm, at the request of a person; the brakes stay closed. 502 when it is rejected."""
        await _answered(dashboard.power_on())
        return view_of(report(), options)

    @routes.post(
        f"{path}/brake-release",
        name=f"release the brakes of {robot}",
        dependencies=[require(Permission.MOVE_ROBOTS, of_robot)],
    )
    async def brake_release() -> ControllerView:
        """Release the brakes, at the request of a person who sees the arm; it may move a little."""
        await _answered(dashboard.release_brakes())
        return view_of(report(), options)


async def _answered(asked: Awaitable[T]) -> T:
    try:
        return await asked
    except DashboardError as error:
        raise Problem(502, "Controller", text_of(error)) from None
