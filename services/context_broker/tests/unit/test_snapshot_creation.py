"""Creation of snapshots: any failure ends the status "preparing" and is named in the snapshot."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from handover_broker.app import Broker
from handover_broker.request.request_context import Request, RequestContext, Response
from handover_broker.request.routing import Operation
from handover_broker.settings import BrokerSettings
from handover_broker.storage.database import SqliteDatabase
from handover_broker.storage.entries import DocumentKind
from handover_broker.storage.journal import Journal
from handover_federation.snapshots.snapshot import Snapshot, Status, new_snapshot
from handover_federation.snapshots.snapshot_creation import SnapshotCreator
from handover_federation.snapshots.snapshot_store import SnapshotStore

QUERY = {"type": "Query", "entities": [{"type": "Task"}]}


@pytest.fixture
async def broker(tmp_path: Path) -> AsyncIterator[Broker]:
    journal = Journal(SqliteDatabase(tmp_path / "broker.db"))
    journal.open()
    made = Broker(BrokerSettings(data_dir=tmp_path), journal)
    await made.start()
    yield made
    await made.stop()


async def settled(
    broker: Broker, creator: SnapshotCreator, store: SnapshotStore, *queries: Any, context: Any
) -> Snapshot:
    """Create a snapshot; return it once its status is no longer "preparing"."""
    tenant = broker.tenants.of(b"", makes=False)
    await store.start()
    made = new_snapshot("urn:x:1", {"snapshotQueries": list(queries)})
    await store.store(tenant, made)
    request = RequestContext(Request("POST", b"/ngsi-ld/v1/snapshots", b"", {}), (), broker.contexts, tenant)
    creator.start(request, made, context)
    async with asyncio.timeout(120):
        while store.of(tenant)["urn:x:1"].status is Status.PREPARING:
            await asyncio.sleep(0.005)
    async with store.lock:
        await store.stop()
        return store.of(tenant)["urn:x:1"]


def kept_status(broker: Broker) -> list[bytes]:
    return [body for _, _, body in broker.journal.documents(DocumentKind.SNAPSHOT)]


async def test_a_failing_query_is_reported_and_the_others_are_carried_out(broker: Broker) -> None:
    asked = 0

    async def carry_out(operation: Operation, request: RequestContext) -> Response:
        nonlocal asked
        asked += 1
        if asked == 1:
            raise ZeroDivisionError
        return await operation.answer(request)

    store = SnapshotStore(broker.tenants)
    creator = SnapshotCreator(broker.tenants, store, carry_out, broker._by_name)
    one = await settled(broker, creator, store, QUERY, QUERY, context=None)
    assert one.status is Status.PARTIAL
    broken, empty = one.document["snapshotQueriesDetails"]
    assert empty == {"resultStatus": "empty"}
    assert broken["problemDetails"]["detail"].startswith("ZeroDivisionError while carrying out the query")


async def test_a_failed_creation_stores_the_status_failure_with_its_reason(broker: Broker) -> None:
    store = SnapshotStore(broker.tenants)
    creator = SnapshotCreator(broker.tenants, store, broker.federation.distribute, broker._by_name)
    one = await settled(broker, creator, store, 5, context="https://no.query.at.all")
    assert one.status is Status.FAILURE
    (broken,) = one.document["snapshotQueriesDetails"]
    assert broken["problemDetails"]["detail"].startswith("TypeError while creating the snapshot")
    assert kept_status(broker) == [one.stored()]
