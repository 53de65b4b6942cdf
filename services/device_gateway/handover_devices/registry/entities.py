"""The entities of a device: its Device, with the latest values, and its ResourceSpecification."""

from datetime import UTC, datetime
from typing import Any

from handover.files.content_digest import with_digest
from handover.service_addresses import DEVICE_GATEWAY
from handover.settings import Settings
from handover_datamodels.numbers import portable
from handover_datamodels.times import iso
from handover_devices.model.description import ROBOTS, DeviceDescription
from handover_devices.registry.device import Device

SOURCE = DEVICE_GATEWAY


def device_id(settings: Settings, name: str) -> str:
    """Return the URN of a device."""
    return settings.entity_id("Device", name)


def specification_id(settings: Settings, name: str) -> str:
    """Return the URN of the ResourceSpecification of a device."""
    return settings.entity_id("ResourceSpecification", name)


def device_entity(settings: Settings, device: Device) -> dict[str, Any]:
    """Return the Device as it is now."""
    description = device.stored.description
    entity: dict[str, Any] = {
        "id": device_id(settings, device.name),
        "type": "Device",
        "category": _property(["robot" if description.kind in ROBOTS else str(description.kind)]),
        "controlledProperty": _property(list(device.values) or ["state"]),
        "source": _property(SOURCE),
        "connectionState": _property("connected" if device.link is not None else "disconnected"),
        "isSpecifiedBy": _property(
            [{"type": "Relationship", "object": specification_id(settings, device.name)}]
        ),
    }
    if description.serial_number:
        entity["serialNumber"] = _property(description.serial_number)
    place = description.placement
    if place.relative_position is not None:
        entity["relativePosition"] = _property(list(place.relative_position))
    if place.coordinates is not None:
        point = {"type": "Point", "coordinates": list(place.coordinates)}
        entity["location"] = {"type": "GeoProperty", "value": point}
    if place.location is not None:
        entity["isLocatedAt"] = {
            "type": "Relationship",
            "object": settings.entity_id("Location", place.location),
        }
    if device.latest:
        latest = device.latest.items()
        at = max(value.t for _, value in latest)
        entity["value"] = _property({name: value.value for name, value in latest}, at)
    if device.state is not None:
        entity["deviceState"] = _property(device.state.value, device.state_at)
    if device.battery_level is not None:
        entity["batteryLevel"] = _property(device.battery_level, device.state_at)
    if device.event is not None:
        name, data, at = device.event
        entity["lastEvent"] = _property({"name": name, "data": portable(data)}, at)
    return entity


def specification_entity(
    settings: Settings, name: str, description: DeviceDescription, url: str
) -> dict[str, Any]:
    """Return the ResourceSpecification of a device; `url` is that of the device over REST."""
    parameters = description.model_dump(
        mode="json", by_alias=True, exclude_defaults=True, exclude={"kind", "title", "skills"}
    )
    parameters["kind"] = description.kind.value
    parameters["url"] = url
    entity: dict[str, Any] = {
        "id": specification_id(settings, name),
        "type": "ResourceSpecification",
        "name": _property(description.title or description.model or name),
        "resourceType": _property("robot" if description.kind in ROBOTS else str(description.kind)),
        "parameters": _property(parameters),
    }
    if description.skills:
        entity["skills"] = _property(list(description.skills))
    return with_digest(entity)


def _property(value: Any, at_s: float | None = None) -> dict[str, Any]:
    written: dict[str, Any] = {"type": "Property", "value": value}
    if at_s is not None:
        written["observedAt"] = iso(datetime.fromtimestamp(at_s, UTC))
    return written
