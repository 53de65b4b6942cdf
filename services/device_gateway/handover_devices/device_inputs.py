"""Input devices that drive a robot: haptic devices, handhelds, motion capture, gloves.

A person who is signed in connects a device with a robot. The control at the service of the robot is opened
with the credentials of this person, so that the right of the person counts, not that of the device; the
control ends with the right, the session of the person, or the connection of the device. Inputs do not queue
here and are not stored: the newest one counts, and the service of the robot stops it when none arrives.
"""

import asyncio
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Final
from urllib.parse import quote, urlencode

import orjson
from pydantic import ValidationError

from handover.control.control_link import ControlLink, Ended
from handover.errors import Problem
from handover.formats.validation import fault_text
from handover.runtime.background_tasks import BackgroundTasks
from handover.telemetry import get_logger
from handover_datamodels.streams import HumanInput
from handover_devices.gateway import DeviceGateway
from handover_devices.input_mapping import AxisInput, InputMapping, MappedAxes, written
from handover_devices.settings import GatewaySettings

log = get_logger(__name__)

MAX_INPUT_BYTES: Final = 4096
LOOK_EVERY_S: Final = 1.0
"""How often the names of the axes of a device are read that drives no robot."""


class DeviceControl:
    """The control of one robot with one device; `overrides` replace members of each input."""

    def __init__(
        self, robot: str, mapping: InputMapping | None, overrides: Mapping[str, Any], link_of: Any
    ) -> None:
        self.robot = robot
        self.state: dict[str, Any] | None = None
        self.error: str | None = None
        self.ended: Ended | None = None
        self.inputs = 0
        self._axes = None if mapping is None else MappedAxes(mapping)
        self._overrides = overrides
        self._link: ControlLink = link_of(self._receive)

    def put(self, line: bytes) -> None:
        """Pass on an input of the device; an invalid one stops the robot, since none is passed on."""
        self.inputs += 1
        try:
            if len(line) > MAX_INPUT_BYTES:
                self.error = f"an input has at most {MAX_INPUT_BYTES} bytes"
                return
            self._link.put(written(self._input_of(line), self._overrides))
        except ValidationError as error:
            self.error = fault_text(error, "input")

    def _input_of(self, line: bytes) -> HumanInput:
        if self._axes is None:
            return HumanInput.model_validate_json(line, strict=True)
        return self._axes.input_of(AxisInput.model_validate_json(line, strict=True), time.monotonic())

    def _receive(self, text: str) -> None:
        message = orjson.loads(text)
        if message.get("type") == "error":
            self.error = str(message.get("reason"))
        else:
            self.state = message

    async def run(self) -> None:
        """Serve until the service of the robot ends the control."""
        self.ended = await self._link.run()
        log.info("device control ended", robot=self.robot, code=self.ended.code, reason=self.ended.reason)


class DeviceInputs:
    """The controls of all devices, by the name of the device; an asynchronous context manager."""

    def __init__(self, settings: GatewaySettings, gateway: DeviceGateway) -> None:
        self._url = settings.trajectory_tool
        self._own_url = settings.device_gateway
        self._gateway = gateway
        self._ca_files = settings.ca_files
        gateway.on_input = self.receive
        gateway.on_disconnected = self._disconnected
        self._controls: dict[str, tuple[DeviceControl, asyncio.Task[None]]] = {}
        self._seen: dict[str, tuple[float, tuple[str, ...]]] = {}
        self._tasks = BackgroundTasks("device inputs")

    async def __aenter__(self) -> "DeviceInputs":
        await self._tasks.__aenter__()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._tasks.__aexit__()

    def of(self, device: str) -> DeviceControl | None:
        """Return the present or the last control with a device."""
        control = self._controls.get(device)
        return None if control is None else control[0]

    def begin(  # noqa: PLR0917 - called by the route only
        self,
        device: str,
        robot: str,
        query: Mapping[str, str],
        mapping: InputMapping | None,
        overrides: Mapping[str, Any],
        credentials: Mapping[str, str],
    ) -> DeviceControl:
        """Drive `robot` with `device`, with the credentials of a person. Raises `Problem` 409."""
        before = self.of(device)
        if before is not None and before.ended is None:
            raise Problem.translated(
                409,
                "Device in use",
                "device.in_use",
                "{device} drives {robot} already; end that control first",
                device=device,
                robot=before.robot,
            )
        path = f"/robots/{quote(robot, safe='')}/control?{urlencode(query)}"
        service = self._own_url if robot in self._gateway.devices and robot != device else self._url
        url = f"ws{service.removeprefix('http')}{path}"

        def link_of(on_message: Any) -> ControlLink:
            return ControlLink(url, credentials, on_message, self._ca_files)

        control = DeviceControl(robot, mapping, overrides, link_of)
        self._controls[device] = control, self._tasks.start(control.run)
        return control

    def receive(self, device: str, line: bytes) -> None:
        """Pass on an input; without a control it moves nothing, and only the names of its axes are kept."""
        self._look(device, line)
        control = self._controls.get(device)
        if control is not None and control[0].ended is None:
            control[0].put(line)

    def axes(self) -> dict[str, tuple[str, ...]]:
        """Return the axes of each connected device that sends inputs; none for one that sends velocities."""
        return {name: axes for name, (_, axes) in self._seen.items()}

    def _look(self, device: str, line: bytes) -> None:
        now_s = time.monotonic()
        before = self._seen.get(device)
        if len(line) > MAX_INPUT_BYTES or (before is not None and now_s - before[0] < LOOK_EVERY_S):
            return
        with suppress(ValidationError):
            if b'"axes"' in line:
                axes = tuple(sorted(AxisInput.model_validate_json(line, strict=True).axes))
            else:
                HumanInput.model_validate_json(line, strict=True)
                axes = ()
            self._seen[device] = now_s, axes

    def _disconnected(self, device: str) -> None:
        self._seen.pop(device, None)
        self.end(device, "the device has disconnected")

    def end(self, device: str, reason: str) -> None:
        """End the control with a device; the robot stops."""
        control = self._controls.get(device)
        if control is not None and control[0].ended is None:
            control[0].ended = Ended(1000, reason)
            control[1].cancel()
