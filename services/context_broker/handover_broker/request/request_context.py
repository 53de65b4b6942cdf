"""Requests and responses of operations: media types, @contexts, limits.

Plain ASGI with orjson, without a framework: this is the most frequent code path (clauses 6.3.4 to 6.3.6).
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from http import HTTPStatus
from typing import Any, Final
from urllib.parse import parse_qsl, unquote

import orjson
from starlette.types import Receive, Scope, Send

from handover.errors import Problem
from handover.security.caller import LOCAL_OWNER, Caller
from handover_broker.contexts.context_resolver import ContextResolver
from handover_broker.model.context import Context
from handover_broker.model.negotiation import (
    GEO_JSON,
    JSON,
    JSON_LD,
    MERGE_PATCH,
    PLAIN,
    accepted,
    context_link,
    preferred_version,
)
from handover_broker.model.nesting import MAX_NESTING, is_too_deep, too_deep
from handover_broker.model.problems import (
    MethodNotAllowed,
    bad_request_data,
    invalid_request,
    length_required,
    not_acceptable,
    too_large,
    unsupported_media_type,
)
from handover_broker.model.validation import shown
from handover_broker.query.parameters import BOOLEANS
from handover_broker.tenants import Tenant

__all__ = ["GEO_JSON", "JSON", "JSON_LD", "PREFIX", "Disconnected", "Request", "RequestContext", "Response"]

RETRY_AFTER_S: Final = 2
"""Sent with 503: the database, or the broker that serves, is back soon."""
PREFIX: Final = "/ngsi-ld/v1/"
MAX_QUERY_LENGTH: Final = 64 * 1024
_ANSWERED_AS: Final = {"HEAD": "GET"}
"""Operations treat both the same; the server leaves out the body of a response to HEAD."""
MAX_HEADER_LENGTH: Final = 4096
MAX_PARAMETERS: Final = 100
"""Maximum query parameters: no operation has half as many."""
MAX_REMEMBERED_CHARACTERS: Final = 1024
"""Maximum length of a query string that is cached."""

_READABLE = {JSON, JSON_LD, MERGE_PATCH}
_PLAINLY_SAID: Final = {character.encode(): character for character in _READABLE}
_WITH_BODY = {"POST", "PATCH", "PUT"}
_WITH_ENTITIES = tuple(
    PREFIX + path
    for path in ("entities", "entityOperations/query", "temporal/entities", "temporal/entityOperations")
)
"""Paths of entities."""
WITHOUT_BODY: Final[Mapping[int, tuple[tuple[bytes, bytes], ...]]] = {
    411: (),
    415: ((b"accept", f"{JSON}, {JSON_LD}".encode()),),
}
"""Refusals without a body (clause 6.3.4), with headers that name the way out instead (RFC 9110, 15.5.16)."""
_BROKEN_PERCENT = re.compile(r"%(?![0-9A-Fa-f]{2})")


class Disconnected(Exception):
    """The client has disconnected before the request was read."""


@dataclass(slots=True)
class Response:
    """A response: status, body and headers."""

    status: int
    body: bytes = b""
    headers: list[tuple[bytes, bytes]] = field(default_factory=list)


@dataclass(slots=True)
class Request:
    """A request: its head, and once it is read its parameters and body.

    `headers` are by name in lower case; repeated ones are joined with a comma.
    """

    method: str
    raw_path: bytes
    query: bytes
    headers: dict[bytes, bytes]
    parameters: Mapping[str, str] = field(default_factory=dict)
    body: bytes = b""
    address: str | None = None
    """The IP address of the client."""

    @classmethod
    def of_scope(cls, scope: Scope) -> "Request":
        """Return the request of an ASGI scope."""
        path = scope.get("raw_path") or scope["path"].encode()
        client = scope.get("client")
        return cls(
            scope["method"],
            path.partition(b"?")[0],
            scope["query_string"],
            by_name(scope["headers"]),
            address=None if client is None else client[0],
        )

    @property
    def path(self) -> str:
        """Return the decoded path."""
        path = self.raw_path.decode("latin-1")
        return unquote(path) if "%" in path else path

    def path_parts(self) -> list[str]:
        """Return the parts of the path after /ngsi-ld/v1/, decoded one by one: a %2F stays in its part."""
        try:
            text = self.raw_path.decode("ascii")[len(PREFIX) :].rstrip("/")
            parts = text.split("/")
            if "%" not in text:
                return parts
            if _BROKEN_PERCENT.search(text):
                raise invalid_request("the path has a % without two digits after it; write %25 for a %")
            return [unquote(part, errors="strict") for part in parts]
        except UnicodeDecodeError:
            raise invalid_request("the path is not percent-encoded UTF-8") from None


def by_name(headers: Sequence[tuple[bytes, bytes]]) -> dict[bytes, bytes]:
    """Return headers by name."""
    merged = dict(headers)
    if len(merged) < len(headers):
        merged.clear()
        for name, value in headers:
            merged[name] = merged[name] + b", " + value if name in merged else value
    return merged


class RequestContext:
    """A request while it is executed; `names` are the variable parts of its path."""

    __slots__ = ("caller", "contexts", "headers", "method", "names", "parameters", "path", "raw", "tenant")

    def __init__(
        self,
        request: Request,
        names: tuple[str, ...],
        contexts: ContextResolver,
        tenant: Tenant,
        caller: Caller = LOCAL_OWNER,
    ) -> None:
        self.caller = caller
        self.method = _ANSWERED_AS.get(request.method, request.method)
        self.path = request.path
        self.parameters = request.parameters
        self.headers = request.headers
        self.raw = request.body
        self.names = names
        self.contexts = contexts
        self.tenant = tenant

    def parameter(self, name: str) -> str | None:
        """Return a query parameter; None if it is absent."""
        return self.parameters.get(name)

    def flag(self, name: str) -> bool:
        """Return a boolean query parameter; `require_known` has refused any other value."""
        return self.parameters.get(name) == "true"

    def require_known(self, allowed: frozenset[str]) -> None:
        """Refuse parameters that the operation does not have, and invalid booleans.

        All booleans are checked here, since an operation reads only those that it needs.
        """
        for name, text in self.parameters.items():
            if name in BOOLEANS and name in allowed and text not in {"true", "false"}:
                raise bad_request_data(f"the parameter {name} is true or false, not {shown(text)}")
            if name not in allowed:
                raise invalid_request(
                    f"there is no parameter {shown(name)} here, only {', '.join(sorted(allowed)) or 'none'}"
                )

    def document(self) -> Any:
        """Return the body as JSON; raise a problem (400) if it is not JSON, or nested too deeply."""
        try:
            document = orjson.loads(self.raw)
        except orjson.JSONDecodeError as error:
            if "depth" in error.msg or "recursion" in error.msg.lower():
                raise too_deep() from None
            raise invalid_request(
                f"the body is not JSON: {error.msg} at line {error.lineno}, column {error.colno}"
            ) from None
        if self.raw.count(b"[") + self.raw.count(b"{") > MAX_NESTING and is_too_deep(document):
            raise too_deep()
        return document

    async def body(self) -> tuple[Any, Context]:
        """Return the body and the context of its names."""
        media_type = self.content_type()
        document = self.document()
        if document.__class__ is dict and media_type != JSON_LD and "@context" not in document:
            ready = self.contexts.at_hand(self.link() or self.contexts.default or b"null")
            if ready is not None:
                return document, ready
        if isinstance(document, list):
            raise bad_request_data("the body is a list; this operation takes one JSON object")
        return document, await self.context_of(document, media_type)

    def content_type(self) -> str:
        """Return the media type of the body; raise a problem (415) if it is not supported."""
        value = self.headers.get(b"content-type", b"")
        media_type = _PLAINLY_SAID.get(value) or value.decode("latin-1").partition(";")[0].strip().lower()
        if media_type not in _READABLE or (media_type == MERGE_PATCH and self.method != "PATCH"):
            raise unsupported_media_type(
                f"Content-Type {shown(value.decode('latin-1'))} is not supported; send {JSON} (@context in a "
                f"Link header) or {JSON_LD} (@context in the body)"
            )
        return media_type

    async def context_of(self, document: Any, media_type: str) -> Context:
        """Return the context of a document that was sent as `media_type`."""
        in_body = document.get("@context") if isinstance(document, dict) else None
        link = self.link()
        if media_type == JSON_LD:
            self.require_no_link(media_type)
            if in_body is None:
                raise bad_request_data(f'with {JSON_LD} the body has an "@context"; add it, or send {JSON}')
            return await self.contexts.of(in_body)
        if isinstance(document, dict) and "@context" in document:
            raise bad_request_data(
                f"with {media_type} the @context belongs into a Link header; move it there, or send {JSON_LD}"
            )
        return await self.contexts.of(link or self.contexts.default)

    def require_no_link(self, media_type: str) -> None:
        """Refuse a Link header beside a body with an @context (clause 6.3.5)."""
        if media_type == JSON_LD and self.link() is not None:
            raise bad_request_data(f"with {JSON_LD} the @context is in the body; leave the Link header out")

    async def reader_context(self) -> Context:
        """Return the context of the names in the response."""
        return await self.contexts.of(self.link() or self.contexts.default)

    def link(self) -> str | None:
        """Return the URL of the context in the Link header, None if there is none."""
        header = self.headers.get(b"link")
        return None if header is None else context_link(_of_bearable_length(header, "Link"))

    def accept(self, offered: tuple[str, ...] = PLAIN) -> str:
        """Return the accepted media type of `offered`; raise a problem (406) if none is."""
        header = self.headers.get(b"accept")
        chosen = offered[0] if header is None else accepted(_of_bearable_length(header, "Accept"), offered)
        if chosen is None:
            raise not_acceptable(
                f"Accept {shown((header or b'').decode('latin-1'))} excludes all of them; accept "
                f"{', '.join(offered[:-1])} or {offered[-1]}",
                offered,
            )
        return chosen


def _of_bearable_length(header: bytes, name: str) -> bytes:
    if len(header) > MAX_HEADER_LENGTH:
        raise invalid_request(
            f"the {name} header has {len(header)} characters; the maximum is {MAX_HEADER_LENGTH}"
        )
    return header


def _parameters(query: bytes) -> Mapping[str, str]:
    return (
        _read_parameters(query)
        if len(query) <= MAX_REMEMBERED_CHARACTERS
        else _read_parameters.__wrapped__(query)
    )


@lru_cache(maxsize=4096)
def _read_parameters(query: bytes) -> Mapping[str, str]:
    try:
        text = query.decode("ascii")
        pairs = parse_qsl(text, keep_blank_values=True, errors="strict", max_num_fields=MAX_PARAMETERS)
    except ValueError as error:
        raise invalid_request(
            f"the query of the URL is invalid: {error}; percent-encode it as UTF-8"
        ) from None
    if _BROKEN_PERCENT.search(text):
        raise invalid_request("the query of the URL has a % without two digits after it; write %25 for a %")
    parameters = dict(pairs)
    if len(parameters) < len(pairs):
        raise invalid_request("a parameter is given twice; join its values with commas")
    return parameters


async def read(request: Request, body: bytes | Receive, max_bytes: int) -> None:
    """Read the parameters and the body of a request: the whole body, or what is still to be received.

    Raises a problem: 411 for a body without a Content-Length (clause 6.3.4 has no exception for chunks), 413
    for one larger than `max_bytes`.
    """
    if request.query:
        if len(request.query) > MAX_QUERY_LENGTH:
            raise invalid_request(
                f"the query of the URL has more than {MAX_QUERY_LENGTH} characters; use POST"
            )
        request.parameters = _parameters(request.query)
    announced = request.headers.get(b"content-length")
    if announced is None:
        if request.method in _WITH_BODY:
            raise length_required()
    elif announced.isdigit() and int(announced) > max_bytes:
        raise too_large(f"the body has {int(announced)} bytes; the maximum is {max_bytes}, send less at once")
    request.body = body if isinstance(body, bytes) else await _whole(body, max_bytes)


async def _whole(receive: Receive, max_bytes: int) -> bytes:
    pieces: list[bytes] = []
    size, is_more = 0, True
    while is_more:
        message = await receive()
        if message["type"] == "http.disconnect":
            raise Disconnected
        pieces.append(message.get("body", b""))
        size += len(pieces[-1])
        is_more = message.get("more_body", False)
        if size > max_bytes:
            raise too_large(f"the body has more than {max_bytes} bytes; send less at once")
    return b"".join(pieces)


async def send_response(send: Send, answer: Response) -> None:
    """Send a response."""
    headers = [*answer.headers, (b"content-length", str(len(answer.body)).encode())]
    if answer.status == 204:
        headers = answer.headers
    await send({"type": "http.response.start", "status": answer.status, "headers": headers})
    await send({"type": "http.response.body", "body": answer.body})


def with_echoed_headers(request: Request, answer: Response) -> Response:
    """Return the response with headers that echo the request: the tenant, the preferred version.

    The tenant is in errors too (clause 6.3.14). A response that was converted to an earlier version has the
    status 203 (clause 6.3.21); one that did not have to be converted keeps its status.
    """
    tenant = request.headers.get(b"ngsild-tenant")
    if tenant is not None:
        answer = Response(answer.status, answer.body, [*answer.headers, (b"ngsild-tenant", tenant)])
    prefer = request.headers.get(b"prefer")
    if prefer is None or answer.status != 200:
        return answer
    return _as_preferred(request, prefer, answer)


def of_tenant(request: Request, answer: Response) -> Response:
    """Return the response to a request that was refused before it was read, with its tenant."""
    tenant = request.headers.get(b"ngsild-tenant")
    tenant_headers = [] if tenant is None else [(b"ngsild-tenant", tenant)]
    return Response(answer.status, answer.body, [*answer.headers, *tenant_headers])


def _as_preferred(request: Request, prefer: bytes, answer: Response) -> Response:
    from handover_broker.model.representation import conformance  # noqa: PLC0415 - few ask for another version

    try:
        version = preferred_version(_of_bearable_length(prefer, "Prefer"))
    except Problem as problem:
        return problem_response(problem)
    if version is None or not answer.body:
        return answer
    applied = "ngsi-ld={}.{}".format(*min(version, conformance.OURS)).encode()
    headers = [*answer.headers, (b"preference-applied", applied)]
    if not request.path.startswith(_WITH_ENTITIES):
        return Response(200, answer.body, headers)
    formats = request.parameters.get("format") or request.parameters.get("options", "")
    document = orjson.loads(answer.body)
    simplified = not {"keyValues", "simplified"}.isdisjoint(formats.split(","))
    conformed = conformance.conformed(document, version, simplified=simplified)
    if conformed is document:
        return Response(200, answer.body, headers)
    return Response(203, orjson.dumps(conformed), headers)


def problem_response(problem: Problem) -> Response:
    """Return a problem as a response: RFC 7807 as plain JSON, for old clients (clauses 5.5.3 and 6.3.3)."""
    if problem.status in WITHOUT_BODY:
        return Response(problem.status, b"", list(WITHOUT_BODY[problem.status]))
    headers = [(b"content-type", JSON.encode())]
    if isinstance(problem, MethodNotAllowed):
        headers.append((b"allow", ", ".join(problem.allowed).encode()))
    if problem.status == HTTPStatus.SERVICE_UNAVAILABLE:
        headers.append((b"retry-after", b"%d" % RETRY_AFTER_S))
    return Response(problem.status, orjson.dumps(problem.body()), headers)
