"""How things have been, told by several sources (clauses 5.7.3.4 and 5.7.4.4).

The evolutions are put together as documents, in the form that was asked for: instances and pairs of value and
time side by side, in the order of time. Totals over a period cannot be put together: of these, the one with
the strongest claim counts (the broker's own, then exclusive, redirect, inclusive).
"""

from collections.abc import Iterable, Mapping
from typing import Any, Final

import orjson

from handover.errors import Problem
from services.context_broker.api.exchange import JSON_LD, Answer, Exchange, problem_answer
from services.context_broker.api.words import moment, require_uri
from services.context_broker.contexts.book import Context
from services.context_broker.distribution.distribution import (
    Performing,
    Sources,
    all_of,
    gateway_problem,
    in_place_of,
)
from services.context_broker.distribution.forwarding import INVALID, SILENT, Question, Unheard, quoted
from services.context_broker.distribution.questions import asked_by, questions_in, reach_of, where_of
from services.context_broker.distribution.source_answers import answered_context, heard
from services.context_broker.distribution.translation import translated
from services.context_broker.entities.intake import expand
from services.context_broker.queries.pages import Window
from services.context_broker.queries.reading import DEFAULT_LIMIT, LARGEST_LIMIT, json_headers, page_links
from services.context_broker.sources.registration import Asked, Match, Registration
from services.context_broker.subscriptions.http_sender import Reply

_NOT_PASSED_ON: Final = frozenset(
    {"local", "id", "idPattern", "type", "attrs", "pick", "omit", "limit", "offset", "count", "csf",
     "splitEntities", "entities", "temporalQ"}
)  # fmt: skip
_NAMING: Final = frozenset({"q", "geoproperty"})
_MEMBERS: Final = frozenset({"id", "type", "@context", "scope", "createdAt", "modifiedAt", "deletedAt"})
_TIMES: Final = ("observedAt", "modifiedAt", "createdAt")

Evolution = dict[str, Any]
"""How one entity has been, as a document in the names of the reader."""


async def retrieve(sources: Sources, exchange: Exchange, perform: Performing) -> Answer:
    """GET temporal/entities/{id}."""
    context = await exchange.reader_context()
    entity_id = require_uri(exchange.names[0], "the entity id in the path")
    asked = Asked((entity_id,), None, None, _names_of(exchange.parameters, context))
    where = where_of(None, context, reach_of(exchange.parameters, context.terms.expand))
    matches = sources.unasked(sources.registry.matching("retrieveTemporal", asked, where))
    if not matches:
        return await perform(exchange)
    path = f"temporal/entities/{quoted(entity_id)}"
    found = await all_of(
        *(_ask(sources, one, path, exchange.parameters, context, single=True) for one in matches)
    )
    told = [
        (one.registration, document) for one, some in zip(matches, found, strict=True) for document in some
    ]
    try:
        own: Answer | None = await perform(exchange)
    except Problem as problem:
        silent = [one for one in sources.unheard if one.registration.mode.is_proxied]
        if problem.status == 404 and not told and silent:
            return problem_answer(gateway_problem(silent[0]))
        if problem.status != 404 or not told:
            raise
        own = None
    if not told:
        assert own is not None  # noqa: S101 - else it was raised
        return own
    mine = [] if own is None else [(None, orjson.loads(own.body))]
    document = _together([*mine, *told], context, exchange.parameters)
    if own is not None:
        return Answer(own.status, orjson.dumps(document), own.headers)
    return _answer(exchange, context, document)


async def query(sources: Sources, exchange: Exchange, perform: Performing) -> Answer:
    """GET temporal/entities."""
    context = await exchange.reader_context()
    return await _query(sources, exchange, perform, context, [dict(exchange.parameters)])


async def query_batch(sources: Sources, exchange: Exchange, perform: Performing) -> Answer:
    """POST temporal/entityOperations/query."""
    document, context = await exchange.body()
    if not isinstance(document, dict):
        return await perform(exchange)
    temporal = document.get("temporalQ")
    flat = {**document, **(temporal if isinstance(temporal, dict) else {})}
    numbers = {name: str(said) for name, said in flat.items() if isinstance(said, int) and said is not True}
    questions = list(questions_in({**flat, **numbers}, exchange.parameters))
    return await _query(sources, exchange, perform, context, questions)


