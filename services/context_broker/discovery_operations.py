"""What there is: the types of entities and what they look like (clauses 5.7.5 to 5.7.7), and who answers."""

import time
from hashlib import sha256
from typing import Any, Final

import orjson

from services.context_broker.conformance import OURS
from services.context_broker.exchange import JSON_LD, Answer, Exchange
from services.context_broker.intake import expand
from services.context_broker.operation import Operation
from services.context_broker.problems import not_found
from services.context_broker.reading import json_headers
from services.context_broker.words import require_name, shown, timestamp_now

_KNOWN: Final = frozenset({"details", "limit", "offset", "local"})


class DiscoveryOperations:
    """What readers can learn about the broker's content as a whole."""

    def __init__(self) -> None:
        self._since_s = time.monotonic()

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations of this room."""
        identity = "info/sourceIdentity"
        return (
            Operation("GET", "types", "retrieveEntityTypes", "6.25.3.1", self.types, _KNOWN),
            Operation("GET", "types/{type}", "retrieveEntityTypeInfo", "6.26.3.1", self.type_details, _KNOWN),
            Operation("GET", identity, "retrieveContextSourceIdentity", "6.33.3.1", self.source_identity),
        )

    async def types(self, exchange: Exchange) -> Answer:
        """GET types; with details=true the attributes of each."""
        compact = (await exchange.reader_context()).terms.compact
        store = exchange.tenant.store
        kinds = sorted(store.types())
        body: Any
        if exchange.flag("details"):
            body = [
                {
                    "id": kind,
                    "type": "EntityType",
                    "typeName": compact(kind),
                    "attributeNames": [compact(name) for name in store.attributes_of(kind)[1]],
                }
                for kind in kinds
            ]
        else:
            digest = sha256("\n".join(kinds).encode()).hexdigest()[:16]
            body = {
                "id": f"urn:ngsi-ld:EntityTypeList:{digest}",
                "type": "EntityTypeList",
                "typeList": [compact(kind) for kind in kinds],
            }
        return await _answer(exchange, body)

    async def type_details(self, exchange: Exchange) -> Answer:
        """GET types/{type}."""
        context = await exchange.reader_context()
        kind = expand(require_name(exchange.names[0], "the type in the path"), context.terms)
        count, attributes = exchange.tenant.store.attributes_of(kind)
        if not count:
            raise not_found(f"there is no entity of the type {shown(exchange.names[0])} ({kind})")
        compact = context.terms.compact
        body = {
            "id": kind,
            "type": "EntityTypeInfo",
            "typeName": compact(kind),
            "entityCount": count,
            "attributeDetails": [
                {
                    "id": name,
                    "type": "Attribute",
                    "attributeName": compact(name),
                    "attributeTypes": sorted(kinds),
                }
                for name, kinds in attributes.items()
            ],
        }
        return await _answer(exchange, body)

    async def source_identity(self, exchange: Exchange) -> Answer:
        """GET info/sourceIdentity (clause 5.15): who answers, for the tenant that is asked about."""
        alias = exchange.tenant.alias
        body = {
            "id": f"urn:ngsi-ld:ContextSourceIdentity:{alias}",
            "type": "ContextSourceIdentity",
            "contextSourceAlias": alias,
            "contextSourceTimeAt": timestamp_now(),
            "contextSourceUptime": f"PT{time.monotonic() - self._since_s:.3f}S",
            "contextSourceExtras": {"ngsildConformance": "{}.{}".format(*OURS)},
        }
        return await _answer(exchange, body)


async def _answer(exchange: Exchange, body: Any) -> Answer:
    context = await exchange.reader_context()
    if exchange.accept() != JSON_LD:
        return Answer(200, orjson.dumps(body), json_headers(context))
    documents = body if isinstance(body, list) else [body]
    written = [{"@context": context.document, **document} for document in documents]
    return Answer(
        200,
        orjson.dumps(written if isinstance(body, list) else written[0]),
        [(b"content-type", JSON_LD.encode())],
    )
