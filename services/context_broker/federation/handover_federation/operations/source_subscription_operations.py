"""Operations on subscriptions to registrations of context sources (clauses 5.11.2 to 5.11.6, 6.12, 6.13)."""

from typing import Final

from handover_broker.delivery.subscription import Subscription
from handover_broker.delivery.subscription_dispatcher import SubscriptionDispatcher
from handover_broker.operations.subscription_operations import SubscriptionOperations
from handover_broker.request.query_parameters import PAGE_PARAMETERS
from handover_broker.request.routing import Operation
from handover_broker.storage.entries import DocumentKind
from handover_broker.tenants import Tenant
from handover_federation.registrations.source_subscriptions import notices_of_all
from handover_federation.tenant_state import federated

_VIEW: Final = frozenset({"options"})


class SourceSubscriptionOperations(SubscriptionOperations):
    """Operations on subscriptions to registrations. A new one is notified of all matching registrations."""

    KIND = DocumentKind.SOURCE_SUBSCRIPTION
    EXTRA_MEMBERS = frozenset({"temporalQ"})

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations."""
        all_of_them, by_id = "csourceSubscriptions", "csourceSubscriptions/{id}"
        return (
            Operation(
                "POST", all_of_them, "createCSRSubscription", "6.12.3.1", self.create, makes_tenant=True
            ),
            Operation("GET", all_of_them, "queryCSRSubscription", "6.12.3.2", self.list, PAGE_PARAMETERS),
            Operation("GET", by_id, "retrieveCSRSubscription", "6.13.3.1", self.retrieve, _VIEW),
            Operation("PATCH", by_id, "updateCSRSubscription", "6.13.3.2", self.update),
            Operation("DELETE", by_id, "deleteCSRSubscription", "6.13.3.3", self.delete),
        )

    def dispatcher(self, tenant: Tenant) -> SubscriptionDispatcher:
        """Return the dispatcher of a tenant's subscriptions to registrations."""
        return federated(tenant).source_notifier

    async def keep(self, tenant: Tenant, subscription: Subscription) -> None:
        """Store a subscription together with the notification of all matching registrations."""
        dispatcher = self.dispatcher(tenant)
        entries = self.entries_of(tenant, subscription)
        entries.pending = notices_of_all(dispatcher, federated(tenant).registry, subscription)
        await self.write(tenant, entries)
        dispatcher.put(subscription)
        dispatcher.deliver(entries.pending)
