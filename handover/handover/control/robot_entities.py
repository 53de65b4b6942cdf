"""The entities that are alike for robots of every kind: Device and ResourceSpecification."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from handover.files.content_digest import with_digest
from handover_datamodels.entities import DeviceState
from handover_datamodels.times import iso


def robot_device(
    entity_id: str, specification_id: str, state: DeviceState, value: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the Device of a robot as it is now; `value` is its pose and what else it reports."""
    now = iso(datetime.now(UTC))
    return {
        "id": entity_id,
        "type": "Device",
        "category": {"type": "Property", "value": ["robot"]},
        "controlledProperty": {"type": "Property", "value": ["pose"]},
        "deviceState": {"type": "Property", "value": state.value, "observedAt": now},
        "value": {"type": "Property", "value": value, "observedAt": now},
        "isSpecifiedBy": {
            "type": "Property",
            "value": [{"type": "Relationship", "object": specification_id}],
        },
    }


def robot_specification(
    entity_id: str, name: str, parameters: Mapping[str, Any], skills: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the ResourceSpecification of a robot, with the digest of its content."""
    return with_digest(
        {
            "id": entity_id,
            "type": "ResourceSpecification",
            "name": {"type": "Property", "value": name},
            "resourceType": {"type": "Property", "value": "robot"},
            **({"skills": {"type": "Property", "value": list(skills)}} if skills else {}),
            "parameters": {"type": "Property", "value": parameters},
        }
    )
