"""The WebSockets of robots, one client a robot.

`/arm` and `/humanoid`: a driver commands a robot of the graph. `/humanoid/link`: whole-body control shows the
graph its humanoid, and receives the wishes of other nodes.
"""

import asyncio
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager, suppress
from dataclasses import dataclass
from typing import Any, Final, Generic, Protocol, TypeVar

from fastapi import FastAPI
from pydantic import BaseModel, TypeAdapter, ValidationError
from starlette.websockets import WebSocket, WebSocketDisconnect

from handover.formats.validation import fault_text
from handover.http.websocket_closing import close_websocket
from handover.security.guard import require
from handover.security.permissions import Permission
from handover.telemetry import get_logger
from handover_datamodels.arm_stream import ARM_COMMANDS, ArmJoints, ArmSetup
from handover_datamodels.humanoid_link import LINK_STATES, LinkSetup, LinkWish
from handover_datamodels.humanoid_stream import HUMANOID_COMMANDS, HumanoidSetup, HumanoidState
from handover_datamodels.robot_messages import StreamRefusal
from handover_ros.errors import GraphError
from handover_ros.graph.port import RosGraph
from handover_ros.running.arm_stream import ArmStream
from handover_ros.running.humanoid_link import HumanoidLink
from handover_ros.running.humanoid_stream import HumanoidStream

log = get_logger(__name__)

SETUP_TIMEOUT_S = 10.0
MAX_MESSAGE_BYTES = 2**20

Setup = TypeVar("Setup", bound=BaseModel)
Send = Callable[[BaseModel], None]


class Stream(Protocol):
    """A robot of the graph while its stream is open."""

    def take(self, command: Any) -> None:
        """Carry out a command. Raises `ValueError` for one that does not fit the setup."""


@dataclass(frozen=True, slots=True)
class Kind(Generic[Setup]):
    """A kind of robot. `robot_of` names the robot of a setup, which has one client at a time.

    Of the reports of the type `measured` no more than `max_waiting` wait for a slow client; then they are
    left out.
    """

    name: str
    setup: type[Setup]
    commands: TypeAdapter[Any]
    measured: type[BaseModel]
    max_waiting: int
    robot_of: Callable[[Setup], str]
    open: Callable[[RosGraph, Setup, Send], AbstractAsyncContextManager[Stream]]


ARM: Final = Kind(
    "arm",
    ArmSetup,
    ARM_COMMANDS,
    ArmJoints,
    256,
    lambda setup: setup.trajectory_action,
    ArmStream,
)
HUMANOID: Final = Kind(
    "humanoid",
    HumanoidSetup,
    HUMANOID_COMMANDS,
    HumanoidState,
    2,  # only the newest state counts
    lambda setup: setup.joint_commands,
    HumanoidStream,
)

HUMANOID_LINK: Final = Kind(
    "humanoid link",
    LinkSetup,
    LINK_STATES,
    LinkWish,
    2,  # only the newest wish counts
    lambda setup: setup.wish,
    HumanoidLink,
)


def add_routes(app: FastAPI, graph: Callable[[], RosGraph]) -> None:
    """Add the WebSockets. `graph` raises `Problem` while the bridge starts."""
    arms, humanoids, links = set[str](), set[str](), set[str]()

    @app.websocket("/arm", dependencies=[require(Permission.MOVE_ROBOTS)])
    async def arm(client: WebSocket) -> None:
        await _run(ARM, client, graph, arms)

    @app.websocket("/humanoid", dependencies=[require(Permission.MOVE_ROBOTS)])
    async def humanoid(client: WebSocket) -> None:
        await _run(HUMANOID, client, graph, humanoids)

    @app.websocket("/humanoid/link", dependencies=[require(Permission.MOVE_ROBOTS)])
    async def humanoid_link(client: WebSocket) -> None:
        await _run(HUMANOID_LINK, client, graph, links)


async def _run(kind: Kind[Setup], client: WebSocket, graph: Callable[[], RosGraph], in_use: set[str]) -> None:
    await client.accept()
    try:
        async with asyncio.timeout(SETUP_TIMEOUT_S):
            setup = kind.setup.model_validate_json(await _text(client))
    except (TimeoutError, ValueError) as error:
        await _refuse(kind, client, f"the first message is the setup of the {kind.name}: {_words(error)}")
        return
    except WebSocketDisconnect:
        return
    robot = kind.robot_of(setup)
    if robot in in_use:
        await _refuse(kind, client, f"another client commands {robot}; end that one first")
        return
    in_use.add(robot)
    try:
        await _serve(kind, client, graph(), setup)
    except GraphError as error:
        await _refuse(kind, client, str(error))
    finally:
        in_use.discard(robot)


async def _serve(kind: Kind[Setup], client: WebSocket, graph: RosGraph, setup: Setup) -> None:
    reports: asyncio.Queue[BaseModel] = asyncio.Queue()

    def send(report: BaseModel) -> None:
        if not isinstance(report, kind.measured) or reports.qsize() < kind.max_waiting:
            reports.put_nowait(report)

    async def write() -> None:
        while True:
            await client.send_text((await reports.get()).model_dump_json(by_alias=True))

    async with kind.open(graph, setup, send) as stream:
        log.info(f"{kind.name} commanded", robot=kind.robot_of(setup))
        writing = asyncio.create_task(write())
        try:
            while True:
                stream.take(kind.commands.validate_json(await _text(client)))
        except ValueError as error:
            await _refuse(kind, client, _words(error))
        except WebSocketDisconnect:
            log.info(f"{kind.name} released", robot=kind.robot_of(setup))
        finally:
            writing.cancel()
            with suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await writing


async def _text(client: WebSocket) -> str:
    """Return the next message. Raises `ValueError` for one that is no text or too long."""
    message = await client.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1000))
    text = message.get("text")
    if not isinstance(text, str) or len(text) > MAX_MESSAGE_BYTES:
        raise ValueError(f"a message is JSON text of {MAX_MESSAGE_BYTES} bytes at most")
    return text


async def _refuse(kind: Kind[Any], client: WebSocket, reason: str) -> None:
    log.warning(f"{kind.name} stream refused", reason=reason)
    with suppress(WebSocketDisconnect, RuntimeError):
        await client.send_text(StreamRefusal(reason=reason).model_dump_json())
        await close_websocket(client, 4400, reason)


def _words(error: Exception) -> str:
    if isinstance(error, ValidationError):
        return fault_text(error)
    return str(error) or "no message in time"
