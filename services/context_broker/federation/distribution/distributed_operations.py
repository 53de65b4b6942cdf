"""Distribution: operations that other context sources have a share in (clauses 4.3.6, 5.5 and 6.3.17).

The rooms do everything for the broker's own entities. Where a tenant has registrations, an operation passes
through here first: the sources concerned are asked, all at once, and their answers and the broker's own
become one. `local=true` and what no registration is about stay with the rooms.
"""

import asyncio
import functools
from collections.abc import Awaitable, Callable, Iterable, Mapping
from typing import Any, Final
from urllib.parse import quote

from handover.errors import Problem
from services.context_broker.federation.distribution.forwarding import Forwarder, RequestOrigin, SourceError
from services.context_broker.federation.distribution.via import MAX_CHAIN_LENGTH, chain
from services.context_broker.federation.entity_maps.mapped_exchange import entity_map_of
from services.context_broker.federation.registrations.registration import Match, Registration
from services.context_broker.federation.tenant_state import federated
from services.context_broker.model.problems import ERRORS
from services.context_broker.request.request_context import (
    PREFIX,
)
from services.context_broker.request.request_context import (
    RequestContext as Exchange,
)
from services.context_broker.request.request_context import (
    Response as Answer,
)
from services.context_broker.request.request_context import (
    problem_response as problem_answer,
)
from services.context_broker.request.routing import Operation

Perform = Callable[[Exchange], Awaitable[Answer]]
"""Carries an operation out on the broker's own entities."""

MAP_HEADER: Final = "NGSILD-EntityMap"
MAX_WARNING_LENGTH: Final = 300
"""Characters of the reason that a warning gives."""


class Sources:
    """The context sources of one tenant, as they can be asked on behalf of one request.

    `warnings` gathers what went wrong, for those who get an answer all the same (table 6.3.17-1).
    """

    def __init__(self, exchange: Exchange, forwarder: Forwarder) -> None:
        self.exchange = exchange
        self.forwarder = forwarder
        self.registry = federated(exchange.tenant).registry
        self.origin = RequestOrigin(exchange.headers, exchange.tenant.alias, self.registry)
        self.warnings: dict[tuple[int, str], None] = {}
        self.source_errors: list[SourceError] = []
        self._passed = frozenset(chain(exchange.headers.get(b"via", b"")))

    def unvisited(self, matches: Iterable[Match], *, uses_map: bool = True) -> list[Match]:
        """Return the matches whose sources the request has not passed already (clause 4.3.6.4).

        Of those, if the request is answered by an entity map, the ones that the map says to have something,
        each narrowed to what that is (clause 5.7.2.4).
        """
        found = [one for one in matches if not self.has_visited(one.registration)]
        entity_map = entity_map_of(self.exchange) if uses_map else None
        if entity_map is None:
            return found
        return [some for one in found if (some := one.among(entity_map.entities)).parts]

    def map_headers(self, registration: Registration) -> tuple[tuple[str, str], ...]:
        """Return the header that names a source's own entity map, if the request is answered by maps."""
        entity_map = entity_map_of(self.exchange)
        linked = None if entity_map is None else entity_map.linked.get(registration.id)
        return () if linked is None else ((MAP_HEADER, f"{PREFIX}entityMaps/{quote(linked, safe=':')}"),)

    def has_visited(self, registration: Registration) -> bool:
        """Say whether the request has passed a source already; this broker itself it is at."""
        if self.forwarder.alias_of(registration) in self._passed:
            return True
        return self.forwarder.is_ourselves(registration, self.registry, self.origin.name)

    def is_loop_answer(self, registration: Registration, status: int) -> bool:
        """Say whether a source's answer tells that it need not have been asked: the request had passed it.

        Sources that say no alias are known by their first answer. What they have to do they do already.
        """
        return status == 508 and self.has_visited(registration)

    def add_warning(self, code: int, why: str) -> None:
        """Note something to warn of."""
        self.warnings[code, why] = None

    def add_error(self, error: SourceError) -> None:
        """Note that a source was not heard."""
        self.source_errors.append(error)
        self.add_warning(error.warning, error.why)

    def with_warnings(self, answer: Answer) -> Answer:
        """Return the answer with what there is to warn of."""
        name = self.origin.name
        for code, why in self.warnings:
            text = "".join(sign if " " <= sign <= "~" and sign not in '"\\' else "'" for sign in why)
            warning = f'{code} {name} "{text[:MAX_WARNING_LENGTH]}"'
            answer.headers.append((b"ngsild-warning", warning.encode()))
        return answer


Handler = Callable[[Sources, Exchange, Perform], Awaitable[Answer]]


class DistributedOperations:
    """Carries out operations together with other sources; how (by name) is looked up at the first one."""

    def __init__(self, forwarder: Forwarder, handlers: Callable[[], Mapping[str, Handler]]) -> None:
        self.forwarder = forwarder
        self._handlers = functools.cache(handlers)

    async def answer(self, operation: Operation, exchange: Exchange) -> Answer:
        """Answer a request of a tenant that has registrations."""
        handler = self._handlers().get(operation.name)
        if handler is None or is_local(exchange):
            return await operation.answer(exchange)
        sources = Sources(exchange, self.forwarder)
        passed = chain(exchange.headers.get(b"via", b""))
        name = sources.origin.name
        try:
            if name in passed or len(passed) > MAX_CHAIN_LENGTH:
                raise loop_detected(name)
            answer = await handler(sources, exchange, operation.answer)
        except Problem as problem:
            answer = problem_answer(problem)
        if passed:  # who asks learns our name, and need not ask us another time for what has passed us
            answer = Answer(answer.status, answer.body, [*answer.headers, (b"via", f"1.1 {name}".encode())])
        return sources.with_warnings(answer) if sources.warnings else answer


def is_local(exchange: Exchange) -> bool:
    """Say whether a request is about what the broker itself has (clause 6.3.18)."""
    return (
        exchange.parameter("local") == "true"
        or exchange.parameter("type") == "*"
        or b"ngsild-snapshot" in exchange.headers
    )


async def gather_all(*asked: Awaitable[Any]) -> list[Any]:
    """Return what all awaited things return; they run at the same time."""
    return list(await asyncio.gather(*asked))


def loop_detected(name: str) -> Problem:
    """The request has been here already."""
    return Problem(
        508,
        "Loop detected",
        f"the request has passed {name} already (see its Via header); registrations lead round in a circle: "
        'set "management": {"localOnly": true} in one of them, or ask with local=true',
        ERRORS + "LoopDetected",
    )


def gateway_problem(error: SourceError) -> Problem:
    """Nothing could be done because a source was not heard (clause 6.3.17)."""
    one = error.registration.id
    if error.status == 508:
        return Problem(508, "Loop detected", f"registration {one}: {error.why}", ERRORS + "LoopDetected")
    title = "Gateway timeout" if error.status == 504 else "Bad gateway"
    detail = f"the source of registration {one} holds what was asked for: {error.why}; try again later"
    return Problem(error.status, title, detail, ERRORS + "InternalError", {"registrationId": one})
