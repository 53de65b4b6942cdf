"""Operations on snapshots (clauses 5.16, 6.36 to 6.38), and where NGSILD-Snapshot leads (6.3.22).

A snapshot is made after its creation has been answered: its queries are carried out, sources included, and
what they find is written as the content of a tenant of its own, which becomes visible at once.
"""

import asyncio
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Final
from urllib.parse import quote, urlsplit
from uuid import uuid4

import orjson

from handover.errors import Problem
from handover.telemetry import get_logger
from services.context_broker.api.exchange import PREFIX, Answer, Exchange
from services.context_broker.api.operation import Operation
from services.context_broker.api.problems import (
    already_exists,
    not_found,
    not_stored,
)
from services.context_broker.api.words import inside, moment, outside, require_uri, timestamp_now
from services.context_broker.distribution.distribution import in_place_of
from services.context_broker.snapshots.content import Content, end_of, written
from services.context_broker.snapshots.making import HEADER, Answering, asked, gathered
from services.context_broker.snapshots.past import EVERYTHING, Perform, copied
from services.context_broker.snapshots.purge import purged
from services.context_broker.snapshots.snapshot import (
    MOST_HELD,
    MOST_SNAPSHOTS,
    PAST,
    PRESENT,
    QUERIES,
    Snapshot,
    Status,
    checked,
    checked_change,
    details,
    ending,
    new_snapshot,
    status_of,
)
from services.context_broker.snapshots.telling import Tellings, restored, telling_of
from services.context_broker.sources.registration_operations import answer, with_context
from services.context_broker.storage.journal import Entries, Journal, Kind, NotStored
from services.context_broker.storage.tenants import DEFAULT, Tenant, Tenants

log = get_logger(__name__)

USE_NOTED_S: Final = 10.0
"""How often the time of the last use is written, at most: it is not worth a write for each use."""
LONGEST_NAP_S: Final = 86400.0
OUTSIDE_SNAPSHOTS: Final = frozenset(
    {"createSnapshot", "purgeSnapshots", "retrieveSnapshotStatus", "updateSnapshotStatus", "deleteSnapshot",
     "cloneSnapshot"}
)  # fmt: skip
"""Operations that are about snapshots themselves, wherever they are asked for."""
_DONE: Final = Answer(204)
_PURGE: Final = frozenset({"q"})


