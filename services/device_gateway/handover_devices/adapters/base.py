"""The adapter interface: how devices with another protocol (MQTT, OPC UA, Modbus) join the gateway.

An adapter is a function `make(settings, gateway)` that returns an `Adapter`, or None if it is not configured.
A package registers it by an entry point, and nothing else in the tree knows its name:

    [project.entry-points."handover.device_adapters"]
    opcua = "opcua_adapter:make"

An adapter turns what it receives into lines of the protocol (`protocol.messages`) and passes them to the
gateway, so that rights, limits, history, anomalies and commands are the same for all devices:

- `gateway.connect(hello, link)` begins a session after the token was checked; `link.send` receives commands;
- `gateway.receive(device, lines, respond)` processes messages; its future is done when they are durable;
- an adapter that polls a machine without tokens (Modbus) calls `gateway.attach(name, link)` instead.

A motion command must reach the device at once or never: an adapter must not store commands.
"""

from collections.abc import Callable
from typing import Final, Protocol

from handover.extensions import ExtensionPoint
from handover_devices.gateway import DeviceGateway
from handover_devices.settings import GatewaySettings


class Adapter(Protocol):
    """A connection to other devices; `run` is restarted with backoff when it returns or fails."""

    @property
    def fault(self) -> str | None:
        """Why it cannot reach its devices at present; None while it can."""
        ...

    async def run(self) -> None:
        """Serve devices until cancelled."""
        ...


MakeAdapter = Callable[[GatewaySettings, DeviceGateway], Adapter | None]

ADAPTERS: Final = ExtensionPoint(
    "device adapter", "handover.device_adapters", {"mqtt": "handover_devices.adapters.mqtt:make"}
)


def configured(settings: GatewaySettings, gateway: DeviceGateway) -> dict[str, Adapter]:
    """Return the adapters that are configured, by name; raise `UsageError` for one that cannot be loaded."""
    adapters: dict[str, Adapter] = {}
    for name in ADAPTERS.names():
        make: MakeAdapter = ADAPTERS.load(name)
        adapter = make(settings, gateway)
        if adapter is not None:
            adapters[name] = adapter
    return adapters
