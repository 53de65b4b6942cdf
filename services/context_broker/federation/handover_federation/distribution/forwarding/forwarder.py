"""Sends one HTTP request to one context source, in the dialect and with the headers of its registration.

Clauses 4.3.6.5 and 4.3.6.6 (contextSourceInfo), 6.3.17 (failures), 6.3.18 (Via, local).
"""

import time
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final
from urllib.parse import quote

import orjson

from handover.network.http_client import (
    BodyReadingHttpClient,
    HttpResponse,
    ResponseTimeout,
    ResponseTooLarge,
    SendError,
)
from handover.network.outbound_policy import OutboundPolicy
from handover.telemetry import get_logger
from handover_broker.contexts.context_resolver import CORE, ContextResolver
from handover_broker.model.context import Context
from handover_broker.request.request_context import JSON, JSON_LD
from handover_federation.distribution.forwarding.translation import older, translated
from handover_federation.distribution.forwarding.via import append_to_via, chain
from handover_federation.registrations.registration import Registration
from handover_federation.registrations.registry import Registry

log = get_logger(__name__)

FROM_THE_REQUEST: Final = "urn:ngsi-ld:request"
"""A value in contextSourceInfo that stands for the same header of the client's request (clause 4.3.6.5)."""
MAX_CACHED_RESPONSES: Final = 256
"""Cached responses of sources whose registration allows it (localCache)."""
MAX_ALIASES: Final = 10_000
"""Sources whose alias is remembered."""
MAX_CACHED_BYTES: Final = 1024 * 1024
"""Size of a cached response in bytes."""
_PROCESSED: Final = frozenset({"jsonldcontext", "accept", "contenttype", "ngsildconformance"})
_NOT_THEIRS: Final = frozenset(
    {"host", "content-length", "content-type", "transfer-encoding", "connection", "keep-alive", "upgrade",
     "te", "trailer", "expect", "via", "ngsild-tenant", "link"}
)  # fmt: skip
"""Hop-by-hop headers, and headers that the broker sets: contextSourceInfo cannot change them."""

STALE, INVALID, SILENT, REFUSED = 110, 111, 199, 299
"""Codes of NGSILD-Warning (table 6.3.17-1): a cached response, an invalid response, no response in time or
a loop, an error response."""


class SourceError(Exception):
    """A source gave no usable response: `warning` is the code for reads, `status` the HTTP status for writes.

    `answered` is the status of an error response, None without a response.
    """

    def __init__(
        self, registration: Registration, warning: int, status: int, why: str, answered: int | None = None
    ) -> None:
        super().__init__(why)
        self.registration = registration
        self.warning = warning
        self.status = status
        self.why = why
        self.answered = answered


@dataclass(frozen=True, slots=True)
class RequestOrigin:
    """The request for which sources are queried: its headers, with the chain of brokers in Via."""

    headers: Mapping[bytes, bytes]
    name: str
    """The alias of this broker for the tenant of the request."""
    registry: Registry
    timed_out: set[str] = field(default_factory=set)
    """Registrations whose source timed out during this request; it is not queried again for it."""


@dataclass(frozen=True, slots=True)
class SourceDialect:
    """How to address a source: the @context of names, the media type of bodies, the Link to the context."""

    context: Context
    media_type: str
    link: str | None

    def name(self, iri: str) -> str:
        """Return the name of a type or an attribute in the dialect."""
        return self.context.terms.compact(iri)


@dataclass(frozen=True, slots=True)
class SourceRequest:
    """A request to a source; `path` is relative to the root of the API and percent-encoded."""

    method: str
    path: str
    dialect: SourceDialect
    parameters: tuple[tuple[str, str], ...] = ()
    document: Any = None
    headers: tuple[tuple[str, str], ...] = ()


@dataclass(slots=True)
class _CachedResponse:
    response: HttpResponse
    until_s: float


