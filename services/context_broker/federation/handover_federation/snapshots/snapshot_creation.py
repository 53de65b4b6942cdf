"""Creates snapshots: carries out their queries and collects the results (clause 5.16.1.4).

Creation runs after the response to POST snapshots; clients poll the status until it is no longer `preparing`.
Therefore every failure ends in the status `failure`, with the reason at each query it concerns.
"""

from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Any, Final

import orjson

from handover.errors import Problem
from handover.telemetry import get_logger
from handover_broker.extensions.plugins import CarryOut, PerformByName
from handover_broker.extensions.snapshots import SNAPSHOT_HEADER
from handover_broker.model.problems import ERRORS, not_stored, too_many_results, went_wrong
from handover_broker.query.query_document import query_parameters, selectors_of
from handover_broker.query.selection import hits_of
from handover_broker.request.derived_request import derived
from handover_broker.request.query_parameters import selection_of
from handover_broker.request.request_context import (
    JSON,
    RequestContext,
    Response,
)
from handover_broker.request.routing import Operation
from handover_broker.storage.database import NotStored
from handover_broker.tenants import Tenant, Tenants
from handover_federation.snapshots.content import SnapshotContent, write_content
from handover_federation.snapshots.history_copy import EVERYTHING, copy_history
from handover_federation.snapshots.snapshot import (
    MAX_ENTITIES,
    PAST,
    PRESENT,
    QUERIES,
    Snapshot,
    Status,
    details,
    status_of,
)
from handover_federation.snapshots.snapshot_store import SnapshotStore

log = get_logger(__name__)

_INTERRUPTED: Final = Problem(
    500,
    "Internal error",
    "the broker stopped while it created this snapshot; delete it and create it again with POST snapshots",
    ERRORS + "InternalError",
)


class SnapshotCreator:
    """Creates snapshots in background tasks."""

    def __init__(
        self, tenants: Tenants, snapshots: SnapshotStore, carry_out: CarryOut, by_name: PerformByName
    ) -> None:
        self._tenants = tenants
        self._snapshots = snapshots
        self._carry_out = carry_out
        self._by_name = by_name
        self._running: set[tuple[str, str]] = set()

    def start(self, request: RequestContext, snapshot: Snapshot, context: Any) -> None:
        """Start to carry out the queries of a snapshot; `context` is the @context they were sent with."""
        self._start(request.tenant, snapshot, partial(self._fill, request, snapshot, context))

    def start_copy(self, request: RequestContext, original: Snapshot, snapshot: Snapshot) -> None:
        """Start to copy another snapshot."""
        self._start(request.tenant, snapshot, partial(self._copy, request, original, snapshot))

    def fail_interrupted(self) -> None:
        """Set the status of interrupted creations to `failure`: the process that ran them has ended."""
        for tenant in self._tenants:
            for snapshot in list(self._snapshots.of(tenant).values()):
                if snapshot.status is Status.PREPARING and (tenant.name, snapshot.id) not in self._running:
                    failed = snapshot.failed(_INTERRUPTED)
                    self._snapshots.publish(tenant, failed)
                    self._snapshots.tasks.start(self._record_failure, tenant, failed)

    def _start(self, tenant: Tenant, snapshot: Snapshot, work: Callable[[], Awaitable[None]]) -> None:
        self._running.add((tenant.name, snapshot.id))
        self._snapshots.tasks.start(self._run, tenant, snapshot, work)

    async def _run(self, tenant: Tenant, snapshot: Snapshot, work: Callable[[], Awaitable[None]]) -> None:
        try:
            await work()
        except Exception as error:  # any error must end the status "preparing", for which clients poll
            log.exception("snapshot creation failed", snapshot=snapshot.id)
            problem = error if isinstance(error, Problem) else went_wrong(error, "creating the snapshot")
            await self._fail(tenant, snapshot, problem)
        finally:
            self._running.discard((tenant.name, snapshot.id))

    async def _fail(self, tenant: Tenant, snapshot: Snapshot, problem: Problem) -> None:
        now = self._snapshots.of(tenant).get(snapshot.id)
        if now is None:  # deleted during its creation
            await self._snapshots.delete_content(self._tenants.inside(tenant, snapshot.id))
            return
        failed = now.failed(problem)
        self._snapshots.publish(tenant, failed)  # readers see the failure even if the disk refuses it
        await self._record_failure(tenant, failed)

    async def _record_failure(self, tenant: Tenant, failed: Snapshot) -> None:
        """Store the failure of a snapshot and delete its partial content."""
        async with self._snapshots.lock:
            if self._snapshots.of(tenant).get(failed.id) is failed:
                await self._snapshots.store(tenant, failed, notify=True)
                await self._snapshots.delete_content(self._tenants.inside(tenant, failed.id))

    async def _fill(self, request: RequestContext, snapshot: Snapshot, context: Any) -> None:
        """Carry out the queries and store their results (clause 5.16.1.4)."""
        tenant, content = request.tenant, SnapshotContent()
        results: dict[str, list[dict[str, Any]]] = {}
        for query in snapshot.document.get(PRESENT, ()):
            result = await result_of(
                collect_hits(self._carry_out, query_request(request, query, context), content)
            )
            results.setdefault(f"{PRESENT}Details", []).append(result)
        await self._write(tenant, snapshot, content)
        inner = self._tenants.inside(tenant, snapshot.id)
        for query in snapshot.document.get(PAST, ()):
            result = await result_of(
                copy_history(self._by_name, query_request(request, query, context), inner)
            )
            results.setdefault(f"{PAST}Details", []).append(result)
        await self._finish(tenant, snapshot, results)

    async def _copy(self, request: RequestContext, original: Snapshot, snapshot: Snapshot) -> None:
        tenant, content = request.tenant, SnapshotContent()
        content.add(self._tenants.inside(tenant, original.id).store.candidates(), None)
        await self._write(tenant, snapshot, content)
        names = [f"{name}Details" for name in QUERIES]
        results = {name: original.document[name] for name in names if name in original.document}
        if PAST in original.document:
            everything = derived(
                query_request(request, EVERYTHING, None),
                tenant=self._tenants.inside(tenant, original.id),
                parameters={"local": "true"},
            )
            await copy_history(self._by_name, everything, self._tenants.inside(tenant, snapshot.id))
        await self._finish(tenant, snapshot, results)

    async def _write(self, tenant: Tenant, snapshot: Snapshot, content: SnapshotContent) -> None:
        """Write the entities of a snapshot and evict others if needed. Raises a problem (507) if the disk
        refuses."""
        async with self._snapshots.lock:
            await self._snapshots.evict_for(tenant, snapshot, len(content.entities))
        try:
            await write_content(self._tenants.inside(tenant, snapshot.id), content)
        except NotStored as error:
            raise not_stored(str(error), is_away=error.is_away) from error

    async def _finish(
        self, tenant: Tenant, snapshot: Snapshot, results: Mapping[str, list[dict[str, Any]]]
    ) -> None:
        status = status_of([detail for several in results.values() for detail in several])
        async with self._snapshots.lock:
            now = self._snapshots.of(tenant).get(snapshot.id)
            if now is None:  # deleted during its creation
                await self._snapshots.delete_content(self._tenants.inside(tenant, snapshot.id))
                return
            await self._snapshots.store(
                tenant, now.changed(snapshotStatus=status.value, **results), notify=True
            )


