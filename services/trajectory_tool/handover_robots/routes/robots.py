"""REST: the robots of the cell with their Tasks, what they can do, and their grippers."""

import inspect
from typing import Any

from fastapi import FastAPI, Response
from pydantic import ConfigDict
from starlette.requests import HTTPConnection

from handover.control.lease import Leases
from handover.errors import Problem
from handover.formats.strict_json import StrictModel
from handover.http.api_description import TaggedRoutes, sends
from handover.messages import text_of
from handover.security.guard import ResourceOf, in_path, require, require_somewhere
from handover.security.permissions import Permission
from handover_robots.cell.device import description
from handover_robots.model.faults import RobotFault
from handover_robots.routes.scenes import scene_view
from handover_robots.tasks.controller import Controller, Controllers
from handover_robots.tasks.operations import OPERATIONS

of_robot = in_path("Device", "robot")

RobotView = dict[str, Any]


class Seen(StrictModel):
    """The Task that a person has confirmed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    task: str


def add_robot_routes(app: FastAPI, controllers: Controllers, leases: Leases) -> None:
    """Add the routes of robots and of what they can do."""
    routes = TaggedRoutes(app, "robots")

    @routes.get("/robots", dependencies=[require(Permission.READ)])
    async def robots() -> list[RobotView]:
        """Return the state of every robot."""
        return [view_of(controller, leases) for controller in controllers.by_name.values()]

    @routes.get("/robots/{robot}", dependencies=[require(Permission.READ, of_robot)])
    async def one_robot(robot: str) -> RobotView:
        """Return the state of a robot: joints, tool pose, gripper, and its Task."""
        return view_of(controller_of(controllers, robot), leases)

    @routes.get("/robots/{robot}/description", dependencies=[require(Permission.READ, of_robot)])
    async def describe(robot: str) -> dict[str, Any]:
        """Return what the robot is: joints with limits, home, gripper, and the URDF that draws it.

        It is constant while the tool runs; `revision` differs for every other description.
        """
        controller = controller_of(controllers, robot)
        return {"id": controller.robot_name, **description(controller.unit)}

    @routes.get(
        "/robots/{robot}/urdf",
        response_class=Response,
        responses=sends("application/xml"),
        dependencies=[require(Permission.READ, of_robot)],
    )
    async def urdf(robot: str) -> Response:
        """Return the URDF of the robot."""
        return Response(controller_of(controllers, robot).unit.model.urdf, media_type="application/xml")

    @routes.get("/robots/{robot}/scene", dependencies=[require(Permission.READ, of_robot)])
    async def scene(robot: str) -> dict[str, Any]:
        """Return the cell in its own frame: bins, fixtures, obstacles, and the pose of each part."""
        controller_of(controllers, robot)
        return scene_view(controllers.cell)

    @routes.get("/operations", dependencies=[require_somewhere(Permission.READ)])
    async def operations_known() -> dict[str, Any]:
        """Return the operations of robots, each with the JSON Schema of its workParameters."""
        return {
            name: {
                "description": inspect.getdoc(operation.perform),
                "parameters": operation.parameters.model_json_schema(by_alias=True),
            }
            for name, operation in OPERATIONS.items()
        }

    @routes.post(
        "/robots/{robot}/confirm", dependencies=[require(Permission.PERFORM_TASKS, _of_work(controllers))]
    )
    async def confirm(robot: str, seen: Seen | None = None) -> RobotView:
        """Confirm a hand-over: the person holds the part; 409 while there is nothing to confirm.

        With `task`, only that Task is confirmed: another one may have begun since the person looked.
        """
        controller = controller_of(controllers, robot)
        work = controller.work
        is_other = seen is not None and work is not None and work.task != seen.task
        if work is None or is_other or not work.confirm():
            raise Problem.translated(
                409,
                "Nothing to confirm",
                "robot.nothing_to_confirm",
                "{robot} waits for no confirmation",
                robot=robot,
            )
        return view_of(controller, leases)

    @routes.post("/robots/{robot}/gripper/free", dependencies=[require(Permission.MOVE_ROBOTS, of_robot)])
    async def free(robot: str) -> RobotView:
        """Open the gripper so that a person can remove the part; 409 while the robot executes a Task."""
        controller = controller_of(controllers, robot)
        if controller.work is not None:
            raise Problem.translated(
                409,
                "Robot at work",
                "robot.robot_at_work",
                "{robot} executes {task}; wait for its end or cancel it",
                robot=robot,
                task=controller.work.task,
            )
        try:
            await controller.unit.free()
        except RobotFault as fault:
            raise Problem.translated(
                503,
                "Robot fault",
                "robot.robot_fault",
                "the gripper cannot be opened: {fault}",
                fault=text_of(fault),
            ) from fault
        controller.device.set_state(controller.device.state)
        return view_of(controller, leases)


def controller_of(controllers: Controllers, robot: str) -> Controller:
    """Return the controller of a robot. Raises `Problem` for an unknown one."""
    controller = controllers.of(robot)
    if controller is None:
        raise Problem.translated(
            404,
            "No such robot",
            "robot.no_such_robot",
            'there is no robot "{robot}"; there is {known}',
            robot=robot,
            known=", ".join(controllers.by_name),
        )
    return controller


def view_of(controller: Controller, leases: Leases) -> RobotView:
    """Return the present state of the robot."""
    unit, work = controller.unit, controller.work
    lease = leases.of(unit.name)
    return {
        "id": controller.robot_name,
        "device": controller.device.id,
        "deviceState": controller.device.state.value,
        "model": unit.model.name,
        "revision": unit.model.revision,
        "scene": unit.scene.digest,
        "joints": unit.robot.state().written(unit.model.joint_names),
        "toolPose": unit.tool_pose.written(),
        "gripper": {
            "closed": unit.robot.gripper_closed,
            "holds": unit.held,
            "interrupted": unit.begun.kind if unit.begun is not None and work is None else None,
        },
        "task": None if work is None else work.task,
        "awaitsConfirmation": work is not None and work.awaits_confirmation,
        "operation": None if work is None else work.operation,
        "progress": None if work is None else round(work.progress(), 3),
        "remainingS": None if work is None else round(work.remaining_s(), 2),
        "controlledBy": None if lease is None else lease.name,
        "waitingForControl": [
            {"id": person.session, "name": person.name} for person in leases.waiting(unit.name)
        ],
    }


def _of_work(controllers: Controllers) -> ResourceOf:
    def resources(connection: HTTPConnection) -> tuple[str, ...]:
        controller = controllers.of(str(connection.path_params["robot"]))
        work = None if controller is None else controller.work
        return (of_robot(connection), *(() if work is None else work.involves))

    resources.__doc__ = "Device `{robot}`, or a resource that its Task involves"
    return resources
