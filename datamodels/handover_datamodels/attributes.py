"""Attributes: Property, Relationship and GeoProperty with their metadata.

A bare value is accepted in place of an attribute: `Task(status="pending")`. Unknown members (attributes of
attributes) are stored in normalized form and written again.
"""

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from enum import Enum
from typing import Annotated, Any, ClassVar, Generic, Self, TypeVar, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    PlainValidator,
    StrictBool,
    StrictFloat,
    StrictInt,
    Tag,
    WithJsonSchema,
    model_validator,
)
from pydantic.alias_generators import to_camel
from pydantic.json_schema import SkipJsonSchema
from pydantic_core import CoreSchema, core_schema

from handover_datamodels import forms
from handover_datamodels.forms import Bare
from handover_datamodels.states import MeasurementStatus
from handover_datamodels.times import Timestamp, as_written

T = TypeVar("T")

_MOMENT_SCHEMA = {"type": "string", "format": "date-time"}
_DATE_TIME_SCHEMA = {
    "type": "object",
    "properties": {"@type": {"const": "DateTime"}, "@value": _MOMENT_SCHEMA},
    "required": ["@type", "@value"],
    "additionalProperties": False,
}


def _moment(written: Any) -> datetime:
    if isinstance(written, str):
        return Timestamp.read(written)
    if not isinstance(written, datetime):
        raise ValueError("must be a time like 2026-01-31T08:30:00Z")  # noqa: TRY004 - pydantic wants ValueError
    if written.tzinfo is None:
        raise ValueError(f"{written.isoformat()} has no time zone; give one, such as datetime.now(UTC)")
    return written


def _date_time(written: Any) -> datetime:
    if isinstance(written, Mapping):
        if written.get("@type") != "DateTime" or "@value" not in written:
            raise ValueError('must be {"@type": "DateTime", "@value": "…"}')
        written = written["@value"]
    return _moment(written)


def _whole(number: Any) -> Any:
    if isinstance(number, bool | str):
        raise ValueError("must be a whole number")  # noqa: TRY004 - pydantic wants ValueError
    return number


def _only(member: Any) -> Any:
    return member[0] if isinstance(member, list | tuple) and len(member) == 1 else member


def _as_list(instances: Any) -> Any:
    """Accept a single item as a list: the JSON-LD compaction of some brokers unpacks lists of one."""
    return instances if isinstance(instances, list | tuple) else (instances,)


def _geometry(geometry: dict[str, Any]) -> dict[str, Any]:
    if not forms.is_geometry(geometry):
        raise ValueError('must be a GeoJSON geometry like {"type": "Point", "coordinates": [23.7, 61.5]}')
    return geometry


Moment = Annotated[datetime, PlainValidator(_moment), WithJsonSchema(_MOMENT_SCHEMA)]
"""A time as metadata, such as `observedAt`; written as text."""

DateTime = Annotated[datetime, PlainValidator(_date_time), WithJsonSchema(_DATE_TIME_SCHEMA)]
"""A time as the value of a Property; written as a typed value of JSON-LD."""

