"""The entity types: design, execution, resources and Alerts.

The SHOP4CF data models; four of them are published only as UML, and their attributes are ours. An entity is
frozen; unknown attributes are stored in normalized form in `model_extra`.
"""

from collections.abc import Iterable, Mapping
from functools import cache
from typing import Annotated, Any, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    StrictBool,
    ValidationError,
    model_validator,
)
from pydantic.alias_generators import to_camel
from pydantic.json_schema import SkipJsonSchema
from pydantic_core import CoreSchema

from handover_datamodels import forms
from handover_datamodels.attributes import (
    DateTime,
    Fraction,
    GeoProperty,
    Links,
    Measurement,
    Moment,
    Number,
    Numbers,
    Objects,
    Property,
    PropertyOrRelationship,
    Relationship,
    Sha256,
    TaskLocation,
    Uri,
    Whole,
    Words,
    WordsOrObjects,
    plain,
)
from handover_datamodels.errors import DataModelError, explained
from handover_datamodels.forms import Bare, Form
from handover_datamodels.states import (
    AlertPriority,
    AlertState,
    CellState,
    DeviceState,
    Outcome,
    RequestedStatus,
    Severity,
    TaskStatus,
)
from handover_datamodels.times import as_written

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
    "HumanState",
    "Location",
    "Material",
    "Outcome",
    "Person",
    "PhysiologicalSession",
    "PressureMat",
    "Process",
    "ProcessDefinition",
    "RequestedStatus",
    "ResourceSpecification",
    "Severity",
    "SpeedLimit",
    "Task",
    "TaskDefinition",
    "TaskStatus",
    "read",
]

_OWN_MEMBERS = {"id": "id", "type": "type", "@context": "context"}
_TIMES = {"createdAt": "created_at", "modifiedAt": "modified_at"}


class Entity(BaseModel):
    """An NGSI-LD entity: an `id` (a URI), a `type` and attributes.

    Its subclasses are the types of the vocabulary; `Entity` itself accepts any type.
    """

    model_config = ConfigDict(
        frozen=True,
        extra="allow",
        alias_generator=to_camel,
        validate_by_name=True,
        validate_by_alias=True,
        allow_inf_nan=False,
    )

    id: Uri
    type: str | tuple[str, ...] = ""
    context: SkipJsonSchema[Any] = Field(None, alias="@context")
    created_at: SkipJsonSchema[Moment | None] = None
    modified_at: SkipJsonSchema[Moment | None] = None

    @classmethod
    def ngsi_type(cls) -> str:
        """Return the name of the entity type in NGSI-LD."""
        return cls.__name__

    @classmethod
    def from_ngsild(cls, data: Mapping[str, Any], form: Form | None = None) -> Self:
        """Return the entity `data` in any of the three forms.

        Without `form`, each attribute is read for what it looks like; a bare JSON object with a
        member `value` looks like a concise attribute, so give `Form.KEY_VALUES` where such values may come.
        Raises `DataModelError`, which names the entity, the attribute and the rule.
        """
        if not isinstance(data, Mapping):
            raise DataModelError(f"an entity is a JSON object, not {type(data).__name__}")
        attributes = {
            key: Bare(value) if form is Form.KEY_VALUES and not forms.is_entity_member(key) else value
            for key, value in data.items()
        }
        for name in (attributes.keys() & _names(cls)) - _aliases(
            cls
        ):  # an attribute with the name of a field
            attributes[name] = forms.normalized_attribute(attributes[name])
        try:
            return cls.model_validate(attributes, by_alias=True, by_name=False)
        except ValidationError as error:
            raise DataModelError(explained(cls.ngsi_type(), data, error.errors())) from None

    def to_normalized(self) -> dict[str, Any]:
        """Return the entity in normalized form as JSON."""
        written: dict[str, Any] = {"id": self.id, "type": plain(self.type)}
        for name, field in type(self).model_fields.items():
            value = getattr(self, name)
            if name not in _OWN_MEMBERS.values() and name not in _TIMES.values() and value is not None:
                written[field.alias or name] = value.to_normalized()
        written |= self.model_extra or {}
        for alias, name in _TIMES.items():
            if (moment := getattr(self, name)) is not None:
                written[alias] = as_written(moment)
        if self.context is not None:
            written["@context"] = self.context
        return written

    def to_concise(self) -> dict[str, Any]:
        """Return the entity in concise form, without loss; `from_ngsild` is the inverse."""
        return forms.to_concise(self.to_normalized())

    def to_key_values(self) -> dict[str, Any]:
        """Return the entity as bare values (keyValues): attribute types and metadata are lost."""
        fields = type(self).model_fields.items()
        links = [field.alias or name for name, field in fields if isinstance(getattr(self, name), Links)]
        return forms.to_key_values(self.to_normalized(), link_lists=links)

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        return ((name, value) for name, value in super().__repr_args__() if value is not None)

    @model_validator(mode="before")
    @classmethod
    def _read(cls, entity: Any) -> Any:
        if not isinstance(entity, Mapping):
            return entity
        declared = _names(cls) | _aliases(cls)
        data: dict[str, Any] = {}
        for key, value in entity.items():
            if key in declared:
                if not _is_deleted(value):
                    data[key] = value
            elif forms.is_entity_member(key):
                data[key] = value
            else:
                data[key] = forms.normalized_attribute(value)
        if cls is not Entity:
            data.setdefault("type", cls.ngsi_type())
        return data

    @model_validator(mode="after")
    def _check_type(self) -> Self:
        types = (self.type,) if isinstance(self.type, str) else self.type
        if not all(types) or not types:
            raise ValueError("has no type")
        if type(self) is not Entity and self.ngsi_type() not in types:
            raise ValueError(f"its type is {', '.join(types)}")
        return self

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        written = handler.resolve_ref_schema(handler(schema))
        written["properties"] = {**written["properties"], "type": {"const": cls.ngsi_type()}}
        required = (key for key in written["properties"] if key in {*written["required"], "type"})
        written["required"] = list(required)
        return written