def query_request(request: RequestContext, query: Mapping[str, Any], context: Any) -> RequestContext:
    """Return the request that carries out a query of a snapshot in the names of its creator."""
    headers = {
        name: value for name, value in request.headers.items() if name not in {SNAPSHOT_HEADER, b"accept"}
    }
    if context is None:
        headers[b"content-type"] = JSON.encode()
        return derived(request, raw=orjson.dumps(query), parameters={}, headers=headers)
    document = {**query, "@context": context}
    return derived(request, raw=orjson.dumps(document), parameters={}, headers=headers)


async def result_of(query: Awaitable[dict[str, Any]]) -> dict[str, Any]:
    """Return the details of a query (clause 5.2.42); any failure becomes a result."""
    try:
        return await query
    except Problem as problem:
        return details(Status.FAILURE, problem)
    except Exception as error:  # a failed query must not stop the others
        log.exception("snapshot query failed")
        return details(Status.FAILURE, went_wrong(error, "carrying out the query"))


async def collect_hits(
    carry_out: CarryOut, request: RequestContext, content: SnapshotContent
) -> dict[str, Any]:
    """Add the results of a query to the content; return the details of the query.

    Nothing is added if it fails.
    """
    before = len(content.entities)
    count = 0

    async def collect(over: RequestContext) -> Response:
        nonlocal count
        document, context = await over.body()
        any_of = selectors_of(document, context)
        selection = selection_of(query_parameters(document), context, any_of)
        hits = await hits_of(over.tenant.store, selection, MAX_ENTITIES + 1)
        count = len(hits)
        content.add(hits, selection.attributes)
        return Response(200)

    try:
        answer = await carry_out(Operation("POST", "", "queryBatch", "", collect), request)
    except Exception:
        content.keep_only(before)
        raise
    if len(content.entities) > MAX_ENTITIES:
        content.keep_only(before)
        return details(
            Status.FAILURE,
            too_many_results(f"a snapshot has {MAX_ENTITIES} entities at most; ask for fewer"),
        )
    if answer.status >= 300:
        content.keep_only(before)
        return {"resultStatus": Status.FAILURE.value, "problemDetails": orjson.loads(answer.body)}
    if any(name == b"ngsild-warning" for name, _ in answer.headers):
        return details(Status.PARTIAL)
    return details(Status.SUCCESS if count else Status.EMPTY)
