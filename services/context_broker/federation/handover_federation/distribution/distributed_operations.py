"""Distributed operations: carried out together with context sources (clauses 4.3.6, 5.5 and 6.3.17).

A request of a tenant with registrations passes through here before the local operation. All matching sources
are queried at the same time, and their results are merged with the broker's own. Requests with `local=true`,
and requests that match no registration, go to the local operation only.
"""

import asyncio
import functools
from collections.abc import Awaitable, Callable, Iterable, Mapping
from typing import Any, Final
from urllib.parse import quote

from handover.errors import Problem
from handover_broker.delivery.disclosure import Unverified
from handover_broker.delivery.endpoint import CREDENTIALS
from handover_broker.model.problems import ERRORS
from handover_broker.request.request_context import (
    PREFIX,
    RequestContext,
    Response,
    problem_response,
)
from handover_broker.request.routing import Operation
from handover_federation.distribution.forwarding.forwarder import (
    SILENT,
    Forwarder,
    RequestOrigin,
    SourceError,
)
from handover_federation.distribution.forwarding.via import MAX_CHAIN_LENGTH, chain
from handover_federation.entity_maps.mapped_request import entity_map_of
from handover_federation.registrations.admission import Admission
from handover_federation.registrations.registration import Match, Registration
from handover_federation.tenant_state import federated

Perform = Callable[[RequestContext], Awaitable[Response]]
"""Carries out an operation on the broker's own entities."""

MAP_HEADER: Final = "NGSILD-EntityMap"
MAX_WARNING_LENGTH: Final = 300
"""Characters of the reason in a warning."""


class Sources:
    """The context sources of one tenant, queried for one request.

    `warnings` collects failures for readers, who get a result without the failed sources (table 6.3.17-1).
    """

    def __init__(self, request: RequestContext, forwarder: Forwarder) -> None:
        self.request = request
        self.forwarder = forwarder
        self.registry = federated(request.tenant).registry
        headers = request.headers
        if not request.tenant.receivers.passes_credentials_on():
            headers = {
                name: value for name, value in headers.items() if name.decode("latin-1") not in CREDENTIALS
            }
        self.origin = RequestOrigin(headers, request.tenant.alias, self.registry)
        self.warnings: dict[tuple[int, str], None] = {}
        self.source_errors: list[SourceError] = []
        self.admission = Admission(request.tenant.receivers, request.tenant.name, request.tenant.store)
        self._passed = frozenset(chain(request.headers.get(b"via", b"")))

    def unvisited(
        self, matches: Iterable[Match], *, uses_map: bool = True, changes: bool = False
    ) -> list[Match]:
        """Return the matches whose sources are not in the Via header of the request (clause 4.3.6.4).

        They are narrowed to what the owners of the registrations and the client may see (`Admission`).

        If an entity map answers the request, each match is narrowed to the entities that the map lists for
        its source (clause 5.7.2.4).
        """
        admitted = [
            some
            for match in matches
            if not self.has_visited(match.registration)
            and (some := self.admission.narrowed(match, changes=changes)) is not None
        ]
        entity_map = entity_map_of(self.request) if uses_map else None
        if entity_map is None:
            return admitted
        return [some for match in admitted if (some := match.among(entity_map.entities)).parts]

    def map_headers(self, registration: Registration) -> tuple[tuple[str, str], ...]:
        """Return the header that names the source's own entity map, if an entity map answers the request."""
        entity_map = entity_map_of(self.request)
        linked = None if entity_map is None else entity_map.linked.get(registration.id)
        return () if linked is None else ((MAP_HEADER, f"{PREFIX}entityMaps/{quote(linked, safe=':')}"),)

    def has_visited(self, registration: Registration) -> bool:
        """Return whether the request has already passed a source, or the source is this broker itself."""
        if self.forwarder.alias_of(registration) in self._passed:
            return True
        return self.forwarder.is_ourselves(registration, self.registry, self.origin.name)

    def is_loop_answer(self, registration: Registration, status: int) -> bool:
        """Return whether a 508 response comes from a source that the request has already passed.

        A source that is registered without an alias is known from its first response. It has already done its
        part.
        """
        return status == 508 and self.has_visited(registration)

    async def record(self, registration: Registration, ids: Iterable[str]) -> None:
        """Record which entities about bodies of persons are sent to a source. Raises `SourceError`."""
        try:
            for entity_id in ids:
                await self.admission.record(registration, entity_id)
        except Unverified as error:
            raise SourceError(registration, SILENT, 502, str(error)) from None

    def add_warning(self, code: int, why: str) -> None:
        """Add a warning for the client."""
        self.warnings[code, why] = None

    def add_error(self, error: SourceError) -> None:
        """Record that a source could not be queried."""
        self.source_errors.append(error)
        self.add_warning(error.warning, error.why)

    def with_warnings(self, answer: Response) -> Response:
        """Return the response with all warnings as headers."""
        name = self.origin.name
        for code, why in self.warnings:
            text = "".join(sign if " " <= sign <= "~" and sign not in '"\\' else "'" for sign in why)
            warning = f'{code} {name} "{text[:MAX_WARNING_LENGTH]}"'
            answer.headers.append((b"ngsild-warning", warning.encode()))
        return answer