class ProcessDefinition(Entity):
    """A process model: its BPMN 2.0, as XML or as the URL of the XML.

    Definitions of our components have a `content_digest` (`handover.files.content_digest`).
    """

    name: Property[str]
    version: Property[str]
    bpmn: Property[str]
    description: Property[str] | None = None
    content_digest: Property[str] | None = None


class TaskDefinition(Entity):
    """A kind of Task: its description, command and required skills.

    With `handles_outcomes`, a Task with another outcome than `ok` is completed, since its process handles the
    outcome; without it, such a Task fails. With `require_pin`, the person who answers gives the own PIN.
    """

    name: Property[str]
    description: Property[str] | None = None
    gesture: Property[str] | None = None
    command_id: Property[Whole] | None = None
    handles_outcomes: Property[StrictBool] | None = None
    require_pin: Property[StrictBool] | None = None
    required_skills: Property[Words] | None = None
    work_parameters_schema: Property[dict[str, Any]] | None = None
    output_parameters_schema: Property[dict[str, Any]] | None = None
    specification: Property[dict[str, Any]] | None = None
    """What is written to the specification database before such a Task is posted."""
    is_part_of: Relationship | None = None
    content_digest: Property[str] | None = None


class ResourceSpecification(Entity):
    """A kind of resource: its skills, roles and shifts, and how many Tasks it performs at a time.

    A skill is a name, or an object with `name` and the numbers `level`, `cost` and `speed`. A shift has the
    ISO `weekday`, the times `from` and `to`, and the time `zone`.
    """

    name: Property[str]
    resource_type: Property[str]
    skills: Property[WordsOrObjects] | None = None
    roles: Property[Words] | None = None
    capacity: Property[Whole] | None = None
    shifts: Property[Objects] | None = None
    parameters: Property[dict[str, Any]] | None = None
    content_digest: Property[str] | None = None


class Location(Entity):
    """A place with a name, possibly a part of another one."""

    name: Property[str]
    location: GeoProperty | None = None
    is_part_of: Relationship | None = None


class Process(Entity):
    """One run of a process: its status and its Tasks."""

    is_defined_by: Relationship
    status: Property[TaskStatus]
    work_parameters: Property[dict[str, Any]] | None = None
    output_parameters: Property[dict[str, Any]] | None = None
    is_composed_of: Links[Relationship] | None = None


