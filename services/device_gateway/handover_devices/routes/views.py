"""What the REST interface shows of devices, commands and history."""

from collections.abc import Mapping, Sequence
from typing import Any, NotRequired

from typing_extensions import TypedDict

from handover.messages import with_code
from handover_devices.commands.command import Command
from handover_devices.model.description import DeviceDescription
from handover_devices.registry.device import Device
from handover_devices.settings import GatewaySettings


class ValueView(TypedDict):
    """The latest value: time in seconds since 1970, unit as UN/CEFACT code.

    It is stale if newer values are missing: for three of its usual periods, at least for 10 s.
    """

    value: float
    t: float
    unit: str | None
    stale: bool


class SensorView(TypedDict):
    """A sensor that is registered, also before it has sent a value."""

    name: str
    unit: str | None
    minimum: float | None
    maximum: float | None


class DeviceView(TypedDict):
    """A device: what is registered, whether it is connected, and its latest values.

    `values` has those of its sensors and of its joints.
    """

    name: str
    entity: str
    kind: str
    title: str
    connected: bool
    hasToken: bool
    certificateEndsAt: float | None
    state: str | None
    batteryLevel: float | None
    seenAt: float | None
    updatedAt: float
    location: str | None
    sensors: list[SensorView]
    values: dict[str, ValueView]


class ForecastPoint(TypedDict):
    """A forecast for the middle of an interval; 90 % of earlier forecasts were within such a band."""

    t: float
    mean: float
    low: float
    high: float


class ForecastView(TypedDict):
    """A forecast: `error` is the mean absolute error of the `method` from `origins` earlier times.

    `naiveError` is that of repeating the last value. The method is `seasonalNaive` or `dampedTrend`.
    """

    name: str
    unit: str | None
    method: str
    error: float
    naiveError: float
    origins: int
    coverage: float
    points: list[ForecastPoint]


class CertificateView(TypedDict):
    """The certificate of a device and its private key, which is shown only once, in PEM.

    `authority` is the certificate by which the device verifies the gateway.
    """

    name: str
    certificate: str
    key: str
    authority: str
    endsAt: float


class DeviceDetails(DeviceView):
    """A device with its whole description, and the files it has: `urdf`, `picture`."""

    description: DeviceDescription
    createdAt: float
    files: list[str]


class TokenView(TypedDict):
    """A device and its token, which is shown only once, and the port to which the device connects."""

    name: str
    token: str
    port: int
    tls: bool


class CommandView(TypedDict):
    """A command; times are seconds since 1970."""

    id: str
    device: str
    name: str
    kind: str
    parameters: Mapping[str, Any]
    state: str
    progress: float | None
    result: Mapping[str, Any] | None
    reason: str | None
    reasonCode: NotRequired[str]
    reasonParameters: NotRequired[Mapping[str, Any]]
    createdAt: float
    deadline: float


class MessageView(TypedDict):
    """A message that a device sent or received; a refused line is shown as text."""

    number: int
    at: float
    direction: str
    type: str
    message: Any
    answer: str | None


class PointView(TypedDict):
    """The values of one interval, which begins at `t`."""

    t: float
    n: int
    mean: float
    min: float
    max: float


class SeriesView(TypedDict):
    """The values of one sensor or joint over time."""

    name: str
    unit: str | None
    points: list[PointView]


def token_view(name: str, token: str, settings: GatewaySettings) -> TokenView:
    """Return a new token."""
    return {"name": name, "token": token, "port": settings.device_port, "tls": settings.has_device_tls}


def device_view(device: Device, entity: str, now_s: float) -> DeviceView:
    """Return a device without its description."""
    description = device.stored.description
    return {
        "name": device.name,
        "entity": entity,
        "kind": description.kind.value,
        "title": description.title,
        "connected": device.link is not None,
        "hasToken": device.stored.token_sha256 is not None,
        "certificateEndsAt": None
        if device.stored.certificate_end_us is None
        else device.stored.certificate_end_us / 1e6,
        "state": None if device.state is None else device.state.value,
        "batteryLevel": device.battery_level,
        "seenAt": device.seen_at,
        "updatedAt": device.stored.updated_us / 1e6,
        "location": description.placement.location,
        "sensors": [
            {"name": sensor.name, "unit": sensor.unit, "minimum": sensor.minimum, "maximum": sensor.maximum}
            for sensor in description.sensors
        ],
        "values": {
            name: {
                "value": latest.value,
                "t": latest.t,
                "unit": device.values[name].unit,
                "stale": latest.is_stale(now_s),
            }
            for name, latest in device.latest.items()
        },
    }


def device_details(device: Device, entity: str, now_s: float, files: Sequence[str]) -> DeviceDetails:
    """Return a device with its description."""
    return {
        **device_view(device, entity, now_s),
        "description": device.stored.description,
        "createdAt": device.stored.created_us / 1e6,
        "files": list(files),
    }


def command_view(command: Command) -> CommandView:
    """Return a command."""
    return {
        "id": command.id,
        "device": command.device,
        "name": command.name,
        "kind": command.kind.value,
        "parameters": command.parameters,
        "state": command.state.value,
        "progress": command.progress,
        "result": command.result,
        "reason": None,
        **({} if command.reason is None else with_code("reason", command.reason)),  # type: ignore[typeddict-item]
        "createdAt": command.created_s,
        "deadline": command.deadline_s,
    }
