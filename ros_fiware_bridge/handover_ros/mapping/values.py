"""The sources, conversions and kinds of values in a mapping."""

import re
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from handover_ros.mapping.part import Part, PathText, Plain, TemplateText, short_form

Kind = Literal["Property", "GeoProperty", "LanguageProperty", "Relationship", "JsonProperty"]

_CONVERSION = re.compile(r"\s*(?P<given>[^>]+?)\s*->\s*(?P<wanted>[^>]+?)\s*")
_NOT_IN_NAMES = re.compile(r"[\s<>\"'=;()]")
OBSERVED_AT = "observedAt"
"""The name by which templates refer to times of observation: `{observedAt.status}`."""
OF_EVERY_ENTITY = frozenset({"id", "entityId", "type"})
"""The names by which templates refer to the last part of an entity's id, the id, and the type."""
RESOURCE = "resource"
"""The name by which a request to the graph refers to the Task's resource: `resource.jointNames`."""
MADE_OF = ("field", "text", "constant", "list", "point", "languages", "object")
"""The possible sources of an attribute."""
_ENTITY_MEMBERS = {"id", "type", "scope", "@context", "createdAt", "modifiedAt"}


def _attribute_name(name: str) -> str:
    if not name or _NOT_IN_NAMES.search(name) or name in _ENTITY_MEMBERS or len(name) > 256:
        raise ValueError(
            f'"{name}" cannot be the name of an attribute; a name has no blanks and none of <>"\'=;() and is '
            f"not one of {', '.join(sorted(_ENTITY_MEMBERS))}"
        )
    return name


AttributeName = Annotated[str, AfterValidator(_attribute_name)]


class DeadBand(Part):
    """The minimum change of a number since it was last sent: `absolute`, or `relative` to its value."""

    absolute: float | None = Field(None, gt=0)
    relative: float | None = Field(None, gt=0, lt=1)

    @model_validator(mode="after")
    def _one_of_them(self) -> Self:
        if self.absolute is None and self.relative is None:
            raise ValueError(
                "a dead band is `absolute` (in the unit of the attribute) or `relative` (0.05: 5 %)"
            )
        return self


class Conversion(Part):
    """The conversion of a value, in this order: convert, map, round."""

    convert: str | None = None
    """Two units of pint: `rad -> deg`; or `yaw -> quaternion`, `quaternion -> yaw`."""
    values: dict[Plain, Any] | None = None
    """The result for each value: `{0: idle, 1: busy}`."""
    otherwise: Any = None
    """The result for values that `values` does not contain; by default such a value is an error."""
    round: int | None = Field(None, ge=0, le=12)

    @property
    def units(self) -> tuple[str, str] | None:
        """Return the unit of the source and the unit of the result."""
        match = _CONVERSION.fullmatch(self.convert) if self.convert is not None else None
        return (match["given"], match["wanted"]) if match else None

    @model_validator(mode="after")
    def _says_what_it_does(self) -> Self:
        if self.convert is not None and self.units is None:
            raise ValueError(f'"{self.convert}" is not a conversion; write it like "rad -> deg"')
        if "otherwise" in self.model_fields_set and self.values is None:
            raise ValueError("`otherwise` needs `values`")
        if self.values is not None and (self.convert or self.round is not None):
            raise ValueError("a value is either mapped by `values` or computed by `convert` and `round`")
        return self


class Origin(Part):
    """The geographic position of a frame, and the angle of its x axis from east to north."""

    longitude: float = Field(ge=-180, le=180)
    latitude: float = Field(ge=-89, le=89)
    turned_deg: float = 0.0


