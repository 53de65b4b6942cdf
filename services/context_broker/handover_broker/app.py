"""The broker: wires its parts, and passes requests to operations."""

import asyncio
import gc
import time
from collections.abc import Coroutine
from functools import partial
from typing import Any, Final, TypeVar

from prometheus_client import Gauge
from starlette.types import Receive

from handover.errors import Problem
from handover.security.audit_trail import RECORDED_HEADER
from handover.security.authentication import Guard
from handover.security.caller import Caller
from handover.telemetry import get_logger
from handover_broker.access.access_record import AccessLog, AccessRecord
from handover_broker.access.authorization import Authorization
from handover_broker.api.application import BrokerApplication
from handover_broker.api.request_metrics import RequestMetrics
from handover_broker.contexts.context_resolver import ContextResolver
from handover_broker.contexts.context_store import Documents
from handover_broker.contexts.fetching import Fetcher
from handover_broker.contexts.own_address import OwnAddress
from handover_broker.delivery.notifier import REQUEST_HEADERS, REQUEST_TIME
from handover_broker.extensions.federation import (
    FEDERATION,
    Federation,
    FederationFactory,
    LocalOnly,
    wants_map,
)
from handover_broker.extensions.snapshots import (
    SNAPSHOTS,
    NoSnapshots,
    Snapshots,
    SnapshotsFactory,
    is_inside_snapshot,
)
from handover_broker.model.problems import not_stored
from handover_broker.model.stored_documents import isolated
from handover_broker.operations.batch_operations import BatchOperations
from handover_broker.operations.context_operations import ContextOperations
from handover_broker.operations.discovery_operations import DiscoveryOperations
from handover_broker.operations.entity_operations import EntityOperations
from handover_broker.operations.subscription_operations import SubscriptionOperations
from handover_broker.request.name_hints import with_name_hints
from handover_broker.request.request_context import (
    Request,
    RequestContext,
    Response,
    problem_response,
    read,
    with_echoed_headers,
)
from handover_broker.request.routing import Operation, Router
from handover_broker.settings import DATABASE, BrokerSettings
from handover_broker.storage.database import Database, SqliteDatabase
from handover_broker.storage.document_counts import documents_with_counts
from handover_broker.storage.entries import DocumentKind, Entries
from handover_broker.storage.journal import Journal, NotStored
from handover_broker.storage.postgres import PostgresDatabase
from handover_broker.temporal.operations import TemporalOperations
from handover_broker.temporal.provision import TemporalProvision
from handover_broker.temporal.retention import Retention
from handover_broker.tenants import Tenants

log = get_logger(__name__)

Result = TypeVar("Result")

ENTITIES = Gauge("handover_broker_entities", "Entities in the broker")
REQUESTS: Final = RequestMetrics()
_RECORDED: Final = RECORDED_HEADER.lower().encode()
GC_THRESHOLDS: Final = (20_000, 20, 50)
"""With Python's defaults, (700, 10, 10), garbage collection took a sixth of the time of a change."""


