"""REST of commands: a client commands a device and follows the command to its end."""

import asyncio
from typing import Annotated, Any

from fastapi import FastAPI, Query, Response
from pydantic import ConfigDict, Field
from sqlalchemy import Engine

from handover.formats.strict_json import StrictModel
from handover.http.api_description import TaggedRoutes
from handover.security.act_recording import lowers
from handover.security.guard import in_path, require
from handover.security.permissions import Permission
from handover.serving.service import json_response
from handover_devices.commands.dispatcher import Dispatcher
from handover_devices.commands.forms import command_of
from handover_devices.gateway import DeviceGateway
from handover_devices.routes.views import CommandView, command_view
from handover_devices.storage import device_store

OF_DEVICE = in_path("Device", "device")
MAX_WAIT_S = 30.0


class NewCommand(StrictModel):
    """A command; the same `id` again returns the same command instead of sending it twice."""

    model_config = ConfigDict(extra="forbid", populate_by_name=True)

    name: str
    parameters: dict[str, Any] = Field(default_factory=dict)
    timeout_s: float = Field(60.0, gt=0, le=86_400, alias="timeoutS")
    id: str | None = Field(None, pattern=r"^[A-Za-z0-9_.-]{1,64}$")


def add_command_routes(app: FastAPI, dispatcher: Dispatcher, gateway: DeviceGateway, engine: Engine) -> None:
    """Add the routes of commands."""
    routes = TaggedRoutes(app, "commands")
    may_read = require(Permission.READ, OF_DEVICE)
    may_command = require(Permission.MOVE_ROBOTS, OF_DEVICE)
    Wait = Annotated[float, Query(ge=0, le=MAX_WAIT_S, description="seconds to wait for the end")]  # noqa: N806

    @routes.post(
        "/devices/{device}/commands", status_code=202, dependencies=[may_command], response_model=CommandView
    )
    async def order(device: str, new: NewCommand) -> Response:
        """Send a command to a device, or queue it while the device is away; motions are never queued."""
        description = gateway.device(device).stored.description
        made = await dispatcher.order(
            device, description, new.name, new.parameters, timeout_s=new.timeout_s, identifier=new.id
        )
        return json_response(command_view(made), 202)

    @routes.get("/devices/{device}/commands", dependencies=[may_read])
    async def commands(device: str, limit: Annotated[int, Query(ge=1, le=500)] = 50) -> list[CommandView]:
        """List the newest commands of a device."""
        gateway.device(device)
        rows = await asyncio.to_thread(device_store.commands_of, engine, device, limit)
        return [command_view(command_of(row)) for row in rows]

    @routes.get("/devices/{device}/commands/{command}", dependencies=[may_read])
    async def one(device: str, command: str, wait: Wait = 0.0) -> CommandView:
        """Return a command; with `wait`, when it has ended or after that time."""
        gateway.device(device)
        present = await dispatcher.find(device, command)
        ends_s = asyncio.get_running_loop().time() + wait
        while present.is_open and (left_s := ends_s - asyncio.get_running_loop().time()) > 0:
            present = await dispatcher.wait(device, command, present, left_s)
        return command_view(present)

    @routes.delete(
        "/devices/{device}/commands/{command}",
        responses={202: {"model": CommandView}},
        dependencies=[may_command],
    )
    @lowers()
    async def cancel(device: str, command: str, response: Response) -> CommandView:
        """Cancel a command; 202 while the device has not answered."""
        gateway.device(device)
        cancelled = await dispatcher.cancel(device, command)
        if cancelled.is_open:
            response.status_code = 202
        return command_view(cancelled)
