"""The broker: its parts put together, and the way of a request through them."""

import asyncio
import time
from collections.abc import Coroutine, Mapping
from functools import partial
from pathlib import Path
from shutil import disk_usage
from typing import TYPE_CHECKING, Final

import orjson
from prometheus_client import Gauge
from starlette.types import Receive

from handover.errors import Problem
from handover.storage import require_storage
from handover.telemetry import get_logger
from services.context_broker.api.exchange import (
    Answer,
    Exchange,
    Request,
    problem_answer,
    read,
    told_back,
)
from services.context_broker.api.operation import Directory, Operation
from services.context_broker.api.problems import not_stored
from services.context_broker.api.request_metrics import RequestMetrics
from services.context_broker.application import BrokerApplication
from services.context_broker.contexts.book import ContextBook
from services.context_broker.contexts.fetching import Fetcher
from services.context_broker.contexts.kept import Documents
from services.context_broker.contexts.operations import ContextOperations
from services.context_broker.contexts.own_address import OwnAddress
from services.context_broker.entities.batch_operations import BatchOperations
from services.context_broker.entities.discovery_operations import DiscoveryOperations
from services.context_broker.entities.entity_operations import EntityOperations
from services.context_broker.federation.distribution.distributed_operations import Distribution, Handler
from services.context_broker.federation.distribution.forwarding import Forwarder
from services.context_broker.federation.distribution.subscription_forwarding import SubscriptionForwarder
from services.context_broker.federation.entity_maps.operations import EntityMapOperations, wants_map
from services.context_broker.federation.registrations.registration_operations import RegistrationOperations
from services.context_broker.federation.registrations.source_subscription_operations import (
    SourceSubscriptionOperations,
)
from services.context_broker.garbage import look_rarely
from services.context_broker.network.http_client import BodyReadingHttpClient
from services.context_broker.settings import BrokerSettings
from services.context_broker.snapshots.operations import OUTSIDE_SNAPSHOTS, SnapshotOperations
from services.context_broker.snapshots.snapshot_creation import HEADER as SNAPSHOT
from services.context_broker.storage.attempts import made_again, was_overtaken
from services.context_broker.storage.database import Database, SqliteDatabase
from services.context_broker.storage.entries import Entries, Kind
from services.context_broker.storage.journal import Journal, NotStored
from services.context_broker.storage.leadership import ElectedBroker, Leadership, SoleBroker
from services.context_broker.storage.postgres import PostgresDatabase
from services.context_broker.storage.replica import TRIMMING, Overtaken, Replica
from services.context_broker.storage.tenants import Tenants
from services.context_broker.subscriptions.notifier import REQUEST_HEADERS
from services.context_broker.subscriptions.operations import SubscriptionOperations
from services.context_broker.subscriptions.subscription import Counts
from services.context_broker.temporal.operations import TemporalOperations
from services.context_broker.temporal.provision import TemporalProvision
from services.context_broker.temporal.retention import Retention

if TYPE_CHECKING:
    from handover.service import Check

log = get_logger(__name__)

ENTITIES = Gauge("handover_broker_entities", "Entities in the broker")
LEADS = Gauge("handover_broker_leads", "1 for the broker that notifies, 0 for others on the same database")
REQUESTS: Final = RequestMetrics()


