"""Values on their way: where one comes from, what is done to it, and as what it arrives."""

import re
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from ros_fiware_bridge.mapping.part import Part, PathText, Plain, TemplateText, short_form

Kind = Literal["Property", "GeoProperty", "LanguageProperty", "Relationship", "JsonProperty"]

_CONVERSION = re.compile(r"\s*(?P<given>[^>]+?)\s*->\s*(?P<wanted>[^>]+?)\s*")
_NOT_IN_NAMES = re.compile(r"[\s<>\"'=;()]")
OBSERVED_AT = "observedAt"
"""By this name texts find when an attribute was observed: `{observedAt.status}`."""
OF_EVERY_ENTITY = frozenset({"id", "entityId", "type"})
"""By these names texts find the last part of an entity's id, the id, and the type."""
MADE_OF = ("field", "text", "constant", "list", "point", "languages", "object")
"""What an attribute may be made of."""
_ENTITY_MEMBERS = {"id", "type", "scope", "@context", "createdAt", "modifiedAt"}


def _attribute_name(name: str) -> str:
    if not name or _NOT_IN_NAMES.search(name) or name in _ENTITY_MEMBERS or len(name) > 256:
        raise ValueError(
            f'"{name}" cannot be the name of an attribute; a name has no blanks and none of <>"\'=;() and is '
            f"none of {', '.join(sorted(_ENTITY_MEMBERS))}"
        )
    return name


AttributeName = Annotated[str, AfterValidator(_attribute_name)]


class DeadBand(Part):
    """How far a number must move from what was last sent: by `absolute`, or by `relative` times it."""

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
    """What is done to a value on its way, in this order: convert, map, round."""

    convert: str | None = None
    """Two units as pint knows them: `rad -> deg`."""
    values: dict[Plain, Any] | None = None
    """What each value becomes: `{0: idle, 1: busy}`."""
    otherwise: Any = None
    """What a value becomes that `values` does not have; without it such a value is an error."""
    round: int | None = Field(None, ge=0, le=12)

    @property
    def units(self) -> tuple[str, str] | None:
        """Return the unit that comes and the unit that goes."""
        found = _CONVERSION.fullmatch(self.convert) if self.convert is not None else None
        return (found["given"], found["wanted"]) if found else None

    @model_validator(mode="after")
    def _says_what_it_does(self) -> Self:
        if self.convert is not None and self.units is None:
            raise ValueError(f'"{self.convert}" is no conversion; it is written like "rad -> deg"')
        if "otherwise" in self.model_fields_set and self.values is None:
            raise ValueError(
                "`otherwise` is for values that `values` does not have, and there is no `values`"
            )
        if self.values is not None and (self.convert or self.round is not None):
            raise ValueError("a value is either looked up in `values` or computed with `convert` and `round`")
        return self


class Origin(Part):
    """Where the frame of a position in metres lies, and how far its x axis is turned from east to north."""

    longitude: float = Field(ge=-180, le=180)
    latitude: float = Field(ge=-89, le=89)
    turned_deg: float = 0.0


class Attribute(Conversion):
    """An attribute of an entity, made from a message."""

    field: PathText | None = None
    text: TemplateText | None = None
    constant: Any = None
    point: tuple[PathText, ...] | None = Field(None, min_length=2, max_length=3)
    list: tuple[PathText, ...] | None = Field(None, min_length=1)
    """Several fields, as a list: a position of x, y and z."""
    languages: dict[str, PathText] | None = Field(None, min_length=1)
    object: TemplateText | None = None
    """The entity that a Relationship leads to, as `entity` is written: `Device:{child_frame_id}`."""

    kind: Kind | None = None
    unit_code: str | None = Field(None, min_length=1, max_length=20)
    """A code of UN/CEFACT Recommendation 20, such as CEL."""
    nan: Plain | None = None
    """What stands for a number that is none (NaN, infinite); without it the attribute is left out then."""
    dead_band: Annotated[DeadBand, short_form("absolute")] | None = None
    origin: Origin | None = None

    @property
    def known_kind(self) -> Kind:
        """Return its kind, which follows from what it is made of unless it is said."""
        if self.kind is not None:
            return self.kind
        if self.point is not None or self.origin is not None:
            return "GeoProperty"
        if self.languages is not None:
            return "LanguageProperty"
        return "Relationship" if self.object is not None else "Property"

    @model_validator(mode="after")
    def _made_of_one_thing(self) -> Self:
        given = [name for name in MADE_OF if name in self.model_fields_set]
        if len(given) != 1:
            raise ValueError(
                f"an attribute is made of one of {', '.join(MADE_OF)}; "
                f"here is {' and '.join(given) or 'none'}"
            )
        self._fits_its_kind(given[0])
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
            raise ValueError(f"a {self.known_kind} has no unit_code; drop it")


class Source(Conversion):
    """Where a field of a message that is sent takes its value from: an attribute, a parameter, the clock."""

    attribute: PathText | None = None
    """The attribute, and the way inside its value: `speed`, `value.joints[0]`."""
    name: str | None = None
    """The attribute if its name is no word, a URI perhaps."""
    text: TemplateText | None = None
    constant: Any = None
    observed_at: str | None = None
    """The attribute whose observedAt a time field takes."""
    now: Literal[True] | None = None
    json_fields: dict[str, PathText] | None = Field(None, min_length=1)
    """An object that becomes JSON text, each of its members from an attribute: `{taskName: description}`."""
    json_of: str | None = None
    """The attribute whose value becomes JSON text; `.` for the whole entity as key-values."""
    default: Any = None
    """What is taken when there is no such attribute; without it the definition's default."""
    required: bool = False
    """Say nothing at all when it is missing."""

    @model_validator(mode="after")
    def _from_one_place(self) -> Self:
        places = ("attribute", "name", "text", "constant", "observed_at", "now", "json_of", "json_fields")
        given = [name for name in places if name in self.model_fields_set]
        if len(given) != 1:
            raise ValueError(
                f"a field is filled from one of {', '.join(places)}; here is {' and '.join(given) or 'none'}"
            )
        return self

    def attributes(self) -> set[str]:
        """Return the names of the attributes that it looks at."""
        found = {name for name in (self.name, self.observed_at, self.json_of) if name and name != "."}
        if self.attribute is not None and self.attribute.root:
            found.add(self.attribute.root)
        paths = [*(self.text.paths if self.text else ()), *(self.json_fields or {}).values()]
        for path in paths:
            if path.root == OBSERVED_AT and len(path.steps) > 1:
                found.add(str(path.steps[1]).removeprefix("."))
            elif path.root:
                found.add(path.root)
        return found - OF_EVERY_ENTITY


class Condition(Part):
    """What must hold of a value: `is`, one of `any_of`, none of `none_of`, `above`, `below`."""

    field: PathText
    equals: Plain | None = Field(None, alias="is")
    any_of: tuple[Plain, ...] | None = None
    none_of: tuple[Plain, ...] | None = None
    above: float | None = None
    below: float | None = None

    @model_validator(mode="after")
    def _asks_something(self) -> Self:
        if self.model_fields_set <= {"field"}:
            raise ValueError("a condition says `is`, `any_of`, `none_of`, `above` or `below`")
        return self


AttributeGiven = Annotated[Attribute, short_form("field")]
SourceGiven = Annotated[Source, short_form("attribute")]