class Broker:
    """The parts of the broker."""

    def __init__(self, settings: BrokerSettings, journal: Journal) -> None:
        self.settings = settings
        self.guard = Guard(settings, "context-broker")
        self.authorization = Authorization(self.guard, settings)
        self.journal = journal
        self.tenants = Tenants(journal, settings, self.authorization.receivers)
        self.access_log = AccessLog(settings, self.tenants, self.authorization.health_types)
        self.audit = self.access_log.trail
        self.authorization.receivers.record_in(self.access_log)
        policy, ca_files = settings.outbound_policy(), settings.ca_files
        self.contexts = ContextResolver(
            self._keep_documents,
            lambda documents: self.tenants.commits.store_later(Entries(documents=dict(documents))),
            Fetcher(settings.broker_context_timeout_s, policy, ca_files),
            OwnAddress(settings.broker_public_url, settings.url_of(settings.broker_port)),
            settings.broker_default_context,
        )
        self.contexts.on_renewal = self._renew
        self._running: set[asyncio.Task[Any]] = set()
        self.subscriptions = SubscriptionOperations(self.contexts)
        self.federation = self._federation()
        self.tenants.federation_of = self.federation.tenant_state
        self.snapshots = self._snapshots()
        self.router = Router(
            operation
            for operations in (
                EntityOperations(),
                BatchOperations(),
                DiscoveryOperations(self.tenants.named),
                self.subscriptions,
                self.federation,
                self.snapshots,
                ContextOperations(self.contexts),
                TemporalOperations(journal.archive),
                TemporalProvision(journal.archive, self.tenants.recorder),
            )
            for operation in operations.operations()
        )
        self.retention = Retention(
            journal.archive,
            self.tenants.commits,
            settings.broker_history_keep_days,
            lambda: [tenant.name for tenant in self.tenants],
        )

    async def start(self) -> None:
        """Load the journal, and start to notify."""
        await self.guard.__aenter__()
        for tenant, key, stored in self.journal.documents(DocumentKind.CONTEXT):
            with isolated(DocumentKind.CONTEXT.value, tenant, key, {}):
                self.contexts.remember(tenant, key, stored)
        for _, key, stored in self.journal.documents(DocumentKind.CONTEXT_USAGE):
            with isolated(DocumentKind.CONTEXT_USAGE.value, "", key, {}):
                self.contexts.usage.remember(key, stored)
        self.tenants.load()
        self.tenants.commits.start()
        await self.tenants.keep_identity()
        self.snapshots.restore(self.journal)
        await self.federation.restore(self.journal)
        await self._restore_subscriptions()
        await self.contexts.tidy()
        await self.snapshots.start(self.journal)
        self.tenants.ends.start()
        await self.federation.start(self.journal)
        self.retention.start()
        if self.guard.has_accounts():
            await self.access_log.start()
        ENTITIES.set_function(self.tenants.entities)
        gc.set_threshold(*GC_THRESHOLDS)
        gc.freeze()  # what was loaded stays
        log.info("broker ready", entities=self.tenants.entities(), database=self.journal.name)

    async def stop(self) -> None:
        """Commit what is pending, and close."""
        await self.guard.__aexit__()
        await self.access_log.stop()
        for task in self._running:
            task.cancel("the broker stops")
        self.tenants.ends.stop()
        await self.snapshots.stop()
        for tenant in self.tenants:
            tenant.notifier.stop()
            tenant.federation.stop()
        await self.tenants.outbound.close()
        self.contexts.usage.write()
        await self.federation.stop()
        await self.retention.stop()
        await self.tenants.commits.stop()
        await asyncio.to_thread(self.journal.close)

    async def answer(self, request: Request, body: bytes | Receive) -> Response:
        """Return the response to a request, whose body is there or still to be received."""
        if request.method == "OPTIONS":
            allowed = self.router.allowed(request)
            return Response(204, b"", [(b"allow", ", ".join(allowed).encode())])
        caller = self.guard.authenticate_now(request.address, request.headers)
        if caller is None:  # `accounts` has to be asked
            caller = await self._in_own_task(self.guard.authenticate(request.address, request.headers))
        operation, names = self.router.find(request)
        await read(request, body, self.settings.broker_max_body_bytes)
        started_s = time.perf_counter()
        try:
            if self.access_log.has_records_of(caller):
                answer = await self._execute_recorded(operation, request, names, caller)
            else:
                answer = await self._execute(operation, request, names, caller)
        except Problem as problem:
            answer = problem_response(problem)
        answer = with_echoed_headers(request, answer)
        REQUESTS.note(operation.title, answer.status, time.perf_counter() - started_s)
        return answer

    async def _execute_recorded(
        self, operation: Operation, request: Request, names: tuple[str, ...], caller: Caller
    ) -> Response:
        """Execute an operation, and record what it has changed and which private data it has read."""
        tenant = b"" if operation.of_no_tenant else request.headers.get(b"ngsild-tenant", b"")
        rights = self.authorization.rights_of(caller, tenant.decode("latin-1"))
        record = AccessRecord(rights, operation, request, names)
        if record.is_change:
            await self._in_own_task(self.access_log.begin(record))
        try:
            answer = await self._execute(operation, request, names, caller, record)
        except Problem as problem:
            await self.access_log.finish(record, problem.status)
            raise
        except Exception:
            await self.access_log.finish(record, 500)
            raise
        if not await self.access_log.finish(record, answer.status) and record.is_lowering:
            return Response(answer.status, answer.body, [*answer.headers, (_RECORDED, b"false")])
        return answer

    async def _execute(
        self,
        operation: Operation,
        request: Request,
        names: tuple[str, ...],
        caller: Caller,
        record: AccessRecord | None = None,
    ) -> Response:
        named = b"" if operation.of_no_tenant else request.headers.get(b"ngsild-tenant", b"")
        tenant = self.tenants.of(named, makes=operation.makes_tenant)
        try:
            visible = self.authorization.tenant_for(caller, operation, request, names, tenant, record)
            context = RequestContext(request, names, self.contexts, visible, caller)
            if request.parameters:
                context.require_known(operation.parameters)
            if request.method != "GET":
                REQUEST_TIME.set(time.time())
            if tenant.notifier.passes_headers_on:
                REQUEST_HEADERS.set(request.headers)
            if (
                operation.is_brief
                and tenant.federation.is_empty
                and not self._is_extended(operation, context)
            ):
                answer = await operation.answer(context)
            else:
                answer = await self._in_own_task(self._with_extensions(operation, context))
            return await with_name_hints(operation, context, answer)
        finally:
            self.tenants.leave(tenant)

    async def _in_own_task(self, work: Coroutine[None, None, Result]) -> Result:
        """Run work that may wait for others in a task of its own."""
        task = asyncio.get_running_loop().create_task(work)
        self._running.add(task)
        task.add_done_callback(self._running.discard)
        return await task

    @staticmethod
    def _is_extended(operation: Operation, context: RequestContext) -> bool:
        """Return whether a request names a snapshot or an entity map, or wants a map."""
        return is_inside_snapshot(operation, context) or wants_map(operation, context)

    async def _with_extensions(self, operation: Operation, context: RequestContext) -> Response:
        """Carry out an operation inside a snapshot, or with context sources and entity maps."""
        if is_inside_snapshot(operation, context):
            return await self.snapshots.answer(operation, context, self.federation.answer_locally)
        return await self.federation.answer(operation, context)

    async def _by_name(self, name: str, context: RequestContext) -> Response:
        """Execute an operation that another one needs."""
        operations = (operation for operation in self.router.operations if operation.name == name)
        wanted = next(operation for operation in operations if operation.method == context.method)
        return await self.federation.distribute(wanted, context)

    async def _renew(self, context_id: str) -> None:
        """Recompute everything that was derived from a changed @context."""
        for tenant in list(self.tenants):
            await self.subscriptions.renew(tenant, context_id)
            await self.federation.refresh_context(tenant, context_id)

    async def _restore_subscriptions(self) -> None:
        stored = documents_with_counts(self.journal, DocumentKind.SUBSCRIPTION, DocumentKind.COUNTS)
        for tenant in self.tenants:
            await self.subscriptions.restore(tenant, stored.get(tenant.name, ()))

    def _federation(self) -> Federation:
        """Return federation, if it is installed and the settings have it."""
        make: FederationFactory | None = FEDERATION.factory(is_wanted=self.settings.broker_federation)
        return make(self.tenants, self.contexts, self.settings, self._by_name) if make else LocalOnly()

    def _snapshots(self) -> Snapshots:
        """Return snapshots, if they are installed and the settings have them."""
        make: SnapshotsFactory | None = SNAPSHOTS.factory(is_wanted=self.settings.broker_snapshots)
        return make(self.tenants, self.federation.distribute, self._by_name) if make else NoSnapshots()

    async def _keep_documents(self, documents: Documents) -> None:
        names = {tenant for _, tenant, _ in documents}
        commits = self.tenants.commits_of(names.pop()) if len(names) == 1 else self.tenants.commits
        try:
            await commits.store(Entries(documents=dict(documents)))
        except NotStored as error:
            raise not_stored(str(error), is_away=error.is_away) from error


def operations_of(settings: BrokerSettings) -> tuple[Operation, ...]:
    """Return all operations of a broker that is neither started nor written."""
    journal = Journal(SqliteDatabase(settings.data_dir / DATABASE))
    return Broker(settings, journal).router.operations


def create_broker(settings: BrokerSettings) -> "BrokerApplication":
    """Return the broker as an ASGI application; raise `UsageError` when its database cannot be used."""
    application = BrokerApplication(
        partial(_opened, settings), settings.data_dir, over_asgi=settings.broker_http == "asgi"
    )
    application.open()
    return application


def _opened(settings: BrokerSettings) -> Broker:
    """Return a broker on its database, which is not locked and not loaded yet."""
    database: Database
    if settings.broker_database_url:
        database = PostgresDatabase(settings.with_password(settings.broker_database_url))
    else:
        database = SqliteDatabase(settings.data_dir / DATABASE)
    journal = Journal(database)
    journal.open()
    return Broker(settings, journal)