@dataclass(slots=True)
class Forwarder:
    """Sends requests to the context sources of all tenants."""

    contexts: ContextResolver
    timeout_s: float
    http_client: BodyReadingHttpClient = field(
        default_factory=lambda: BodyReadingHttpClient(OutboundPolicy())
    )
    small_pages: set[str] = field(default_factory=set)
    """Endpoints of sources that refuse large pages."""
    _aliases: dict[tuple[str, str], str] = field(default_factory=dict)
    _cached: OrderedDict[tuple[Any, ...], _CachedResponse] = field(default_factory=OrderedDict)

    def alias_of(self, registration: Registration) -> str | None:
        """Return the alias of a source in Via: from its registration, or from an earlier response."""
        if registration.alias is not None:
            return registration.alias
        return self._aliases.get((registration.endpoint, registration.tenant))

    def is_ourselves(self, registration: Registration, registry: Registry, name: str) -> bool:
        """Return whether a source is this broker and tenant, whose alias is `name`.

        If the address is not known as the broker's own, the first response contains the alias.
        """
        if self.alias_of(registration) == name:
            return True
        return registration.tenant == registry.tenant and self.contexts.is_ours(registration.endpoint)

    def patience_s(self, registration: Registration) -> float:
        """Return the timeout for one response of a source."""
        return registration.management.timeout_s or self.timeout_s

    async def dialect(
        self, registration: Registration, context: Context, *, body: str | None
    ) -> SourceDialect:
        """Return the dialect of a source for a request made in `context`.

        `body` is the media type of the request's body, None if nothing is sent: JSON-LD is forwarded as
        JSON-LD. Raises a problem (504) when the source's own @context cannot be loaded.
        """
        wanted = _info(registration, "jsonldContext")
        if wanted is not None:
            return SourceDialect(await self.contexts.of(wanted), JSON, wanted)
        media_type = _info(registration, "contentType")
        if body is not None and (media_type or body) == JSON_LD:
            return SourceDialect(context, JSON_LD, None)
        if context.document == CORE:
            return SourceDialect(context, JSON, None)
        if context.link is not None:
            return SourceDialect(context, JSON, context.link)
        if body is not None and media_type is None:
            return SourceDialect(context, JSON_LD, None)
        return SourceDialect(
            await self.contexts.of(None), JSON, None
        )  # the context has no URL for a Link header: full names

    async def send(
        self, registration: Registration, source_request: SourceRequest, origin: RequestOrigin
    ) -> tuple[HttpResponse, bool]:
        """Return the response, whatever its status, and whether it is a cached one.

        Raises `SourceError` if there is none: timeout, connection failure or cooldown. Only a registration
        sets a cooldown (clause 5.2.34); without one, the next request queries the source again.
        """
        headers = _headers(registration, source_request, origin)
        url = _url(registration, source_request)
        is_kept = source_request.method == "GET" and registration.management.cache_s > 0
        key = (registration.id, url, *headers)
        if is_kept and (cached := self._cached.get(key)) and cached.until_s > time.monotonic():
            return cached.response, True
        _refuse_at_rest(registration, origin)
        response = await self._sent(registration, source_request, origin, url, headers)
        if is_kept and response.status == 200 and len(response.body) <= MAX_CACHED_BYTES:
            self._cache(key, response, registration.management.cache_s)
        return response, False

    async def _sent(
        self,
        registration: Registration,
        source_request: SourceRequest,
        origin: RequestOrigin,
        url: str,
        headers: list[tuple[str, str]],
    ) -> HttpResponse:
        timeout_s, registry = self.patience_s(registration), origin.registry
        try:
            response = await self.http_client.request(
                source_request.method, url, headers, _body(registration, source_request), timeout_s
            )
        except SendError as error:
            if isinstance(error, ResponseTimeout):
                origin.timed_out.add(registration.id)
            registry.record_attempt(registration, succeeded=False)
            warning = INVALID if isinstance(error, ResponseTooLarge) else SILENT
            why = f"{registration.shown}: {error}"
            log.info("context source failed", registration=registration.id, why=why)
            raise SourceError(
                registration, warning, 504 if isinstance(error, ResponseTimeout) else 502, why
            ) from None
        registry.record_attempt(registration, succeeded=response.status < 500 or response.status == 508)
        if names := chain(response.headers.get("via", "").encode("latin-1", "replace")):
            if len(self._aliases) >= MAX_ALIASES:
                self._aliases.clear()
            self._aliases[registration.endpoint, registration.tenant] = names[0]
        return response

    def _cache(self, key: tuple[Any, ...], response: HttpResponse, seconds: float) -> None:
        self._cached[key] = _CachedResponse(response, time.monotonic() + seconds)
        self._cached.move_to_end(key)
        if len(self._cached) > MAX_CACHED_RESPONSES:
            self._cached.popitem(last=False)