Uri = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9+.-]*:\S+$")]
Whole = Annotated[int, BeforeValidator(_whole)]
Number = StrictInt | StrictFloat
Fraction = Annotated[float, Field(ge=0, le=1, strict=True)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Words = Annotated[tuple[str, ...], BeforeValidator(_as_list)]
WordsOrObjects = Annotated[tuple[str | dict[str, Any], ...], BeforeValidator(_as_list)]
Objects = Annotated[tuple[dict[str, Any], ...], BeforeValidator(_as_list)]
Numbers = Annotated[tuple[Number, ...], BeforeValidator(_as_list)]
Geometry = Annotated[
    dict[str, Any],
    AfterValidator(_geometry),
    WithJsonSchema(
        {
            "type": "object",
            "properties": {"type": {"enum": sorted(forms.GEOMETRIES)}, "coordinates": {"type": "array"}},
            "required": ["type"],
        }
    ),
]


class Attribute(BaseModel):
    """The members of every attribute: time of observation and datasetId.

    `alternatives` are the other instances of the attribute (with other datasetIds), normalized.
    """

    model_config = ConfigDict(
        frozen=True,
        extra="allow",
        alias_generator=to_camel,
        validate_by_name=True,
        validate_by_alias=True,
        allow_inf_nan=False,
    )

    kind: ClassVar[str]
    member: ClassVar[str]

    observed_at: Moment | None = None
    dataset_id: Uri | None = None
    created_at: Moment | None = None
    modified_at: Moment | None = None
    alternatives: SkipJsonSchema[tuple[dict[str, Any], ...]] = Field((), alias="@alternatives")

    def to_normalized(self) -> dict[str, Any] | list[dict[str, Any]]:
        """Return the attribute in normalized form: an object, or a list if it has several instances."""
        written: dict[str, Any] = {"type": self.kind, self.member: plain(getattr(self, self.member))}
        for name, alias in _written_members(type(self)):
            value = getattr(self, name)
            if value is not None:
                written[alias] = as_written(value) if isinstance(value, datetime) else plain(value)
        written |= self.model_extra or {}
        return [written, *self.alternatives] if self.alternatives else written

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        return ((name, value) for name, value in super().__repr_args__() if value not in (None, ()))

    @model_validator(mode="before")
    @classmethod
    def _read(cls, written: Any) -> Any:
        if isinstance(written, cls):
            return written
        if isinstance(written, Attribute):
            written = written.to_normalized()
        if isinstance(written, Bare):
            return cls._from_bare(written.value)
        if forms.are_instances(written):
            return cls._from_instances(written)
        return cls._from_one(written)

    @classmethod
    def _from_bare(cls, value: Any) -> dict[str, Any]:
        instances = forms.bare_instances(value)
        if instances is None:
            return {cls.member: value}
        rebuilt = [
            {"type": cls.kind, cls.member: said} | ({} if name == "@none" else {"datasetId": name})
            for name, said in instances.items()
        ]
        return cls._from_instances(rebuilt)

    @classmethod
    def _from_instances(cls, instances: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        main = next((instance for instance in instances if "datasetId" not in instance), instances[0])
        others = [forms.normalized_attribute(instance) for instance in instances if instance is not main]
        return {**cls._from_one(main), "@alternatives": others}

    @classmethod
    def _from_one(cls, instance: Any) -> dict[str, Any]:
        if not isinstance(instance, Mapping):
            return {cls.member: instance}
        kind = instance.get("type")
        if isinstance(kind, str) and kind in forms.MEMBERS:
            if kind != cls.kind:
                raise ValueError(f"is a {kind}, but must be a {cls.kind}")
            if cls.member not in instance:
                raise ValueError(f'is a {cls.kind} without "{cls.member}"')
        elif "type" in instance or cls.member not in instance:
            return {cls.member: instance}
        members = _known_members(cls)
        rest = {key: value for key, value in instance.items() if key not in members}
        kept = {key: value for key, value in instance.items() if key in members}
        return {**kept, **forms.with_normalized_members(rest, cls.member)}

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        written = handler.resolve_ref_schema(handler(schema))
        written["properties"] = {"type": {"const": cls.kind}, **written.get("properties", {})}
        written["required"] = ["type", cls.member]
        return written


class Property(Attribute, Generic[T]):
    """A Property: `value`, in `unit_code` (UN/CEFACT) if it has a unit."""

    kind = "Property"
    member = "value"

    value: T
    unit_code: str | None = None


class Measurement(Property[T], Generic[T]):
    """A Property that was measured on a person: its quality from 0 to 1, status, method and sensor.

    The fused value is the default instance. Each sensor has an instance of its own with a `datasetId`.
    """

    quality: "Property[Fraction] | None" = None
    status: "Property[MeasurementStatus] | None" = None
    method: "Property[str] | None" = None
    observed_by: "Relationship | None" = None
    calibrated: "Property[StrictBool] | None" = None
    """False: such a value never feeds a limit. Without it, the value is calibrated."""

    def instances(self) -> tuple[Self, ...]:
        """Return this instance and the others, each checked.

        Raises ValidationError (pydantic) for another instance that is no such measurement.
        """
        return (
            self.model_copy(update={"alternatives": ()}),
            *(type(self).model_validate(alternative) for alternative in self.alternatives),
        )

    @classmethod
    def _from_one(cls, instance: Any) -> dict[str, Any]:
        """Accept keyValues of several instances in any form, since no measurement is a JSON object."""
        is_bare = forms.bare_instances(instance) is not None
        return cls._from_bare(instance) if is_bare else super()._from_one(instance)


class Relationship(Attribute):
    """A Relationship to the entity with the id `object`."""

    kind = "Relationship"
    member = "object"

    object: Annotated[Uri, BeforeValidator(_only)]


class GeoProperty(Attribute):
    """A GeoProperty: `value` is a GeoJSON geometry in WGS 84, longitude first."""

    kind = "GeoProperty"
    member = "value"

    value: Geometry


class TaskLocation(Relationship):
    """A Location of a Task and its function, for example `source` or `target`."""

    location_function: Property[str] | None = None


def _source_kind(source: Any) -> str:
    bare = source.value if isinstance(source, Bare) else source
    if isinstance(bare, str):
        return "Relationship" if bare.startswith("urn:") else "Property"
    if isinstance(bare, Mapping):
        return "Relationship" if bare.get("type") == "Relationship" or "object" in bare else "Property"
    return "Relationship" if isinstance(bare, Relationship) else "Property"


PropertyOrRelationship = Annotated[
    Annotated[Property[str], Tag("Property")] | Annotated[Relationship, Tag("Relationship")],
    Discriminator(_source_kind),
]
"""A URN becomes a Relationship, other text a Property: the published models leave that open."""

LinkT_co = TypeVar("LinkT_co", bound=Relationship, covariant=True)


class Links(tuple[LinkT_co, ...], Generic[LinkT_co]):  # noqa: SLOT001 - a tuple takes no slots beside its items
    """Relationships that the vocabulary writes as one Property with a list: `involves`, `happensAt`.

    A tuple, with the metadata of the Property (`observed_at` and so on) in `about`. It is also read from a
    Relationship, a list of Relationships or URNs, and a Relationship to several objects.
    """

    about: Property[tuple[LinkT_co, ...]]

    def __new__(cls, about: Property[tuple[LinkT_co, ...]]) -> "Links[LinkT_co]":
        """Return the links of a Property that lists them."""
        links = super().__new__(cls, about.value)
        links.about = about
        return links

    def __reduce__(self) -> Any:
        """Copy and pickle with the metadata of the Property."""
        return (Links, (self.about,))

    @property
    def observed_at(self) -> datetime | None:
        """Return the time of observation of the list."""
        return self.about.observed_at

    def to_normalized(self) -> dict[str, Any] | list[dict[str, Any]]:
        """Return the list as a Property in normalized form."""
        return self.about.to_normalized()

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        (link,) = get_args(source) or (Relationship,)
        about = handler.generate_schema(Property[tuple[link, ...]])  # type: ignore[valid-type] # made at run time
        return core_schema.no_info_before_validator_function(
            _links_property, core_schema.no_info_after_validator_function(cls, about)
        )


def _links_property(attribute: Any) -> Any:
    if isinstance(attribute, Links):
        return attribute.about
    if isinstance(attribute, Bare):
        attribute = attribute.value
    if isinstance(attribute, Property):
        attribute = attribute.to_normalized()
    if not isinstance(attribute, Mapping) or ("value" not in attribute and "objectList" not in attribute):
        return Bare(tuple(_each_link(attribute)))
    member = "value" if "value" in attribute else "objectList"
    rest = {key: value for key, value in attribute.items() if key not in {"type", member}}
    return {"type": "Property", "value": tuple(_each_link(attribute[member])), **rest}


def _each_link(attribute: Any) -> Iterable[Any]:
    for item in attribute if isinstance(attribute, list | tuple) else (attribute,):
        objects = item.get("object") if isinstance(item, Mapping) else None
        if isinstance(objects, list | tuple):
            yield from ({**item, "object": target} for target in objects)
        else:
            yield item


def plain(value: Any) -> Any:
    """Return a value as JSON: lists for tuples, texts for enumerations, typed values for times."""
    if isinstance(value, Attribute | Links):
        return value.to_normalized()
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, datetime):
        return {"@type": "DateTime", "@value": as_written(value)}
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


_MEMBERS_OF: dict[type[Attribute], tuple[tuple[str, str], ...]] = {}
_KNOWN_TO: dict[type[Attribute], frozenset[str]] = {}


def _written_members(kind: type[Attribute]) -> tuple[tuple[str, str], ...]:
    """Return name and alias of every member except the value; cached for each class."""
    if kind not in _MEMBERS_OF:
        _MEMBERS_OF[kind] = tuple(
            (name, field.alias or name)
            for name, field in kind.model_fields.items()
            if name not in {kind.member, "alternatives"}
        )
    return _MEMBERS_OF[kind]


def _known_members(kind: type[Attribute]) -> frozenset[str]:
    if kind not in _KNOWN_TO:
        names = {kind.member, "alternatives", "@alternatives"}
        _KNOWN_TO[kind] = frozenset(names.union(*_written_members(kind)))
    return _KNOWN_TO[kind]
