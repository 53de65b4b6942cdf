"""Definition offers: finds definitions of other systems in the broker, and offers them to engineers.

A notification is a hint: the entities that it names are read from the broker. All definitions are queried at
the start, after a lost connection, and regularly. The file of each entity is loaded independently of the
others, so that a slow address delays no other offer. An entity that a component of ours has written, and that
nobody has changed since, is never offered (`handover.files.content_digest`).
"""

import asyncio
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any

from fastapi import Request

from handover.broker import BrokerClient, BrokerError, NotFound
from handover.broker.cells import OtherCells
from handover.broker.resync import Resync
from handover.errors import Problem
from handover.files.content_digest import is_ours
from handover.messages import text_of
from handover.runtime.background_tasks import BackgroundTasks
from handover.subscriptions.notifications import NotificationReceiver
from handover.subscriptions.own_subscriptions import OwnSubscriptions
from handover.telemetry import get_logger
from handover_processes.definitions.offer_rules import (
    OFFERED_TYPES,
    RESOURCES,
    Candidate,
    check_file,
    is_url,
    open_entities,
    read_candidate,
    type_of_entity,
    with_fault,
)
from handover_processes.documents.downloads import Downloader, DownloadFailed
from handover_processes.records.offers import OfferRecord, OfferStatus
from handover_processes.running.orchestrator import Orchestrator
from handover_processes.running.reconcile import Reconciler

log = get_logger(__name__)

RECONCILE_FACTOR = 6
"""All definitions are queried once in so many periods of reconciliation: their files may be large."""
MAX_DOWNLOADS = 4
"""Concurrent downloads."""
RETRY_DOWNLOAD_S = 30.0


