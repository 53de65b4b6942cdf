"""What sources answer to those who read: entities, nothing, or a reason to warn (clause 6.3.17)."""

import asyncio
import hashlib
import re
import time
from typing import Any, Final

import orjson

from handover.errors import Problem
from services.context_broker.contexts.book import Context
from services.context_broker.distribution.distribution import Sources
from services.context_broker.distribution.forwarding import (
    INVALID,
    REFUSED,
    SILENT,
    STALE,
    Question,
    Tongue,
    Unheard,
)
from services.context_broker.distribution.fragments import read_fragment, still_there
from services.context_broker.entities.entity import Entity
from services.context_broker.network.http_sender import Reply
from services.context_broker.sources.registration import Registration

_FROM_ELSEWHERE: Final = 1 << 62
"""Places in the order from here on are those of entities that were created elsewhere, by a hash of their id:
the same at every request, so that pages do not shift."""


_AT_ONCE: Final = 200
"""Entities that are read in one go, then others get their turn."""


async def heard(sources: Sources, registration: Registration, question: Question) -> Reply | None:
    """Return what a source answers to a question, None if it knows nothing; raises `Unheard`."""
    reply, was_kept = await sources.forwarder.ask(registration, question, sources.asking)
    if was_kept:
        sources.warn(STALE, f"what {registration.endpoint} told was kept from a moment ago")
    if reply.status == 404 or sources.had_passed(registration, reply.status):
        return None
    if reply.status == 508:
        raise Unheard(registration, SILENT, 508, f"{registration.endpoint} sees a loop of registrations")
    if not 200 <= reply.status < 300:
        raise Unheard(
            registration, REFUSED, 502, f"{registration.endpoint} answers {reply.status}", reply.status
        )
    return reply


async def read_entities(
    sources: Sources, registration: Registration, reply: Reply, tongue: Tongue, *, single: bool = False
) -> list[Entity]:
    """Return the entities in an answer; raises `Unheard` (111) when it is no NGSI-LD."""
    try:
        found = orjson.loads(reply.body) if reply.body else ({} if single else [])
        documents = [found] if single else found
        if not isinstance(documents, list):
            raise TypeError("it is no list of entities")  # noqa: TRY301 - one way out for all that is wrong
        context = await answered_context(sources, reply, tongue)
        entities = []
        for number, told in enumerate(documents, 1):
            if not number % _AT_ONCE:
                await asyncio.sleep(0)
            one = still_there(told, time.time())
            if one is None or (not one and single):
                continue
            inline = one.get("@context") if isinstance(one, dict) else None
            terms = (context if inline is None else await sources.forwarder.contexts.of(inline)).terms
            entities.append(read_fragment(one, terms, place_of(one)))
    except (orjson.JSONDecodeError, TypeError, Problem) as error:
        why = error.detail if isinstance(error, Problem) else str(error)
        invalid = f"{registration.endpoint} answers what is no NGSI-LD: {why}"
        raise Unheard(registration, INVALID, 502, invalid) from None
    return entities


async def answered_context(sources: Sources, reply: Reply, tongue: Tongue) -> Context:
    """Return the @context of an answer in plain JSON: that of its Link, else the one asked with."""
    found = _CONTEXT_LINK.search(reply.headers.get("link", ""))
    if found is None or found.group(1) == tongue.link:
        return tongue.context
    return await sources.forwarder.contexts.of(found.group(1))


_CONTEXT_LINK: Final = re.compile(r'<([^>]*)>[^,<]*rel\s*=\s*"?http://www\.w3\.org/ns/json-ld#context"?')


def place_of(document: Any) -> int:
    """Return the place in the order of an entity that was created elsewhere."""
    entity_id = document.get("id") if isinstance(document, dict) else None
    if not isinstance(entity_id, str):
        return _FROM_ELSEWHERE
    digest = hashlib.blake2b(entity_id.encode("utf-8", "replace"), digest_size=7).digest()
    return _FROM_ELSEWHERE | int.from_bytes(digest)