class Task(Entity):
    """A piece of work for the resources that it involves; the first one executes it.

    `requested_status` is the requested action; `deadline` is the time until which a performer must accept it,
    `due_date` the time until which it should be completed. Until `follow_up_date` nobody needs to look at it.
    Of the Tasks that wait for a resource the one with the highest `priority` (50 by default) comes first.
    The `output_parameters` of a person's Task have an `outcome` (see `Outcome`) and optionally a `note`.
    A Task of people has what a tasklist shows: its `name` and the `element` of its Process.
    """

    is_defined_by: Relationship
    status: Property[TaskStatus]
    involves: Links[Relationship] | None = None
    happens_at: Links[TaskLocation] | None = None
    description: Property[str] | None = None
    work_parameters: Property[dict[str, Any]] | None = None
    output_parameters: Property[dict[str, Any]] | None = None
    requested_status: Property[RequestedStatus] | None = None
    deadline: Property[DateTime] | None = None
    name: Property[str] | None = None
    element: Property[str] | None = None
    is_part_of: Relationship | None = None
    priority: Property[Whole] | None = None
    due_date: Property[DateTime] | None = None
    follow_up_date: Property[DateTime] | None = None


class Device(Entity):
    """A machine, a robot, a sensor or a glove; `performer` is the component that executes its Tasks."""

    controlled_property: Property[Words]
    category: Property[Words] | None = None
    source: PropertyOrRelationship | None = None
    serial_number: Property[str] | None = None
    value: Property[Any] | None = None
    device_state: Property[DeviceState] | None = None
    battery_level: Property[Number] | None = None
    relative_position: Property[Numbers] | None = None
    is_specified_by: Links[Relationship] | None = None
    command_id: Property[Whole] | None = None
    performer: Property[str] | None = None


class Material(Entity):
    """A workpiece or a consumable."""

    description: Property[str] | None = None
    state: Property[Any] | None = None
    is_specified_by: Links[Relationship] | None = None


class Asset(Entity):
    """A reusable object: a tool, a carrier, a fixture."""

    description: Property[str] | None = None
    state: Property[Any] | None = None
    is_specified_by: Links[Relationship] | None = None


class Person(Entity):
    """A person; `performer` is the component that executes their Tasks.

    `relative_position` is ours: x and y in m in the frame of the cell, with `observedAt`.
    """

    first_name: Property[str] | None = None
    last_name: Property[str] | None = None
    state: Property[Any] | None = None
    relative_position: Property[Numbers] | None = None
    is_specified_by: Links[Relationship] | None = None
    performer: Property[str] | None = None


class Alert(Entity):
    """A problem that a person has to know; it is active until `valid_to`.

    `alert_state`, `priority`, `acknowledged_by` and `shelved_until` are ours and follow ISA-18.2. An Alert
    of another component may lack them; `human_verified` then states whether a person has acknowledged it.
    `description_code` and `description_parameters` are ours as well: the page translates the description with
    them.
    """

    category: Property[str]
    date_issued: Property[DateTime]
    alert_source: Relationship
    sub_category: Property[str] | None = None
    severity: Property[Severity] | None = None
    description: Property[str] | None = None
    valid_from: Property[DateTime] | None = None
    valid_to: Property[DateTime] | None = None
    location: GeoProperty | None = None
    source: PropertyOrRelationship | None = None
    human_verified: Property[Annotated[bool, Field(strict=True)]] | None = None
    alert_state: Property[AlertState] | None = None
    priority: Property[AlertPriority] | None = None
    acknowledged_by: PropertyOrRelationship | None = None
    shelved_until: Property[DateTime] | None = None
    description_code: Property[str] | None = None
    description_parameters: Property[dict[str, Any]] | None = None


class SpeedLimit(Entity):
    """How fast a robot may move at most while a person is near or strained; advisory, and only lowering.

    `fraction` is that of the speed of its motions, `max_speed` the speed of the tool in m/s (`MTS`). It is
    the record of what the robot received; the robot itself receives limits over a stream.
    """

    ref_robot: Relationship
    fraction: Property[Fraction]
    reason: Property[str]
    valid_until: Property[DateTime]
    ref_person: Relationship | None = None
    max_speed: Property[Number] | None = None


class Cell(Entity):
    """A cell on the broker, as its orchestrator describes it every 30 s: one for each name of a cell.

    `identity` is random and stays with the database of the orchestrator, so that two cells with one name
    are noticed. The counts of processes that have ended are those of the last hour.
    """

    identity: Property[str]
    cell_state: Property[CellState]
    last_seen: Property[DateTime]
    running_processes: Property[Whole] | None = None
    unfinished_tasks: Property[Whole] | None = None
    incidents: Property[Whole] | None = None
    completed_last_hour: Property[Whole] | None = None
    failed_last_hour: Property[Whole] | None = None


