"""REST interface of the trajectory tool, and the WebSocket stream of joint states."""

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial

from fastapi import FastAPI

from handover.broker import BrokerClient
from handover.control.lease import Leases
from handover.security.audit_trail import AuditTrail
from handover.security.guard import Guard
from handover.serving.service import create_app
from handover.serving.storage import storage_check
from handover_datamodels.entities import DeviceState
from handover_robots.cell.robot_unit import RobotUnit
from handover_robots.driver_base.robot import Robot
from handover_robots.limits.robot_limits import RobotLimits
from handover_robots.routes import control as control_routes
from handover_robots.routes import limits as limit_routes
from handover_robots.routes import people as people_routes
from handover_robots.routes.joint_states import add_joint_state_route
from handover_robots.routes.robots import add_robot_routes, controller_of
from handover_robots.routes.scenes import add_scene_routes
from handover_robots.settings import TrajectorySettings
from handover_robots.tasks.controller import Controller, Controllers


def make_app(settings: TrajectorySettings) -> FastAPI:
    """Return the application; raise `UsageError` for settings that do not work."""
    guard = Guard(settings, "trajectory-tool")
    broker = BrokerClient(settings, credentials=guard.access)
    controllers = Controllers(settings, broker)
    leases = Leases()
    find = partial(controller_of, controllers)

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
    add_scene_routes(app, controllers.cell)
    add_robot_routes(app, controllers, leases)
    add_joint_state_route(app, find)
    people_routes.add_routes(app, controllers.cell.people_sensors, controllers.cell.receive_people)
    limit_routes.add_routes(app, lambda robot: _limits_of(find(robot)))
    control_routes.add_routes(
        app, lambda robot: _controlled(controllers, find(robot)), leases, settings.data_dir
    )
    return app


def _controlled(
    controllers: Controllers, controller: Controller
) -> tuple[RobotUnit, tuple[RobotUnit, ...], Callable[[DeviceState], None]]:
    others = (other.unit for other in controllers.by_name.values() if other is not controller)
    return controller.unit, tuple(others), controller.device.set_state


def _limits_of(controller: Controller) -> tuple[RobotLimits, Robot]:
    return controller.unit.speed, controller.unit.robot