async def _query(
    sources: Sources,
    exchange: Exchange,
    perform: Performing,
    context: Context,
    questions: list[dict[str, str]],
) -> Answer:
    asking: list[tuple[Match, dict[str, str]]] = []
    for parameters in questions:
        asked, where = asked_by(parameters, context, _names_of(parameters, context))
        matches = sources.unasked(sources.registry.matching("queryTemporal", asked, where))
        asking += [(match, parameters) for match in matches]
    if not asking:
        return await perform(exchange)
    window = _window(exchange)
    most = str(min(window.offset + window.limit, LARGEST_LIMIT))
    wider = {**exchange.parameters, "offset": "0", "limit": most}
    own = await perform(in_place_of(exchange, parameters=wider))
    paged = [("limit", most)]
    found = await all_of(
        *(
            _ask(sources, match, "temporal/entities", {**parameters, **dict(paged)}, context, paged=True)
            for match, parameters in asking
        )
    )
    known: dict[str, list[tuple[Registration | None, Evolution]]] = {}
    for one in orjson.loads(own.body):
        known[one["id"]] = [(None, one)]
    mine = len(known)
    for (match, _), some in zip(asking, found, strict=True):
        for document in some:
            known.setdefault(document["id"], []).append((match.registration, document))
    others = sorted(list(known)[mine:])
    order = [*list(known)[:mine], *others]
    page = order[window.offset : window.offset + window.limit]
    documents = [_together(known[one], context, exchange.parameters) for one in page]
    headers = [(name, value) for name, value in own.headers if name != b"link" or b"json-ld#context" in value]
    headers = [
        (name, str(int(value) + len(others)).encode() if name == b"ngsild-results-count" else value)
        for name, value in headers
    ]
    if exchange.method == "GET":
        more = len(order) > window.offset + window.limit
        headers += page_links(exchange, window, exchange.accept(), more=more)
    return Answer(own.status, orjson.dumps(documents), headers)


async def _ask(
    sources: Sources,
    match: Match,
    path: str,
    parameters: Mapping[str, str],
    context: Context,
    *,
    single: bool = False,
    paged: bool = False,
) -> list[Evolution]:
    """Return what a source tells, as documents in the names of `context`."""
    registration = match.registration
    try:
        tongue = await sources.forwarder.tongue(registration, context, body=None)
        names = match.attributes
        wanted = [] if single else _who(match, parameters, tongue.name)
        if names is not None:
            wanted.append(("attrs", ",".join(sorted(tongue.name(one) for one in names))))
        same = tongue.context is context
        wanted += [
            (name, said)
            for name, said in parameters.items()
            if name not in _NOT_PASSED_ON and (same or name not in _NAMING)
        ]
        if paged:
            wanted.append(("limit", parameters["limit"]))
        reply = await heard(sources, registration, Question("GET", path, tongue, tuple(wanted)))
        if reply is None:
            return []
        documents = _documents(registration, reply, single=single)
        there = await answered_context(sources, reply, tongue)
    except Unheard as unheard:
        sources.note(unheard)
        return []
    except Problem as problem:
        sources.note(Unheard(registration, SILENT, 502, problem.detail))
        return []
    in_ours = (translated(_plain(one), there.terms, context.terms) for one in documents)
    return [_limited(one, names, context) for one in in_ours]


def _who(match: Match, parameters: Mapping[str, str], name: Any) -> list[tuple[str, str]]:
    types = {kind for part in match.parts for kind in part.types or ()} or {
        kind for piece in match.registration.information for one in piece.entities for kind in one.types
    }
    wanted = [("type", ",".join(sorted(name(kind) for kind in types)))] if types else []
    ids = match.ids
    if ids:
        wanted.append(("id", ",".join(ids)))
    elif "idPattern" in parameters:
        wanted.append(("idPattern", parameters["idPattern"]))
    return wanted


def _documents(registration: Registration, reply: Reply, *, single: bool) -> list[Evolution]:
    try:
        found = orjson.loads(reply.body) if reply.body else ({} if single else [])
    except orjson.JSONDecodeError as error:
        why = f"{registration.endpoint} answers no JSON: {error}"
        raise Unheard(registration, INVALID, 502, why) from None
    documents = [found] if single and found else found
    if not isinstance(documents, list) or not all(
        isinstance(one, dict) and isinstance(one.get("id"), str) for one in documents
    ):
        raise Unheard(registration, INVALID, 502, f"{registration.endpoint} answers no temporal entities")
    return documents


