"""The broker as an application: NGSI-LD under /ngsi-ld/v1 in plain ASGI, health and metrics beside it."""

import gc
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from typing import Final

from fastapi import FastAPI
from prometheus_client import Counter, Gauge, Histogram
from starlette.types import ASGIApp, Receive, Scope, Send

from handover.errors import Problem
from handover.service import create_app
from handover.telemetry import get_logger
from services.context_broker.batch_operations import BatchOperations
from services.context_broker.contexts import ContextBook
from services.context_broker.discovery_operations import DiscoveryOperations
from services.context_broker.entity_operations import EntityOperations
from services.context_broker.exchange import (
    PREFIX,
    Answer,
    Disconnected,
    Exchange,
    path_parts,
    problem_answer,
    received,
    send_answer,
)
from services.context_broker.journal import Entries, Journal, NotStored, SqliteJournal
from services.context_broker.notifier import Notifier
from services.context_broker.problems import (
    ERRORS,
    method_not_allowed,
    no_such_tenant,
    not_found,
    not_stored,
)
from services.context_broker.settings import BrokerSettings
from services.context_broker.store import Store
from services.context_broker.subscription_operations import SubscriptionOperations

log = get_logger(__name__)

Operation = Callable[[Exchange], Awaitable[Answer]]

ENTITIES = Gauge("handover_broker_entities", "Entities in the broker")
REQUESTS = Counter("handover_broker_requests_total", "Requests answered", ["operation", "status"])
SECONDS = Histogram(
    "handover_broker_request_seconds",
    "From a request to its answer, commit included",
    ["operation"],
    buckets=(0.0005, 0.001, 0.002, 0.005, 0.01, 0.05, 0.1, 0.5, 1, 5),
)
_ROOMS: Final = {
    "entities": ("entities", "entities/*", "entities/*/attrs", "entities/*/attrs/*"),
    "subscriptions": ("subscriptions", "subscriptions/*"),
    "types": ("types", "types/*"),
}


