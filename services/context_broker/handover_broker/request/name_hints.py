"""Hints at names that mean something else without their @context.

A query without a Link header reads the names of types and attributes with the default @context. If all
entities have them from another @context, the result is empty. `NGSILD-Warning` (clause 6.3.17) then says
which IRI is stored, and with which @context the name has it.
"""

from collections.abc import AsyncIterator, Mapping
from typing import Any, Final

from handover.errors import Problem
from handover_broker.query.alternatives import alternatives
from handover_broker.query.q_grammar import parse, paths
from handover_broker.request.request_context import RequestContext, Response
from handover_broker.request.routing import Operation

_HINTED: Final = frozenset({"queryEntity", "queryBatch", "queryTemporal", "queryTemporalBatch"})
_EMPTY: Final = (b"[]", b'{"type":"FeatureCollection","features":[]')
_MISCELLANEOUS: Final = 199
_MAX_HINTS: Final = 5
_ENDS_OF_BASES: Final = ("/", "#", ":")
_SETTING: Final = "HANDOVER_BROKER_DEFAULT_CONTEXT"


async def with_name_hints(operation: Operation, request: RequestContext, answer: Response) -> Response:
    """Return the response to a query, with warnings if it is empty and its names are stored as other IRIs."""
    if not answer.body.startswith(_EMPTY) or answer.status != 200 or operation.name not in _HINTED:
        return answer
    try:
        hints = [hint async for hint in _hints(operation, request)]
    except Problem:  # the query was answered; a hint is no reason to fail
        return answer
    warnings = [(b"ngsild-warning", f'{_MISCELLANEOUS} - "{hint}"'.encode()) for hint in hints[:_MAX_HINTS]]
    return Response(answer.status, answer.body, [*answer.headers, *warnings])


async def _hints(operation: Operation, request: RequestContext) -> AsyncIterator[str]:
    document = request.document() if operation.name.endswith("Batch") else None
    named = request.link() if document is None or "@context" not in document else document["@context"]
    # Neither fetched nor counted as used: the query has done that.
    context = await request.contexts.as_before(named or request.contexts.default)
    statistics = request.tenant.store.statistics()
    types, attributes = _names_in(request.parameters, document)
    for what, names, stored in (
        ("type", types, statistics.types()),
        ("attribute", attributes, statistics.attributes()),
    ):
        for name in dict.fromkeys(names):
            iri = context.terms.expand(name)
            if iri == name or iri in stored:
                continue
            for other in stored:
                if other.endswith(name) and other.removesuffix(name).endswith(_ENDS_OF_BASES):
                    yield await _hint(request, what, name, iri, other)


async def _hint(request: RequestContext, what: str, name: str, iri: str, other: str) -> str:
    text = f"nothing has the {what} {iri}, which {name} is with the @context of this request; "
    text += f"entities have {other}: "
    link = await request.contexts.link_with(name, other)
    if link is None:
        text += f"name the @context that they were created with in a Link header, or use the IRI as {what}"
    else:
        text += f"send the @context {link} in a Link header, or set {_SETTING} to it"
    return "".join(sign if " " <= sign <= "~" and sign not in '"\\' else "'" for sign in text)


def _names_in(parameters: Mapping[str, str], document: Any) -> tuple[list[str], list[str]]:
    """Return the names of types and of attributes in a query."""
    members: dict[str, Any] = {**parameters, **(document or {})}
    types, attributes = list[str](), list[str]()
    selectors = members.get("entities")
    texts = [members.get("type") if document is None else None]
    texts += (
        [selector.get("type") for selector in selectors if isinstance(selector, dict)] if selectors else []
    )
    for text in texts:
        if isinstance(text, str):
            types += [name for alternative in alternatives(text, "the type", str) for name in alternative]
    attrs = members.get("attrs")
    attributes += attrs.split(",") if isinstance(attrs, str) else attrs or []
    if isinstance(q := members.get("q"), str):
        attributes += [path.names[0] for path in paths(parse(q))]
    return types, attributes
