"""Making a snapshot: its queries are carried out as any query is, what they find is gathered (5.16.1.4)."""

from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Final

import orjson

from handover.errors import Problem
from services.context_broker.api.exchange import JSON, Answer, Exchange
from services.context_broker.api.operation import Operation
from services.context_broker.api.problems import too_many_results
from services.context_broker.distribution.distribution import in_place_of
from services.context_broker.queries.query_document import query_parameters, selectors_of
from services.context_broker.queries.reading import selection_of
from services.context_broker.queries.selection import hits_of
from services.context_broker.snapshots.content import Content
from services.context_broker.snapshots.snapshot import MOST_ENTITIES, Status, details

HEADER: Final = b"ngsild-snapshot"

Answering = Callable[[Operation, Exchange], Awaitable[Answer]]
"""Carries an operation out, sources included."""


def asked(exchange: Exchange, query: Mapping[str, Any], context: Any) -> Exchange:
    """Return the exchange that carries a query of a snapshot out, in the names of whoever makes it."""
    headers = {name: value for name, value in exchange.headers.items() if name not in {HEADER, b"accept"}}
    if context is None:
        headers[b"content-type"] = JSON.encode()
        return in_place_of(exchange, raw=orjson.dumps(query), parameters={}, headers=headers)
    document = {**query, "@context": context}
    return in_place_of(exchange, raw=orjson.dumps(document), parameters={}, headers=headers)


async def gathered(carry_out: Answering, exchange: Exchange, content: Content) -> dict[str, Any]:
    """Add what a query finds to the content; return what became of the query."""
    before = len(content.entities)
    count = 0

    async def collect(over: Exchange) -> Answer:
        nonlocal count
        document, context = await over.body()
        any_of = selectors_of(document, context)
        selection = selection_of(query_parameters(document), context, any_of)
        hits = await hits_of(over.tenant.store, selection, MOST_ENTITIES + 1)
        count = len(hits)
        content.add(hits, selection.attributes)
        return Answer(200)

    try:
        told = await carry_out(Operation("POST", "", "queryBatch", "", collect), exchange)
    except Problem as problem:
        return details(Status.FAILURE, problem)
    if len(content.entities) > MOST_ENTITIES:
        del content.entities[before:]
        return details(
            Status.FAILURE,
            too_many_results(f"a snapshot has {MOST_ENTITIES} entities at most; ask for fewer"),
        )
    if told.status >= 300:
        return {"resultStatus": Status.FAILURE.value, "problemDetails": orjson.loads(told.body)}
    if any(name == b"ngsild-warning" for name, _ in told.headers):
        return details(Status.PARTIAL)
    return details(Status.SUCCESS if count else Status.EMPTY)
