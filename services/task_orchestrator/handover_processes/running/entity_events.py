"""Entity events: the subscriptions to the entities that start, move and interrupt processes.

There is one subscription for each distinct filter. Its notifications go to a route of its own. A condition is
evaluated with the data of the notification, so a value that returns at once counts. For a message or signal
the notification is a hint: the entity is read from the broker, and several notifications cause one query.

Each filter is also queried every few seconds, which finds what happened while the orchestrator or the broker
was down. Work on one filter is serialized, so an older answer never follows a newer one.
"""

import asyncio
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from typing import Any

from fastapi import Request

from handover.alerts import alert_id, clear_alert, raise_alert
from handover.alerts.catalogue import ENTITY_FILTER_REFUSED
from handover.broker import BrokerClient, BrokerError, BrokerUnavailable
from handover.broker.cells import OtherCells
from handover.broker.resync import Resync
from handover.errors import Problem
from handover.runtime.background_tasks import BackgroundTasks
from handover.subscriptions.notifications import NotificationReceiver
from handover.subscriptions.own_subscriptions import OwnSubscriptions
from handover.telemetry import get_logger
from handover_bpmn.model import EntityFilter
from handover_processes.events.entity_delivery import Watched
from handover_processes.events.entity_matching import replay
from handover_processes.records.step import Step
from handover_processes.running.orchestrator import Orchestrator

log = get_logger(__name__)

MAX_ENTITIES_PER_STEP = 100
MAX_ID_LENGTH = 2000

Entities = Sequence[Mapping[str, Any]]


