"""Mapping: entity maps made together with sources that make some, too (clauses 4.3.6.7, 5.14.4, 5.14.5).

A source's map lists what the source has of the query, and is linked from the broker's: later pages are asked
for by it, so that the source, too, need not look around again. Where conditions have to wait until an entity
is put together, the entities are read as well.
"""

from collections.abc import Mapping
from typing import Any, Final

import orjson

from handover.errors import Problem
from services.context_broker.api.exchange import Answer, Exchange
from services.context_broker.api.words import require_uri
from services.context_broker.contexts.book import Context
from services.context_broker.distribution.distribution import Performing, Sources, all_of, in_place_of
from services.context_broker.distribution.fetching import can_be_asked, fetch_many, narrowed
from services.context_broker.distribution.fetching_past import of_the_past, who
from services.context_broker.distribution.forwarding import INVALID, SILENT, Question, Unheard
from services.context_broker.distribution.gathering import Gathering
from services.context_broker.distribution.questions import FILTERS, asked_by, questions_in, refuse_order
from services.context_broker.distribution.source_answers import heard
from services.context_broker.snapshots.entity_maps import Listed
from services.context_broker.sources.registration import Match, Registration
from services.context_broker.temporal.operations import temporal_parameters

MAKES: Final = "createEntityMapQueryEntity"
MAKES_OF_THE_PAST: Final = "createEntityMapQueryTemporal"
_LIFETIME: Final = "entityMapLifetime"
_PAGE: Final = 1000
_MOST_PAGES: Final = 100
"""Pages of entities of the past that are read from a source that makes no maps."""


class Mapper:
    """Has sources make maps of the answers to one query; `listed` is what comes of it."""

    def __init__(self, sources: Sources, context: Context, lifetime: str | None) -> None:
        self._sources = sources
        self._context = context
        self._lifetime = () if lifetime is None else ((_LIFETIME, lifetime),)
        self.listed = Listed()

    async def ask(
        self, match: Match, parameters: Mapping[str, str], into: Gathering, *, is_split: bool
    ) -> None:
        """Have a source make a map if it does, and read its entities if that is not enough."""
        registration = match.registration
        is_listed = False
        if registration.takes(MAKES):
            try:
                tongue = await self._sources.forwarder.tongue(registration, self._context, body=None)
                questions = list(narrowed(match, parameters, self._context, tongue, is_split=is_split))
                if len(questions) == 1:
                    plain = [one for one in questions[0] if one[0] != "options"]
                    question = Question("GET", "entityMaps", tongue, (*plain, *self._lifetime))
                    is_listed = await self._take(registration, question)
            except Unheard as unheard:
                self._sources.note(unheard)
                return
            except Problem as problem:  # its @context
                self._sources.note(Unheard(registration, SILENT, 502, problem.detail))
                return
        if can_be_asked(match) and (not is_listed or _needs_entities(registration, parameters, is_split)):
            self.listed.entities = {
                one: rest
                for one, who_has in self.listed.entities.items()
                if (rest := [each for each in who_has if each != registration.id])
            }  # these are candidates: what is read decides
            await fetch_many(self._sources, match, parameters, self._context, into, is_split=is_split)

    async def _take(self, registration: Registration, question: Question) -> bool:
        """Take the map that a source makes; say whether it made one. Raises `Unheard` if it is silent."""
        try:
            reply = await heard(self._sources, registration, question)
        except Unheard as unheard:
            if unheard.answered is None:
                raise
            return False  # it makes no maps, whatever its registration says
        if reply is None:
            return False
        try:
            document = orjson.loads(reply.body)
        except orjson.JSONDecodeError:
            document = None
        entities = document.get("entityMap") if isinstance(document, dict) else None
        map_id = document.get("id") if isinstance(document, dict) else None
        if not isinstance(entities, dict) or not isinstance(map_id, str):
            self._sources.warn(INVALID, f"{registration.endpoint} answers something else than an entity map")
            return False
        self.listed.linked[registration.id] = map_id
        for one in entities:
            if _may_have(registration, one):
                self.listed.entities.setdefault(one, []).append(registration.id)
        return True

    async def ask_of_the_past(self, match: Match, parameters: Mapping[str, str]) -> None:
        """Have a source make a map of the past if it does; else read which entities it tells of."""
        registration = match.registration
        try:
            tongue = await self._sources.forwarder.tongue(registration, self._context, body=None)
            asked = [*who(match, parameters, tongue.name)]
            asked += of_the_past(match, parameters, tongue, same=tongue.context is self._context)
            if registration.takes(MAKES_OF_THE_PAST):
                question = Question("GET", "temporal/entityMaps", tongue, (*asked, *self._lifetime))
                if await self._take(registration, question):
                    return
            if registration.takes("queryTemporal"):
                await self._read_ids(registration, Question("GET", "temporal/entities", tongue, tuple(asked)))
        except Unheard as unheard:
            self._sources.note(unheard)
        except Problem as problem:
            self._sources.note(Unheard(registration, SILENT, 502, problem.detail))

    async def _read_ids(self, registration: Registration, question: Question) -> None:
        plain = [one for one in question.parameters if one[0] not in {"lastN", "options", "format"}]
        for page in range(_MOST_PAGES):
            window = (("lastN", "1"), ("limit", str(_PAGE)), ("offset", str(page * _PAGE)))
            asked = Question("GET", question.path, question.tongue, (*plain, *window))
            reply = await heard(self._sources, registration, asked)
            try:
                told = orjson.loads(reply.body) if reply is not None and reply.body else []
            except orjson.JSONDecodeError:
                told = None
            if not isinstance(told, list):
                why = f"{registration.endpoint} answers no temporal entities"
                raise Unheard(registration, INVALID, 502, why)
            ids = {one.get("id") for one in told if isinstance(one, dict)}
            fresh = [one for one in ids if isinstance(one, str) and self._is_new(one, registration)]
            for one in sorted(fresh):
                self.listed.entities.setdefault(one, []).append(registration.id)
            if not fresh or len(told) < _PAGE:
                return

    def _is_new(self, entity_id: str, registration: Registration) -> bool:
        return registration.id not in self.listed.entities.get(entity_id, ())


