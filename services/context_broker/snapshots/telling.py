"""Who wants to know how a snapshot is, is told when it is made, changed or gone (5.3.4 and 5.16.6)."""

import asyncio
from typing import Final
from uuid import uuid4

import orjson

from handover.telemetry import get_logger
from services.context_broker.api.words import tenant_headers, timestamp_now
from services.context_broker.snapshots.snapshot import Snapshot
from services.context_broker.storage.tenants import Tenant
from services.context_broker.subscriptions.http_sender import SendError

log = get_logger(__name__)

TRIES: Final = 5
"""Attempts to tell; who misses them all can still ask for the snapshot."""
FIRST_REST_S: Final = 0.5
_TOLD_AS: Final = (
    ("snapshotQueriesDetails", "snapshotQueriesDetails"),
    ("temporalSnapshotQueriesDetails", "snapshotTemporalQueriesDetails"),
)
"""Members of a notification, and what they are called in a snapshot (table 5.3.4-1)."""


async def tell(tenant: Tenant, one: Snapshot) -> None:
    """Tell whoever wants to be told how a snapshot is; of one that is gone, expiresAt is past."""
    document = one.document
    if document.get("endpoint") is None:
        return
    told = {
        "id": f"urn:ngsi-ld:SnapshotNotification:{uuid4()}",
        "type": "SnapshotNotification",
        "notifiedAt": timestamp_now(),
        "snapshotId": one.id,
        **{name: document[name] for name in ("snapshotPriority", "snapshotStatus", "expiresAt")},
        **{name: document[source] for name, source in _TOLD_AS if source in document},
    }
    headers = [("Content-Type", "application/json"), *tenant_headers(tenant.name)]
    headers += [(pair["key"], pair["value"]) for pair in document.get("receiverInfo") or ()]
    outbound, rest_s = tenant.notifier.outbound, FIRST_REST_S
    for _ in range(TRIES):
        try:
            status = await outbound.sender.post(
                document["endpoint"], headers, orjson.dumps(told), outbound.timeout_s
            )
            if status < 500:
                return
        except SendError as error:
            log.info("a snapshot cannot be told of", snapshot=one.id, error=str(error))
        await asyncio.sleep(rest_s)
        rest_s *= 2
    log.warning("nobody was told of a snapshot", snapshot=one.id, endpoint=document["endpoint"])
