"""Devices: gloves, robots and all other Device entities, with their state."""

from collections.abc import Collection, Mapping
from typing import Any

from handover_datamodels.entities import Device, DeviceState
from handover_datamodels.times import iso
from handover_web.live.event_log import Event, EventLog, Level, normalized_timestamp
from handover_web.live.live_state import LiveState
from handover_web.live.views import DeviceView
from handover_web.sources.broker_entities import EntityHandler
from handover_web.sources.services import ServiceMonitor

LEVELS: Mapping[DeviceState, Level] = {
    DeviceState.ERROR: "stop",
    DeviceState.OUT_OF_BATTERY: "attention",
    DeviceState.FOR_MAINTENANCE: "attention",
}


def short_name(urn: str) -> str:
    """Return the last part of a URN, as shown to people."""
    return urn.rsplit(":", 1)[-1]


class Devices(EntityHandler):
    """Publishes Device entities, and records an event when the state changes other than to or from `busy`."""

    ngsi_type = "Device"

    def __init__(self, state: LiveState, events: EventLog, services: ServiceMonitor) -> None:
        self._state = state
        self._events = events
        self._services = services
        self._performers: dict[str, str] = {}
        self._states: dict[str, tuple[DeviceState, str]] = {}
        self._ids: set[str] = set()

    def update(self, entity: Mapping[str, Any]) -> None:
        """Handle a Device; an entity with nothing but a performer is not shown yet."""
        if "performer" in entity:
            performer = entity["performer"]
            if isinstance(performer, Mapping):
                self._set_performer(str(entity["id"]), str(performer.get("value")))
        if "controlledProperty" not in entity and "deviceState" not in entity:
            return
        device = Device.from_ngsild({"controlledProperty": {"type": "Property", "value": []}, **entity})
        self._ids.add(device.id)
        self._state.publish(f"device/{device.id}", view_of(device))
        self._log_state(device)

    def active_ids(self) -> Collection[str]:
        """Return all known Devices: a Device has no final state."""
        return self._ids

    def remove(self, entity_id: str) -> None:
        """Forget a Device."""
        self._ids.discard(entity_id)
        self._performers.pop(entity_id, None)
        self._states.pop(entity_id, None)
        self._state.remove(f"device/{entity_id}")

    def performer_of(self, resource: str) -> str | None:
        """Return the component that performs the Tasks of a resource."""
        return self._performers.get(resource)

    def _set_performer(self, device: str, performer: str) -> None:
        if self._performers.get(device) != performer:
            self._performers[device] = performer
            self._record_performer_message(device)

    def _record_performer_message(self, device: str) -> None:
        """Record the state as the last message of the performer; either may arrive first."""
        performer = self.performer_of(device)
        if performer is not None and device in self._states:
            state, at = self._states[device]
            self._services.record_message(performer, f"{short_name(device)}: {state.value}", at)

    def _log_state(self, device: Device) -> None:
        if device.device_state is None:
            return
        state = device.device_state.value
        if device.id in self._states and self._states[device.id][0] == state:
            return
        seen = device.device_state.observed_at
        at = normalized_timestamp(iso(seen) if seen else None)
        self._states[device.id] = state, at
        self._record_performer_message(device.id)
        name = short_name(device.id)
        logged = self._events.last_mark(device.id) or ""
        if state is DeviceState.BUSY or logged.partition("@")[0] == state.value:
            return  # the events of its Tasks say so already
        self._events.record(
            Event(
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


def view_of(device: Device) -> DeviceView:
    """Return a Device as sent to pages."""
    timestamps = [
        attribute.observed_at
        for attribute in (device.device_state, device.value, device.battery_level, device.command_id)
        if attribute is not None and attribute.observed_at is not None
    ]
    return {
        "id": device.id,
        "category": list(device.category.value) if device.category else [],
        "deviceState": device.device_state.value.value if device.device_state else None,
        "batteryLevel": device.battery_level.value if device.battery_level else None,
        "observedAt": iso(max(timestamps)) if timestamps else None,
        "value": device.value.value if device.value else None,
    }