class Attribute(Conversion):
    """An attribute of an entity and its source in a message."""

    field: PathText | None = None
    text: TemplateText | None = None
    constant: Any = None
    point: tuple[PathText, ...] | None = Field(None, min_length=2, max_length=3)
    list: tuple[PathText, ...] | None = Field(None, min_length=1)
    """Several fields, as a list: x, y and z of a position."""
    languages: dict[str, PathText] | None = Field(None, min_length=1)
    object: TemplateText | None = None
    """The entity of a Relationship, written like `entity`: `Device:{child_frame_id}`."""

    kind: Kind | None = None
    unit_code: str | None = Field(None, min_length=1, max_length=20)
    """A code of UN/CEFACT Recommendation 20, such as CEL."""
    nan: Plain | None = None
    """The replacement for NaN and infinity; by default such a value leaves out the attribute."""
    dead_band: Annotated[DeadBand, short_form("absolute")] | None = None
    origin: Origin | None = None
    sub_attributes: "dict[AttributeName, AttributeGiven]" = Field(default_factory=dict)
    """Attributes of the attribute, such as its quality. Only of attributes that a topic writes."""

    @property
    def known_kind(self) -> Kind:
        """Return the kind; by default the source determines it."""
        if self.kind is not None:
            return self.kind
        if self.point is not None or self.origin is not None:
            return "GeoProperty"
        if self.languages is not None:
            return "LanguageProperty"
        return "Relationship" if self.object is not None else "Property"

    @model_validator(mode="after")
    def _made_of_one_thing(self) -> Self:
        sources = [name for name in MADE_OF if name in self.model_fields_set]
        if len(sources) != 1:
            raise ValueError(
                f"an attribute has one of the sources {', '.join(MADE_OF)}; "
                f"this one has {' and '.join(sources) or 'none'}"
            )
        self._fits_its_kind(sources[0])
        if any(attribute.sub_attributes for attribute in self.sub_attributes.values()):
            raise ValueError("a sub-attribute has no sub-attributes; write them beside it")
        return self

    def _fits_its_kind(self, made_of: str) -> None:
        allowed = {
            "Property": {"field", "text", "constant", "list"},
            "JsonProperty": {"field", "constant", "list"},
            "GeoProperty": {"field", "point", "constant"},
            "LanguageProperty": {"languages", "constant"},
            "Relationship": {"object"},
        }[self.known_kind]
        if made_of not in allowed:
            raise ValueError(
                f"a {self.known_kind} is made of {' or '.join(sorted(allowed))}, not of {made_of}"
            )
        if self.unit_code and self.known_kind != "Property":
            raise ValueError(f"a {self.known_kind} has no unit_code; remove it")


class Source(Conversion):
    """The source of a field of a sent message: an attribute, a parameter, a constant or the clock."""

    attribute: PathText | None = None
    """The attribute and the path inside its value: `speed`, `value.joints[0]`."""
    name: str | None = None
    """The attribute, if its name is not a word, for example a URI."""
    text: TemplateText | None = None
    constant: Any = None
    observed_at: str | None = None
    """The attribute whose observedAt becomes the value of a time field."""
    now: Literal[True] | None = None
    json_fields: dict[str, PathText] | None = Field(None, min_length=1)
    """An object that is written as JSON text, each member from an attribute: `{taskName: description}`."""
    json_of: str | None = None
    """The attribute whose value is written as JSON text; `.` is the whole entity as key-values."""
    default: Any = None
    """The value if the attribute is missing; by default the default of the definition."""
    required: bool = False
    """Whether a missing attribute suppresses the message."""

    @model_validator(mode="after")
    def _from_one_place(self) -> Self:
        places = ("attribute", "name", "text", "constant", "observed_at", "now", "json_of", "json_fields")
        sources = [name for name in places if name in self.model_fields_set]
        if len(sources) != 1:
            has = " and ".join(sources) or "none"
            raise ValueError(f"a field has one of the sources {', '.join(places)}; it has {has}")
        return self

    def attributes(self) -> set[str]:
        """Return the names of the attributes that the source reads."""
        used = {name for name in (self.name, self.observed_at, self.json_of) if name and name != "."}
        if self.attribute is not None and self.attribute.root:
            used.add(self.attribute.root)
        paths = [*(self.text.paths if self.text else ()), *(self.json_fields or {}).values()]
        for path in paths:
            if path.root == OBSERVED_AT and len(path.steps) > 1:
                used.add(str(path.steps[1]).removeprefix("."))
            elif path.root:
                used.add(path.root)
        return used - OF_EVERY_ENTITY


class Condition(Part):
    """A condition on a value: `is`, `any_of`, `none_of`, `above`, `below`."""

    field: PathText
    equals: Plain | None = Field(None, alias="is")
    any_of: tuple[Plain, ...] | None = None
    none_of: tuple[Plain, ...] | None = None
    above: float | None = None
    below: float | None = None

    @model_validator(mode="after")
    def _asks_something(self) -> Self:
        if self.model_fields_set <= {"field"}:
            raise ValueError("a condition needs `is`, `any_of`, `none_of`, `above` or `below`")
        return self


AttributeGiven = Annotated[Attribute, short_form("field")]
Attribute.model_rebuild()
SourceGiven = Annotated[Source, short_form("attribute")]
