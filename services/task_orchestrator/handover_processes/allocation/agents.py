"""Agents: the Devices and Persons of the broker, with what their ResourceSpecification says of them.

An attribute of the Device or Person itself comes before that of its ResourceSpecification.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime, time
from typing import Any
from zoneinfo import ZoneInfo

from handover_datamodels.states import DeviceState

TYPES = ("Device", "Person", "ResourceSpecification", "Location")
WATCHED = (
    *("deviceState", "connection", "state", "isSpecifiedBy"),
    *("skills", "roles", "capacity", "shifts", "resourceType"),
)
UNAVAILABLE = frozenset(
    {
        *(DeviceState.PAUSED, DeviceState.OUT_OF_BATTERY, DeviceState.FOR_MAINTENANCE, DeviceState.ERROR),
        *("offline", "disconnected", "absent"),
    }
)
STATIONS = frozenset({"station", "workstation", "workplace"})
"""Resource types whose capacity is unlimited unless it is given."""
UNLIMITED = 1_000_000
EARTH_RADIUS_M = 6_371_000.0

Entity = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Skill:
    """A skill of an agent: a higher level is better, a higher speed is faster."""

    level: float = 1.0
    cost: float = 0.0
    speed: float = 1.0


@dataclass(frozen=True, slots=True)
class Shift:
    """A time of a weekday (ISO: Monday is 1) in which an agent works; it may end on the next day."""

    weekday: int
    begins: time
    ends: time
    zone: ZoneInfo

    def contains(self, moment: datetime) -> bool:
        """Return whether the agent works at `moment`."""
        local = moment.astimezone(self.zone)
        today, clock = local.isoweekday() == self.weekday, local.time()
        if self.begins < self.ends:
            return today and self.begins <= clock < self.ends
        is_next_day = local.isoweekday() == self.weekday % 7 + 1
        return (today and clock >= self.begins) or (is_next_day and clock < self.ends)


@dataclass(frozen=True, slots=True)
class Position:
    """A place: cartesian in metres, or longitude and latitude in degrees."""

    coordinates: tuple[float, ...]
    is_geographic: bool = False

    def distance_m(self, other: "Position") -> float | None:
        """Return the distance in metres; None if the two are not in the same frame."""
        if self.is_geographic is not other.is_geographic:
            return None
        if not self.is_geographic:
            return math.dist(_three(self.coordinates), _three(other.coordinates))
        (lon, lat), (lon_2, lat_2) = (
            [math.radians(x) for x in place.coordinates[:2]] for place in (self, other)
        )
        haversine = (
            math.sin((lat_2 - lat) / 2) ** 2
            + math.cos(lat) * math.cos(lat_2) * math.sin((lon_2 - lon) / 2) ** 2
        )
        return 2 * EARTH_RADIUS_M * math.asin(math.sqrt(min(1.0, haversine)))


@dataclass(frozen=True, slots=True)
class Agent:
    """Somebody or something that performs Tasks; `id` is a URN."""

    id: str
    is_person: bool = False
    skills: Mapping[str, Skill] = field(default_factory=dict)
    roles: frozenset[str] = frozenset()
    capacity: int = 1
    """How many Tasks it gets at a time when it is chosen."""
    limit: int = 1
    """How many Tasks it gets at a time when it is named; a person without a capacity claims them."""
    position: Position | None = None
    shifts: tuple[Shift, ...] = ()
    """When it works; empty: always."""
    unavailable: str | None = None
    """The state in which it accepts no Tasks."""
    performer: str | None = None
    """The component that executes its Tasks, as it has announced itself."""

    @property
    def name(self) -> str:
        """Return the last part of its URN."""
        return self.id.rpartition(":")[2]

    def works_at(self, moment: datetime) -> bool:
        """Return whether it is on shift."""
        return not self.shifts or any(shift.contains(moment) for shift in self.shifts)


@dataclass(frozen=True, slots=True)
class Agents:
    """All agents, and the positions of Locations, by URN."""

    by_id: Mapping[str, Agent] = field(default_factory=dict)
    places: Mapping[str, Position] = field(default_factory=dict)


def read_agents(entities: Iterable[Entity]) -> Agents:
    """Return the agents and places among normalized entities; what cannot be read is ignored."""
    entities = list(entities)
    specifications = {str(e.get("id")): e for e in entities if e.get("type") == "ResourceSpecification"}
    agents, places = {}, {}
    for entity in entities:
        if entity.get("type") in {"Device", "Person"}:
            agent = _agent(entity, specifications)
            agents[agent.id] = agent
        elif entity.get("type") == "Location" and (position := position_of(entity)) is not None:
            places[str(entity.get("id"))] = position
    return Agents(agents, places)


def _agent(entity: Entity, specifications: Mapping[str, Entity]) -> Agent:
    targets = _linked(entity.get("isSpecifiedBy"))
    entities = [entity, *(specifications[target] for target in targets if target in specifications)]

    def value(name: str) -> Any:
        return next(
            (attribute for source in entities if (attribute := _value(source, name)) is not None), None
        )

    states = (_value(entity, name) for name in ("deviceState", "connection", "state"))
    performer = _value(entity, "performer")
    maximum = value("capacity")
    is_given = isinstance(maximum, int) and maximum >= 0
    is_person = entity.get("type") == "Person"
    is_station = str(value("resourceType")).lower() in STATIONS
    capacity = maximum if is_given else UNLIMITED if is_station else 1
    return Agent(
        id=str(entity.get("id")),
        is_person=is_person,
        skills=dict(_skill(skill) for skill in _listed(value("skills")) if skill_name(skill)),
        roles=frozenset(str(role) for role in _listed(value("roles"))),
        capacity=capacity,
        limit=UNLIMITED if is_person and not is_given else capacity,
        position=position_of(entity),
        shifts=tuple(
            shift for shift_ in _listed(value("shifts")) if (shift := read_shift(shift_)) is not None
        ),
        unavailable=next((s for s in states if isinstance(s, str) and s in UNAVAILABLE), None),
        performer=performer if isinstance(performer, str) else None,
    )


def _linked(links: Any) -> Iterator[str]:
    """Yield the targets of a Relationship, a list of them, or a Property whose value is such a list."""
    if isinstance(links, list):
        for link in links:
            yield from _linked(link)
    elif isinstance(links, str):
        yield links
    elif isinstance(links, Mapping):
        yield from _linked(links.get("object", links.get("value")))


def _value(entity: Entity, name: str) -> Any:
    attribute = entity.get(name)
    return attribute.get("value") if isinstance(attribute, Mapping) else None


def _listed(value: Any) -> list[Any]:
    if value is None:
        return []
    return list(value) if isinstance(value, list) else [value]


def skill_name(skill: Any) -> str | None:
    """Return the name of a skill, which is a name or an object with one; None if it has none."""
    name = skill.get("name") if isinstance(skill, Mapping) else skill
    return name if isinstance(name, str) and name else None


def _skill(skill: Any) -> tuple[str, Skill]:
    name = str(skill_name(skill))
    if not isinstance(skill, Mapping):
        return name, Skill()
    numbers = {key: skill.get(key) for key in ("level", "cost", "speed")}
    return name, Skill(
        **{key: float(n) for key, n in numbers.items() if isinstance(n, int | float) and math.isfinite(n)}
    )


def read_shift(shift: Any) -> Shift | None:
    """Return a shift; None if it cannot be read."""
    if not isinstance(shift, Mapping):
        return None
    try:
        weekday = int(shift["weekday"])
        begins, ends = time.fromisoformat(shift["from"]), time.fromisoformat(shift["to"])
        zone = ZoneInfo(shift.get("zone", "UTC"))
    except (KeyError, ValueError, TypeError, OSError):
        return None
    if begins.tzinfo is not None or ends.tzinfo is not None:
        return None
    return Shift(weekday, begins, ends, zone) if 1 <= weekday <= 7 else None


def position_of(entity: Entity) -> Position | None:
    """Return the position of a Device, Person or Location; None if it has none."""
    relative = _value(entity, "relativePosition")
    if _are_numbers(relative):
        return Position(tuple(relative))
    place = _value(entity, "location")
    if isinstance(place, Mapping) and place.get("type") == "Point" and _are_numbers(place.get("coordinates")):
        return Position(tuple(place["coordinates"]), is_geographic=True)
    return None


def _are_numbers(value: Any) -> bool:
    if not isinstance(value, list) or not 2 <= len(value) <= 3:
        return False
    return all(isinstance(x, int | float) and math.isfinite(x) for x in value)


def _three(coordinates: tuple[float, ...]) -> tuple[float, ...]:
    return (*coordinates, 0.0, 0.0)[:3]