async def map_past(sources: Sources, exchange: Exchange, perform: Performing) -> Answer:
    """GET or POST temporal/entityMaps."""
    if exchange.method == "GET":
        context, parameters = await exchange.reader_context(), dict(exchange.parameters)
        questions = [parameters]
    else:
        document, context = await exchange.body()
        if not isinstance(document, dict):
            return await perform(exchange)
        parameters = {**exchange.parameters, **temporal_parameters(document)}
        plain = {name: said for name, said in document.items() if name not in {"temporalQ", "aggrParams"}}
        questions = list(questions_in(plain, parameters))
    mapper = Mapper(sources, context, exchange.parameter(_LIFETIME))
    asking = []
    for each in questions:
        asked, where = asked_by(each, context, None)
        found = sources.registry.matching((MAKES_OF_THE_PAST, "queryTemporal"), asked, where)
        refuse_order(each, sources.unasked(found, heeds_map=False))
        asking += [mapper.ask_of_the_past(match, each) for match in sources.unasked(found)]
    if not asking:
        return await perform(exchange)
    own = in_place_of(exchange, parameters={**exchange.parameters, "local": "true"}, elsewhere=mapper.listed)
    await all_of(*asking)
    return await perform(own)


def _needs_entities(registration: Registration, parameters: Mapping[str, str], is_split: bool) -> bool:
    """Say whether a list of ids is not enough to know which entities answer a query."""
    if "join" in parameters:
        return True
    has_other_names = any(name.lower() == "jsonldcontext" for name, _ in registration.source_info)
    return (is_split or has_other_names) and any(name in parameters for name in FILTERS)


def _may_have(registration: Registration, entity_id: Any) -> bool:
    try:
        require_uri(entity_id, "an id in an entity map")
    except Problem:
        return False
    return any(
        not piece.entities or any(one.has(entity_id) for one in piece.entities)
        for piece in registration.information
    )
