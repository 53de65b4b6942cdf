"""Authorization: which tenant, operation and entity a caller may use.

A resource is the id of an entity; in a tenant other than that of our own services it is `<tenant>/<id>`. A
caller with all rights for the tenant gets its store itself; any other caller gets a `RestrictedStore`.

Entities about the body of a person (`broker_health_types`) are visible with the permission `readHealthData`
only. A Person is created, changed and deleted by our services, or with the permission `managePeople`. What
says who answered a Task is written by our services only (`task_evidence`).
"""

import copy
import re
from dataclasses import replace
from functools import partial
from typing import Any, Final

import orjson

from handover.security.authentication import Guard
from handover.security.caller import LOCAL_OWNER, Caller, CallerKind
from handover.security.permissions import Permission
from handover.security.resource_patterns import ANY_RESOURCE
from handover_broker.access.operation_access import OperationAccess, access_of
from handover_broker.access.receivers import OwnerReceivers
from handover_broker.access.restricted_store import Recording, RestrictedStore
from handover_broker.access.rights import Rights, resource_prefix
from handover_broker.model.personal_data import short_name
from handover_broker.request.request_context import Request
from handover_broker.request.routing import Operation
from handover_broker.settings import BrokerSettings
from handover_broker.tenants import Tenant

_SUBSCRIBING: Final = frozenset({"createSubscription", "updateSubscription"})
OF_SUBSCRIPTIONS: Final = frozenset(
    {*_SUBSCRIBING, "querySubscription", "retrieveSubscription", "deleteSubscription"}
)
"""What the performer of a Device does with subscriptions of its own (`request.ownership`)."""
_NAME: Final = re.compile(r"[^\s()|,;]+")
"""A name in a type selection such as `(Robot|Device);Task`."""


class Authorization:
    """Checks the requests of a broker."""

    def __init__(self, guard: Guard, settings: BrokerSettings) -> None:
        self._guard = guard
        self._own_tenant = settings.broker_tenant or ""
        self.health_types = frozenset(settings.broker_health_types)
        self.receivers = OwnerReceivers(guard, self.health_types, self._own_tenant)

    def tenant_for(  # noqa: PLR0917 - internal
        self,
        caller: Caller,
        operation: Operation,
        request: Request,
        names: tuple[str, ...],
        tenant: Tenant,
        recording: Recording | None = None,
    ) -> Tenant:
        """Return `tenant` as `caller` may use it for an operation; `recording` notes what it does.

        Raises a problem: 403 without the permission, 503 if a revocation may have been missed.
        """
        if caller is LOCAL_OWNER:
            return tenant
        if access_of(operation) is OperationAccess.OWN_CREDENTIAL:
            return tenant
        rights = self.rights_of(caller, tenant.name)
        self._require(rights, operation, request, names, tenant)
        missing = rights.missing()
        if missing is None and recording is None and caller.kind is CallerKind.SERVICE:
            return tenant
        if missing is not None and b"ngsild-snapshot" in request.headers:
            raise rights.denied(missing)
        restricted = copy.copy(tenant)
        refusal = partial(rights.refusal, tenant.store.latest)
        restricted.store = RestrictedStore(tenant.store, rights, refusal, recording)
        return restricted

    def rights_of(self, caller: Caller, tenant: str) -> Rights:
        """Return the rights of `caller` in a tenant."""
        return Rights(caller, resource_prefix(tenant, self._own_tenant), self.health_types)

    def _require(
        self,
        rights: Rights,
        operation: Operation,
        request: Request,
        names: tuple[str, ...],
        tenant: Tenant,
    ) -> None:
        access = access_of(operation)
        if access is OperationAccess.READ_ENTITIES:
            if not rights.caller.may_somewhere(Permission.READ):
                raise rights.denied(Permission.READ)
        elif access is OperationAccess.READ_TENANT:
            if not rights.may_everywhere(Permission.READ):
                raise rights.denied(Permission.READ)
        elif access is OperationAccess.WRITE_ENTITIES:
            self._guard.require_current(Permission.WRITE_ENTITIES)
            if not rights.may_everywhere(Permission.WRITE_ENTITIES):
                _require_each(rights, names[:1] or _ids_in(request.body), tenant)
        else:
            self._guard.require_current(Permission.WRITE_ENTITIES)
            is_own = operation.name in OF_SUBSCRIPTIONS and rights.may_somewhere_perform
            if not is_own and not rights.may_everywhere(Permission.WRITE_ENTITIES):
                raise rights.denied(Permission.WRITE_ENTITIES)
            if operation.name in _SUBSCRIBING and not rights.may_everywhere(Permission.READ_HEALTH_DATA):
                self._require_other_types(rights, operation, request.body)

    def _require_other_types(self, rights: Rights, operation: Operation, body: bytes) -> None:
        """Refuse a subscription that may notify about the body of a person.

        A change without `entities` keeps the selection of the subscription.
        """
        try:
            document: Any = orjson.loads(body)
        except orjson.JSONDecodeError:
            return
        if not isinstance(document, dict) or (
            operation.name == "updateSubscription" and "entities" not in document
        ):
            return
        selectors = document.get("entities")
        types: list[Any] = (
            [selector.get("type") for selector in selectors if isinstance(selector, dict)]
            if isinstance(selectors, list)
            else []
        )
        texts = [kind for kind in types if isinstance(kind, str) and kind != ANY_RESOURCE]
        if not texts or len(texts) < len(types):
            raise replace(
                rights.denied(Permission.READ_HEALTH_DATA),
                detail=f'"{rights.caller.name}" has no permission "{Permission.READ_HEALTH_DATA}", so each '
                "selector of a subscription names a type; add `entities` with a `type` each",
            )
        named = {short_name(name) for text in texts for name in _NAME.findall(text)}
        if not named.isdisjoint(self.health_types):
            raise rights.denied(Permission.READ_HEALTH_DATA)


def _require_each(rights: Rights, ids: tuple[str, ...], tenant: Tenant) -> None:
    """Check ids before anything is forwarded to a context source, which knows nothing of our rights."""
    if not ids:
        raise rights.denied(Permission.WRITE_ENTITIES)
    for entity_id in ids:
        if rights.may(Permission.WRITE_ENTITIES, entity_id):
            continue
        entity = tenant.store.latest(entity_id)
        if entity is None or not rights.performs(entity):
            raise rights.denied(Permission.WRITE_ENTITIES, entity_id)


def _ids_in(body: bytes) -> tuple[str, ...]:
    """Return the ids of a body: an entity, a list of entities or a list of ids; none if it is unreadable."""
    try:
        document: Any = orjson.loads(body)
    except orjson.JSONDecodeError:
        return ()
    ids: list[str] = []
    for part in document if isinstance(document, list) else [document]:
        entity_id = part.get("id", part.get("@id")) if isinstance(part, dict) else part
        if not isinstance(entity_id, str):
            return ()
        ids.append(entity_id)
    return tuple(ids)
