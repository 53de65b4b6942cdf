"""Making snapshots: whatever goes wrong, the snapshot does not stay in the making, and says why."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from services.context_broker.app import Broker
from services.context_broker.request.request_context import Answer, Exchange, Request
from services.context_broker.request.routing import Operation
from services.context_broker.settings import BrokerSettings
from services.context_broker.snapshots.snapshot import Snapshot, Status, new_snapshot
from services.context_broker.snapshots.snapshot_creation import SnapshotCreator
from services.context_broker.snapshots.snapshot_store import SnapshotStore
from services.context_broker.storage.database import SqliteDatabase
from services.context_broker.storage.entries import Kind
from services.context_broker.storage.journal import Journal

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
    broker: Broker, making: SnapshotCreator, keeping: SnapshotStore, *queries: Any, context: Any
) -> Snapshot:
    """Make a snapshot; return it once it is no longer being made."""
    tenant = broker.tenants.of(b"", makes=False)
    made = new_snapshot("urn:x:1", {"snapshotQueries": list(queries)})
    await keeping.keep(tenant, made)
    exchange = Exchange(Request("POST", b"/ngsi-ld/v1/snapshots", b"", {}), (), broker.contexts, tenant)
    making.start(exchange, made, context)
    async with asyncio.timeout(120):
        while tenant.snapshots["urn:x:1"].status is Status.PREPARING:
            await asyncio.sleep(0.005)
    async with keeping.lock:
        return tenant.snapshots["urn:x:1"]


def kept_status(broker: Broker) -> list[bytes]:
    return [body for _, _, body in broker.journal.documents(Kind.SNAPSHOT)]


async def test_a_query_that_breaks_is_told_and_the_others_are_carried_out(broker: Broker) -> None:
    asked = 0

    async def carry_out(operation: Operation, exchange: Exchange) -> Answer:
        nonlocal asked
        asked += 1
        if asked == 1:
            raise ZeroDivisionError
        return await operation.answer(exchange)

    keeping = SnapshotStore(broker.tenants)
    making = SnapshotCreator(broker.tenants, keeping, carry_out, broker._by_name)
    one = await settled(broker, making, keeping, QUERY, QUERY, context=None)
    assert one.status is Status.PARTIAL
    broken, empty = one.document["snapshotQueriesDetails"]
    assert empty == {"resultStatus": "empty"}
    assert broken["problemDetails"]["detail"].startswith("ZeroDivisionError while carrying out the query")


async def test_a_making_that_breaks_ends_in_failure_with_the_reason_on_disk(broker: Broker) -> None:
    keeping = SnapshotStore(broker.tenants)
    making = SnapshotCreator(broker.tenants, keeping, broker._answered, broker._by_name)
    one = await settled(broker, making, keeping, 5, context="https://no.query.at.all")
    assert one.status is Status.FAILURE
    (broken,) = one.document["snapshotQueriesDetails"]
    assert broken["problemDetails"]["detail"].startswith("TypeError while making the snapshot")
    assert kept_status(broker) == [one.stored()]
