"""The order of entities: by values, texts, times or distances (clause 4.23 of ETSI GS CIM 009).

The sort key of an entity can be written as JSON, so that a page can continue after the last one even if its
last entity was deleted.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import total_ordering
from types import NoneType
from typing import Any, Final

import orjson

from handover_broker.model.entity import Entity
from handover_broker.model.geometry import fault_of
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import moment, shown
from handover_broker.query.collation import Key, collation
from handover_broker.query.geo_query import Geometry, distance_to_m, reference_geometry
from handover_broker.query.parameters import Use, names_for
from handover_broker.query.q_grammar import Path, path_of
from handover_broker.query.q_match import Expand, LanguageMap, finder, no_lookup

PARAMETERS: Final = names_for(Use.ORDER)
MAX_KEYS: Final = 10
"""Maximum sort keys."""

MAX_KEY_LENGTH: Final = 256
"""Characters of a text that are compared; entities whose texts begin alike keep the order of creation. The
sort key has to fit into the URL of the next page."""

_DIRECTIONS: Final = ("asc", "desc", "dist-asc", "dist-desc")
_TIME_OF_DAY: Final = re.compile(r"\d{2}:\d{2}:\d{2}(?:[.,]\d+)?Z?")
_TIMES: Final = frozenset({"createdAt", "modifiedAt", "observedAt", "expiresAt", "deletedAt"})

# Clause 4.23.2: what comes before what, when values are of different kinds.
_PLACE, _NUMBER, _TEXT, _OBJECT, _LIST, _TRUTH, _TIME, _DATE, _DATE_TIME, _NULL, _ABSENT = range(11)
_HELD: Final[dict[Any, Any]] = {
    _PLACE: int | float, _NUMBER: int | float, _TEXT: str, _OBJECT: str, _LIST: str, _TRUTH: bool, _TIME: str,
    _DATE: int | float, _DATE_TIME: int | float, _NULL: NoneType, _ABSENT: NoneType,
}  # fmt: skip
_COUNTED: Final = frozenset({_PLACE, _NUMBER, _TRUTH, _DATE, _DATE_TIME})
"""Kinds of values that are sorted in reverse by negation."""
_TYPED: Final = {"Time": _TIME, "Date": _DATE, "DateTime": _DATE_TIME}

KeyValue = list[Any]
"""A sort key value: the kind of the value, and the value."""


@total_ordering
@dataclass(frozen=True, slots=True, eq=False)
class _Downwards:
    """A value that sorts in reverse."""

    value: Any

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Downwards) and bool(self.value == other.value)

    def __lt__(self, other: "_Downwards") -> bool:
        return bool(other.value < self.value)

    def __hash__(self) -> int:
        return hash(self.value)


@dataclass(frozen=True, slots=True, eq=False)
class _OrderKey:
    read: Callable[[Entity], KeyValue]
    is_descending: bool


@dataclass(frozen=True, slots=True, eq=False)
class Ordering:
    """An order of entities. `text` is the request; orders of the same text are equal."""

    text: str
    keys: tuple[_OrderKey, ...]
    collated: Key

    def sort_key(self, entity: Entity) -> list[KeyValue]:
        """Return the sort key of the entity as JSON values."""
        return [_truncated(key.read(entity)) for key in self.keys]

    def place(self, sort_key: Sequence[Any], seq: int) -> tuple[Any, ...]:
        """Return what entities are compared by; `seq` decides between equal ones.

        Raises LookupError, TypeError or ValueError for an invalid key.
        """
        places: list[Any] = []
        for key, (kind, value) in zip(self.keys, sort_key, strict=True):
            if not isinstance(value, _HELD[kind]):
                raise TypeError
            places.append(self._ranked(kind, value, key.is_descending))
        return (*places, seq)

    def place_of(self, entity: Entity) -> tuple[Any, ...]:
        """Return the position of the entity in the order."""
        if len(self.keys) == 1:
            key = self.keys[0]
            kind, value = _truncated(key.read(entity))
            return self._ranked(kind, value, key.is_descending), entity.seq
        return self.place(self.sort_key(entity), entity.seq)

    def _ranked(self, kind: int, value: Any, is_descending: bool) -> tuple[int, Any]:
        if kind == _TEXT:
            value = (self.collated(value), value)
        if not is_descending:
            return kind, value
        if value is None:  # missing values come last in both directions (clause 4.23.2)
            return kind, None
        return -kind, -value if kind in _COUNTED else _Downwards(value)


def ordering(parameters: Mapping[str, str], expand: Expand) -> Ordering | None:
    """Return the order in query parameters; None for the order of creation.

    Raises a problem (400) that names the parameter and the way out.
    """
    wanted = parameters.get("orderBy")
    if wanted is None:
        for name in PARAMETERS - {"orderBy"}:
            if name in parameters:
                raise bad_request_data(f"{name} needs orderBy; add it, or leave {name} out")
        return None
    coordinates, kind = parameters.get("orderFrom"), parameters.get("orderGeometry")
    names = ("orderGeometry", "orderFrom")
    origin = None if coordinates is None else reference_geometry(kind or "Point", coordinates, names)
    if coordinates is None and kind is not None:
        raise bad_request_data("orderGeometry goes with orderFrom, its coordinates; add them")
    text = "&".join(f"{name}={parameters[name]}" for name in sorted(PARAMETERS) if name in parameters)
    return made(wanted.split(","), origin, parameters.get("collation"), expand, text)


def ordering_document(document: Any, expand: Expand) -> Ordering:
    """Return the order of the data type OrderingParams (clause 5.2.43); raise a problem (400) if it is
    invalid."""
    if not isinstance(document, dict):
        raise bad_request_data('"ordering" is an object such as {"orderBy": ["name", "age;desc"]}')
    members = {"orderBy", "coordinates", "geometry", "collation"}
    if unknown := sorted(set(document) - members):
        raise bad_request_data(f"ordering has {', '.join(sorted(members))}, not {shown(unknown[0])}")
    terms, tag = document.get("orderBy"), document.get("collation")
    if not isinstance(terms, list) or not terms or not all(isinstance(term, str) for term in terms):
        raise bad_request_data(f'ordering.orderBy is a list such as ["name", "age;desc"], not {shown(terms)}')
    if tag is not None and not isinstance(tag, str):
        raise bad_request_data(f"ordering.collation is text such as de-u-co-phonebk, not {shown(tag)}")
    kind, origin = document.get("geometry", "Point"), None
    if not isinstance(kind, str):
        raise bad_request_data(f"ordering.geometry is text such as Point, not {shown(kind)}")
    if "coordinates" in document:
        if not isinstance(document["coordinates"], list):
            raise bad_request_data(f"ordering.coordinates is a list, not {shown(document['coordinates'])}")
        names = ("ordering.geometry", "ordering.coordinates")
        origin = reference_geometry(kind, document["coordinates"], names)
    return made(terms, origin, tag, expand, orjson.dumps(document, option=orjson.OPT_SORT_KEYS).decode())


def made(
    terms: Sequence[str], origin: Geometry | None, tag: str | None, expand: Expand, text: str
) -> Ordering:
    """Return the order by `terms` such as `age;desc`; distances are measured from `origin`."""
    if len(terms) > MAX_KEYS:
        raise bad_request_data(f"orderBy has {len(terms)} members; {MAX_KEYS} are allowed")
    return Ordering(text, tuple(_order_key(term, origin, expand) for term in terms), collation(tag))


def _order_key(term: str, origin: Geometry | None, expand: Expand) -> _OrderKey:
    member, _, direction = term.partition(";")
    direction = direction or "asc"
    if direction not in _DIRECTIONS:
        raise bad_request_data(f"orderBy={shown(term)}: the direction is one of {', '.join(_DIRECTIONS)}")
    path = path_of(member, "orderBy")
    read = _reader(path, expand)
    if direction.startswith("dist"):
        if origin is None:
            raise bad_request_data(
                f"orderBy={shown(term)} needs a place to measure from; add orderFrom=[8,40]"
            )
        read = _distance_reader(path, origin, read, expand)
    return _OrderKey(read, direction.endswith("desc"))


def _reader(path: Path, expand: Expand) -> Callable[[Entity], KeyValue]:
    name = path.names[0] if len(path.names) == 1 and not path.trail else ""
    if name == "id":
        return lambda entity: [_TEXT, entity.id]
    if name == "type":
        return lambda entity: [_TEXT, " ".join(sorted(entity.types))]
    if name == "scope":
        return lambda entity: [_TEXT, " ".join(entity.scopes)] if entity.scopes else [_ABSENT, None]
    find = finder(path, expand)
    is_time = path.names[-1] in _TIMES and not path.trail

    def read(entity: Entity) -> KeyValue:
        # Of several instances the first one, which is the default one if there is one.
        for value in find(entity, no_lookup):
            return _key_value(value, is_time=is_time)
        return [_ABSENT, None]

    return read


def _distance_reader(
    path: Path, origin: Geometry, read: Callable[[Entity], KeyValue], expand: Expand
) -> Callable[[Entity], KeyValue]:
    find = finder(path, expand)

    def sort_key(entity: Entity) -> KeyValue:
        distances = [
            distance_to_m(origin, value)
            for value in find(entity, no_lookup)
            if isinstance(value, dict) and fault_of(value) is None
        ]
        return [_PLACE, min(distances)] if distances else read(entity)

    return sort_key


def _key_value(value: Any, *, is_time: bool) -> KeyValue:
    if isinstance(value, bool):
        return [_TRUTH, value]
    if isinstance(value, int | float):
        return [_NUMBER, value]
    if isinstance(value, str):
        seconds = moment(value) if is_time else None
        return [_TEXT, value] if seconds is None else [_DATE_TIME, seconds]
    if isinstance(value, LanguageMap):
        return _key_value(value.get("@none", next(iter(value.values()), None)), is_time=False)
    return _object_value(value) if isinstance(value, dict) else _list_value(value)


def _list_value(value: Any) -> KeyValue:
    if not isinstance(value, list):
        return [_NULL, None]
    # A relationship to one entity is sorted as a list of one.
    return _key_value(value[0], is_time=False) if len(value) == 1 else [_LIST, _written(value)]


def _object_value(value: dict[str, Any]) -> KeyValue:
    typed, literal = _TYPED.get(str(value.get("@type"))), value.get("@value")
    if typed is None or not isinstance(literal, str):
        return [_OBJECT, _written(value)]
    if typed == _TIME and _TIME_OF_DAY.fullmatch(literal):
        return [_TIME, literal.rstrip("Z").replace(",", ".")]
    seconds = moment(literal)
    return [_TEXT, literal] if seconds is None else [typed, seconds]


def _truncated(sort_key: KeyValue) -> KeyValue:
    kind, value = sort_key
    return (
        [kind, value[:MAX_KEY_LENGTH]] if isinstance(value, str) and len(value) > MAX_KEY_LENGTH else sort_key
    )


def _written(value: Any) -> str:
    return orjson.dumps(value, option=orjson.OPT_SORT_KEYS).decode()
