"""REST interface of the trajectory tool, and the WebSocket stream of joint states."""

import inspect
import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from fastapi import FastAPI, Response, WebSocket
from pydantic import ConfigDict
from starlette.requests import HTTPConnection

from handover.api_description import sends
from handover.broker import BrokerClient
from handover.control.lease import Leases
from handover.errors import Problem
from handover.messages import message, text_of
from handover.security.audit_trail import AuditTrail
from handover.security.guard import Guard, ResourceOf, require, require_somewhere
from handover.security.permissions import Permission
from handover.service import create_app
from handover.storage import storage_check
from handover.strict_json import StrictModel
from handover.websocket_closing import close_websocket
from handover_datamodels.entities import DeviceState
from handover_robots.cell import Cell
from handover_robots.control import routes as control_routes
from handover_robots.controller import Controller, Controllers
from handover_robots.device import description
from handover_robots.joint_states import stream, written
from handover_robots.limits import routes as limit_routes
from handover_robots.limits.robot_limits import RobotLimits
from handover_robots.operations import OPERATIONS
from handover_robots.people import routes as people_routes
from handover_robots.robot import Robot, RobotFault
from handover_robots.scene_routes import add_scene_routes, scene_view
from handover_robots.settings import TrajectorySettings

STREAM_HZ = 30.0
MAX_HZ = 125.0

of_robot = limit_routes.of_robot

RobotView = dict[str, Any]