class HumanState(Entity):
    """How a person is, as sensors on and near the body measure it: one entity a Person.

    Each attribute is a `Measurement` with `observed_at`: the fused value is the default instance, that of
    each sensor has a `datasetId`. Units: heart rate `BPM`, breathing rate and cadence `C94` (per minute),
    heart rate variability `C26` (ms), SpO2 `P1` (%), skin conductance `D80` (microsiemens), skin
    temperature `CEL`, blink rate `C94`, mean duration of blinks and fixations `C26`, saccade rate `HTZ`,
    amplitude of saccades `DD` (degree), diameter of the pupils `MMT`. `movement` (of an accelerometer),
    `fatigue` and `stress` are fractions from 0 to 1, `body_movement` (of a radar) is in percent. It is the
    record: a control loop never waits for it, and it is no diagnosis.
    """

    ref_person: Relationship
    heart_rate: Measurement[Number] | None = None
    breathing_rate: Measurement[Number] | None = None
    hrv_rmssd: Measurement[Number] | None = None
    hrv_sdnn: Measurement[Number] | None = None
    spo2: Measurement[Number] | None = None
    eda_tonic: Measurement[Number] | None = None
    skin_temperature: Measurement[Number] | None = None
    movement: Measurement[Number] | None = None
    body_movement: Measurement[Number] | None = None
    steps: Measurement[Number] | None = None
    cadence: Measurement[Number] | None = None
    activity: Measurement[str] | None = None
    posture: Measurement[str] | None = None
    sleep_position: Measurement[str] | None = None
    wear_state: Measurement[str] | None = None
    exertion_level: Measurement[Number | str] | None = None
    fatigue: Measurement[Number] | None = None
    stress: Measurement[Number] | None = None
    blink_rate: Measurement[Number] | None = None
    blink_duration: Measurement[Number] | None = None
    fixation_duration: Measurement[Number] | None = None
    saccade_rate: Measurement[Number] | None = None
    saccade_amplitude: Measurement[Number] | None = None
    pupil_diameter: Measurement[Number] | None = None


class PressureMat(Entity):
    """What a pressure mat measures of the person on it.

    The centre of pressure is in mm (`MMT`) in the frame of the mat, to the right and to the front. `load` is
    the fraction of the full scale of all cells, `active_cells` the number of cells with load.
    """

    ref_device: Relationship
    cop_x: Measurement[Number] | None = None
    cop_y: Measurement[Number] | None = None
    load: Measurement[Number] | None = None
    active_cells: Measurement[Whole] | None = None


class PhysiologicalSession(Entity):
    """A recording of body signals of a person: its URI, and the SHA-256 of the file in hexadecimal digits.

    Until it ends it has neither `sha256` nor `ended_at`.
    """

    ref_person: Relationship
    started_at: Property[DateTime]
    ended_at: Property[DateTime] | None = None
    recording: Property[Uri] | None = None
    sha256: Property[Sha256] | None = None


TYPES: dict[str, type[Entity]] = {
    model.ngsi_type(): model
    for model in (
        ProcessDefinition,
        TaskDefinition,
        ResourceSpecification,
        Location,
        Process,
        Task,
        Device,
        Material,
        Asset,
        Person,
        Alert,
        SpeedLimit,
        Cell,
        HumanState,
        PressureMat,
        PhysiologicalSession,
    )
}
"""The models by entity type."""


def read(data: Mapping[str, Any], form: Form | None = None) -> Entity:
    """Return the entity `data` as the model of its type; a plain `Entity` for a foreign type.

    Raises `DataModelError`, as `Entity.from_ngsild` does.
    """
    if not isinstance(data, Mapping):
        return Entity.from_ngsild(data, form)
    type_name = data.get("type")
    types = type_name if isinstance(type_name, list | tuple) else (type_name,)
    model = next((TYPES[name] for name in types if isinstance(name, str) and name in TYPES), Entity)
    return model.from_ngsild(data, form)


@cache
def _names(model: type[Entity]) -> frozenset[str]:
    return frozenset(model.model_fields)


@cache
def _aliases(model: type[Entity]) -> frozenset[str]:
    return frozenset(field.alias or name for name, field in model.model_fields.items())


def _is_deleted(value: Any) -> bool:
    return value == forms.NULL or (
        isinstance(value, Mapping) and forms.NULL in (value.get("value"), value.get("object"))
    )