class Broker:
    """The broker's parts, put together."""

    def __init__(self, settings: BrokerSettings, journal: Journal) -> None:
        self.settings = settings
        self.journal = journal
        self.contexts = ContextBook(self._keep_context, settings.broker_context_timeout_s)
        self.notifier = Notifier(
            timeout_s=settings.broker_notification_timeout_s,
            keep_s=settings.broker_notification_keep_h * 3600,
        )
        self.store = Store(journal, self.notifier.announce, self.notifier.deliver)
        self.notifier.store = self.store
        self.subscriptions = SubscriptionOperations(self.store, self.notifier, self.contexts)
        self.routes = self._routes()
        self._seen: dict[tuple[str, int], tuple[Counter, Histogram]] = {}

    async def start(self) -> None:
        """Take up what the journal holds, and begin to notify."""
        for url, stored in self.journal.contexts():
            self.contexts.remember(url, stored)
        self.store.load()
        self.store.commits.start()
        self.notifier.start(await self.subscriptions.restore())
        ENTITIES.set_function(lambda: len(self.store))
        gc.freeze()  # what was loaded stays: collections need not walk through it again and again
        log.info("broker ready", entities=len(self.store), file=str(self.settings.data_dir / "broker.db"))

    async def stop(self) -> None:
        """Commit what is on its way, and close."""
        self.notifier.stop()
        await self.store.commits.stop()
        self.journal.close()

    async def answer(self, scope: Scope, receive: Receive) -> Answer:
        """Answer one request."""
        method: str = scope["method"]
        parts = path_parts(scope)
        shape, names = _shape(parts)
        methods = self.routes.get(shape)
        if methods is None:
            raise not_found(
                f"there is nothing at {scope['path']}; see {PREFIX}entities and {PREFIX}subscriptions"
            )
        operation = methods.get(method)
        if operation is None:
            raise method_not_allowed(f"{scope['path']} takes {', '.join(methods)}, not {method}")
        exchange = await received(scope, receive, names, self.contexts, self.settings.broker_max_body_bytes)
        if exchange.headers.get(b"ngsild-tenant"):
            raise no_such_tenant("this broker keeps one tenant only; leave the NGSILD-Tenant header out")
        started_s = time.perf_counter()
        try:
            answer = await operation(exchange)
        except Problem as problem:
            answer = problem_answer(problem)
        self._observe(f"{method} {shape}", answer.status, time.perf_counter() - started_s)
        return answer

    def _observe(self, operation: str, status: int, seconds: float) -> None:
        key = (operation, status)
        seen = self._seen.get(key)
        if seen is None:
            seen = REQUESTS.labels(operation, str(status)), SECONDS.labels(operation)
            self._seen[key] = seen
        seen[0].inc()
        seen[1].observe(seconds)

    async def _keep_context(self, url: str, text: bytes) -> None:
        try:
            await self.store.commits.store(Entries(contexts={url: text}))
        except NotStored as error:
            raise not_stored(str(error)) from error

    def _routes(self) -> Mapping[str, Mapping[str, Operation]]:
        entities = EntityOperations(self.store)
        batch = BatchOperations(entities)
        discovery = DiscoveryOperations(self.store, f"handover-{self.settings.factory}")
        subscriptions = self.subscriptions
        return {
            "entities": {"GET": entities.query, "POST": entities.create},
            "entities/*": {
                "GET": entities.retrieve,
                "DELETE": entities.delete,
                "PUT": entities.replace,
                "PATCH": entities.merge,
            },
            "entities/*/attrs": {"POST": entities.append, "PATCH": entities.update},
            "entities/*/attrs/*": {
                "PATCH": entities.update_attribute,
                "PUT": entities.replace_attribute,
                "DELETE": entities.delete_attribute,
            },
            "entityOperations/create": {"POST": batch.create},
            "entityOperations/upsert": {"POST": batch.upsert},
            "entityOperations/update": {"POST": batch.update},
            "entityOperations/merge": {"POST": batch.merge},
            "entityOperations/delete": {"POST": batch.delete},
            "entityOperations/query": {"POST": batch.query},
            "types": {"GET": discovery.types},
            "types/*": {"GET": discovery.type_details},
            "subscriptions": {"GET": subscriptions.list, "POST": subscriptions.create},
            "subscriptions/*": {
                "GET": subscriptions.retrieve,
                "PATCH": subscriptions.update,
                "DELETE": subscriptions.delete,
            },
            "info/sourceIdentity": {"GET": discovery.source_identity},
        }


def create_broker(settings: BrokerSettings) -> ASGIApp:
    """Return the broker as an ASGI application; raise `UsageError` when its file cannot be used."""
    journal = SqliteJournal(settings.data_dir / "broker.db")
    journal.open()
    broker = Broker(settings, journal)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        await broker.start()
        yield
        await broker.stop()

    operations = create_app(
        "Context broker",
        description="The embedded NGSI-LD broker (ETSI GS CIM 009). NGSI-LD itself is under /ngsi-ld/v1.",
        lifespan=lifespan,
    )

    async def application(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or not scope["path"].startswith(PREFIX):
            await operations(scope, receive, send)
            return
        try:
            answer = await broker.answer(scope, receive)
        except Problem as problem:
            answer = problem_answer(problem)
        except Disconnected:
            return
        except Exception as error:  # one broken request must not end the connection without an answer
            log.exception("request failed", method=scope["method"], path=scope["path"])
            reason = f"{type(error).__name__} while answering; the log of the broker has more"
            answer = problem_answer(Problem(500, "Internal error", reason, ERRORS + "InternalError"))
        await send_answer(send, answer)

    return application


def _shape(parts: list[str]) -> tuple[str, tuple[str, ...]]:
    """Return the path with its names as stars, and the names."""
    rooms = _ROOMS.get(parts[0])
    if rooms is None:
        return "/".join(parts), ()
    if len(parts) > len(rooms) or (len(parts) > 2 and parts[2] != "attrs"):
        return "", ()
    return rooms[len(parts) - 1], tuple(parts[1::2])