class Seen(StrictModel):
    """The Task that a person has confirmed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    task: str


def make_app(settings: TrajectorySettings) -> FastAPI:
    """Return the application; raise `UsageError` for settings that do not work."""
    guard = Guard(settings, "trajectory-tool")
    broker = BrokerClient(settings, credentials=guard.access)
    controllers = Controllers(settings, broker)
    leases = Leases()

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with broker, controllers:
            yield

    app = create_app(
        "Trajectory tool",
        description=__doc__ or "",
        lifespan=lifespan,
        checks={
            "broker": broker.probe,
            "tasks": controllers.probe,
            "storage": storage_check(settings.data_dir),
        },
        guard=guard,
        audit=AuditTrail(settings, "trajectory-tool"),
    )
    app.state.controllers = controllers
    controllers.mount(app)
    add_scene_routes(app, controllers.workcell)
    _add_robots(app, controllers, leases)
    _add_stream(app, controllers)
    people_routes.add_routes(app, controllers.workcell.people_sensors, controllers.workcell.receive_people)
    limit_routes.add_routes(app, lambda robot: _limits_of(_known(controllers, robot)))
    control_routes.add_routes(
        app, lambda robot: _controlled(controllers, _known(controllers, robot)), leases, settings.data_dir
    )
    return app


def view_of(controller: Controller, leases: Leases) -> RobotView:
    """Return the present state of the robot."""
    cell, work = controller.cell, controller.work
    lease = leases.of(cell.name)
    return {
        "id": controller.robot_name,
        "device": controller.device.id,
        "deviceState": controller.device.state.value,
        "model": cell.model.name,
        "revision": cell.model.revision,
        "scene": cell.scene.digest,
        "joints": written(cell.robot.state(), cell.model.joint_names),
        "toolPose": cell.tool_pose.written(),
        "gripper": {
            "closed": cell.robot.gripper_closed,
            "holds": cell.held,
            "interrupted": cell.begun.kind if cell.begun is not None and work is None else None,
        },
        "task": None if work is None else work.task,
        "awaitsConfirmation": work is not None and work.awaits_confirmation,
        "operation": None if work is None else work.operation,
        "progress": None if work is None else round(work.progress(), 3),
        "remainingS": None if work is None else round(work.remaining_s(), 2),
        "controlledBy": None if lease is None else lease.name,
        "waitingForControl": [{"id": one.session, "name": one.name} for one in leases.waiting(cell.name)],
    }


def _add_robots(app: FastAPI, controllers: Controllers, leases: Leases) -> None:
    @app.get("/robots", tags=["robots"], dependencies=[require(Permission.READ)])
    async def robots() -> list[RobotView]:
        """Return the state of every robot."""
        return [view_of(controller, leases) for controller in controllers.by_name.values()]

    @app.get("/robots/{robot}", tags=["robots"], dependencies=[require(Permission.READ, of_robot)])
    async def one_robot(robot: str) -> RobotView:
        """Return the state of a robot: joints, tool pose, gripper, and its Task."""
        return view_of(_known(controllers, robot), leases)

    @app.get(
        "/robots/{robot}/description", tags=["robots"], dependencies=[require(Permission.READ, of_robot)]
    )
    async def describe(robot: str) -> dict[str, Any]:
        """Return what the robot is: joints with limits, home, gripper, and the URDF that draws it.

        It is constant while the tool runs; `revision` differs for every other description.
        """
        controller = _known(controllers, robot)
        return {"id": controller.robot_name, **description(controller.cell)}

    @app.get(
        "/robots/{robot}/urdf",
        tags=["robots"],
        response_class=Response,
        responses=sends("application/xml"),
        dependencies=[require(Permission.READ, of_robot)],
    )
    async def urdf(robot: str) -> Response:
        """Return the URDF of the robot."""
        return Response(_known(controllers, robot).cell.model.urdf, media_type="application/xml")

    @app.get("/robots/{robot}/scene", tags=["robots"], dependencies=[require(Permission.READ, of_robot)])
    async def scene(robot: str) -> dict[str, Any]:
        """Return the cell in its own frame: bins, fixtures, obstacles, and the pose of each part."""
        _known(controllers, robot)
        return scene_view(controllers.workcell)

    @app.get("/operations", tags=["robots"], dependencies=[require_somewhere(Permission.READ)])
    async def operations_known() -> dict[str, Any]:
        """Return the operations of robots, each with the JSON Schema of its workParameters."""
        return {
            name: {
                "description": inspect.getdoc(operation.perform),
                "parameters": operation.parameters.model_json_schema(by_alias=True),
            }
            for name, operation in OPERATIONS.items()
        }

    @app.post(
        "/robots/{robot}/confirm",
        tags=["robots"],
        dependencies=[require(Permission.PERFORM_TASKS, _of_work(controllers))],
    )
    async def confirm(robot: str, seen: Seen | None = None) -> RobotView:
        """Confirm a hand-over: the person holds the part; 409 while there is nothing to confirm.

        With `task`, only that Task is confirmed: another one may have begun since the person looked.
        """
        controller = _known(controllers, robot)
        work = controller.work
        is_other = seen is not None and work is not None and work.task != seen.task
        if work is None or is_other or not work.confirm():
            raise Problem(
                409,
                "Nothing to confirm",
                message("robot.nothing_to_confirm", "{robot} waits for no confirmation", robot=robot),
            )
        return view_of(controller, leases)

    @app.post(
        "/robots/{robot}/gripper/free",
        tags=["robots"],
        dependencies=[require(Permission.MOVE_ROBOTS, of_robot)],
    )
    async def free(robot: str) -> RobotView:
        """Open the gripper so that a person can remove the part; 409 while the robot executes a Task."""
        controller = _known(controllers, robot)
        if controller.work is not None:
            raise Problem(
                409,
                "Robot at work",
                message(
                    "robot.robot_at_work",
                    "{robot} executes {task}; wait for its end or cancel it",
                    robot=robot,
                    task=controller.work.task,
                ),
            )
        try:
            await controller.cell.free()
        except RobotFault as fault:
            raise Problem(
                503,
                "Robot fault",
                message("robot.robot_fault", "the gripper cannot be opened: {fault}", fault=text_of(fault)),
            ) from fault
        controller.device.set_state(controller.device.state)
        return view_of(controller, leases)


def _add_stream(app: FastAPI, controllers: Controllers) -> None:
    @app.websocket("/robots/{robot}/joint_states", dependencies=[require(Permission.READ, of_robot)])
    async def joint_states(reader: WebSocket, robot: str) -> None:
        try:
            controller = _known(controllers, robot)
            hz = _rate(reader.query_params.get("hz"))
        except Problem as problem:
            await reader.accept()
            await close_websocket(reader, 4000 + problem.status, problem.detail)
            return
        await stream(controller.cell.robot, controller.cell.model.joint_names, reader, hz)


def _of_work(controllers: Controllers) -> ResourceOf:
    def resources(connection: HTTPConnection) -> tuple[str, ...]:
        controller = controllers.of(str(connection.path_params["robot"]))
        work = None if controller is None else controller.work
        return (of_robot(connection), *(() if work is None else work.involves))

    resources.__doc__ = "Device `{robot}`, or a resource that its Task involves"
    return resources


def _known(controllers: Controllers, robot: str) -> Controller:
    controller = controllers.of(robot)
    if controller is None:
        raise Problem(
            404,
            "No such robot",
            message(
                "robot.no_such_robot",
                'there is no robot "{robot}"; there is {known}',
                robot=robot,
                known=", ".join(controllers.by_name),
            ),
        )
    return controller


def _controlled(
    controllers: Controllers, controller: Controller
) -> tuple[Cell, tuple[Cell, ...], Callable[[DeviceState], None]]:
    others = (one.cell for one in controllers.by_name.values() if one is not controller)
    return controller.cell, tuple(others), controller.device.set_state


def _limits_of(controller: Controller) -> tuple[RobotLimits, Robot]:
    return controller.cell.speed, controller.cell.robot


def _rate(rate: str | None) -> float:
    if rate is None:
        return STREAM_HZ
    try:
        hz = float(rate)
    except ValueError:
        hz = math.nan
    if not 0 < hz <= MAX_HZ:
        raise Problem(
            400,
            "No such rate",
            message(
                "robot.no_such_rate",
                "hz must be a number above 0 and at most {limit}",
                limit=f"{MAX_HZ:.0f}",
            ),
        )
    return hz