def _refuse_at_rest(registration: Registration, origin: RequestOrigin) -> None:
    if registration.id in origin.timed_out:
        why = f"{registration.shown} did not answer another part of this request in time"
        raise SourceError(registration, SILENT, 504, why)
    if origin.registry.is_cooling_down(registration):
        why = f"{registration.shown} failed within the cooldown that its registration sets"
        raise SourceError(registration, SILENT, 504, why)


def _info(registration: Registration, key: str) -> str | None:
    wanted = key.lower()
    return next((value for name, value in registration.source_info if name.lower() == wanted), None)


def _url(registration: Registration, source_request: SourceRequest) -> str:
    parameters: Iterable[tuple[str, str]] = source_request.parameters
    if registration.management.local_only:
        parameters = (*parameters, ("local", "true"))
    query = "&".join(f"{name}={quote(value, safe=_PLAIN_IN_QUERIES)}" for name, value in parameters)
    url = registration.url(source_request.path)
    return f"{url}?{query}" if query else url


_PLAIN_IN_QUERIES: Final = ":,/()*"
"""Characters that are valid unescaped in a query and easier to read in logs."""


def _body(registration: Registration, source_request: SourceRequest) -> bytes:
    if source_request.document is None:
        return b""
    version = _info(registration, "ngsildConformance")
    document = source_request.document if version is None else older(source_request.document, version)
    if source_request.dialect.media_type == JSON_LD:
        document = _with_context(document, source_request.dialect.context.document)
    return orjson.dumps(document)


def _with_context(document: Any, context: Any) -> Any:
    if isinstance(document, list):
        return [_with_context(part, context) for part in document]
    return {"@context": context, **document} if isinstance(document, dict) else document


def _headers(
    registration: Registration, source_request: SourceRequest, origin: RequestOrigin
) -> list[tuple[str, str]]:
    dialect = source_request.dialect
    headers = [
        ("Accept", _info(registration, "accept") or JSON),
        ("Via", append_to_via(origin.headers.get(b"via", b""), origin.name)),
        *source_request.headers,
    ]
    if source_request.document is not None:
        headers.append(("Content-Type", dialect.media_type))
    if dialect.link is not None and (source_request.document is None or dialect.media_type != JSON_LD):
        link = f'<{dialect.link}>; rel="http://www.w3.org/ns/json-ld#context"; type="{JSON_LD}"'
        headers.append(("Link", link))
    if registration.tenant:
        headers.append(("NGSILD-Tenant", registration.tenant))
    for name, value in registration.source_info:
        if name.lower() in _PROCESSED or name.lower() in _NOT_THEIRS:
            continue
        if value == FROM_THE_REQUEST:
            value = origin.headers.get(name.lower().encode("latin-1", "replace"), b"").decode("latin-1")  # noqa: PLW2901
        if value and value.isprintable() and value.isascii() and _TOKEN.issuperset(name):
            headers.append((name, value))
    return headers


_TOKEN: Final = frozenset("!#$%&'*+-.^_`|~0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ")


def in_dialect(document: Any, context: Context, dialect: SourceDialect) -> Any:
    """Return a document with its names in `context` translated to the dialect, without @context."""
    if isinstance(document, list):
        return [in_dialect(part, context, dialect) for part in document]
    without_context = {name: value for name, value in document.items() if name != "@context"}
    return (
        without_context
        if dialect.context is context
        else translated(without_context, context.terms, dialect.context.terms)
    )


def quoted(part: str) -> str:
    """Return a path segment, percent-encoded."""
    return quote(part, safe=":")
