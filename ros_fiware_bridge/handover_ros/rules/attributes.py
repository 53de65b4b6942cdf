"""Compiles the attributes of a rule into functions of a message."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from handover.errors import HandoverError
from handover_ros.mapping.paths import Getter, Path
from handover_ros.mapping.templates import Template, in_id
from handover_ros.mapping.values import Attribute, DeadBand, Origin
from handover_ros.rules import conversion
from handover_ros.rules.json_values import JsonValues, absent
from handover_ros.rules.message_schema import InvalidRule, MessageSchema
from handover_ros.types.definition import TEXTS, Many

Make = Callable[[Any], Any]

EARTH_M_PER_DEG = 111_195.0
"""Along a meridian of a sphere with a radius of 6371 km."""
_VALUE_MEMBER = {
    "Property": "value",
    "GeoProperty": "value",
    "LanguageProperty": "languageMap",
    "Relationship": "object",
    "JsonProperty": "json",
}


class InvalidPosition(HandoverError):
    """A message has no valid position on earth."""


@dataclass(frozen=True, slots=True)
class MadeAttribute:
    """A compiled attribute: `make` returns its value from a message (or message and element)."""

    name: str
    kind: str
    make: Make
    unit_code: str | None = None
    dead_band: DeadBand | None = None
    parts: "tuple[MadeAttribute, ...]" = ()
    """Its sub-attributes."""

    def written(self, value: Any, observed_at: str | None) -> dict[str, Any]:
        """Return the attribute as NGSI-LD (normalized)."""
        written = {"type": self.kind, _VALUE_MEMBER[self.kind]: value}
        if observed_at is not None:
            written["observedAt"] = observed_at
        if self.unit_code is not None:
            written["unitCode"] = self.unit_code
        return written


@dataclass(frozen=True, slots=True)
class CompileContext:
    """The context of the attributes of one rule: the message type, and values such as `factory`."""

    schema: MessageSchema
    values: JsonValues
    settings: Mapping[str, str]


def compiled(
    name: str, attribute: Attribute, context: CompileContext, dead_band: DeadBand | None = None
) -> MadeAttribute:
    """Return `attribute` compiled for messages. Raises `InvalidRule`."""
    schema, values, settings = context.schema, context.values, context.settings
    kind = attribute.known_kind
    if kind == "GeoProperty":
        make = _place(attribute, schema)
    elif kind == "LanguageProperty":
        make = _languages(attribute, schema, values)
    elif kind == "Relationship":
        make = _link(attribute, schema, settings)
    else:
        make = _value(attribute, schema, values, settings)
    convert = conversion.compiled(attribute)
    if convert is not None:
        _require_convertible(attribute, schema)
        unconverted, converted = make, convert
        make = lambda scope: converted(unconverted(scope))  # noqa: E731 - a composition
    parts = tuple(
        compiled(part, sub_attribute, context) for part, sub_attribute in attribute.sub_attributes.items()
    )
    return MadeAttribute(name, kind, make, attribute.unit_code, attribute.dead_band or dead_band, parts)


def entity_id(template: Template, schema: MessageSchema, settings: Mapping[str, str]) -> Callable[[Any], str]:
    """Return the function from a message to an entity id. Raises `InvalidRule`."""

    def safe(path: Path) -> Getter:
        find = schema.find(path)
        return lambda scope: in_id(find(scope), path)

    return template.with_settings(settings).filler(safe)


def text(template: Template, schema: MessageSchema, settings: Mapping[str, str]) -> Callable[[Any], str]:
    """Return the function that fills `template` from a message. Raises `InvalidRule`."""
    return template.with_settings(settings).filler(schema.find)


def _value(
    attribute: Attribute, schema: MessageSchema, values: JsonValues, settings: Mapping[str, str]
) -> Make:
    if attribute.field is not None:
        find = schema.find(attribute.field)
        nan = attribute.nan if "nan" in attribute.model_fields_set else absent()
        to_json = values.maker(schema.target(attribute.field), str(attribute.field), nan)
        return lambda scope: to_json(find(scope))
    if attribute.text is not None:
        return text(attribute.text, schema, settings)
    if attribute.list is not None:
        nan = attribute.nan if "nan" in attribute.model_fields_set else absent()
        makes = [
            _then(schema.find(path), values.maker(schema.target(path), str(path), nan))
            for path in attribute.list
        ]
        return lambda scope: [make(scope) for make in makes]
    constant = attribute.constant
    if constant is None:
        raise InvalidRule("`constant` is empty; an NGSI-LD attribute needs a value")
    return lambda _: constant


def _languages(attribute: Attribute, schema: MessageSchema, values: JsonValues) -> Make:
    if attribute.languages is None:
        constant = attribute.constant
        if not isinstance(constant, dict):
            raise InvalidRule("a LanguageProperty needs text by language, such as {en: open, fi: auki}")
        return lambda _: constant
    made: dict[str, Make] = {}
    for language, path in attribute.languages.items():
        if not (target := schema.target(path)).is_text:
            raise InvalidRule(f"{path} is {target}; a LanguageProperty is made of text")
        made[language] = _then(schema.find(path), values.maker(target, str(path)))
    return lambda scope: {language: make(scope) for language, make in made.items()}


def _link(attribute: Attribute, schema: MessageSchema, settings: Mapping[str, str]) -> Make:
    if attribute.object is None:
        raise InvalidRule("a Relationship needs `object`, such as Device:{header.frame_id}")
    written = str(attribute.object)
    kind, _, rest = written.partition(":")
    if kind == "urn":
        template = attribute.object
    elif rest and "{" not in kind:
        first, *others = attribute.object.parts
        template = Template((f"urn:ngsi-ld:{kind}:{settings['factory']}{str(first)[len(kind) :]}", *others))
    else:
        raise InvalidRule(f'"{written}" is not an entity; write Type:id, such as Device:{{header.frame_id}}')
    return entity_id(template, schema, settings)


def _place(attribute: Attribute, schema: MessageSchema) -> Make:
    if attribute.constant is not None:
        constant = attribute.constant
        return lambda _: constant
    if attribute.point is not None:
        for path in attribute.point:
            if not (target := schema.target(path)).is_number:
                raise InvalidRule(f"{path} is {target}; a point needs numbers")
        finds = [schema.find(path) for path in attribute.point]
        if attribute.origin is not None:
            return _from_metres(lambda scope: [find(scope) for find in finds], attribute.origin)
        return lambda scope: _point([find(scope) for find in finds])
    assert attribute.field is not None  # noqa: S101 - the mapping has made sure of it
    kind = schema.target(attribute.field).type
    find = schema.find(attribute.field)
    if kind is None:
        return find
    names = _coordinates(kind.base, schema) if kind.many is Many.ONE and kind.is_message else None
    if names is None:
        raise InvalidRule(
            f"{attribute.field} is {kind}; a GeoProperty needs a message with longitude and latitude, "
            "or with x and y in metres (and an `origin`), or of a `point` of two paths"
        )
    if names[0] == "longitude":
        return lambda scope: _point([find(scope)[name] for name in names])
    if attribute.origin is None:
        raise InvalidRule(
            f"{attribute.field} is {kind}, in metres of its frame, but a GeoProperty is in degrees; set "
            "the position of the frame (origin: {longitude: …, latitude: …}), or map it as a Property"
        )
    return _from_metres(lambda scope: [find(scope)[name] for name in names], attribute.origin)


def _coordinates(type_name: str, schema: MessageSchema) -> tuple[str, ...] | None:
    definition = schema.definition(type_name)
    for names in (("longitude", "latitude"), ("x", "y")):
        if all(definition.field(name) for name in names):
            return names
    return None


def _from_metres(place: Make, origin: Origin) -> Make:
    """Return the position on the tangent plane at `origin`; accurate within some kilometres of it."""
    turned = math.radians(origin.turned_deg)
    cosine, sine = math.cos(turned), math.sin(turned)
    per_longitude = EARTH_M_PER_DEG * math.cos(math.radians(origin.latitude))

    def make(scope: Any) -> dict[str, Any]:
        x, y = place(scope)[:2]
        east, north = x * cosine - y * sine, x * sine + y * cosine
        longitude = origin.longitude + east / per_longitude
        return _point([longitude, origin.latitude + north / EARTH_M_PER_DEG])

    return make


def _point(coordinates: list[Any]) -> dict[str, Any]:
    numbers = [float(coordinate) for coordinate in coordinates]
    if not all(map(math.isfinite, numbers)) or abs(numbers[0]) > 180 or abs(numbers[1]) > 90:
        raise InvalidPosition(f"longitude {numbers[0]} and latitude {numbers[1]} are not a position on earth")
    return {"type": "Point", "coordinates": [round(numbers[0], 9), round(numbers[1], 9), *numbers[2:]]}


def _require_convertible(attribute: Attribute, schema: MessageSchema) -> None:
    if attribute.values is not None or attribute.field is None:
        return
    kind = schema.target(attribute.field).type
    if attribute.units == conversion.QUATERNION_TO_YAW:
        if kind is not None and kind.base != conversion.QUATERNION:
            raise InvalidRule(f"{attribute.field} is {kind}; a yaw is that of a {conversion.QUATERNION}")
        return
    if kind is not None and (kind.is_message or kind.base in {*TEXTS, "bool"}):
        raise InvalidRule(f"{attribute.field} is {kind}, but only numbers are converted and rounded")


def _then(first: Make, second: Make) -> Make:
    return lambda scope: second(first(scope))
