"""Copies the results of a temporal query, context sources included, into the history of a snapshot."""

from typing import Any, Final

import orjson

from handover_broker.extensions.plugins import PerformByName
from handover_broker.request.derived_request import derived
from handover_broker.request.request_context import (
    JSON_LD,
    RequestContext,
)
from handover_broker.tenants import Tenant
from handover_federation.snapshots.snapshot import Status, details

PAGE: Final = 100
"""Evolutions in one query; each may have a thousand instances of every attribute."""
MAX_EVOLUTIONS: Final = 20_000
"""Evolutions in one snapshot; any beyond are left out, and the snapshot is partial."""
EVERYTHING: Final = {
    "type": "Query",
    "temporalQ": {"timerel": "after", "timeAt": "1970-01-01T00:00:00Z", "timeproperty": "createdAt"},
}


async def copy_history(perform: PerformByName, request: RequestContext, inner: Tenant) -> dict[str, Any]:
    """Copy the results of a temporal query (the body of `request`); return its details (clause 5.2.42)."""
    headers = {name: value for name, value in request.headers.items() if name != b"link"}
    writing_headers = {**headers, b"content-type": JSON_LD.encode()}
    count, is_partial = 0, False
    while count < MAX_EVOLUTIONS:
        parameters = {**request.parameters, "limit": str(PAGE), "offset": str(count)}
        asking = {**request.headers, b"accept": JSON_LD.encode()}
        answer = await perform("queryTemporalBatch", derived(request, parameters=parameters, headers=asking))
        if answer.status >= 300:
            return {"resultStatus": Status.FAILURE.value, "problemDetails": orjson.loads(answer.body)}
        # 206: an evolution has more instances than fit into a response; some are missing
        is_partial |= answer.status == 206 or any(name == b"ngsild-warning" for name, _ in answer.headers)
        page = orjson.loads(answer.body)
        for subject in page:
            writing = derived(
                request, tenant=inner, raw=orjson.dumps(subject), parameters={}, headers=writing_headers
            )
            await perform("upsertTemporal", writing)
        count += len(page)
        if len(page) < PAGE:
            break
    else:
        is_partial = True
    if is_partial:
        return details(Status.PARTIAL)
    return details(Status.SUCCESS if count else Status.EMPTY)
