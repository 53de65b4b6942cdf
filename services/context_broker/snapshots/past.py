"""The past in a snapshot: what a temporal query finds, sources included, written as its own past."""

from collections.abc import Awaitable, Callable
from typing import Any, Final

import orjson

from services.context_broker.api.exchange import JSON_LD, Exchange
from services.context_broker.api.exchange import Answer as Told
from services.context_broker.distribution.distribution import in_place_of
from services.context_broker.snapshots.snapshot import Status, details
from services.context_broker.storage.tenants import Tenant

PAGE: Final = 100
"""Evolutions that are read at once; each may have a thousand instances of every attribute."""
MOST_EVOLUTIONS: Final = 20_000
"""Evolutions in one snapshot; what goes beyond is left out, and the snapshot is partial."""
EVERYTHING: Final = {
    "type": "Query",
    "temporalQ": {"timerel": "after", "timeAt": "1970-01-01T00:00:00Z", "timeproperty": "createdAt"},
}

Perform = Callable[[str, Exchange], Awaitable[Told]]
"""Carries an operation out by its name, sources included."""


async def copied(perform: Perform, exchange: Exchange, inner: Tenant) -> dict[str, Any]:
    """Copy what a temporal query (the body of `exchange`) finds; return what became of it (clause 5.2.42)."""
    headers = {name: value for name, value in exchange.headers.items() if name != b"link"}
    writing_headers = {**headers, b"content-type": JSON_LD.encode()}
    found, is_partial = 0, False
    while found < MOST_EVOLUTIONS:
        parameters = {**exchange.parameters, "limit": str(PAGE), "offset": str(found)}
        asking = {**exchange.headers, b"accept": JSON_LD.encode()}
        told = await perform(
            "queryTemporalBatch", in_place_of(exchange, parameters=parameters, headers=asking)
        )
        if told.status >= 300:
            return {"resultStatus": Status.FAILURE.value, "problemDetails": orjson.loads(told.body)}
        # 206: an evolution has more instances than are told at once; the oldest or newest of them are there.
        is_partial |= told.status == 206 or any(name == b"ngsild-warning" for name, _ in told.headers)
        page = orjson.loads(told.body)
        for one in page:
            writing = in_place_of(
                exchange, tenant=inner, raw=orjson.dumps(one), parameters={}, headers=writing_headers
            )
            await perform("upsertTemporal", writing)
        found += len(page)
        if len(page) < PAGE:
            break
    else:
        is_partial = True
    if is_partial:
        return details(Status.PARTIAL)
    return details(Status.SUCCESS if found else Status.EMPTY)
