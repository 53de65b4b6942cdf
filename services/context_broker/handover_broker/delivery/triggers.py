"""Triggers: what a change of an entity is, and which subscriptions it concerns (clauses 5.2.12 and 5.8.6).

A change creates, updates or deletes attributes, and may create or delete the whole entity. Creating an entity
creates its attributes, deleting it deletes them. Scopes count as an attribute, since clause 4.18 calls them a
Property. Types do not: an added type is notified with the next change. Writing an attribute with its present
value is an update too; the standard asks for a different value, but clients of other brokers rely on a
notification for every write.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

from handover_broker.model.entity import Entity, Event, Instance, dataset_of
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import shown

ENTITY_CREATED: Final = "entityCreated"
ENTITY_UPDATED: Final = "entityUpdated"
ENTITY_DELETED: Final = "entityDeleted"
ATTRIBUTE_CREATED: Final = "attributeCreated"
ATTRIBUTE_UPDATED: Final = "attributeUpdated"
ATTRIBUTE_DELETED: Final = "attributeDeleted"

ALL: Final = (
    ENTITY_CREATED,
    ENTITY_UPDATED,
    ENTITY_DELETED,
    ATTRIBUTE_CREATED,
    ATTRIBUTE_UPDATED,
    ATTRIBUTE_DELETED,
)
DEFAULT: Final = frozenset({ATTRIBUTE_CREATED, ATTRIBUTE_UPDATED})
_OF_UPDATED: Final = frozenset({ATTRIBUTE_CREATED, ATTRIBUTE_UPDATED, ATTRIBUTE_DELETED})

SCOPE: Final = "https://uri.etsi.org/ngsi-ld/scope"
"""The scopes of an entity, as an attribute that can be watched."""

Names = frozenset[str]
_NONE: Final[Names] = frozenset()


@dataclass(frozen=True, slots=True)
class EntityChange:
    """The effect of a change on the attributes (IRIs) of an entity, with the entity before and after.

    `lost` are attributes with fewer instances than before; those of `deleted` have none left.
    """

    before: Entity | None
    after: Entity | None
    created: Names = _NONE
    updated: Names = _NONE
    lost: Names = _NONE

    @property
    def entity(self) -> Entity:
        """The entity after the change, or before it if it was deleted."""
        entity = self.after or self.before
        assert entity is not None  # noqa: S101 - a change has at least one end
        return entity


def entity_change(event: Event) -> EntityChange:
    """Return the effect of a change."""
    before, after = event.before, event.after
    if before is None:
        return EntityChange(before, after, created=_all_of(after) if after else _NONE)
    if after is None:
        return EntityChange(before, after, lost=_all_of(before))
    created: set[str] = set()
    updated: set[str] = set()
    lost = set(before.attributes.keys() - after.attributes.keys())
    for name in event.written:
        new, old = after.attributes.get(name), before.attributes.get(name)
        if new is None:
            continue
        if old is None:
            created.add(name)
        elif new is old or len(old) == len(new) == 1:
            updated.add(name)
        else:
            has_lost = bool(lost_instances(old, new))
            if has_lost:
                lost.add(name)
            if not has_lost or not {id(instance) for instance in new} <= {id(instance) for instance in old}:
                updated.add(name)
    if before.scopes != after.scopes:
        (created if not before.scopes else updated if after.scopes else lost).add(SCOPE)
    return EntityChange(before, after, frozenset(created), frozenset(updated), frozenset(lost))


def _all_of(entity: Entity) -> Names:
    return frozenset((*entity.attributes, SCOPE) if entity.scopes else entity.attributes)


def lost_instances(old: Iterable[Instance], new: Iterable[Instance]) -> list[Instance]:
    """Return the instances that an attribute does not have any more."""
    remaining = {dataset_of(instance) for instance in new}
    return [instance for instance in old if dataset_of(instance) not in remaining]


@dataclass(frozen=True, slots=True)
class Triggers:
    """The kinds of changes that a subscription notifies.

    `watched` limits them to attributes (IRIs), None watches all. A change of the whole entity matches watched
    attributes if the entity has one of them.
    """

    kinds: frozenset[str] = DEFAULT
    watched: Names | None = None

    def match(self, change: EntityChange) -> bool:
        """Return whether a change is one of them."""
        kinds, watched = self.kinds, self.watched
        if kinds is DEFAULT:  # as nearly all are
            if watched is None:
                return bool(change.created or change.updated)
            return not (watched.isdisjoint(change.created) and watched.isdisjoint(change.updated))
        touched: Names = _NONE
        if ATTRIBUTE_CREATED in kinds:
            touched |= change.created
        if ATTRIBUTE_UPDATED in kinds:
            touched |= change.updated
        if ATTRIBUTE_DELETED in kinds:
            touched |= change.lost
        if bool(touched) if watched is None else not watched.isdisjoint(touched):
            return True
        concerns_whole = (change.before is None and ENTITY_CREATED in kinds) or (
            change.after is None and ENTITY_DELETED in kinds
        )
        return concerns_whole and (watched is None or not watched.isdisjoint(change.entity.attributes))

    @property
    def reports_deletions(self) -> bool:
        """Return whether deleted attributes are notified."""
        return ATTRIBUTE_DELETED in self.kinds


def read_kinds(triggers: Any) -> frozenset[str]:
    """Return the kinds of changes in `notificationTrigger`; `entityUpdated` becomes its parts.

    Raises a problem (400) for an unknown one.
    """
    if triggers is None:
        return DEFAULT
    if not isinstance(triggers, list) or not triggers:
        raise bad_request_data(
            f"notificationTrigger is a list with at least one of {', '.join(ALL)}, not {shown(triggers)}"
        )
    for kind in triggers:
        if kind not in ALL:
            raise bad_request_data(f"notificationTrigger has {', '.join(ALL)}, not {shown(kind)}")
    kinds = frozenset(triggers)
    if ENTITY_UPDATED in kinds:
        kinds = kinds - {ENTITY_UPDATED} | _OF_UPDATED
    return DEFAULT if kinds == DEFAULT else kinds
