"""Triggers: what a change of an entity is, and which subscriptions it concerns (clauses 5.2.12 and 5.8.6).

A change creates, updates or deletes attributes, and it may create or delete the entity as a whole. With the
creation of an entity its attributes are created, with its deletion they are deleted. Scopes are an attribute
here, for clause 4.18 calls them a Property; types are none, so a type that is added is told with the next
change. An attribute that is written with the value it has counts too: the standard asks for a different one,
but users of other brokers count on hearing of every write.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

from services.context_broker.model.entity import Entity, Event, Instance, dataset_of
from services.context_broker.model.problems import bad_request_data
from services.context_broker.model.validation import shown

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
    """What a change did to the attributes (IRIs) of an entity, and how the entity was and is.

    `lost` are attributes that have fewer instances than before; those of `deleted` have none at all.
    """

    before: Entity | None
    after: Entity | None
    created: Names = _NONE
    updated: Names = _NONE
    lost: Names = _NONE

    @property
    def entity(self) -> Entity:
        """The entity as it is, or as it was if it is gone."""
        one = self.after or self.before
        assert one is not None  # noqa: S101 - a change has at least one end
        return one


def entity_change(event: Event) -> EntityChange:
    """Return what a change did."""
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
            if not has_lost or not {id(one) for one in new} <= {id(one) for one in old}:
                updated.add(name)
    if before.scopes != after.scopes:
        (created if not before.scopes else updated if after.scopes else lost).add(SCOPE)
    return EntityChange(before, after, frozenset(created), frozenset(updated), frozenset(lost))


def _all_of(entity: Entity) -> Names:
    return frozenset((*entity.attributes, SCOPE) if entity.scopes else entity.attributes)


def lost_instances(old: Iterable[Instance], new: Iterable[Instance]) -> list[Instance]:
    """Return the instances that an attribute no longer has."""
    kept = {dataset_of(one) for one in new}
    return [one for one in old if dataset_of(one) not in kept]


@dataclass(frozen=True, slots=True)
class Triggers:
    """Which changes a subscriber wants to be told of.

    `watched` limits them to attributes (IRIs), None watches all. A change of the entity as a whole concerns
    who watches attributes if the entity has one of them.
    """

    kinds: frozenset[str] = DEFAULT
    watched: Names | None = None

    def match(self, change: EntityChange) -> bool:
        """Say whether a change is one of those."""
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
        """Say whether attributes that are gone are told of."""
        return ATTRIBUTE_DELETED in self.kinds

    @property
    def reports_expiry(self) -> bool:
        """Say whether the end of an entity can concern them."""
        return ENTITY_DELETED in self.kinds or ATTRIBUTE_DELETED in self.kinds


def read_kinds(given: Any) -> frozenset[str]:
    """Return the kinds of change that `notificationTrigger` names; those of `entityUpdated` one by one.

    Raises a problem (400) for what names none.
    """
    if given is None:
        return DEFAULT
    if not isinstance(given, list) or not given:
        raise bad_request_data(
            f"notificationTrigger is a list with at least one of {', '.join(ALL)}, not {shown(given)}"
        )
    for one in given:
        if one not in ALL:
            raise bad_request_data(f"notificationTrigger has {', '.join(ALL)}, not {shown(one)}")
    kinds = frozenset(given)
    if ENTITY_UPDATED in kinds:
        kinds = kinds - {ENTITY_UPDATED} | _OF_UPDATED
    return DEFAULT if kinds == DEFAULT else kinds
