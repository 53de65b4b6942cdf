"""The limits over REST, and the streams of speed limits and people over WebSocket.

Nothing here is a safety-rated function: a limit is advisory and only ever lowers the speed. Emergency and
protective stops of the real robot are shown, and never reset.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import Annotated, Any, TypeVar

import orjson
from fastapi import FastAPI
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.alias_generators import to_camel
from starlette.websockets import WebSocket, WebSocketDisconnect

from datamodels.streams import PeopleReport, SpeedLimitReport
from handover.errors import Problem
from handover.messages import message
from services.trajectory_tool.limits.robot_limits import RobotLimits
from services.trajectory_tool.limits.speed_limits import RefusedReport
from services.trajectory_tool.limits.store import MeasuredStop, Mode, SafeSpeed
from services.trajectory_tool.metrics import LIMIT_REPORTS
from services.trajectory_tool.robot import Robot

NOTICE = "These limits are not a safety-rated function. They are advisory and only lower the speed."
MAX_MESSAGE_BYTES = 16 * 1024
MAX_REPORTS_PER_S = 100
SHOWN_DECISIONS = 20

Report = TypeVar("Report", bound=BaseModel)
Find = Callable[[str], tuple[RobotLimits, Robot]]
"""Returns the limits and the driver of a robot by name. Raises `Problem` for an unknown one."""

Text = Annotated[str, Field(min_length=1, max_length=200)]


class _Body(BaseModel):
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


class Rate:
    """Counts messages in each second."""

    def __init__(self) -> None:
        self._second = 0
        self._count = 0

    def excess(self, now_s: float) -> int:
        """Count a message, and return how many more than permitted have arrived in this second."""
        second = int(now_s)
        self._count = self._count + 1 if second == self._second else 1
        self._second = second
        return max(self._count - MAX_REPORTS_PER_S, 0)


def add_routes(app: FastAPI, find: Find) -> None:
    """Add the routes of the limits."""

    @app.get("/robots/{robot}/limits", tags=["limits"])
    async def limits(robot: str) -> dict[str, Any]:
        """Return what limits the speed of a robot now: which rule, the distance of people, the sources."""
        return view_of(*find(robot))

    @app.post("/robots/{robot}/limits/reset", tags=["limits"])
    async def reset(robot: str, body: ByPerson) -> dict[str, Any]:
        """Release stops for body signals; 409 while a source still demands the stop."""
        found, driver = find(robot)
        still = await found.reset(body.name)
        if still:
            raise Problem(
                409,
                "Still stopped",
                message(
                    "robot.limit_still_stops",
                    "{sources} still stop the robot; look at the person and the sensor before the reset",
                    sources=", ".join(still),
                ),
            )
        return view_of(found, driver)

    @app.post("/robots/{robot}/limits/confirm-clear", tags=["limits"])
    async def confirm_clear(robot: str, body: ByPerson) -> dict[str, Any]:
        """Forget people who vanished near the robot: a person has seen that nobody is there."""
        found, driver = find(robot)
        await found.confirm_clear(body.name)
        return view_of(found, driver)

    @app.post("/robots/{robot}/limits/sources/{source}/remove", tags=["limits"])
    async def remove(robot: str, source: str, body: Removal) -> dict[str, Any]:
        """Stop requiring a source of speed limits or a sensor of people; recorded with name and reason."""
        found, driver = find(robot)
        if not await found.remove(source, body.name, body.reason):
            known = (*found.body.sources, *found.separation.sources)
            raise Problem(
                404,
                "No such source",
                message(
                    "robot.no_such_limit_source",
                    'there is no source "{source}"; there is {known}',
                    source=source,
                    known=", ".join(known) or "none",
                ),
            )
        return view_of(found, driver)

    @app.put("/robots/{robot}/limits/mode", tags=["limits"])
    async def set_mode(robot: str, body: ModeChange) -> dict[str, Any]:
        """Set the mode, `normal` or `reduced`."""
        found, driver = find(robot)
        await found.set_mode(body.mode, body.name)
        return view_of(found, driver)

    @app.put("/robots/{robot}/limits/safe-speed", tags=["limits"])
    async def set_safe_speed(robot: str, body: SafeSpeedChange) -> dict[str, Any]:
        """Set the speed of the tool that was validated for the end effector, with the date of validation."""
        found, driver = find(robot)
        speed = SafeSpeed.model_validate(body.model_dump(exclude={"name"}))
        await found.set_safe_speed(speed, body.name)
        return view_of(found, driver)

    @app.put("/robots/{robot}/limits/stop", tags=["limits"])
    async def set_stop(robot: str, body: StopChange) -> dict[str, Any]:
        """Set the measured stop, from which protective distances are computed."""
        found, driver = find(robot)
        stop = MeasuredStop.model_validate(body.model_dump(exclude={"name"}))
        await found.set_stop(stop, body.name)
        return view_of(found, driver)

    @app.websocket("/robots/{robot}/speed_limits")
    async def speed_limits(sender: WebSocket, robot: str) -> None:
        await _receive(
            sender,
            robot,
            find,
            kind="speed limit",
            form=SpeedLimitReport,
            receiver=lambda at: at.receive_limit,
        )

    @app.websocket("/robots/{robot}/people")
    async def people(sender: WebSocket, robot: str) -> None:
        await _receive(
            sender, robot, find, kind="people", form=PeopleReport, receiver=lambda at: at.receive_people
        )


def view_of(limits: RobotLimits, driver: Robot) -> dict[str, Any]:
    """Return the limits as JSON."""
    lowest, record, state = limits.lowest(), limits.record, limits.state
    rule = limits.separation.rule
    status = driver.safety_status()
    return {
        "notice": NOTICE,
        "pace": round(limits.pace(), 3),
        "rule": None if lowest is None else lowest.rule,
        "reason": None if lowest is None else lowest.reason,
        "needsReset": any(each.needs_reset for each in limits.allowed()),
        "rules": [
            {
                "rule": each.rule,
                "fraction": round(each.fraction, 3),
                "maxSpeed": each.max_speed_mps if each.max_speed_mps < float("inf") else None,
                "reason": each.reason,
                "needsReset": each.needs_reset,
            }
            for each in limits.allowed()
        ],
        "separation": {
            "distance": None if state.distance_m is None else round(state.distance_m, 3),
            "required": None if state.required_m is None else round(state.required_m, 3),
            "lost": list(state.lost),
            "hold": rule.hold_s,
        },
        "limitSources": list(limits.body.sources),
        "peopleSensors": list(limits.separation.sources),
        "mode": record.mode,
        "safeSpeed": None if record.safe_speed is None else record.safe_speed.model_dump(mode="json"),
        "stopping": {
            "delay": rule.stopping.delay_s,
            "deceleration": rule.stopping.deceleration_mps2,
            "measuredAt": rule.stopping.measured_at,
        },
        "safetyStatus": None if status is None else status.written(),
        "decisions": [each.model_dump(mode="json") for each in record.decisions[-SHOWN_DECISIONS:]],
    }


async def _receive(
    sender: WebSocket,
    robot: str,
    find: Find,
    *,
    kind: str,
    form: type[Report],
    receiver: Callable[[RobotLimits], Callable[[Report], Awaitable[None]]],
) -> None:
    """Answer each message of a stream; messages beyond the rate are dropped, and answered once a second."""
    await sender.accept()
    try:
        limits, _ = find(robot)
    except Problem as problem:
        await sender.close(4000 + problem.status, problem.detail[:120])
        return
    receive, rate = receiver(limits), Rate()
    try:
        while True:
            text = await sender.receive_text()
            excess = rate.excess(time.monotonic())
            if excess > 0:
                LIMIT_REPORTS.labels(kind, "dropped").inc()
                if excess == 1:
                    reason = f"more than {MAX_REPORTS_PER_S} messages in a second; the others are dropped"
                    await sender.send_text(_refusal(reason))
                await asyncio.sleep(0)  # other connections are read meanwhile
                continue
            answer, outcome = await _answer(text, form, receive)
            LIMIT_REPORTS.labels(kind, outcome).inc()
            await sender.send_text(answer)
    except (WebSocketDisconnect, RuntimeError, KeyError):
        return  # the sender has left, or sent bytes; its limits age out


async def _answer(
    text: str, form: type[Report], receive: Callable[[Report], Awaitable[None]]
) -> tuple[str, str]:
    if len(text) > MAX_MESSAGE_BYTES:
        return _refusal(f"a message has at most {MAX_MESSAGE_BYTES} bytes"), "refused"
    try:
        report = form.model_validate_json(text)
        await receive(report)
    except ValidationError as error:
        faults = (
            f"{'.'.join(map(str, fault['loc'])) or 'message'}: {fault['msg']}" for fault in error.errors()[:5]
        )
        return _refusal("; ".join(faults)), "refused"
    except RefusedReport as refused:
        return _refusal(str(refused)), "refused"
    except OSError as error:
        return _refusal(f"the source is required, and cannot be stored: {error.strerror}"), "accepted"
    values = report.model_dump()
    accepted = {"accepted": True, "source": values["source"], "stamp": values["stamp"]}
    return orjson.dumps(accepted).decode(), "accepted"


def _refusal(reason: str) -> str:
    return orjson.dumps({"accepted": False, "reason": reason}).decode()
