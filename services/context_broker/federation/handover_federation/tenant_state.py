"""The federation state of one tenant: its registrations, the subscriptions to them, its entity maps."""

from collections.abc import Iterator

from handover_broker.storage.entries import DocumentKey, DocumentKind
from handover_broker.tenant_extensions import Announced
from handover_broker.tenants import Tenant
from handover_federation.entity_maps.entity_map import EntityMaps
from handover_federation.registrations.registry import Registry
from handover_federation.registrations.source_subscriptions import SourceNotifier


class FederatedTenant:
    """Implements `TenantFederation`."""

    def __init__(self, tenant: Tenant) -> None:
        self._name = tenant.name
        self.registry = Registry(tenant.name, tenant.commits)
        self.entity_maps = EntityMaps(tenant.name, tenant.commits)
        self.source_notifier = SourceNotifier(
            tenant.name, tenant.commits, tenant.notifier.outbound, self.registry
        )

    @property
    def is_empty(self) -> bool:
        return self.registry.is_empty

    def announced(self) -> Iterator[Announced]:
        for registration in self.registry:
            for piece in registration.information:
                yield piece.attributes or (), {kind for entity in piece.entities for kind in entity.types}

    def has_subscription(self, subscription_id: str) -> bool:
        return self.source_notifier.get(subscription_id) is not None

    def document_keys(self) -> Iterator[DocumentKey]:
        for subscription in self.source_notifier.all():
            yield DocumentKind.SOURCE_SUBSCRIPTION, self._name, subscription.id
            yield DocumentKind.COUNTS, self._name, subscription.id
        for registered in self.registry:
            yield DocumentKind.REGISTRATION, self._name, registered.id
            yield DocumentKind.ATTEMPTS, self._name, registered.id
        for map_id in self.entity_maps:
            yield DocumentKind.ENTITY_MAP, self._name, map_id

    def stop(self) -> None:
        self.source_notifier.stop()


def federated(tenant: Tenant) -> FederatedTenant:
    """Return the federation state of a tenant; only this package asks for it."""
    state = tenant.federation
    if not isinstance(state, FederatedTenant):
        raise TypeError(f"tenant {tenant.name!r} has no federation state")
    return state