class Broker:
    """The broker's parts, put together."""

    def __init__(
        self, settings: BrokerSettings, journal: Journal, leadership: Leadership, replica: Replica | None
    ) -> None:
        self.settings = settings
        self.journal = journal
        self.leadership = leadership
        self.tenants = Tenants(journal, settings, leadership, replica)
        policy, ca_file = settings.outbound_policy(), settings.broker_notification_ca_file
        self.contexts = ContextBook(
            self._keep_documents,
            lambda documents: self.tenants.commits.store_later(Entries(documents=dict(documents))),
            Fetcher(settings.broker_context_timeout_s, policy, ca_file),
            OwnAddress(settings.broker_public_url, settings.url_of(settings.broker_port)),
            settings.broker_default_context,
        )
        self.contexts.on_renewal = self._renew
        self._renewing: set[asyncio.Task[None]] = set()
        self._under_way: set[asyncio.Task[Answer]] = set()
        self.subscriptions = SubscriptionOperations(self.contexts)
        self.registrations = RegistrationOperations(self.contexts)
        self.source_subscriptions = SourceSubscriptionOperations(self.contexts)
        self.entity_maps = EntityMapOperations(self._by_name)
        self.snapshots = SnapshotOperations(self.tenants, self._answered, self._by_name)
        http_client = BodyReadingHttpClient(policy, ca_file)
        forwarder = Forwarder(self.contexts, settings.broker_source_timeout_s, http_client)
        self.subscription_forwarder = SubscriptionForwarder(
            self.tenants, self.contexts, forwarder, settings.broker_public_url
        )
        self.distribution = Distribution(forwarder, self._handlers)
        self.directory = Directory(
            operation
            for room in (
                EntityOperations(),
                BatchOperations(),
                DiscoveryOperations(),
                self.subscriptions,
                self.registrations,
                self.source_subscriptions,
                self.subscription_forwarder,
                self.entity_maps,
                self.snapshots,
                ContextOperations(self.contexts),
                TemporalOperations(journal.archive),
                TemporalProvision(journal.archive, self.tenants.recorder),
            )
            for operation in room.operations()
        )
        self.retention = Retention(
            journal.archive,
            self.tenants.commits,
            settings.broker_history_keep_days,
            lambda: leadership.leads,
            lambda: [tenant.name for tenant in self.tenants],
        )

    async def start(self) -> None:
        """Take up what the journal holds, and begin to notify."""
        self.tenants.commits.open()
        for tenant, key, stored in self.journal.documents(Kind.CONTEXT):
            self.contexts.remember(tenant, key, stored)
        for _, key, stored in self.journal.documents(Kind.CONTEXT_USAGE):
            self.contexts.usage.remember(key, stored)
        self.tenants.load()
        self._follow_others()
        self.tenants.commits.start()
        await self.tenants.keep_identity()
        await self._take_up_registrations()
        await self._take_up_subscriptions()
        await self.contexts.tidy()
        self.snapshots.start(self.journal)
        self.tenants.ends.start()
        self.leadership.start(self._turn, self.tenants.commits.look)
        await self.subscription_forwarder.start(self.journal)
        self.retention.start()
        ENTITIES.set_function(self.tenants.entities)
        LEADS.set_function(lambda: self.leadership.leads)
        look_rarely()
        log.info("broker ready", entities=self.tenants.entities(), database=self.journal.name)

    async def stop(self) -> None:
        """Commit what is on its way, and close."""
        for task in self._under_way:
            task.cancel("the broker stops")
        self.tenants.ends.stop()
        self.snapshots.stop()
        for tenant in self.tenants:
            tenant.notifier.stop()
            tenant.source_notifier.stop()
        await self.tenants.outbound.close()
        self.contexts.usage.write()
        self.subscription_forwarder.stop()
        self.distribution.forwarder.http_client.close()
        await self.retention.stop()
        await self.tenants.commits.stop()
        await asyncio.to_thread(self.leadership.stop)
        self.journal.close()

    async def answer(self, request: Request, body: bytes | Receive) -> Answer:
        """Answer one request, whose body is there or still to be received."""
        if request.method == "OPTIONS":
            allowed = self.directory.allowed(request)
            return Answer(204, b"", [(b"allow", ", ".join(allowed).encode())])
        operation, names = self.directory.find(request)
        await read(request, body, self.settings.broker_max_body_bytes)
        started_s = time.perf_counter()
        try:
            answer = await self._carried_out(operation, request, names)
        except (Overtaken, Problem) as error:
            answer = await self._after(error, operation, request, names)
        answer = told_back(request, answer)
        REQUESTS.note(operation.title, answer.status, time.perf_counter() - started_s)
        return answer

    async def _after(
        self, error: Overtaken | Problem, operation: Operation, request: Request, names: tuple[str, ...]
    ) -> Answer:
        """Answer with the problem, or carry it all out again from its start if another broker was quicker."""
        if isinstance(error, Problem) and not was_overtaken(error):
            return problem_answer(error)
        try:
            return await made_again(lambda: self._carried_out(operation, request, names))
        except Problem as problem:
            return problem_answer(problem)

    async def _carried_out(self, operation: Operation, request: Request, names: tuple[str, ...]) -> Answer:
        named = b"" if operation.of_no_tenant else request.headers.get(b"ngsild-tenant", b"")
        tenant = self.tenants.of(named, makes=operation.makes_tenant)
        try:
            exchange = Exchange(request, names, self.contexts, tenant)
            if request.parameters:
                exchange.require_known(operation.parameters)
            if tenant.notifier.passes_headers_on:
                REQUEST_HEADERS.set(request.headers)
            is_alone = tenant.registry.is_empty and SNAPSHOT not in request.headers
            if operation.is_brief and is_alone and not wants_map(operation, exchange):
                return await operation.answer(exchange)
            return await self._at_length(self._with_others(operation, exchange))
        finally:
            self.tenants.leave(tenant)

    async def _at_length(self, work: Coroutine[None, None, Answer]) -> Answer:
        """Have something done that may have to wait for others: it has a task of its own."""
        task = asyncio.get_running_loop().create_task(work)
        self._under_way.add(task)
        task.add_done_callback(self._under_way.discard)
        return await task

    async def _with_others(self, operation: Operation, exchange: Exchange) -> Answer:
        """Carry out an operation that is about more than what the tenant has now, or may be."""
        if SNAPSHOT in exchange.headers and operation.name not in OUTSIDE_SNAPSHOTS:
            return await self._inside_snapshot(operation, exchange)
        if wants_map(operation, exchange):
            return await self.entity_maps.answer(operation, exchange, partial(self._answered, operation))
        return await self._answered(operation, exchange)

    async def _inside_snapshot(self, operation: Operation, exchange: Exchange) -> Answer:
        named = exchange.headers[SNAPSHOT]
        exchange.tenant = self.snapshots.inside(exchange)
        if wants_map(operation, exchange):
            answer = await self.entity_maps.answer(operation, exchange, operation.answer)
        else:
            answer = await operation.answer(exchange)
        return Answer(answer.status, answer.body, [*answer.headers, (SNAPSHOT, named)])

    async def _answered(self, operation: Operation, exchange: Exchange) -> Answer:
        if exchange.tenant.registry.is_empty:
            return await operation.answer(exchange)
        return await self.distribution.answer(operation, exchange)

    def _handlers(self) -> Mapping[str, Handler]:
        """Return how operations are carried out together with context sources."""
        # Most brokers have no sources: they start without what it takes to ask them.
        from services.context_broker.federation.distribution.handlers import HANDLERS  # noqa: PLC0415 - as said

        return {**HANDLERS, **self.subscription_forwarder.handlers()}

    async def _by_name(self, name: str, exchange: Exchange) -> Answer:
        """Carry out an operation that another one needs."""
        operations = (one for one in self.directory.operations if one.name == name)
        wanted = next(one for one in operations if one.method == exchange.method)
        return await self._answered(wanted, exchange)

    async def _take_up_registrations(self) -> None:
        kept = self._kept(Kind.REGISTRATION, Kind.ATTEMPTS)
        for tenant in self.tenants:
            await self.registrations.restore(tenant, kept.get(tenant.name, ()))

    def _turn(self, leads: bool) -> None:
        self.tenants.turn(leads)
        self.snapshots.turn(leads=leads)

    def _follow_others(self) -> None:
        following = self.tenants.following
        following.on(Kind.CONTEXT, self._follow_context)
        following.on(Kind.CONTEXT_USAGE, self._follow_context_usage)
        following.on(Kind.SUBSCRIPTION, self._follow_subscription)
        following.on(Kind.SOURCE_SUBSCRIPTION, self._follow_source_subscription)
        following.on(Kind.COUNTS, self._follow_counts)
        following.on(Kind.REGISTRATION, self._follow_registration)
        following.on(Kind.ENTITY_MAP, self._follow_entity_map)
        following.on(Kind.RELAY, self.subscription_forwarder.follow)
        following.on(Kind.SNAPSHOT, self.snapshots.follow)
        following.on(Kind.SNAPSHOT_TELLING, self.snapshots.notifier.follow)
        following.on(Kind.IDENTITY, self._follow_identity)
        following.on(Kind.ATTEMPTS, self._follow_attempts)

    async def _follow_context(self, tenant: str, key: str, body: bytes | None) -> None:
        if body is None:
            self.contexts.forget(key)
        else:
            # Apart, for who changes a subscription waits for a commit, and that waits for the news.
            renewing = asyncio.create_task(self._renew(self.contexts.remember(tenant, key, body)))
            self._renewing.add(renewing)
            renewing.add_done_callback(self._renewing.discard)

    async def _renew(self, context_id: str) -> None:
        """Have what was made with a context that is another now made anew."""
        for tenant in list(self.tenants):
            for room in (self.subscriptions, self.source_subscriptions, self.registrations):
                await room.renew(tenant, context_id)

    async def _follow_context_usage(self, _: str, key: str, body: bytes | None) -> None:
        if body is not None:
            self.contexts.usage.remember(key, body)

    async def _follow_subscription(self, tenant: str, subscription_id: str, body: bytes | None) -> None:
        await self.subscriptions.follow(self.tenants.kept(tenant), subscription_id, body)

    async def _follow_source_subscription(self, tenant: str, one: str, body: bytes | None) -> None:
        await self.source_subscriptions.follow(self.tenants.kept(tenant), one, body)

    async def _follow_registration(self, tenant: str, one: str, body: bytes | None) -> None:
        await self.registrations.follow(self.tenants.kept(tenant), one, body)

    async def _follow_entity_map(self, tenant: str, one: str, body: bytes | None) -> None:
        maps = self.tenants.kept(tenant).entity_maps
        maps.forget(one) if body is None else maps.load(body)

    async def _follow_identity(self, _: str, __: str, body: bytes | None) -> None:
        if body is not None:
            self.tenants.identify(body)

    async def _follow_attempts(self, tenant: str, one: str, body: bytes | None) -> None:
        if body is not None:
            self.tenants.kept(tenant).registry.restore_attempts(one, body)

    async def _follow_counts(self, tenant: str, subscription_id: str, body: bytes | None) -> None:
        kept = self.tenants.kept(tenant)
        found = kept.notifier.get(subscription_id) or kept.source_notifier.get(subscription_id)
        if found is not None and body is not None and not self.leadership.leads:
            found.counts = Counts(*orjson.loads(body))

    async def _take_up_subscriptions(self) -> None:
        for kind, room in (
            (Kind.SUBSCRIPTION, self.subscriptions),
            (Kind.SOURCE_SUBSCRIPTION, self.source_subscriptions),
        ):
            kept = self._kept(kind, Kind.COUNTS)
            for tenant in self.tenants:
                await room.restore(tenant, kept.get(tenant.name, ()))

    def _kept(self, kind: Kind, counts: Kind) -> dict[str, list[tuple[bytes, bytes | None]]]:
        """Return what the journal holds of a kind by tenant, each with its counts."""
        told = {(tenant, one): body for tenant, one, body in self.journal.documents(counts)}
        kept: dict[str, list[tuple[bytes, bytes | None]]] = {}
        for name, one, body in self.journal.documents(kind):
            kept.setdefault(name, []).append((body, told.get((name, one))))
        return kept

    async def _keep_documents(self, documents: Documents) -> None:
        names = {tenant for _, tenant, _ in documents}
        commits = self.tenants.commits_of(names.pop()) if len(names) == 1 else self.tenants.commits
        try:
            await commits.store(Entries(documents=dict(documents)))
        except NotStored as error:
            raise not_stored(str(error)) from error


