"""Devices: gloves, robots and whatever else has a Device entity, with the state it says it is in."""

from collections.abc import Collection, Mapping
from typing import Any

from datamodels.entities import Device, DeviceState
from datamodels.times import iso
from webui.events import EventLog, Happening, Level, in_milliseconds
from webui.sources.entities import Kind
from webui.sources.services import Services
from webui.world import World

LEVELS: Mapping[DeviceState, Level] = {
    DeviceState.ERROR: "stop",
    DeviceState.OUT_OF_BATTERY: "attention",
    DeviceState.FOR_MAINTENANCE: "attention",
}


def short(urn: str) -> str:
    """Return the last part of an id, by which people know the thing."""
    return urn.rsplit(":", 1)[-1]


class Devices(Kind):
    """Tells the world about Device entities, and the log when one changes its state for other than work."""

    ngsi_type = "Device"

    def __init__(self, world: World, events: EventLog, services: Services) -> None:
        self._world = world
        self._events = events
        self._services = services
        self._performers: dict[str, str] = {}
        self._states: dict[str, tuple[DeviceState, str]] = {}
        self._known: set[str] = set()

    def take(self, entity: Mapping[str, Any]) -> None:
        """Take a Device as it is now; one of which only the performer is announced is none yet."""
        if "performer" in entity:
            performer = entity["performer"]
            if isinstance(performer, Mapping):
                self._is_acted_for(str(entity["id"]), str(performer.get("value")))
        if "controlledProperty" not in entity and "deviceState" not in entity:
            return
        device = Device.from_ngsild({"controlledProperty": {"type": "Property", "value": []}, **entity})
        self._known.add(device.id)
        self._world.tell(f"device/{device.id}", view_of(device))
        self._log_state(device)

    def still_open(self) -> Collection[str]:
        """Return all that are known: a Device never ends."""
        return self._known

    def gone(self, entity_id: str) -> None:
        """Forget a Device."""
        self._known.discard(entity_id)
        self._performers.pop(entity_id, None)
        self._states.pop(entity_id, None)
        self._world.forget(f"device/{entity_id}")

    def performer_of(self, resource: str) -> str | None:
        """Return the component that acts for a resource."""
        return self._performers.get(resource)

    def _is_acted_for(self, device: str, performer: str) -> None:
        if self._performers.get(device) != performer:
            self._performers[device] = performer
            self._credit(device)

    def _credit(self, device: str) -> None:
        """Let the performer be heard with the Device's state; either may come first."""
        performer = self.performer_of(device)
        if performer is not None and device in self._states:
            state, at = self._states[device]
            self._services.heard(performer, f"{short(device)}: {state.value}", at)

    def _log_state(self, device: Device) -> None:
        if device.device_state is None:
            return
        state = device.device_state.value
        if device.id in self._states and self._states[device.id][0] == state:
            return
        seen = device.device_state.observed_at
        at = in_milliseconds(iso(seen) if seen else None)
        self._states[device.id] = state, at
        self._credit(device.id)
        name = short(device.id)
        logged = self._events.last_mark(device.id) or ""
        if state is DeviceState.BUSY or logged.partition("@")[0] == state.value:
            return  # that it works and rests is what its Tasks say; the log would be full of it
        self._events.record(
            Happening(
                subject=device.id,
                mark=f"{state.value}@{at}",
                key="device.state",
                source=name,
                text=f"{name} is {state.value}",
                at=at,
                level=LEVELS.get(state, "info"),
                values={"device": device.id, "name": name, "state": state.value},
            )
        )


def view_of(device: Device) -> dict[str, Any]:
    """Return a Device as pages get it."""
    moments = [
        attribute.observed_at
        for attribute in (device.device_state, device.value, device.battery_level, device.command_id)
        if attribute is not None and attribute.observed_at is not None
    ]
    return {
        "id": device.id,
        "category": list(device.category.value) if device.category else [],
        "deviceState": device.device_state.value.value if device.device_state else None,
        "batteryLevel": device.battery_level.value if device.battery_level else None,
        "observedAt": iso(max(moments)) if moments else None,
        "value": device.value.value if device.value else None,
    }
