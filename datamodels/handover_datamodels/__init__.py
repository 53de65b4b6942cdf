"""The vocabulary: the entity types of people, robots and software in manufacturing.

Frozen models of the SHOP4CF data models in NGSI-LD, with their @contexts, JSON Schemas and examples. This
package imports no other package of Handover.
"""

from typing import TYPE_CHECKING, Any

from handover_datamodels.errors import DataModelError
from handover_datamodels.forms import Form
from handover_datamodels.states import (
    AlertPriority,
    AlertState,
    CellState,
    DeviceState,
    MeasurementStatus,
    Outcome,
    RequestedStatus,
    Severity,
    TaskStatus,
)

if TYPE_CHECKING:
    from handover_datamodels.attributes import (
        GeoProperty,
        Links,
        Measurement,
        Property,
        Relationship,
        TaskLocation,
    )
    from handover_datamodels.entities import (
        TYPES,
        Alert,
        Asset,
        Cell,
        Device,
        Entity,
        HumanState,
        Location,
        Material,
        Person,
        PhysiologicalSession,
        PressureMat,
        Process,
        ProcessDefinition,
        ResourceSpecification,
        SpeedLimit,
        Task,
        TaskDefinition,
        read,
    )

__all__ = [
    "TYPES",
    "Alert",
    "AlertPriority",
    "AlertState",
    "Asset",
    "Cell",
    "CellState",
    "DataModelError",
    "Device",
    "DeviceState",
    "Entity",
    "Form",
    "GeoProperty",
    "HumanState",
    "Links",
    "Location",
    "Material",
    "Measurement",
    "MeasurementStatus",
    "Outcome",
    "Person",
    "PhysiologicalSession",
    "PressureMat",
    "Process",
    "ProcessDefinition",
    "Property",
    "Relationship",
    "RequestedStatus",
    "ResourceSpecification",
    "Severity",
    "SpeedLimit",
    "Task",
    "TaskDefinition",
    "TaskLocation",
    "TaskStatus",
    "read",
]


def __getattr__(name: str) -> Any:
    """Import a model or an attribute type on first access.

    The broker needs only the @contexts, and its start should not wait for pydantic.
    """
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from handover_datamodels import attributes, entities  # noqa: PLC0415 - not before they are asked for

    member = getattr(entities, name) if hasattr(entities, name) else getattr(attributes, name)
    globals()[name] = member
    return member
