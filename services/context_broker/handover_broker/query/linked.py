"""Linked entities: entities in a response together with those of their relationships (clause 4.5.23).

Inline, a linked entity is inside the relationship; flat, it is appended to the list. Only entities of this
broker are linked; an entity is not repeated on its own path.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from handover_broker.model.entity import Entity, Instance, Terms
from handover_broker.model.problems import bad_request_data, too_many_results
from handover_broker.model.representation.projection import Projection
from handover_broker.model.representation.rendering import Form, View, render
from handover_broker.model.validation import require_uri, shown
from handover_broker.query.parameters import Use, names_for
from handover_broker.query.q_match import Lookup

PARAMETERS: Final = names_for(Use.LINKS)
DEEPEST: Final = 10
"""Maximum depth of links."""
MAX_LINKED: Final = 10_000
"""Maximum linked entities in one response; cyclic links would otherwise give endless combinations."""

Shown = tuple[Entity, dict[str, Any]]
"""An entity, and its representation."""

_KINDS: Final = {"Relationship": "entity", "ListRelationship": "entityList"}


@dataclass(frozen=True, slots=True)
class Join:
    """How linked entities are requested: `level` links deep; the client has those `contained` already."""

    is_flat: bool
    level: int
    contained: frozenset[str] = frozenset()


def join_of(parameters: Mapping[str, Any]) -> Join | None:
    """Return the request for linked entities in `join`, `joinLevel` and `containedBy`; None without them.

    `parameters` are query parameters, or a Query or the notification of a subscription, in which the last two
    are a number and a list. Raises a problem (400) that names the parameter and the rule.
    """
    wanted, level, contained = (
        parameters.get("join"),
        parameters.get("joinLevel"),
        parameters.get("containedBy"),
    )
    if wanted is not None and wanted not in ("flat", "inline", "@none"):
        raise bad_request_data(f"join is flat, inline or @none, not {shown(wanted)}")
    if wanted in (None, "@none"):
        for name, value in (("joinLevel", level), ("containedBy", contained)):
            if value is not None and wanted is None:
                raise bad_request_data(
                    f"{name} goes with join; add join=inline or join=flat, or leave it out"
                )
        return None
    if isinstance(contained, str):
        contained = contained.split(",")
    if contained is not None and not (isinstance(contained, list) and contained):
        raise bad_request_data(f"containedBy is a list of entity ids, not {shown(contained)}")
    ids = frozenset(require_uri(entity_id, "an id in containedBy") for entity_id in contained or ())
    return Join(wanted == "flat", _level(level), ids)


def check_depth(join: Join | None, projection: Projection | None, hops: int) -> None:
    """Raise a problem (400) if q or the projection uses more links than `level`; `hops` are those of q."""
    level = 0 if join is None else join.level
    for name, depth in (("pick or omit", _depth(projection)), ("q", hops)):
        if depth > level:
            raise bad_request_data(
                f"{name} refers to entities {depth} links away, and {level or 'none'} are followed; add "
                f"join=inline or join=flat with joinLevel={depth}"
            )


def joined(entities: Iterable[Entity], terms: Terms, view: View, join: Join, lookup: Lookup) -> list[Shown]:
    """Return entities as JSON objects together with their linked entities; `lookup` finds these by id.

    Each object comes with its entity: the requested ones, and flat also the linked ones. Raises a problem
    (403) when there are too many.
    """
    walk = _Walk(terms, lookup, join.contained)
    if join.is_flat:
        return walk.flat(list(entities), view, join.level)
    return [
        (entity, walk.inline(entity, view, join.level, join.contained | {entity.id})) for entity in entities
    ]


class _Walk:
    """Follows relationships, and counts the entities."""

    def __init__(self, terms: Terms, lookup: Lookup, contained: frozenset[str]) -> None:
        self._terms = terms
        self._lookup = lookup
        self._contained = contained
        self._met = 0

    def inline(self, entity: Entity, view: View, level: int, way: frozenset[str]) -> dict[str, Any]:
        """Return an entity with linked entities inside; `way` are the entities on its path."""
        result = render(entity, self._terms, view)
        if not level:
            return result
        for name, instances in _relationships(entity, view):
            below = _below(view, name)
            linked = [
                {
                    target: self.inline(linked_entity, below, level - 1, way | {target})
                    for target in _targets(instance)
                    if target not in way and (linked_entity := self._found(target)) is not None
                }
                for instance in instances
            ]
            if any(linked):
                short = self._terms.compact(name)
                result[short] = _with_linked(result[short], instances, linked, view.form)
        return result

    def flat(self, entities: list[Entity], view: View, level: int) -> list[Shown]:
        """Return entities, then their linked entities, level by level, each once."""
        result = [(hit, render(hit, self._terms, view)) for hit in entities]
        seen = {hit.id for hit in entities} | self._contained
        now = [(hit, view) for hit in entities]
        for _ in range(level):
            following: list[tuple[Entity, View]] = []
            for entity, seen_by in now:
                for name, instances in _relationships(entity, seen_by):
                    for target in (target_id for instance in instances for target_id in _targets(instance)):
                        if target not in seen and (linked_entity := self._found(target)) is not None:
                            seen.add(target)
                            following.append((linked_entity, _below(seen_by, name)))
            result += [(linked, render(linked, self._terms, below)) for linked, below in following]
            now = following
        return result

    def _found(self, target: str) -> Entity | None:
        linked_entity = self._lookup(target)
        if linked_entity is not None:
            self._met += 1
            if self._met > MAX_LINKED:
                raise too_many_results(
                    f"the entities asked for link to more than {MAX_LINKED} others; ask for fewer with "
                    "limit, or follow fewer links with joinLevel"
                )
        return linked_entity


def _relationships(entity: Entity, view: View) -> Iterator[tuple[str, list[Instance]]]:
    """Yield the relationships of an entity that are in its representation, with the instances."""
    for name, instances in entity.attributes.items():
        if view.attributes is not None and name not in view.attributes:
            continue
        if view.projection is not None and not view.projection.wants(name):
            continue
        filtered = instances
        if view.datasets is not None:
            filtered = [instance for instance in instances if instance.get("datasetId") in view.datasets]
        if any(instance["type"] in _KINDS for instance in filtered):
            yield name, filtered


def _targets(instance: Instance) -> Iterator[str]:
    """Yield the ids in a relationship."""
    if instance["type"] == "Relationship":
        value = instance["object"]
        yield from value if isinstance(value, list) else (value,)
    elif instance["type"] == "ListRelationship" and isinstance(instance["objectList"], list):
        for target in instance["objectList"]:
            value = target["object"]
            yield from value if isinstance(value, list) else (value,)


def _below(view: View, relationship: str) -> View:
    """Return the view of a linked entity: all members, unless braces select some."""
    projection = None if view.projection is None else view.projection.below(relationship)
    return replace(view, attributes=None, projection=projection)


def _with_linked(written: Any, instances: list[Instance], linked: list[dict[str, Any]], form: Form) -> Any:
    """Return a rendered relationship with the linked entities, by their ids, in each instance."""
    if form is Form.KEY_VALUES:
        if len(instances) == 1:
            return _replaced(written, linked[0])
        for instance, linked_entity in zip(instances, linked, strict=True):
            key = instance.get("datasetId", "@none")
            written["dataset"][key] = _replaced(written["dataset"][key], linked_entity)
        return written
    parts = written if len(instances) > 1 else [written]
    for part, instance, linked_entity in zip(parts, instances, linked, strict=True):
        if linked_entity:
            is_one = instance["type"] == "Relationship" and isinstance(instance["object"], str)
            entities = list(linked_entity.values())
            part[_KINDS[instance["type"]]] = entities[0] if is_one else entities
    return written


def _replaced(value: Any, linked: dict[str, Any]) -> Any:
    if isinstance(value, list):
        return [_replaced(part, linked) for part in value]
    return linked.get(value, value) if isinstance(value, str) else value


def _level(level: Any) -> int:
    if level is None:
        return 1
    if isinstance(level, str) and level.isascii() and level.isdigit() and len(level) <= 3:
        level = int(level)
    if not isinstance(level, int) or isinstance(level, bool) or not 1 <= level <= DEEPEST:
        raise bad_request_data(f"joinLevel is a whole number from 1 to {DEEPEST}, not {shown(level)}")
    return level


def _depth(projection: Projection | None) -> int:
    if projection is None or not projection.linked:
        return 0
    return 1 + max(_depth(below) for _, below in projection.linked)
