"""The WebSockets of the page: the live state, and what goes through to services."""

from functools import partial
from urllib.parse import quote

from fastapi import FastAPI, WebSocket

from handover.security.guard import authenticated, in_path, on_new_grants, require, require_somewhere
from handover.security.permissions import Permission
from handover.service_addresses import DEVICE_GATEWAY, HUMAN_STATE, TRAJECTORY, WHOLE_BODY_CONTROL
from handover_web.http.control_proxy import ControlProxy
from handover_web.http.stream_proxy import StreamProxy
from handover_web.live.live_socket import LiveSocket
from handover_web.live.live_state import Reader


def add_streams(app: FastAPI, live_socket: LiveSocket, controls: ControlProxy, streams: StreamProxy) -> None:
    """Add the WebSockets."""

    @app.websocket("/api/live", dependencies=[require_somewhere(Permission.READ)])
    async def live(socket: WebSocket) -> None:
        reader = Reader(partial((await authenticated(socket)).may, Permission.READ))
        on_new_grants(socket, lambda caller: reader.change(partial(caller.may, Permission.READ)))
        await live_socket.serve(socket, reader)

    @app.websocket(
        "/api/trajectory-tool/robots/{robot}/control",
        dependencies=[require(Permission.MOVE_ROBOTS, in_path("Device", "robot"))],
    )
    async def control(socket: WebSocket, robot: str) -> None:
        await controls.serve(socket, TRAJECTORY, _control_of(robot))

    @app.websocket(
        "/api/device-gateway/robots/{robot}/control",
        dependencies=[require(Permission.MOVE_ROBOTS, in_path("Device", "robot"))],
    )
    async def drive(socket: WebSocket, robot: str) -> None:
        await controls.serve(socket, DEVICE_GATEWAY, _control_of(robot))

    @app.websocket(
        "/api/human-state/people/{person}/live",
        dependencies=[require(Permission.READ_HEALTH_DATA, in_path("Person", "person"))],
    )
    async def health(socket: WebSocket, person: str) -> None:
        await streams.serve(socket, HUMAN_STATE, f"/people/{quote(person, safe='')}/live")

    # The service requires the permissions for its humanoid, whose name it alone knows.
    @app.websocket("/api/whole-body-control/live", dependencies=[require_somewhere(Permission.READ)])
    async def humanoid_live(socket: WebSocket) -> None:
        await streams.serve(socket, WHOLE_BODY_CONTROL, "/live")

    @app.websocket(
        "/api/whole-body-control/input", dependencies=[require_somewhere(Permission.PERFORM_TASKS)]
    )
    async def humanoid_input(socket: WebSocket) -> None:
        await controls.serve(socket, WHOLE_BODY_CONTROL, "/input")


def _control_of(robot: str) -> str:
    return f"/robots/{quote(robot, safe='')}/control"
