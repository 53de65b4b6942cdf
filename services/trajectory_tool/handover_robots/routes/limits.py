"""The limits over REST, and the streams of speed limits and people over WebSocket.

Nothing here is a safety-rated function: a limit is advisory and only ever lowers the speed. Emergency and
protective stops of the real robot are shown, and never reset.
"""

from collections.abc import Awaitable, Callable, Mapping
from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import FastAPI
from pydantic import ConfigDict, Field
from pydantic.alias_generators import to_camel
from starlette.websockets import WebSocket

from handover.errors import Problem
from handover.formats.strict_json import StrictModel
from handover.http.api_description import TaggedRoutes
from handover.http.websocket_closing import close_websocket
from handover.security.act_recording import lowers
from handover.security.guard import in_path, require
from handover.security.permissions import Permission
from handover_datamodels.streams import PeopleReport, SpeedLimitReport
from handover_robots.driver_base.robot import Robot
from handover_robots.limits.robot_limits import RobotLimits
from handover_robots.limits.store import MeasuredStop, Mode, SafeSpeed
from handover_robots.routes.limit_views import RobotLimitsView, view_of
from handover_robots.routes.report_stream import Report, receive_reports

Find = Callable[[str], tuple[RobotLimits, Robot]]
"""Returns the limits and the driver of a robot by name. Raises `Problem` for an unknown one."""

of_robot = in_path("Device", "robot")

Text = Annotated[str, Field(min_length=1, max_length=200)]


class _Body(StrictModel):
    model_config = ConfigDict(extra="forbid", alias_generator=to_camel, populate_by_name=True)


class ByPerson(_Body):
    """Who does it."""

    name: Text


class Removal(ByPerson):
    """Who removes a source, and why."""

    reason: Text


class ModeChange(ByPerson):
    """The mode: `reduced` limits the tool to 250 mm/s."""

    mode: Mode


class SafeSpeedChange(ByPerson, SafeSpeed):
    """The validated speed of the end effector, and who enters it."""


class StopChange(ByPerson, MeasuredStop):
    """The measured stop, and who enters it."""


def add_routes(app: FastAPI, find: Find) -> None:
    """Add the routes of the limits."""
    routes = TaggedRoutes(app, "limits")

    def is_lower_speed(arguments: Mapping[str, Any]) -> bool:
        return find(arguments["robot"])[0].is_lower_speed(arguments["body"])

    def is_longer_stop(arguments: Mapping[str, Any]) -> bool:
        return find(arguments["robot"])[0].is_longer_stop(arguments["body"])

    @routes.get("/robots/{robot}/limits", dependencies=[require(Permission.READ, of_robot)])
    async def limits(robot: str) -> RobotLimitsView:
        """Return what limits the speed of a robot now: which rule, the distance of people, the sources."""
        return view_of(*find(robot))

    @routes.post("/robots/{robot}/limits/reset", dependencies=[require(Permission.MOVE_ROBOTS, of_robot)])
    async def reset(robot: str, body: ByPerson) -> RobotLimitsView:
        """Release stops for body signals and after contacts; 409 while a source still demands the stop."""
        robot_limits, driver = find(robot)
        still = await robot_limits.reset(body.name)
        if still:
            raise Problem.translated(
                409,
                "Still stopped",
                "robot.limit_still_stops",
                "{sources} still stop the robot; look at the person and the sensor before the reset",
                sources=", ".join(still),
            )
        return view_of(robot_limits, driver)

    @routes.post(
        "/robots/{robot}/limits/confirm-clear", dependencies=[require(Permission.MOVE_ROBOTS, of_robot)]
    )
    async def confirm_clear(robot: str, body: ByPerson) -> RobotLimitsView:
        """Forget people who vanished near the robot: a person has seen that nobody is there."""
        robot_limits, driver = find(robot)
        await robot_limits.confirm_clear(body.name)
        return view_of(robot_limits, driver)

    @routes.post(
        "/robots/{robot}/limits/sources/{source}/remove",
        dependencies=[require(Permission.CONFIGURE, of_robot)],
    )
    async def remove(robot: str, source: str, body: Removal) -> RobotLimitsView:
        """Stop requiring a source of speed limits or a sensor of people; recorded with name and reason."""
        robot_limits, driver = find(robot)
        if not await robot_limits.remove(source, body.name, body.reason):
            sources = (*robot_limits.body.sources, *robot_limits.separation.sources)
            raise Problem.translated(
                404,
                "No such source",
                "robot.no_such_limit_source",
                'there is no source "{source}"; there is {known}',
                source=source,
                known=", ".join(sources) or "none",
            )
        return view_of(robot_limits, driver)

    @routes.put("/robots/{robot}/limits/mode", dependencies=[require(Permission.CONFIGURE, of_robot)])
    @lowers(lambda arguments: arguments["body"].mode == "reduced")
    async def set_mode(robot: str, body: ModeChange) -> RobotLimitsView:
        """Set the mode, `normal` or `reduced`."""
        robot_limits, driver = find(robot)
        await robot_limits.set_mode(body.mode, body.name)
        return view_of(robot_limits, driver)

    @routes.put("/robots/{robot}/limits/safe-speed", dependencies=[require(Permission.CONFIGURE, of_robot)])
    @lowers(is_lower_speed)
    async def set_safe_speed(robot: str, body: SafeSpeedChange) -> RobotLimitsView:
        """Set the speed of the tool that was validated for an end effector, with the date of validation."""
        robot_limits, driver = find(robot)
        if body.validated_at > datetime.now(UTC):
            raise Problem.translated(
                422,
                "Not validated yet",
                "robot.validated_in_future",
                "the date of validation of {end_effector} is in the future; enter when it was validated",
                end_effector=body.end_effector,
            )
        speed = SafeSpeed.model_validate(body.model_dump(exclude={"name"}))
        await robot_limits.set_safe_speed(speed, body.name)
        return view_of(robot_limits, driver)

    @routes.put("/robots/{robot}/limits/stop", dependencies=[require(Permission.CONFIGURE, of_robot)])
    @lowers(is_longer_stop)
    async def set_stop(robot: str, body: StopChange) -> RobotLimitsView:
        """Set the measured stop, from which protective distances are computed."""
        robot_limits, driver = find(robot)
        stop = MeasuredStop.model_validate(body.model_dump(exclude={"name"}))
        await robot_limits.set_stop(stop, body.name)
        return view_of(robot_limits, driver)

    @app.websocket("/robots/{robot}/speed_limits", dependencies=[require(Permission.MOVE_ROBOTS, of_robot)])
    async def speed_limits(sender: WebSocket, robot: str) -> None:
        await _receive(
            sender,
            robot,
            find,
            kind="speed limit",
            form=SpeedLimitReport,
            receiver=lambda at: at.receive_limit,
        )

    @app.websocket("/robots/{robot}/people", dependencies=[require(Permission.MOVE_ROBOTS, of_robot)])
    async def people(sender: WebSocket, robot: str) -> None:
        await _receive(
            sender, robot, find, kind="people", form=PeopleReport, receiver=lambda at: at.receive_people
        )


async def _receive(
    sender: WebSocket,
    robot: str,
    find: Find,
    *,
    kind: str,
    form: type[Report],
    receiver: Callable[[RobotLimits], Callable[[Report], Awaitable[None]]],
) -> None:
    """Receive a stream for a robot."""
    await sender.accept()
    try:
        limits, _ = find(robot)
    except Problem as problem:
        await close_websocket(sender, 4000 + problem.status, problem.detail)
        return
    await receive_reports(sender, kind, form, receiver(limits))
