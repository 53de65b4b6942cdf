"""REST: drive a robot with an input device."""

from typing import Annotated, Any

from fastapi import FastAPI, Request
from pydantic import ConfigDict, Field, FiniteFloat
from pydantic.alias_generators import to_camel

from handover.errors import Problem
from handover.formats.strict_json import StrictModel
from handover.http.api_description import TaggedRoutes
from handover.security.act_recording import lowers
from handover.security.caller import Caller
from handover.security.guard import guard_of, in_path, require, require_by_handler
from handover.security.permissions import Permission
from handover_devices.device_inputs import DeviceControl, DeviceInputs
from handover_devices.gateway import DeviceGateway
from handover_devices.input_mapping import InputMapping
from handover_devices.model.description import DeviceKind
from handover_devices.routes.access import Reader, may_read
from handover_devices.settings import GatewaySettings

OF_DEVICE = in_path("Device", "device")
Driver = Annotated[Caller, require_by_handler(Permission.MOVE_ROBOTS)]


class _Body(StrictModel):
    model_config = ConfigDict(extra="forbid", alias_generator=to_camel, populate_by_name=True)


class NewControl(_Body):
    """Which robot a device drives, and how: `mapping` for a device that sends axes, `gamma`, and m."""

    robot: Annotated[str, Field(min_length=1, max_length=64)]
    mapping: InputMapping | None = None
    gamma: Annotated[FiniteFloat, Field(gt=0, le=2)] = 1.0
    mix: Annotated[FiniteFloat, Field(ge=0, le=1)] | None = None
    arbitration: bool | None = None
    wait: bool = False
    record: bool = False


class ControlView(_Body):
    """The control with a device: `state` is that of the robot, `ended` why the control has ended."""

    robot: str
    inputs: int
    state: dict[str, Any] | None
    error: str | None
    ended: str | None


class InputDeviceView(_Body):
    """A connected device that sends inputs of a person: the names of its axes, and its present control.

    One without axes sends velocities of the tool, which need no mapping. Before the first input `axes` is
    null.
    """

    device: str
    title: str
    axes: tuple[str, ...] | None
    control: ControlView | None


def add_control_routes(
    app: FastAPI, settings: GatewaySettings, gateway: DeviceGateway, inputs: DeviceInputs
) -> None:
    """Add the routes of control with input devices."""
    routes = TaggedRoutes(app, "control")

    @routes.get("/input-devices")
    async def input_devices(caller: Reader) -> list[InputDeviceView]:
        """List the connected devices of the kind `inputDevice`, and those that send inputs.

        It has those that the caller may read.
        """
        seen = inputs.axes()
        views = []
        for name, device in sorted(gateway.devices.items()):
            description = device.stored.description
            is_one = name in seen or description.kind is DeviceKind.INPUT_DEVICE
            if is_one and device.link is not None and may_read(caller, settings, name):
                control = inputs.of(name)
                view = None if control is None else _view(control)
                views.append(
                    InputDeviceView(device=name, title=description.title, axes=seen.get(name), control=view)
                )
        return views

    @routes.get("/devices/{device}/control", dependencies=[require(Permission.READ, OF_DEVICE)])
    async def control_of(device: str) -> ControlView:
        """Return the present or the last control with a device; 404 if it has driven no robot."""
        return _view(_found(gateway, inputs, device))

    @routes.post("/devices/{device}/control", status_code=201)
    async def begin(device: str, new: NewControl, caller: Driver, request: Request) -> ControlView:
        """Drive a robot with a device, as the person who asks; the robot's lease is theirs.

        Besides the right for the robot the person needs the right to read the device. 409 if it is in use.
        """
        guard = guard_of(request)
        _require(request, caller, new.robot)
        guard.require(caller, Permission.READ, guard.settings.entity_id("Device", device))
        if gateway.device(device).link is None:
            raise Problem.translated(
                409,
                "Not connected",
                "device.not_connected",
                "{device} is not connected; start its program",
                device=device,
            )
        authorization = request.headers.get("authorization")
        credentials = {} if authorization is None else {"Authorization": authorization}
        overrides = {
            name: value
            for name, value in (("gamma", new.gamma), ("mix", new.mix), ("arbitration", new.arbitration))
            if value is not None
        }
        query = {"mode": "wait" if new.wait else "refuse", "record": str(new.record).lower()}
        return _view(inputs.begin(device, new.robot, query, new.mapping, overrides, credentials))

    @routes.delete("/devices/{device}/control")
    @lowers()
    async def end(device: str, caller: Driver, request: Request) -> ControlView:
        """End the control with a device; the robot stops."""
        control = _found(gateway, inputs, device)
        _require(request, caller, control.robot)
        inputs.end(device, "ended by a person")
        return _view(control)


def _require(request: Request, caller: Caller, robot: str) -> None:
    guard = guard_of(request)
    guard.require(caller, Permission.MOVE_ROBOTS, guard.settings.entity_id("Device", robot))


def _found(gateway: DeviceGateway, inputs: DeviceInputs, device: str) -> DeviceControl:
    gateway.device(device)
    control = inputs.of(device)
    if control is None:
        raise Problem.translated(
            404, "No control", "device.drives_nothing", "{device} drives no robot", device=device
        )
    return control


def _view(control: DeviceControl) -> ControlView:
    ended = control.ended
    return ControlView(
        robot=control.robot,
        inputs=control.inputs,
        state=control.state,
        error=control.error,
        ended=None if ended is None else ended.reason or f"closed with code {ended.code}",
    )
