"""Federation of one broker: puts registrations, distributed operations and entity maps together.

A request of a tenant without registrations goes straight to the operation. With registrations it goes to
`distribution`: the registry finds the context sources that can contribute, all are queried at the same time,
and their results are merged with the broker's own. A request that names an entity map, or wants one, is
answered from the map; its pages are read with the same distribution.
"""

from collections.abc import Mapping
from functools import partial

from handover.network.http_client import BodyReadingHttpClient
from handover_broker.contexts.context_resolver import ContextResolver
from handover_broker.extensions.federation import wants_map
from handover_broker.extensions.plugins import PerformByName
from handover_broker.model.stored_documents import isolated
from handover_broker.request.request_context import RequestContext, Response
from handover_broker.request.routing import Operation
from handover_broker.settings import BrokerSettings
from handover_broker.storage.document_counts import documents_with_counts
from handover_broker.storage.entries import DocumentKind
from handover_broker.storage.journal import Journal
from handover_broker.tenants import Tenant, Tenants
from handover_federation.distribution.distributed_operations import (
    DistributedOperations,
    Handler,
)
from handover_federation.distribution.forwarding.forwarder import Forwarder
from handover_federation.distribution.subscriptions.subscription_forwarding import SubscriptionForwarder
from handover_federation.operations.entity_map_operations import EntityMapOperations
from handover_federation.operations.registration_operations import RegistrationOperations
from handover_federation.operations.source_subscription_operations import (
    SourceSubscriptionOperations,
)
from handover_federation.tenant_state import FederatedTenant, federated


class BrokerFederation:
    """Implements `Federation`. `perform` carries out an operation by its name, context sources included."""

    def __init__(
        self,
        tenants: Tenants,
        contexts: ContextResolver,
        settings: BrokerSettings,
        perform: PerformByName,
    ) -> None:
        self._tenants = tenants
        self._registrations = RegistrationOperations(contexts)
        self._source_subscriptions = SourceSubscriptionOperations(contexts)
        self._entity_maps = EntityMapOperations(perform)
        client = BodyReadingHttpClient(settings.outbound_policy(), settings.ca_files)
        self._forwarder = Forwarder(contexts, settings.broker_source_timeout_s, client)
        self._subscription_forwarder = SubscriptionForwarder(
            tenants, contexts, self._forwarder, settings.broker_public_url
        )
        self._distribution = DistributedOperations(self._forwarder, self._handlers)

    def operations(self) -> tuple[Operation, ...]:
        return (
            *self._registrations.operations(),
            *self._source_subscriptions.operations(),
            *self._subscription_forwarder.operations(),
            *self._entity_maps.operations(),
        )

    def tenant_state(self, tenant: Tenant) -> FederatedTenant:
        state = FederatedTenant(tenant)
        state.registry.watchers.append(lambda *_: self._subscription_forwarder.schedule_alignment(tenant))
        return state

    async def restore(self, journal: Journal) -> None:
        for name, map_id, body in journal.documents(DocumentKind.ENTITY_MAP):
            with isolated(DocumentKind.ENTITY_MAP.value, name, map_id, {}):
                federated(self._tenants.kept(name)).entity_maps.load(body)
        registrations = documents_with_counts(journal, DocumentKind.REGISTRATION, DocumentKind.ATTEMPTS)
        subscriptions = documents_with_counts(journal, DocumentKind.SOURCE_SUBSCRIPTION, DocumentKind.COUNTS)
        for tenant in self._tenants:
            await self._registrations.restore(tenant, registrations.get(tenant.name, ()))
            await self._source_subscriptions.restore(tenant, subscriptions.get(tenant.name, ()))

    async def start(self, journal: Journal) -> None:
        await self._subscription_forwarder.start(journal)

    async def stop(self) -> None:
        await self._subscription_forwarder.stop()
        self._forwarder.http_client.close()

    async def refresh_context(self, tenant: Tenant, context_id: str) -> None:
        await self._source_subscriptions.renew(tenant, context_id)
        await self._registrations.renew(tenant, context_id)

    async def answer(self, operation: Operation, request: RequestContext) -> Response:
        if wants_map(operation, request):
            return await self._entity_maps.answer(operation, request, partial(self.distribute, operation))
        return await self.distribute(operation, request)

    async def answer_locally(self, operation: Operation, request: RequestContext) -> Response:
        if wants_map(operation, request):
            return await self._entity_maps.answer(operation, request, operation.answer)
        return await operation.answer(request)

    async def distribute(self, operation: Operation, request: RequestContext) -> Response:
        if request.tenant.federation.is_empty:
            return await operation.answer(request)
        return await self._distribution.answer(operation, request)

    def _handlers(self) -> Mapping[str, Handler]:
        """Return how operations are distributed; imported late, because most brokers have no registration."""
        from handover_federation.distribution.handlers import HANDLERS  # noqa: PLC0415 - late

        return {**HANDLERS, **self._subscription_forwarder.handlers()}
