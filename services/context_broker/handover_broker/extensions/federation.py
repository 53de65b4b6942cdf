"""The interface to federation: context source registrations, distributed operations and entity maps.

The application passes each request to a `Federation`. `LocalOnly` has no context sources: it carries out
operations on the broker's own entities and refuses requests that need a registration or an entity map.
The plugin `federation` is the full implementation (`handover_federation.broker_federation`). The application
loads it, and a broker with HANDOVER_BROKER_FEDERATION=false does not.
"""

from collections.abc import Callable
from typing import Final, Protocol

from handover_broker.contexts.context_resolver import ContextResolver
from handover_broker.extensions.plugins import PerformByName, Plugin, unsupported, warn_of_stored
from handover_broker.model.problems import not_supported
from handover_broker.request.request_context import RequestContext, Response
from handover_broker.request.routing import Operation
from handover_broker.settings import BrokerSettings
from handover_broker.storage.entries import DocumentKind
from handover_broker.storage.journal import Journal
from handover_broker.tenant_extensions import LocalTenant, TenantFederation
from handover_broker.tenants import Tenant, Tenants

MAP_HEADER: Final = b"ngsild-entitymap"
MAP_OPTION: Final = "entityMap"
SINGLE_ENTITY_READS: Final = frozenset({"retrieveEntity", "retrieveTemporal"})
"""Operations on one entity: a map lists the sources to query for it (clauses 5.7.1.4 and 5.7.3.4)."""
_MAPPED_OPERATIONS: Final = SINGLE_ENTITY_READS | {"queryEntity", "queryBatch", "queryTemporal"}
FEDERATION: Final = Plugin(
    "federation",
    "context source registrations, distributed operations and entity maps",
    "HANDOVER_BROKER_FEDERATION",
)
_OPERATIONS: Final = (
    ("POST", "csourceRegistrations", "createCSR", "6.8.3.1"),
    ("GET", "csourceRegistrations", "queryCSR", "6.8.3.2"),
    ("GET", "csourceRegistrations/{id}", "retrieveCSR", "6.9.3.1"),
    ("PATCH", "csourceRegistrations/{id}", "updateCSR", "6.9.3.2"),
    ("DELETE", "csourceRegistrations/{id}", "deleteCSR", "6.9.3.3"),
    ("POST", "csourceSubscriptions", "createCSRSubscription", "6.12.3.1"),
    ("GET", "csourceSubscriptions", "queryCSRSubscription", "6.12.3.2"),
    ("GET", "csourceSubscriptions/{id}", "retrieveCSRSubscription", "6.13.3.1"),
    ("PATCH", "csourceSubscriptions/{id}", "updateCSRSubscription", "6.13.3.2"),
    ("DELETE", "csourceSubscriptions/{id}", "deleteCSRSubscription", "6.13.3.3"),
    ("POST", "sourceNotifications/{token}", "receiveSourceNotification", "6.3.8"),
    ("GET", "entityMaps/{id}", "retrieveEntityMap", "6.32.3.1"),
    ("PATCH", "entityMaps/{id}", "updateEntityMap", "6.32.3.2"),
    ("DELETE", "entityMaps/{id}", "deleteEntityMap", "6.32.3.3"),
    ("GET", "entityMaps", "createEntityMapQueryEntity", "6.34.3.1"),
    ("POST", "entityMaps", "createEntityMapQueryEntity", "6.34.3.2"),
    ("GET", "temporal/entityMaps", "createEntityMapQueryTemporal", "6.35.3.1"),
    ("POST", "temporal/entityMaps", "createEntityMapQueryTemporal", "6.35.3.2"),
)


class Federation(Protocol):
    """Carries out operations together with the context sources that a tenant has registered."""

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations on registrations, on subscriptions to them and on entity maps."""

    def tenant_state(self, tenant: Tenant) -> TenantFederation:
        """Return the state of a new tenant."""

    async def restore(self, journal: Journal) -> None:
        """Load registrations, subscriptions to them and entity maps; all tenants are loaded already."""

    async def start(self, journal: Journal) -> None:
        """Start the background work; call it once everything is restored."""

    async def stop(self) -> None:
        """Stop the background work and close the connections to context sources."""

    async def refresh_context(self, tenant: Tenant, context_id: str) -> None:
        """Recompute everything of a tenant that was derived from a changed @context."""

    async def answer(self, operation: Operation, request: RequestContext) -> Response:
        """Carry out an operation with the context sources, and by an entity map if the request wants one."""

    async def answer_locally(self, operation: Operation, request: RequestContext) -> Response:
        """Carry out an operation on the tenant's own entities, by an entity map if the request wants one."""

    async def distribute(self, operation: Operation, request: RequestContext) -> Response:
        """Carry out an operation with the context sources, without entity maps."""


FederationFactory = Callable[[Tenants, ContextResolver, BrokerSettings, PerformByName], Federation]
"""What the entry point of the plugin is."""


class LocalOnly:
    """A broker without context sources."""

    def __init__(self) -> None:
        self._reason = FEDERATION.missing()

    def operations(self) -> tuple[Operation, ...]:
        return unsupported(_OPERATIONS, self._reason)

    def tenant_state(self, tenant: Tenant) -> TenantFederation:
        return LocalTenant()

    async def restore(self, journal: Journal) -> None:
        warn_of_stored(journal, DocumentKind.REGISTRATION, FEDERATION)

    async def start(self, journal: Journal) -> None:
        return

    async def stop(self) -> None:
        return

    async def refresh_context(self, tenant: Tenant, context_id: str) -> None:
        return

    async def answer(self, operation: Operation, request: RequestContext) -> Response:
        if wants_map(operation, request):
            raise not_supported(self._reason)
        return await operation.answer(request)

    answer_locally = answer

    async def distribute(self, operation: Operation, request: RequestContext) -> Response:
        return await operation.answer(request)


def wants_map(operation: Operation, request: RequestContext) -> bool:
    """Return whether a request names an entity map, or asks for one to be created.

    It asks with entityMap=true or with entityMap among its options.
    """
    parameters = request.parameters
    if MAP_HEADER not in request.headers and MAP_OPTION not in parameters and "options" not in parameters:
        return False
    if operation.name not in _MAPPED_OPERATIONS:
        return False
    return (
        MAP_HEADER in request.headers
        or request.flag(MAP_OPTION)
        or MAP_OPTION in parameters.get("options", "").split(",")
    )