def _plain(document: Evolution) -> Evolution:
    return {name: said for name, said in document.items() if name != "@context"}


def _limited(document: Evolution, names: frozenset[str] | None, context: Context) -> Evolution:
    if names is None:
        return document
    return {
        name: said
        for name, said in document.items()
        if name in _MEMBERS or context.terms.expand(name) in names
    }


def _together(
    told: Iterable[tuple[Registration | None, Evolution]], context: Context, parameters: Mapping[str, str]
) -> Evolution:
    """Return one evolution out of those that were told, the strongest first."""
    ranked = sorted(told, key=lambda one: (0, "") if one[0] is None else (int(one[0].mode) + 1, one[0].id))
    proxied = [one for one, _ in ranked if one is not None and one.mode.is_proxied]
    result: Evolution = {}
    for registration, document in ranked:
        gone = _claimed(proxied, registration, context)
        for name, said in document.items():
            if name in _MEMBERS:
                result.setdefault(name, said)
            elif gone is not None and name not in gone:
                result[name] = _joined(result[name], said) if name in result else said
    last = parameters.get("lastN", "")
    if last.isascii() and last.isdecimal() and int(last):
        for name in result.keys() - _MEMBERS:
            result[name] = _newest(result[name], int(last))
    return result


def _claimed(
    proxied: list[Registration], registration: Registration | None, context: Context
) -> frozenset[str] | None:
    """Return the names of attributes that others have to themselves; None if they have everything."""
    names: set[str] = set()
    for one in proxied:
        if registration is not None and registration.mode <= one.mode:
            continue
        for piece in one.information:
            if piece.attributes is None:
                return None
            names |= {context.terms.compact(name) for name in piece.attributes}
    return frozenset(names)


def _joined(own: Any, other: Any) -> Any:
    """Return two series of one attribute as one."""
    if isinstance(own, list) and isinstance(other, list):
        seen = {_written(one) for one in own}
        return sorted([*own, *(one for one in other if _written(one) not in seen)], key=_time_of)
    if isinstance(own, dict) and isinstance(other, dict):
        for member, pairs in own.items():
            if member in _SERIES and isinstance(pairs, list) and isinstance(other.get(member), list):
                both = {_written(one): one for one in (*pairs, *other[member])}
                return {**own, member: sorted(both.values(), key=_time_of)}
    return own


_SERIES: Final = frozenset(
    {"values", "objects", "languageMaps", "jsons", "vocabs", "valueLists", "objectLists"}
)


def _newest(series: Any, count: int) -> Any:
    if isinstance(series, list) and all(isinstance(one, dict) and "values" not in one for one in series):
        return series[-count:]
    if isinstance(series, dict):
        return {
            name: said[-count:] if name in _SERIES and isinstance(said, list) else said
            for name, said in series.items()
        }
    return series


def _time_of(one: Any) -> float:
    text: Any = None
    if isinstance(one, dict):
        text = next((one[name] for name in _TIMES if name in one), None)
    elif isinstance(one, list) and len(one) > 1:
        text = one[1]
    at = moment(text) if isinstance(text, str) else None
    return float("-inf") if at is None else at


def _written(one: Any) -> bytes:
    plain = (
        {name: said for name, said in one.items() if name != "instanceId"} if isinstance(one, dict) else one
    )
    return orjson.dumps(plain, option=orjson.OPT_SORT_KEYS)


def _names_of(parameters: Mapping[str, str], context: Context) -> frozenset[str] | None:
    given = parameters.get("attrs")
    if not given or "q" in parameters:
        return None
    return frozenset(expand(one, context.terms) for one in given.split(",") if one) or None


def _window(exchange: Exchange) -> Window:
    def number(name: str, default: int) -> int:
        given = exchange.parameter(name) or ""
        return int(given) if given.isascii() and given.isdecimal() and len(given) < 10 else default

    return Window(number("offset", 0), number("limit", DEFAULT_LIMIT), False)


def _answer(exchange: Exchange, context: Context, document: Evolution) -> Answer:
    if exchange.accept() == JSON_LD:
        body = orjson.dumps({"@context": context.document, **document})
        return Answer(200, body, [(b"content-type", JSON_LD.encode())])
    return Answer(200, orjson.dumps(document), json_headers(context))
