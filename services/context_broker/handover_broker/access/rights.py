"""The rights of a caller, or of the owner of a subscription or registration, in one tenant.

`Rights.shows` decides what leaves the broker for whom: answers ask it through the store of the caller
(`restricted_store`), notifications and requests to context sources through their owner (`receivers`).
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from handover.errors import Problem
from handover.security.authentication import not_allowed
from handover.security.caller import Caller, CallerKind
from handover.security.permissions import Permission
from handover.security.resource_patterns import ANY_RESOURCE
from handover.tasks.task_life import performers_of
from handover_broker.access.task_evidence import (
    TASK,
    performer_refusal,
    resources_of,
    task_refusal,
)
from handover_broker.model.entity import Entity, Event
from handover_broker.model.personal_data import has_type_of, is_of, type_in

PERSON: Final = "Person"
_PEOPLE: Final = frozenset({PERSON})
_TASKS: Final = frozenset({TASK})


@dataclass(frozen=True, slots=True)
class Rights:
    """The rights of a caller in one tenant, whose resources begin with `prefix`."""

    caller: Caller
    prefix: str
    health_types: frozenset[str]

    @property
    def everything(self) -> str:
        """The resource for all entities of the tenant."""
        return f"{self.prefix}{ANY_RESOURCE}"

    def may(self, permission: Permission, entity_id: str) -> bool:
        """Return whether the caller has `permission` for an entity."""
        return self.caller.may(permission, self.prefix + entity_id)

    def may_everywhere(self, permission: Permission) -> bool:
        """Return whether the caller has `permission` for all entities of the tenant."""
        return self.caller.may(permission, self.everything)

    def shows(self, entity: Entity) -> bool:
        """Return whether the caller may see `entity`."""
        is_seen = self.may_see(entity.id, is_private=self.is_private(entity.id, entity.types))
        return is_seen or self.performs(entity)

    def performs(self, entity: Entity) -> bool:
        """Return whether `entity` is a Task of a Device for which the caller performs Tasks."""
        if not self.may_somewhere_perform or not is_of(entity, _TASKS):
            return False
        resources = performers_of(resources_of(entity))
        return any(self.may(Permission.PERFORM_FOR_DEVICES, resource) for resource in resources)

    @property
    def may_somewhere_perform(self) -> bool:
        """Return whether the caller performs Tasks of some Device."""
        return self.caller.may_somewhere(Permission.PERFORM_FOR_DEVICES)

    def may_see(self, entity_id: str, *, is_private: bool) -> bool:
        """Return whether the caller may see an entity, which is about the body of a person or not."""
        if not self.may(Permission.READ, entity_id):
            return False
        return not is_private or self.may(Permission.READ_HEALTH_DATA, entity_id)

    def is_private(self, entity_id: str, types: Iterable[str]) -> bool:
        """Return whether an entity is about the body of a person, by its id or its types (IRIs)."""
        return type_in(entity_id) in self.health_types or has_type_of(types, self.health_types)

    def refusal(self, find: Callable[[str], Entity | None], event: Event) -> Problem | None:
        """Return why the caller may not make a change; None if it may. `find` returns other entities."""
        entity = event.after or event.before
        assert entity is not None  # noqa: S101 - a change has at least one end
        if not self.may(Permission.WRITE_ENTITIES, entity.id):
            if event.before is not None and self.performs(event.before):
                return performer_refusal(event) or task_refusal(event, find)
            return self.denied(Permission.WRITE_ENTITIES, entity.id)
        ends = [end for end in (event.before, event.after) if end is not None]
        is_service = self.caller.kind is CallerKind.SERVICE
        if not is_service and any(is_of(end, _PEOPLE) for end in ends):
            return (
                None
                if self.may(Permission.MANAGE_PEOPLE, entity.id)
                else self.denied(Permission.MANAGE_PEOPLE, entity.id)
            )
        if any(self.is_private(end.id, end.types) for end in ends) and not self.may(
            Permission.READ_HEALTH_DATA, entity.id
        ):
            return self.denied(Permission.READ_HEALTH_DATA, entity.id)
        if not is_service and any(is_of(end, _TASKS) for end in ends):
            return task_refusal(event, find)
        return None

    def denied(self, permission: Permission, entity_id: str = ANY_RESOURCE) -> Problem:
        """The caller lacks a permission."""
        return not_allowed(self.caller, permission, self.prefix + entity_id)

    def missing(self) -> Permission | None:
        """Return a permission that the caller lacks to see and change every entity of the tenant, if any."""
        asked = [Permission.READ, Permission.WRITE_ENTITIES, Permission.READ_HEALTH_DATA]
        if self.caller.kind is not CallerKind.SERVICE:
            asked.append(Permission.MANAGE_PEOPLE)
        return next((permission for permission in asked if not self.may_everywhere(permission)), None)


def resource_prefix(tenant: str, own_tenant: str) -> str:
    """Return what the resources of a tenant begin with; `own_tenant` is that of our own services."""
    if tenant == "" and own_tenant:
        return "default/"
    return "" if tenant in {"", own_tenant} else f"{tenant}/"