class DefinitionOffers:
    """Offers definitions of other systems; an asynchronous context manager while it does so."""

    def __init__(self, orchestrator: Orchestrator, broker: BrokerClient, reconciler: Reconciler) -> None:
        self._orchestrator = orchestrator
        self._broker = broker
        self._reconciler = reconciler
        self._settings = orchestrator.settings
        self._receiver = NotificationReceiver("task-orchestrator", self._settings, broker)
        self._subscriptions = OwnSubscriptions("task-orchestrator", self._settings, broker)
        self._resync = Resync(self._try_reconcile, self._settings.reconcile_s * RECONCILE_FACTOR)
        self._cells = OtherCells(self._settings, broker)
        self._last: dict[str, str] = {}
        """The content of each entity that was seen last, as the id of its offer."""
        self._retry_at_s: dict[str, float] = {}
        """When the file of an offer may be loaded again, after a failure."""
        self._to_read: dict[str, set[str]] = {}
        self._has_to_read = asyncio.Event()
        self._downloader = Downloader(self._settings.outbound_policy(), self._settings.ca_files)
        self._downloads = asyncio.Semaphore(MAX_DOWNLOADS)
        self._tasks = BackgroundTasks("definition-offers")

    async def __aenter__(self) -> "DefinitionOffers":
        self._receiver.require_key()
        await self._tasks.__aenter__()
        self._tasks.start(self._resync.run)
        self._tasks.start(self._read_notified)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._tasks.__aexit__()
        self._downloader.close()

    async def receive_notification(self, request: Request) -> None:
        """Read the entities of a notification soon; raise `Problem` if it is refused."""
        for entity in await self._receiver.receive(request):
            type_ = type_of_entity(entity)
            if type_ is not None and not is_ours(entity) and not self._cells.has(entity["id"]):
                self._to_read.setdefault(type_, set()).add(entity["id"])
        self._has_to_read.set()

    async def reconcile(self) -> None:
        """Query all definitions once, and offer those of other systems."""
        await self._orchestrator.cell.require()
        await self._cells.read()
        await self._subscriptions.keep(self._subscription())
        definitions = [entity for type_ in OFFERED_TYPES for entity in await self._broker.query(type=type_)]
        entities = [definition for definition in definitions if not self._cells.has(definition.get("id"))]
        await self._receive(entities)
        present = {entity.get("id") for entity in entities}
        for entity_id in open_entities(self._orchestrator.state.offers) - present:
            with suppress(NotFound):
                await self._receive([await self._broker.retrieve(entity_id)])
                continue
            await self._withdraw(entity_id)

    async def accept(self, offer: str, *, by: str, why: str | None) -> OfferRecord:
        """Accept an offer if its entity still has the content that the engineer saw.

        Raises `Problem` 404 if there is no such offer, 409 if it is closed or its entity was changed or
        deleted, 422 if it has faults, and 503 if the broker does not answer.
        """
        record = self._orchestrator.offering.require(offer)
        if record.status in {OfferStatus.OPEN, OfferStatus.REJECTED}:
            await self._require_unchanged(record)
        accepted = await self._orchestrator.offering.accept(offer, by=by, why=why)
        log.info("offer accepted", offer=offer, entity=record.entity, by=by)
        self._apply_resources(record)
        return accepted

    async def reject(self, offer: str, *, by: str, why: str | None) -> OfferRecord:
        """Reject an offer; raise `Problem` 404 if there is no such offer, 409 if it is closed."""
        rejected = await self._orchestrator.offering.reject(offer, by=by, why=why)
        log.info("offer rejected", offer=offer, entity=rejected.entity, by=by)
        self._apply_resources(rejected)
        return rejected

    def _apply_resources(self, record: OfferRecord) -> None:
        if record.type in RESOURCES:
            self._reconciler.request_agents()

    async def _require_unchanged(self, record: OfferRecord) -> None:
        try:
            entity = await self._broker.retrieve(record.entity)
        except NotFound:
            await self._withdraw(record.entity)
            raise Problem.translated(
                409,
                "Entity is gone",
                "offer.gone",
                "{entity} was deleted from the broker",
                entity=record.entity,
            ) from None
        candidate = read_candidate(entity)
        if candidate is None or candidate.id != record.id or is_ours(entity):
            await self._receive([entity])
            raise Problem.translated(
                409,
                "Entity has changed",
                "offer.changed",
                "{entity} was changed meanwhile; look at the present offer of it",
                entity=record.entity,
            )

    async def _receive(self, entities: Iterable[Mapping[str, Any]]) -> None:
        """Offer the entities of other systems that have changed."""
        offers = self._orchestrator.state.offers
        changed: list[Candidate] = []
        for entity in entities:
            if type_of_entity(entity) is None:
                continue
            entity_id = str(entity["id"])
            if is_ours(entity):
                offers.foreign.discard(entity_id)
                if entity_id in open_entities(offers):
                    await self._withdraw(entity_id)
                continue
            offers.foreign.add(entity_id)
            candidate = read_candidate(entity)
            if candidate is not None and self._is_news(candidate):
                self._last[entity_id] = candidate.id
                changed.append(candidate)
        if changed:
            await asyncio.gather(*(self._offer(candidate) for candidate in changed))

    def _is_news(self, candidate: Candidate) -> bool:
        if self._last.get(candidate.entity) != candidate.id:
            return True
        retry_at_s = self._retry_at_s.get(candidate.id)
        return retry_at_s is not None and asyncio.get_running_loop().time() >= retry_at_s

    async def _offer(self, candidate: Candidate) -> None:
        offer = self._orchestrator.state.offers.find(candidate.id)
        if offer is None or not (offer.has_file or offer.is_decided):
            candidate = await self._with_file(candidate)
        if self._last.get(candidate.entity) != candidate.id:
            return  # it was changed while the file was loaded
        try:
            await self._orchestrator.offering.receive([candidate])
        except Problem as problem:
            self._last.pop(candidate.entity, None)
            log.warning("offer not stored yet", entity=candidate.entity, error=str(problem))
            return
        present = self._orchestrator.state.offers.find(candidate.id)
        if offer is None and present is not None:
            faults = [str(fault) for fault in present.faults]
            log.info("definition offered", entity=candidate.entity, offer=candidate.id, faults=faults)

    async def _with_file(self, candidate: Candidate) -> Candidate:
        """Return the candidate with its BPMN file, or with the fault why there is none."""
        if candidate.bpmn is None or candidate.faults:
            return candidate
        self._retry_at_s.pop(candidate.id, None)
        if not is_url(candidate.bpmn):
            file = candidate.bpmn.encode("utf-8", "surrogatepass")
        else:
            try:
                async with self._downloads:
                    file = await self._downloader.download(candidate.bpmn.strip())
            except DownloadFailed as failure:
                self._retry_at_s[candidate.id] = asyncio.get_running_loop().time() + RETRY_DOWNLOAD_S
                return with_fault(candidate, text_of(failure))
        return await asyncio.to_thread(check_file, candidate, file)

    async def _withdraw(self, entity: str) -> None:
        self._last.pop(entity, None)
        self._orchestrator.state.offers.foreign.discard(entity)
        await self._orchestrator.offering.receive((), gone=[entity])

    async def _read_notified(self) -> None:
        while True:
            await self._has_to_read.wait()
            self._has_to_read.clear()
            requested, self._to_read = self._to_read, {}
            self._tasks.start(self._read, requested)

    async def _read(self, requested: Mapping[str, set[str]]) -> None:
        """Read the entities of notifications, and offer them."""
        try:
            for type_, ids in requested.items():
                await self._receive(await self._receiver.read(type_, ids))
        except (BrokerError, Problem) as error:
            log.warning("changed definitions not read", error=str(error))
            self._resync.request()

    async def _try_reconcile(self) -> bool:
        try:
            await self.reconcile()
        except BrokerError as error:
            log.warning("definitions not reconciled", error=str(error))
            return False
        except Problem as problem:
            log.warning("offers not stored", error=str(problem))
            return False
        return True

    def _subscription(self) -> dict[str, Any]:
        return {
            "id": self._settings.entity_id("Subscription", "task-orchestrator-definitions"),
            "type": "Subscription",
            "description": "Definitions of other systems for the orchestrator",
            "entities": self._cells.selectors(*OFFERED_TYPES),
            "notification": {
                "format": "normalized",
                "endpoint": self._receiver.endpoint(
                    f"{self._settings.orchestrator}/notifications/definitions"
                ),
            },
        }