Handler = Callable[[Sources, RequestContext, Perform], Awaitable[Response]]


class DistributedOperations:
    """Carries out distributed operations; the handlers are looked up by operation name at the first one."""

    def __init__(self, forwarder: Forwarder, handlers: Callable[[], Mapping[str, Handler]]) -> None:
        self.forwarder = forwarder
        self._handlers = functools.cache(handlers)

    async def answer(self, operation: Operation, request: RequestContext) -> Response:
        """Answer a request of a tenant that has registrations."""
        handler = self._handlers().get(operation.name)
        if handler is None or is_local(request):
            return await operation.answer(request)
        sources = Sources(request, self.forwarder)
        passed = chain(request.headers.get(b"via", b""))
        name = sources.origin.name
        try:
            if name in passed or len(passed) > MAX_CHAIN_LENGTH:
                raise loop_detected(name)
            await sources.admission.prepare(sources.registry)
            answer = await handler(sources, request, operation.answer)
        except Problem as problem:
            answer = problem_response(problem)
        if passed:  # the next broker learns this alias and can skip this broker for requests that passed it
            answer = Response(answer.status, answer.body, [*answer.headers, (b"via", f"1.1 {name}".encode())])
        return sources.with_warnings(answer) if sources.warnings else answer


def is_local(request: RequestContext) -> bool:
    """Return whether a request is limited to this broker's own entities (clause 6.3.18)."""
    return (
        request.parameter("local") == "true"
        or request.parameter("type") == "*"
        or b"ngsild-snapshot" in request.headers
    )


async def gather_all(*asked: Awaitable[Any]) -> list[Any]:
    """Await everything at the same time and return the results in order."""
    return list(await asyncio.gather(*asked))


def loop_detected(name: str) -> Problem:
    """The request has passed this broker before."""
    return Problem(
        508,
        "Loop detected",
        f"the request has passed {name} already (see its Via header); registrations form a loop: "
        'set "management": {"localOnly": true} in one of them, or query with local=true',
        ERRORS + "LoopDetected",
    )


def gateway_problem(error: SourceError) -> Problem:
    """The operation failed because a source could not be queried (clause 6.3.17)."""
    registration_id = error.registration.id
    if error.status == 508:
        return Problem(
            508, "Loop detected", f"registration {registration_id}: {error.why}", ERRORS + "LoopDetected"
        )
    title = "Gateway timeout" if error.status == 504 else "Bad gateway"
    detail = (
        f"the source of registration {registration_id} has the requested data: {error.why}; try again later"
    )
    return Problem(error.status, title, detail, ERRORS + "InternalError", {"registrationId": registration_id})
