"""Entities purged at several sources (clause 5.6.21).

A source purges no more than it is registered for: of the types it has registered, and where it has registered
attributes, these attributes and not the entities. Where one entity may be spread over several sources, it is
found out first which meet the conditions as a whole: a part alone may look as if it did.
"""

from collections.abc import Iterable, Mapping
from typing import Any, Final

import orjson

from handover.errors import Problem
from services.context_broker.api.exchange import Answer, Exchange
from services.context_broker.contexts.book import Context
from services.context_broker.distribution import outcomes, reading
from services.context_broker.distribution.distribution import Performing, Sources, all_of, in_place_of
from services.context_broker.distribution.fetching import AT_A_TIME, MOST_IDS
from services.context_broker.distribution.forwarding import SILENT, Question, Tongue, Unheard
from services.context_broker.distribution.outcomes import Outcome
from services.context_broker.distribution.questions import FILTERS, asked_by, may_be_split
from services.context_broker.entities.purge import selection_to_purge
from services.context_broker.queries.reading import selection_of
from services.context_broker.queries.selection import hits_of
from services.context_broker.sources.registration import Asked, Match

_NAMING: Final = frozenset({"q", "geoproperty"})
_AS_THEY_ARE: Final = ("q", "scopeQ", "georel", "geometry", "coordinates", "geoproperty", "idPattern")


async def purge(sources: Sources, exchange: Exchange, perform: Performing) -> Answer:
    """DELETE entities: the broker's own first, then those of all sources at once."""
    context = await exchange.reader_context()
    asked, where = asked_by(exchange.parameters, context, None)
    matches = sources.unasked(sources.registry.matching("purgeEntity", asked, where))
    conditions = any(name in exchange.parameters for name in (*FILTERS, "attrs"))
    if conditions and may_be_split(exchange.parameters, matches):
        hits = await _whole_hits(sources, exchange, context)
        if not hits:
            return Answer(204)
        gone = {name: exchange.parameters[name] for name in ("drop", "keep") if name in exchange.parameters}
        exchange = in_place_of(exchange, parameters={**gone, "id": ",".join(hits), "local": "true"})
        named = Asked(tuple(hits), None, asked.types)
        matches = sources.unasked(sources.registry.matching("purgeEntity", named, where))
    own = await perform(exchange)
    pieces = [piece for one in matches for piece in one.in_questions(MOST_IDS)]
    found: list[Outcome] = []
    for start in range(0, len(pieces), AT_A_TIME):
        some = pieces[start : start + AT_A_TIME]
        found += await all_of(*(_purge_at(sources, one, exchange.parameters, context) for one in some))
    failed = [one for one in found if one.problem is not None and one.status != 404]
    if not failed:
        return own
    body: dict[str, Any] = {"success": [], "errors": []}
    if own.status == 207:
        body |= orjson.loads(own.body)
    body["errors"] = [*body["errors"], *outcomes.entity_errors(None, failed)]
    return outcomes.multi_status(body)


async def _whole_hits(sources: Sources, exchange: Exchange, context: Context) -> list[str]:
    """Return the ids of the entities that meet the conditions, all that sources tell of them included."""
    selection_to_purge(exchange, context)
    asking = {name: said for name, said in exchange.parameters.items() if name not in {"drop", "keep"}}
    found: list[str] = []

    async def collect(over: Exchange) -> Answer:
        selection = selection_of({**over.parameters, "local": "true"}, context)
        found.extend(one.id for one in await hits_of(over.tenant.store, selection))
        return Answer(200)

    await reading.query(sources, in_place_of(exchange, parameters=asking), collect)
    return found


async def _purge_at(
    sources: Sources, match: Match, parameters: Mapping[str, str], context: Context
) -> Outcome:
    one, nothing = match.registration, frozenset[str]()
    try:
        tongue = await sources.forwarder.tongue(one, context, body=None)
        if tongue.context is not context and not _NAMING.isdisjoint(parameters):
            return outcomes.of_refusal(one, nothing, "conditions on attributes in names that are not its own")
        wanted = _narrowed(match, parameters, context, tongue)
        if wanted is None:
            return Outcome(one, nothing, 204)
        question = Question("DELETE", "entities", tongue, tuple(wanted))
        reply, _ = await sources.forwarder.ask(one, question, sources.asking)
        if sources.had_passed(one, reply.status):
            return Outcome(one, nothing, 204)
    except Unheard as unheard:
        return outcomes.of_silence(unheard, nothing)
    except Problem as problem:  # its @context
        return outcomes.of_silence(Unheard(one, SILENT, 502, problem.detail), nothing)
    return outcomes.of_reply(one, nothing, reply)


def _narrowed(
    match: Match, parameters: Mapping[str, str], context: Context, tongue: Tongue
) -> list[tuple[str, str]] | None:
    """Return what to ask of a source, None if nothing that it is registered for is to go."""
    one = match.registration
    types = {kind for part in match.parts for kind in part.types or ()} or {
        kind for piece in one.information for each in piece.entities for kind in each.types
    }
    wanted = [("type", _joined(types, tongue))] if types else []
    if match.ids:
        wanted.append(("id", ",".join(match.ids)))
    wanted += [(name, parameters[name]) for name in _AS_THEY_ARE if name in parameters]
    gone = _attributes(parameters.get("drop"), context)
    kept = _attributes(parameters.get("keep"), context)
    if all(piece.attributes is not None for piece in one.information):
        names = {name for piece in one.information for name in piece.attributes or ()}
        gone = (names if gone is None else names & gone) - (kept or set())
        if not gone:
            return None
        kept = None
    if gone is not None:
        wanted.append(("drop", _joined(gone, tongue)))
    if kept is not None:
        wanted.append(("keep", _joined(kept, tongue)))
    return wanted


def _attributes(given: str | None, context: Context) -> set[str] | None:
    return None if given is None else {context.terms.expand(one) for one in given.split(",") if one}


def _joined(names: Iterable[str], tongue: Tongue) -> str:
    return ",".join(sorted(tongue.name(one) for one in names))