class EntityEvents:
    """Delivers entities of the broker to processes; an asynchronous context manager."""

    def __init__(self, orchestrator: Orchestrator, broker: BrokerClient) -> None:
        self._orchestrator = orchestrator
        self._broker = broker
        self._settings = orchestrator.settings
        self._delivery = orchestrator.state.entities
        self._receiver = NotificationReceiver("task-orchestrator", self._settings, broker)
        self._subscriptions = OwnSubscriptions("task-orchestrator", self._settings, broker)
        self._resync = Resync(self._try_reconcile, self._settings.reconcile_s)
        self._cells = OtherCells(self._settings, broker)
        self._subscribed: set[str] | None = None
        """The filters with a subscription; None: unknown, since the broker was not reachable."""
        self._watched: dict[str, Watched] = {}
        self._locks: dict[str, asyncio.Lock] = defaultdict(asyncio.Lock)
        self._was_disconnected = True
        """Whether conditions may have been true meanwhile without a notification."""
        self._queried: set[str] = set()
        self._refused: set[str] = set()
        """The filters that the broker refuses; there is an Alert for each."""
        self._alerts_known = False
        """Whether the Alerts of an earlier run were compared with the filters."""
        self._to_read: dict[str, set[str]] = {}
        self._waits_changed = asyncio.Event()
        self._tasks = BackgroundTasks("entity-events")

    async def __aenter__(self) -> "EntityEvents":
        self._receiver.require_key()
        self._orchestrator.state.on_entity_waits = self._waits_changed.set
        await self._tasks.__aenter__()
        self._tasks.start(self._resync.run)
        self._tasks.start(self._follow_waits)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._tasks.__aexit__()

    async def receive_notification(self, key: str, request: Request) -> None:
        """Deliver the entities of a notification for the filter `key`.

        Raises `Problem` if the notification is refused, or if the consequences cannot be stored.
        """
        received = await self._receiver.receive(request)
        watched = self._watched.get(key)
        if watched is None:
            return
        entities = self._usable(watched.on, received)
        if watched.messages:
            self._to_read.setdefault(key, set()).update(entity["id"] for entity in entities)
        async with self._locks[key]:
            if watched.conditions:
                await self._judge(key, entities)
            ids = self._to_read.pop(key, None)
            if ids is None:
                return  # another notification has read them
            try:
                read = await self._receiver.read(watched.on.type, ids, q=watched.on.q)
                present = self._usable(watched.on, read)
            except BrokerError as error:
                log.warning("changed entities not read", error=str(error))
                self._resync.request()
                return
            if self._delivery.seen.has_baseline(key):
                await self._receive(key, present)
                await self._forget(key, ids.difference(entity["id"] for entity in present))

    async def reconcile(self) -> None:
        """Register missing subscriptions, remove unused ones, and query every filter once."""
        await self._orchestrator.writer.recover()
        await self._orchestrator.cell.require()
        await self._cells.read()
        watched = self._watched = self._delivery.watched()
        await self._update_subscriptions(watched)
        if not self._alerts_known:
            await self._find_alerts(watched)
        failure: BrokerUnavailable | None = None
        moment = self._orchestrator.clock()
        since = self._delivery.contact() if self._was_disconnected else None
        for key, watch in watched.items():
            try:
                await self._reconcile_filter(key, watch, since)
                if key in (self._subscribed or ()):
                    await self._clear_refused(key)
            except BrokerUnavailable as error:
                failure = error
            except BrokerError as error:
                log.warning("filter of entities refused", type=watch.on.type, q=watch.on.q, error=str(error))
                await self._report_refused(key, watch.on, str(error))
        if failure is not None:
            raise failure
        self._was_disconnected = False
        if any(self._delivery.has_conditions(key) for key in watched):
            await self._store_contact(moment)
        if self._delivery.has_unused():
            await self._orchestrator.writer.apply(self._delivery.remove_unused)

    async def _report_refused(self, key: str, on: EntityFilter, why: str) -> None:
        """Raise the Alert that an event can never occur, since the broker refuses its filter."""
        if key in self._refused:
            return
        source, event = self._delivery.user_of(key)
        await raise_alert(
            self._broker,
            self._settings,
            ENTITY_FILTER_REFUSED,
            key=_refused_key(key),
            source=source,
            description=ENTITY_FILTER_REFUSED.describe(
                "alert.entity_filter_refused",
                event=event,
                type=on.type,
                q=on.q or "-",
                why=why,
            ),
        )
        self._refused.add(key)

    async def _find_alerts(self, watched: Mapping[str, Watched]) -> None:
        """Clear the Alerts of an earlier run about filters that are gone, and remember the others."""
        pattern = alert_id(self._settings, _refused_key(".")).replace(".", "[.]")
        pattern = f"^{pattern.removesuffix('[.]-refused')}.*-refused$"
        alerts = await self._broker.query(type="Alert", id_pattern=pattern)
        active = {str(alert["id"]) for alert in alerts if "validTo" not in alert}
        for key in watched:
            if (raised := alert_id(self._settings, _refused_key(key))) in active:
                active.discard(raised)
                self._refused.add(key)
        for gone in active:
            await clear_alert(self._broker, self._settings, key=gone.rpartition(":")[2])
        self._alerts_known = True

    async def _clear_refused(self, key: str) -> None:
        if key in self._refused:
            await clear_alert(self._broker, self._settings, key=_refused_key(key))
            self._refused.discard(key)

    async def _reconcile_filter(self, key: str, watched: Watched, since: str | None = None) -> None:
        """Query a filter; with `since` evaluate conditions also for the states since then."""
        on = watched.on
        async with self._locks[key]:
            queried = await self._broker.query(type=on.type, id_pattern=on.id_pattern, q=on.q)
            entities = self._usable(on, queried)
            present = {entity["id"] for entity in entities}
            if watched.messages and not self._delivery.seen.has_baseline(key):
                await self._set_baseline(key, entities)
            elif watched.messages:
                await self._receive(key, self._delivery.news(key, entities))
            if since is not None and self._delivery.has_conditions(key):
                await self._replay(key, on, since, {entity["id"]: entity for entity in entities})
            await self._judge(key, entities)
            await self._forget(key, self._delivery.gone(key, present))
            if key not in self._queried:
                self._queried.add(key)
                log.info("entities queried", filter=key, type=on.type, q=on.q, entities=len(entities))

    async def _replay(self, key: str, on: EntityFilter, since: str, present: Mapping[str, Any]) -> None:
        """Evaluate conditions for the states that entities had while nobody was connected.

        With `q` that is impossible: only the broker can evaluate it, and it does so for the present state.
        """
        if on.q is not None:
            return
        try:
            evolutions = await self._broker.evolution(since, type=on.type, id_pattern=on.id_pattern)
            usable = self._usable(on, evolutions)
        except BrokerUnavailable:
            raise
        except BrokerError as error:
            log.warning("no history of entities", type=on.type, error=str(error))
            return
        for evolution in usable:
            for state in replay(evolution, present.get(evolution["id"], {})):
                await self._judge(key, [state])

    async def _set_baseline(self, key: str, entities: Entities) -> None:
        for some in _in_parts(entities) or [()]:
            is_complete = not entities or some[-1] is entities[-1]

            def act(step: Step, some: Entities = some, is_complete: bool = is_complete) -> None:
                self._delivery.set_baseline(step, key, some, is_complete=is_complete)

            await self._orchestrator.writer.apply(act)

    async def _receive(self, key: str, entities: Entities) -> None:
        for some in _in_parts(entities):
            taken = await self._taken(key, some)

            def act(step: Step, some: Entities = some, taken: Mapping[str, str] = taken) -> None:
                self._delivery.receive(step, key, some, taken, self._orchestrator.clock())

            await self._orchestrator.writer.apply(act)

    async def _judge(self, key: str, entities: Entities) -> None:
        for some in _in_parts(entities) if self._delivery.has_conditions(key) else ():
            taken = await self._taken(key, some)

            def act(step: Step, some: Entities = some, taken: Mapping[str, str] = taken) -> None:
                self._delivery.judge(step, key, some, taken, self._orchestrator.clock())

            await self._orchestrator.writer.apply(act)

    async def _forget(self, key: str, ids: Collection[str]) -> None:
        if ids:
            await self._orchestrator.writer.apply(
                lambda step: self._delivery.forget(step, key, ids, self._orchestrator.clock())
            )

    async def _taken(self, key: str, entities: Entities) -> dict[str, str]:
        """Return which business keys of new processes are in use, with the definition that uses them."""
        keys = self._delivery.business_keys(key, entities)
        if not keys:
            return {}
        store = self._orchestrator.store
        taken: dict[str, str] = await self._orchestrator.on_disk(store.business_keys, sorted(keys))
        return taken

    def _usable(self, on: EntityFilter, entities: Entities) -> list[Mapping[str, Any]]:
        """Return the entities that this orchestrator has not written, with an id that can be stored.

        Those of other cells are among them where the filter selects by id.
        """
        return [
            entity
            for entity in entities
            if _is_storable(entity.get("id"))
            and not self._delivery.is_own(entity["id"])
            and (on.id_pattern is not None or not self._cells.has(entity["id"]))
        ]

    async def _store_contact(self, moment: datetime) -> None:
        await self._orchestrator.writer.apply(lambda step: self._delivery.set_contact(step, moment))

    async def _update_subscriptions(self, watched: Mapping[str, Watched]) -> None:
        if not watched and self._subscribed == set():
            return
        prefix = self._subscription_id("")
        listed = {
            str(subscription.get("id")): subscription for subscription in await self._broker.subscriptions()
        }
        registered = {
            subscription_id.removeprefix(prefix)
            for subscription_id in listed
            if subscription_id.startswith(prefix)
        }
        for key in registered - set(watched):
            await self._subscriptions.drop(self._subscription_id(key))
        kept: set[str] = set()
        for key in watched:
            try:
                await self._subscriptions.keep(self._subscription(key, watched[key]), listed)
            except BrokerUnavailable:
                raise
            except BrokerError as error:
                on = watched[key].on
                log.warning("subscription to entities refused", type=on.type, q=on.q, error=str(error))
                await self._report_refused(key, on, str(error))
            else:
                kept = kept | {key}
        self._subscribed = kept
        self._queried &= set(watched)
        for key in self._refused - set(watched):
            await self._clear_refused(key)
        for key in set(self._locks) - set(watched):
            if not self._locks[key].locked():
                del self._locks[key]

    def _subscription_id(self, key: str) -> str:
        return self._settings.entity_id("Subscription", f"task-orchestrator-entities-{key}")

    def _subscription(self, key: str, watched: Watched) -> dict[str, Any]:
        on = watched.on
        by_id = None if on.id_pattern is None else [{"type": on.type, "idPattern": on.id_pattern}]
        address = f"{self._settings.orchestrator}/notifications/entities/{key}"
        return {
            "id": self._subscription_id(key),
            "type": "Subscription",
            "description": "Entities that are events of processes",
            "entities": by_id or self._cells.selectors(on.type),
            **({} if on.q is None else {"q": on.q}),
            "notification": {"format": "normalized", "endpoint": self._receiver.endpoint(address)},
        }

    async def _try_reconcile(self) -> bool:
        try:
            await self.reconcile()
        except BrokerError as error:
            log.warning("entities not reconciled", error=str(error))
            self._subscribed, self._was_disconnected = None, True
            return False
        except Problem as problem:
            log.warning("entity events not stored", error=str(problem))
            return False
        return True

    async def _follow_waits(self) -> None:
        """Subscribe to new filters, and evaluate a condition soon after a process began to wait for it."""
        while True:
            await self._waits_changed.wait()
            self._waits_changed.clear()
            index = self._orchestrator.state.events.entity_index
            keys, index.new_conditions = index.new_conditions, set()
            watched = self._watched = self._delivery.watched()
            if self._subscribed is None or set(watched) - self._subscribed:
                self._resync.request()
            try:
                for key in keys & set(watched):
                    await self._reconcile_filter(key, watched[key])
                if keys and not self._was_disconnected:  # an earlier state is none of the new waits
                    await self._store_contact(self._orchestrator.clock())
            except Problem as problem:
                log.warning("condition not evaluated yet", error=str(problem))
                self._resync.request()


def _is_storable(entity_id: object) -> bool:
    return isinstance(entity_id, str) and 0 < len(entity_id) <= MAX_ID_LENGTH and "\0" not in entity_id


def _in_parts(entities: Entities) -> list[Entities]:
    return [
        entities[start : start + MAX_ENTITIES_PER_STEP]
        for start in range(0, len(entities), MAX_ENTITIES_PER_STEP)
    ]


def _refused_key(filter_key: str) -> str:
    return f"filter {filter_key} refused"