def operations_of(settings: BrokerSettings) -> tuple[Operation, ...]:
    """Return all operations of a broker, of which nothing is started and nothing written."""
    journal = Journal(SqliteDatabase(settings.data_dir / "broker.db"))
    return Broker(settings, journal, SoleBroker(), None).directory.operations


def create_broker(settings: BrokerSettings) -> "BrokerApplication":
    """Return the broker as an ASGI application; raise `UsageError` when its file cannot be used."""
    database: Database
    leadership: Leadership
    given = settings.broker_database_url
    url = settings.with_password(given) if given else given
    if not url:
        database, leadership = SqliteDatabase(settings.data_dir / "broker.db"), SoleBroker()
    else:
        database = PostgresDatabase(url)
        leadership = ElectedBroker(database, TRIMMING)
    journal = Journal(database)
    journal.open()
    broker = Broker(settings, journal, leadership, Replica(journal) if url else None)
    checks: dict[str, Check] = {"database": leadership.check}
    if not url:
        checks["storage"] = partial(_require_storage, journal, settings.data_dir)
    return BrokerApplication(broker, checks)


async def _require_storage(journal: Journal, directory: Path) -> None:
    """Raise an error with the reason while the disk refuses what is committed, or soon may."""
    try:
        journal.require_room()
    except NotStored as error:
        free = disk_usage(directory).free
        raise NotStored(f"{directory} ({free} bytes free) does not take changes: {error}") from error
    require_storage(directory)
