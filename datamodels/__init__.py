"""The vocabulary: the entities that people, robots and programs of a shop floor talk about.

Frozen models of the SHOP4CF data models in NGSI-LD, with their @contexts, JSON Schemas and examples. This
package stands on its own; everything else of Handover stands on it.
"""

from datamodels.attributes import GeoProperty, Links, Property, Relationship, TaskLocation
from datamodels.entities import (
    TYPES,
    Alert,
    Asset,
    Device,
    Entity,
    Location,
    Material,
    Person,
    Process,
    ProcessDefinition,
    ResourceSpecification,
    Task,
    TaskDefinition,
    read,
)
from datamodels.errors import DataModelError
from datamodels.forms import Form
from datamodels.states import DeviceState, RequestedStatus, Severity, TaskStatus

__all__ = [
    "TYPES",
    "Alert",
    "Asset",
    "DataModelError",
    "Device",
    "DeviceState",
    "Entity",
    "Form",
    "GeoProperty",
    "Links",
    "Location",
    "Material",
    "Person",
    "Process",
    "ProcessDefinition",
    "Property",
    "Relationship",
    "RequestedStatus",
    "ResourceSpecification",
    "Severity",
    "Task",
    "TaskDefinition",
    "TaskLocation",
    "TaskStatus",
    "read",
]
