"""Responses of sources to reads: entities, nothing, or a reason for a warning (clause 6.3.17)."""

import asyncio
import hashlib
import re
import time
from typing import Any, Final

import orjson

from handover.errors import Problem
from handover.network.http_client import HttpResponse
from handover_broker.model.context import Context
from handover_broker.model.entity import Entity
from handover_federation.distribution.distributed_operations import Sources
from handover_federation.distribution.forwarding.forwarder import (
    INVALID,
    REFUSED,
    SILENT,
    STALE,
    SourceDialect,
    SourceError,
    SourceRequest,
)
from handover_federation.distribution.reads.fragments import read_fragment, without_expired
from handover_federation.registrations.registration import Registration

_FROM_ELSEWHERE: Final = 1 << 62
"""The first place in the order for entities of other sources, which are ordered by a hash of their id: the
same for every request, so that pages do not shift."""


_ENTITIES_PER_STEP: Final = 200
"""Entities that are read before the event loop serves other tasks."""


async def query_source(
    sources: Sources, registration: Registration, source_request: SourceRequest
) -> HttpResponse | None:
    """Return the response of a source, None if it has nothing; raises `SourceError`."""
    response, was_kept = await sources.forwarder.send(registration, source_request, sources.origin)
    if was_kept:
        sources.add_warning(STALE, f"the response of {registration.shown} comes from the cache")
    if response.status == 404 or sources.is_loop_answer(registration, response.status):
        return None
    if response.status == 508:
        raise SourceError(registration, SILENT, 508, f"{registration.shown} detected a loop of registrations")
    if not 200 <= response.status < 300:
        raise SourceError(
            registration, REFUSED, 502, f"{registration.shown} returns {response.status}", response.status
        )
    return response


async def read_entities(
    sources: Sources,
    registration: Registration,
    response: HttpResponse,
    dialect: SourceDialect,
    *,
    single: bool = False,
) -> list[Entity]:
    """Return the entities in a response; raises `SourceError` (111) if it is not NGSI-LD."""
    try:
        body = orjson.loads(response.body) if response.body else ({} if single else [])
        documents = [body] if single else body
        if not isinstance(documents, list):
            raise TypeError("it is no list of entities")  # noqa: TRY301 - one way out for all that is wrong
        context = await answered_context(sources, response, dialect)
        entities = []
        for number, entity_document in enumerate(documents, 1):
            if not number % _ENTITIES_PER_STEP:
                await asyncio.sleep(0)
            document = without_expired(entity_document, time.time())
            if document is None or (not document and single):
                continue
            inline = document.get("@context") if isinstance(document, dict) else None
            terms = (context if inline is None else await sources.forwarder.contexts.of(inline)).terms
            entities.append(read_fragment(document, terms, place_of(document)))
    except (orjson.JSONDecodeError, TypeError, Problem) as error:
        why = error.detail if isinstance(error, Problem) else str(error)
        invalid = f"{registration.shown} returns invalid NGSI-LD: {why}"
        raise SourceError(registration, INVALID, 502, invalid) from None
    return entities


async def answered_context(sources: Sources, response: HttpResponse, dialect: SourceDialect) -> Context:
    """Return the @context of a plain JSON response: the one in its Link header, else the one of the
    request."""
    match = _CONTEXT_LINK.search(response.headers.get("link", ""))
    if match is None or match.group(1) == dialect.link:
        return dialect.context
    return await sources.forwarder.contexts.of(match.group(1))


_CONTEXT_LINK: Final = re.compile(r'<([^>]*)>[^,<]*rel\s*=\s*"?http://www\.w3\.org/ns/json-ld#context"?')


def place_of(document: Any) -> int:
    """Return the place in the order of an entity of another source."""
    entity_id = document.get("id") if isinstance(document, dict) else None
    if not isinstance(entity_id, str):
        return _FROM_ELSEWHERE
    digest = hashlib.blake2b(entity_id.encode("utf-8", "replace"), digest_size=7).digest()
    return _FROM_ELSEWHERE | int.from_bytes(digest)