class SnapshotOperations:
    """What can be done to snapshots."""

    def __init__(self, tenants: Tenants, carry_out: Answering, by_name: Perform) -> None:
        self._tenants = tenants
        self._carry_out = carry_out
        self._by_name = by_name
        self.tellings = Tellings(tenants)
        self._one_at_a_time = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations of this room."""
        all_of_them, one, clone = "snapshots", "snapshots/{id}", "snapshots/{id}/clone"
        return (
            Operation("POST", all_of_them, "createSnapshot", "6.36.3.1", self.create),
            Operation("DELETE", all_of_them, "purgeSnapshots", "6.36.3.2", self.purge, _PURGE),
            Operation("GET", one, "retrieveSnapshotStatus", "6.37.3.1", self.retrieve),
            Operation("PATCH", one, "updateSnapshotStatus", "6.37.3.2", self.update),
            Operation("DELETE", one, "deleteSnapshot", "6.37.3.3", self.delete),
            Operation("POST", clone, "cloneSnapshot", "6.38.3.1", self.clone),
        )

    def start(self, journal: Journal) -> None:
        """See to the ends of the snapshots of before, and clear away what a power cut has left of others.

        What was not told is told now, and that what was being made has failed.
        """
        owed = [restored(*stored) for stored in journal.documents(Kind.SNAPSHOT_TELLING)]
        for telling in sorted(owed, key=lambda one: one.at):
            self.tellings.take(telling)
        kept: set[str] = set()
        for tenant in self._tenants:
            kept.update(inside(tenant.name, one) for one in tenant.snapshots)
            for one in tenant.snapshots.values():
                self.see_to_its_end(tenant, one)
                if one.was_cut_short and self._tenants.leadership.leads:
                    self._later(self._keep(tenant, one, tells=True))
        for tenant in self._tenants:
            if outside(tenant.name)[1] is not None and tenant.name not in kept:
                self._later(self._clear(tenant))

    async def follow(self, name: str, snapshot_id: str, body: bytes | None) -> None:
        """Take what another broker did to a snapshot of the tenant of that name."""
        tenant = self._tenants.kept(name)
        if body is None:
            tenant.snapshots.pop(snapshot_id, None)
        else:
            one = tenant.snapshots[snapshot_id] = Snapshot(snapshot_id, orjson.loads(body))
            self.see_to_its_end(tenant, one)

    def stop(self) -> None:
        """Make no more; what is unfinished has failed at the next start."""
        for task in self._tasks:
            task.cancel()
        self.tellings.stop()

    def inside(self, exchange: Exchange) -> Tenant:
        """Return what a request with NGSILD-Snapshot is about (clause 6.3.22); raise a problem (404)."""
        tenant = exchange.tenant
        found = _existing(tenant, exchange.headers[HEADER].decode("latin-1").strip())
        found.used()
        if time.monotonic() - found.written_s > USE_NOTED_S:
            found.written_s = time.monotonic()
            tenant.commits.store_later(_entries(tenant, found))
        return self._tenants.inside(tenant, found.id)

    async def create(self, exchange: Exchange) -> Answer:
        """POST snapshots."""
        given, _ = await exchange.body()
        made = new_snapshot(_named(given), checked(given, has_queries=True))
        await self._begin(exchange, made)
        self._later(self._fill(exchange, made, given.get("@context")))
        return _created(made)

    async def clone(self, exchange: Exchange) -> Answer:
        """POST snapshots/{id}/clone: a copy that ends, and changes, by itself (clause 5.16.2)."""
        original = _existing(exchange.tenant, exchange.names[0])
        given = checked((await exchange.body())[0], has_queries=False)
        queries: dict[str, Any] = {
            name: original.document[name] for name in QUERIES if name in original.document
        }
        made = new_snapshot(_named(given), {**given, **queries})
        await self._begin(exchange, made)
        self._later(self._copy(exchange, original, made))
        return _created(made)

    async def retrieve(self, exchange: Exchange) -> Answer:
        """GET snapshots/{id}."""
        return await _told(exchange, _existing(exchange.tenant, exchange.names[0]))

    async def update(self, exchange: Exchange) -> Answer:
        """PATCH snapshots/{id}: its priority, its lifetime, and who is told of it."""
        change = checked_change((await exchange.body())[0])
        members = {name: value for name, value in change.items() if name not in {"type", "@context"}}
        await self._require_open(exchange.tenant, members)
        async with self._one_at_a_time:
            before = _existing(exchange.tenant, exchange.names[0])
            if "snapshotLifetime" in members:
                created_s = moment(before.document["createdAt"]) or time.time()
                start = datetime.fromtimestamp(created_s, UTC)
                members["expiresAt"] = ending(start, members["snapshotLifetime"])
            after = before.changed(**members)
            if after.document.get("snapshotPriority") is None:
                after.document["snapshotPriority"] = before.document["snapshotPriority"]
            await self._keep(exchange.tenant, after, tells=True)
        return await _told(exchange, after)

    async def delete(self, exchange: Exchange) -> Answer:
        """DELETE snapshots/{id}."""
        async with self._one_at_a_time:
            await self._take_away(exchange.tenant, _existing(exchange.tenant, exchange.names[0]))
        return _DONE

    async def purge(self, exchange: Exchange) -> Answer:
        """DELETE snapshots: those for which q holds (clause 5.16.7)."""
        context = await exchange.reader_context()
        wants = purged(exchange.parameter("q"), context)
        async with self._one_at_a_time:
            for one in [found for found in exchange.tenant.snapshots.values() if wants(found)]:
                await self._take_away(exchange.tenant, one)
        return _DONE

    def see_to_its_end(self, tenant: Tenant, one: Snapshot) -> None:
        """Take a snapshot away when it expires, unless it was changed meanwhile."""
        if tenant.snapshots.get(one.id) is not one:
            return
        left_s = one.expires_s - time.time()
        if left_s > 0:
            loop = asyncio.get_running_loop()
            loop.call_later(min(left_s, LONGEST_NAP_S), self.see_to_its_end, tenant, one)
        elif self._tenants.leadership.leads:
            self._later(self._end(tenant, one))

    # Making

    async def _begin(self, exchange: Exchange, made: Snapshot) -> None:
        tenant = exchange.tenant
        await self._require_open(tenant, made.document)
        async with self._one_at_a_time:
            if made.id in tenant.snapshots:
                raise already_exists(f"there is a snapshot {made.id} already; choose another id")
            for one in _by_worth(tenant)[: max(0, len(tenant.snapshots) + 1 - MOST_SNAPSHOTS)]:
                await self._take_away(tenant, one)
            await self._keep(tenant, made)

    async def _fill(self, exchange: Exchange, made: Snapshot, context: Any) -> None:
        """Carry the queries out and keep what they find (clause 5.16.1.4)."""
        tenant, content = exchange.tenant, Content()
        results: dict[str, list[dict[str, Any]]] = {}
        for query in made.document.get(PRESENT, ()):
            asking = asked(exchange, query, context)
            results.setdefault(f"{PRESENT}Details", []).append(
                await gathered(self._carry_out, asking, content)
            )
        is_written = await self._written(tenant, made, content)
        for query in made.document.get(PAST, ()):
            asking = asked(exchange, query, context)
            result = await self._past(asking, self._tenants.inside(tenant, made.id))
            results.setdefault(f"{PAST}Details", []).append(result)
        await self._finish(tenant, made, results, is_written=is_written)

    async def _past(self, exchange: Exchange, inner: Tenant) -> dict[str, Any]:
        try:
            return await copied(self._by_name, exchange, inner)
        except Problem as problem:
            return details(Status.FAILURE, problem)

    async def _copy(self, exchange: Exchange, original: Snapshot, made: Snapshot) -> None:
        tenant, content = exchange.tenant, Content()
        content.add(self._tenants.inside(tenant, original.id).store.candidates(), None)
        is_written = await self._written(tenant, made, content)
        names = [f"{name}Details" for name in QUERIES]
        results = {name: original.document[name] for name in names if name in original.document}
        if PAST in original.document:
            everything = in_place_of(
                asked(exchange, EVERYTHING, None),
                tenant=self._tenants.inside(tenant, original.id),
                parameters={"local": "true"},
            )
            await self._past(everything, self._tenants.inside(tenant, made.id))
        await self._finish(tenant, made, results, is_written=is_written)

    async def _written(self, tenant: Tenant, made: Snapshot, content: Content) -> bool:
        """Write the entities of a snapshot, and make room for them; return whether that could be done."""
        async with self._one_at_a_time:
            for one in self._crowded_out(tenant, made, len(content.entities)):
                await self._take_away(tenant, one)
        try:
            await written(self._tenants.inside(tenant, made.id), content)
        except NotStored as error:
            log.warning("a snapshot was not stored", snapshot=made.id, error=str(error))
            return False
        return True

    async def _finish(
        self, tenant: Tenant, made: Snapshot, results: Mapping[str, list[dict[str, Any]]], *, is_written: bool
    ) -> None:
        told = [one for several in results.values() for one in several]
        status = status_of(told) if is_written else Status.FAILURE
        async with self._one_at_a_time:
            now = tenant.snapshots.get(made.id)
            if now is None:  # it was deleted while it was being made
                await self._clear(self._tenants.inside(tenant, made.id))
                return
            done = now.changed(snapshotStatus=status.value, **results)
            await self._keep(tenant, done, tells=True)

    def _crowded_out(self, tenant: Tenant, made: Snapshot, more: int) -> list[Snapshot]:
        """Return the snapshots that have to go so that there is room for more entities in another."""
        others = [one for one in _by_worth(tenant) if one is not made]
        sizes = [len(self._tenants.inside(tenant, one.id).store) for one in others]
        held, gone = more + sum(sizes), 0
        while held > MOST_HELD and gone < len(others):
            held -= sizes[gone]
            gone += 1
        return others[:gone]

    # Keeping

    async def _keep(self, tenant: Tenant, one: Snapshot, *, tells: bool = False) -> None:
        telling = telling_of(tenant.name, one) if tells else None
        entries = _entries(tenant, one)
        if telling is not None:
            entries.documents[telling.key] = telling.stored()
        await _write(tenant, entries)
        tenant.snapshots[one.id] = one
        self.see_to_its_end(tenant, one)
        if telling is not None:
            self.tellings.take(telling)

    async def _end(self, tenant: Tenant, one: Snapshot) -> None:
        async with self._one_at_a_time:
            if tenant.snapshots.get(one.id) is one:
                await self._take_away(tenant, one)

    async def _take_away(self, tenant: Tenant, one: Snapshot) -> None:
        """Delete a snapshot and all that belongs to it; who is told of it is told so (clause 5.16.6)."""
        gone = Entries(documents={(Kind.SNAPSHOT, tenant.name, one.id): None})
        telling = telling_of(tenant.name, one.changed(expiresAt=timestamp_now()))
        if telling is not None:
            gone.documents[telling.key] = telling.stored()
        await _write(tenant, gone)
        tenant.snapshots.pop(one.id, None)
        await self._clear(self._tenants.inside(tenant, one.id))
        if telling is not None:
            self.tellings.take(telling)

    async def _clear(self, inner: Tenant) -> None:
        """Take all that belongs to a snapshot off the disk."""
        departed = await asyncio.to_thread(lambda: list(inner.notifier.journal.archive.departed(inner.name)))
        for entries in end_of(inner, [(place, one) for place, one, _ in departed]):
            await _write(inner, entries)
        if inner.is_kept:
            await _write(inner, Entries(documents={(Kind.TENANT, DEFAULT, inner.name): None}))
        self._tenants.drop(inner.name)

    # Telling

    async def _require_open(self, tenant: Tenant, document: Mapping[str, Any]) -> None:
        if document.get("endpoint") is not None:
            host = urlsplit(document["endpoint"]).hostname or ""
            await tenant.notifier.outbound.destinations.require_open(host, '"endpoint"')

    def _later(self, work: Any) -> None:
        task: asyncio.Task[None] = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._on_end)

    def _on_end(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("work on a snapshot failed", exc_info=error)


def _named(given: Any) -> str:
    named = given.get("id") if isinstance(given, Mapping) else None
    return named if isinstance(named, str) else f"urn:ngsi-ld:Snapshot:{uuid4()}"


def _existing(tenant: Tenant, snapshot_id: str) -> Snapshot:
    require_uri(snapshot_id, "the id of a snapshot")
    found = tenant.snapshots.get(snapshot_id)
    if found is None or found.expires_s <= time.time():
        raise not_found(
            f"there is no snapshot {snapshot_id}, or it has expired; make one with POST snapshots"
        )
    return found


def _by_worth(tenant: Tenant) -> list[Snapshot]:
    """Return the snapshots, those first that have to go first when there are too many."""
    return sorted(
        tenant.snapshots.values(),
        key=lambda one: (one.document["snapshotPriority"], one.document["lastUsedAt"]),
    )


def _entries(tenant: Tenant, one: Snapshot) -> Entries:
    return Entries(documents={(Kind.SNAPSHOT, tenant.name, one.id): one.stored()})


async def _write(tenant: Tenant, entries: Entries) -> None:
    try:
        await tenant.commits.store(entries)
    except NotStored as error:
        raise not_stored(str(error)) from error


def _created(one: Snapshot) -> Answer:
    return Answer(201, b"", [(b"location", f"{PREFIX}snapshots/{quote(one.id, safe=':')}".encode())])


async def _told(exchange: Exchange, one: Snapshot) -> Answer:
    media_type, context = exchange.accept(), await exchange.reader_context()
    return answer(with_context(one.document, media_type, context), media_type, context)
