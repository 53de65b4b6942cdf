"""An asynchronous NGSI-LD client for any context broker.

It uses only ETSI GS CIM 009. The Link header of every request has the @context, so that types and attributes
have the same meaning for all clients.

A broker that is not ours gets no credentials of ours. Some brokers answer without their database that nothing
is there: before something counts as missing at a broker that is not ours, an entity that this client has
written is read (`_PRESENCE`).
"""

import asyncio
import math
import time
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from email.utils import parsedate_to_datetime
from http import HTTPStatus
from typing import Any, Final, Protocol, Self, TypeVar
from urllib.parse import quote, urlencode

import httpx
import orjson

from handover.broker.credentials import HOW_TO_SET, BrokerCredentials, credentials_of
from handover.broker.identity import (
    CONTEXT_PATH,
    ORION_VERSION_PATH,
    OURS,
    BrokerIdentity,
    identity_in,
    is_our_context,
)
from handover.errors import HandoverError, Problem
from handover.formats.free_values import FREE_VALUES, with_texts, without_texts
from handover.network.http_client import Address, BodyReadingHttpClient, HttpResponse, SendError, address
from handover.runtime.clocks import Lifetime
from handover.settings import Settings
from handover.telemetry import get_logger
from handover_datamodels.entities import Entity

log = get_logger(__name__)

JSON = "application/json"
JSON_LD = "application/ld+json"
PAGE = 500
"""Entities per page; many brokers refuse more than 1000."""
MAX_RESPONSE_BYTES = 256 * 1024 * 1024

UNCERTAIN_IDENTITY_S: Final = 10.0
"""After this time a broker that has not said clearly which one it is, is asked again."""
MAX_FAULTS: Final = 3
"""A request at which the broker has failed so often (`BrokerFault`) is not repeated."""

_ENTITIES: Final = ("/entities", "/entityOperations")
_PRESENCE: Final = "BrokerPresence"
"""Type of the entity that is read before another one counts as missing: one for each cell and tenant."""
_PURPOSE: Final = "While it cannot be read, the broker is without its data, and nothing counts as missing."
_NO_CREDENTIALS: Final[Mapping[str, str]] = {}

AnEntity = TypeVar("AnEntity", bound=Entity)
AJson = TypeVar("AJson", list[Any], dict[str, Any])
NgsiLd = Mapping[str, Any]


_OF_THE_BROKER: Final = frozenset(
    {"id", "type", "@context", "jsonldContext", "status", "origin", "createdAt", "modifiedAt"}
)
"""Members of a subscription that brokers add by themselves."""


class BrokerError(Problem):
    """The broker refused the request with `status`, `title` and `detail`."""


class NotFound(BrokerError):
    """There is no such entity, attribute or subscription."""


class AlreadyExists(BrokerError):
    """An entity or subscription with this id exists."""


class BrokerUnavailable(BrokerError):
    """The broker is unreachable or cannot answer now; a retry may succeed."""


class BrokerUnreachable(BrokerUnavailable):
    """No answer came."""


class BrokerFault(BrokerUnavailable):
    """The broker failed at the request, as with 500; a retry may succeed, or never."""


def is_presence(entity_id: str) -> bool:
    """Return whether an entity is one that clients have written to see that the broker has its data."""
    return entity_id.startswith(f"urn:ngsi-ld:{_PRESENCE}:")


def fault_delay_s(faults: int) -> float:
    """Return the pause before a request is repeated at which the broker has failed `faults` times."""
    return 2.0**faults


class Credentials(Protocol):
    """The credentials of a service for its requests, such as `handover.security.service_access`."""

    async def headers(self) -> Mapping[str, str]:
        """Return the headers of a request; empty while no account exists."""
        ...

    def renew(self, refused: Mapping[str, str]) -> bool:
        """Forget headers that were refused with 401; return whether the next `headers` differ."""
        ...


class BrokerClient:
    """A client of the broker of `settings`; an asynchronous context manager.

    Every method raises `BrokerUnavailable` when the broker does not answer, or not as a broker that has its
    data, and another `BrokerError` when it refuses the request. A broker of ours gets the `credentials`,
    another one those of the settings. `transport` replaces the HTTP client, for example by the ASGI transport
    of httpx. `accept` is the media type of answers. Without a `context_url` in the settings there is no Link
    header; an object with an "@context" is sent as JSON-LD.
    """

    def __init__(
        self,
        settings: Settings,
        *,
        credentials: Credentials | None = None,
        transport: httpx.AsyncBaseTransport | None = None,
        timeout_s: float = 10.0,
        accept: str = JSON,
    ) -> None:
        headers = [("Accept", accept)]
        if settings.broker_tenant:
            headers.append(("NGSILD-Tenant", settings.broker_tenant))
        self._with_context = (*headers, ("Content-Type", JSON_LD))
        if settings.context_url:
            context = f'<{settings.context_url}>; rel="http://www.w3.org/ns/json-ld#context"'
            headers.append(("Link", f'{context}; type="{JSON_LD}"'))
        self.url = settings.broker_url
        self._base = address(f"{settings.broker_url.rstrip('/')}/ngsi-ld/v1")
        self._root = self._base.target.removesuffix("/ngsi-ld/v1")
        self._timeout_s = timeout_s
        self.credentials = credentials
        self._others: BrokerCredentials | None = credentials_of(settings)
        self._identity: BrokerIdentity | None = None
        self._identity_life = Lifetime.begin(math.inf)
        self._identifying = asyncio.Lock()
        self._presence_id = settings.entity_id(_PRESENCE, settings.broker_tenant or "cell")
        self._transport = transport
        self._http = BodyReadingHttpClient(ca_files=settings.ca_files, max_response_bytes=MAX_RESPONSE_BYTES)
        # A robot may be updated hundreds of times a second, so the headers are built once.
        self._headers = tuple(headers)
        self._with_body = (*headers, ("Content-Type", JSON))

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self._http.close()
        if self._others is not None:
            self._others.close()
        if self._transport is not None:
            await self._transport.aclose()

    async def probe(self) -> float | None:
        """Send a small query; return by how many s the broker's clock differs from ours.

        It is None where the broker does not say its time, positive where that is ahead, and right to about a
        second. Raises `BrokerUnavailable` if the broker does not answer.
        """
        answer = await self._call("GET", "/entities", params={"type": "Device", "limit": 1})
        try:
            return parsedate_to_datetime(answer.headers["date"]).timestamp() - time.time()
        except (KeyError, ValueError):
            return None

    async def identity(self) -> BrokerIdentity:
        """Return which broker it is; it is asked again after it could not be reached.

        An answer that may be of the moment, as a sign-in page or 500, makes it a broker without a name for
        `UNCERTAIN_IDENTITY_S`. Raises `BrokerUnavailable`.
        """
        if (identity := self._current_identity()) is not None:
            return identity
        async with self._identifying:
            if (identity := self._current_identity()) is None:
                context, is_certain = await self._look_up(CONTEXT_PATH)
                identity = OURS
                if not is_our_context(context):
                    version, _ = await self._look_up(ORION_VERSION_PATH)
                    identity = identity_in(version)
                is_certain = is_certain or identity != BrokerIdentity()
                self._identity_life = Lifetime.begin(math.inf if is_certain else UNCERTAIN_IDENTITY_S)
                self._identity = identity
            return identity

    def _current_identity(self) -> BrokerIdentity | None:
        return None if self._identity_life.is_over() else self._identity

    async def _look_up(self, path: str) -> tuple[Any, bool]:
        """Return the JSON document at a path of the server, and whether that is certain.

        It is None if the server has none. Our credentials are not sent.
        """
        others = _NO_CREDENTIALS if self._others is None else await _headers_of(self._others)
        url = replace(self._base, target=f"{self._root}{path}")
        # Without the Link header: a broker that cannot fetch the @context now has nothing to do with it here.
        response = await self._send("GET", url, (("Accept", JSON), *others.items()), b"")
        if response.status in _TRANSIENT:
            raise _refusal(response, f"GET {path}")
        if response.status >= 300:
            return None, response.status in _NO_SUCH_PATH
        try:
            return orjson.loads(response.body), True
        except orjson.JSONDecodeError:
            return None, False

    async def request(
        self, method: str, path: str, *, params: Mapping[str, Any] | None = None, body: Any = None
    ) -> HttpResponse:
        """Send a request of the API, with `path` below /ngsi-ld/v1; return the answer as it is.

        A partial success (207) is for the caller to read.
        """
        return await self._call(method, path, params=params, body=body)

    async def create(self, entity: Entity | NgsiLd) -> None:
        """Create an entity; raise `AlreadyExists` if its id is taken."""
        await self._call("POST", "/entities", body=await self._written(entity))

    async def retrieve(self, entity_id: str) -> dict[str, Any]:
        """Return an entity in normalized form; raise `NotFound` if there is none."""
        response = await self._call("GET", f"/entities/{_in_path(entity_id)}")
        return without_texts(_json(response, dict, self.url))

    async def get(self, entity_id: str, model: type[AnEntity]) -> AnEntity:
        """Return an entity as `model`."""
        return model.from_ngsild(await self.retrieve(entity_id))

    async def query(self, **selection: Any) -> list[dict[str, Any]]:
        """Return all entities that match, of all pages, in normalized form.

        `selection` holds the query parameters of NGSI-LD (clause 6.4.3.2): `type`, `id`, `id_pattern`,
        `attrs`, `q`; lists are joined with commas.
        """
        return [without_texts(entity) async for page in self._pages(selection) for entity in page]

    async def count(self, **selection: Any) -> int | None:
        """Return how many entities match; None if the broker does not say it.

        `selection` is that of `query`.
        """
        params = {_parameter(name): _joined(value) for name, value in selection.items() if value is not None}
        response = await self._call("GET", "/entities", params={**params, "count": "true", "limit": 0})
        total = response.headers.get("ngsild-results-count", "")
        return int(total) if total.isdecimal() else None

    async def evolution(self, since: str, **selection: Any) -> list[dict[str, Any]]:
        """Return the temporal evolution, normalized and with times, of entities that changed since a time.

        Raises `BrokerError` if the broker has no temporal API.
        """
        times = {"timerel": "after", "timeAt": since, "timeproperty": "modifiedAt", "options": "sysAttrs"}
        pages = self._pages({**selection, **times}, "/temporal/entities")
        return [entity async for page in pages for entity in page]

    async def find(self, model: type[AnEntity], **selection: Any) -> list[AnEntity]:
        """Return all entities of `model` that match; an invalid one is logged and skipped."""
        found: list[AnEntity] = []
        for entity in await self.query(type=model.ngsi_type(), **selection):
            try:
                found.append(model.from_ngsild(entity))
            except ValueError as error:
                log.warning("entity does not match the data model", entity=entity.get("id"), error=str(error))
        return found

    async def update(self, entity_id: str, attributes: NgsiLd) -> None:
        """Overwrite attributes (PATCH …/attrs); some brokers add missing attributes, others refuse them.

        Raises `NotFound` if the entity does not exist, `BrokerError` with the reasons for refused attributes.
        """
        body = await self._written(attributes)
        answer = await self._call("PATCH", f"/entities/{_in_path(entity_id)}/attrs", body=body)
        _require_all_done(answer, "notUpdated", _not_updated)

    async def append(self, entity_id: str, attributes: NgsiLd) -> None:
        """Overwrite or add attributes (POST …/attrs); raise `NotFound` if the entity does not exist."""
        body = await self._written(attributes)
        await self._call("POST", f"/entities/{_in_path(entity_id)}/attrs", body=body)

    async def delete_attribute(self, entity_id: str, name: str) -> None:
        """Delete an attribute, of a name or an IRI; raise `NotFound` if there is none."""
        await self._call("DELETE", f"/entities/{_in_path(entity_id)}/attrs/{quote(name, safe='')}")

    async def upsert(self, entities: Sequence[Entity | NgsiLd]) -> None:
        """Create the entities, or update the given attributes of existing ones, in one batch."""
        _require_all_done(await self._send_upsert(entities), "errors", _batch_error)

    async def replace(self, entities: Sequence[Entity | NgsiLd]) -> None:
        """Create the entities, or replace existing ones with all their attributes, in one batch."""
        _require_all_done(await self._send_upsert(entities, "replace"), "errors", _batch_error)

    async def upsert_batch(self, entities: Sequence[Entity | NgsiLd]) -> frozenset[str]:
        """Create or update entities as `upsert` does; return the ids of those that were refused."""
        return _refused(await self._send_upsert(entities))

    async def _send_upsert(self, entities: Sequence[Entity | NgsiLd], option: str = "update") -> HttpResponse:
        body = [await self._written(entity) for entity in entities]
        return await self._call("POST", "/entityOperations/upsert", params={"options": option}, body=body)

    async def create_batch(self, entities: Sequence[Entity | NgsiLd]) -> frozenset[str]:
        """Create entities in one request; return the ids of those that exist already or were refused."""
        body = [await self._written(entity) for entity in entities]
        return _refused(await self._call("POST", "/entityOperations/create", body=body))

    async def delete(self, entity_id: str) -> None:
        """Delete an entity; raise `NotFound` if there is none."""
        await self._call("DELETE", f"/entities/{_in_path(entity_id)}")

    async def delete_evolution(self, entity_id: str) -> None:
        """Delete the temporal evolution of an entity; raise `NotFound` if there is none.

        Raises `BrokerError` if the broker has no temporal API.
        """
        await self._call("DELETE", f"/temporal/entities/{_in_path(entity_id)}")

    async def delete_batch(self, entity_ids: Sequence[str]) -> None:
        """Delete entities in one request; missing ones are ignored."""
        path = "/entityOperations/delete"
        with suppress(NotFound):  # some brokers answer so when none exists
            answer = await self._call("POST", path, body=list(entity_ids))
            is_missing = any(map(_is_not_found, _failures(answer, "errors")))
            if is_missing and await self._has_to_repeat():
                answer = await self._request("POST", path, body=list(entity_ids))
            _require_all_done(answer, "errors", _batch_error, is_ignored=_is_not_found)

    async def ensure_subscription(self, subscription: NgsiLd) -> None:
        """Create this subscription (with its `id`), or update the existing one; idempotent.

        One that has members which this one does not have, as an end or a filter that somebody added, is
        deleted and created again, since an update would keep them.
        """
        subscription_id = str(subscription["id"])
        try:
            await self._call("POST", "/subscriptions", body=subscription)
        except AlreadyExists:
            present = await self.subscription(subscription_id)
            added = present.keys() - subscription.keys() - _OF_THE_BROKER
            if added - {name for name in added if (name, present[name]) == ("isActive", True)}:
                with suppress(NotFound):
                    await self.delete_subscription(subscription_id)
                await self._call("POST", "/subscriptions", body=subscription)
                return
            change = {key: value for key, value in subscription.items() if key not in {"id", "@context"}}
            await self._call("PATCH", f"/subscriptions/{_in_path(subscription_id)}", body=change)

    async def types(self) -> list[str]:
        """Return the types of all entities."""
        response = await self._call("GET", "/types")
        return [str(name) for name in _json(response, dict, self.url).get("typeList", [])]

    async def subscriptions(self) -> list[dict[str, Any]]:
        """Return all subscriptions, with the times of their changes."""
        pages = self._pages({"options": "sysAttrs"}, "/subscriptions")
        return [subscription async for page in pages for subscription in page]

    async def subscription(self, subscription_id: str) -> dict[str, Any]:
        """Return a subscription, with the times of its changes; raise `NotFound` if there is none."""
        path = f"/subscriptions/{_in_path(subscription_id)}"
        response = await self._call("GET", path, params={"options": "sysAttrs"})
        return _json(response, dict, self.url)

    async def delete_subscription(self, subscription_id: str) -> None:
        """Delete a subscription; raise `NotFound` if there is none."""
        await self._call("DELETE", f"/subscriptions/{_in_path(subscription_id)}")

    async def _pages(
        self, selection: Mapping[str, Any], path: str = "/entities"
    ) -> AsyncIterator[list[dict[str, Any]]]:
        params = {_parameter(name): _joined(value) for name, value in selection.items() if value is not None}
        offset = 0
        while True:
            page = await self._call("GET", path, params={**params, "limit": PAGE, "offset": offset})
            entities: list[dict[str, Any]] = _json(page, list, self.url)
            yield entities
            if len(entities) < PAGE:
                return
            offset += PAGE

    async def _call(
        self, method: str, path: str, *, params: Mapping[str, Any] | None = None, body: Any = None
    ) -> HttpResponse:
        """Send a request; where another broker finds nothing, or fails, ask first whether it has its data."""
        try:
            response = await self._request(method, path, params, body)
        except NotFound:
            if not path.startswith(_ENTITIES) or not await self._has_to_repeat():
                raise
        except BrokerFault:
            await self._has_to_repeat()
            raise
        else:
            if not _finds_nothing(method, path, params, response) or not await self._has_to_repeat():
                return response
        return await self._request(method, path, params, body)

    async def _written(self, entity: Entity | NgsiLd) -> NgsiLd:
        """Return an entity or attributes as they are written to this broker. Raises `BrokerUnavailable`."""
        document = entity.to_normalized() if isinstance(entity, Entity) else entity
        if document.keys().isdisjoint(FREE_VALUES) or (await self.identity()).is_ours:
            return document
        return with_texts(document)

    async def _has_to_repeat(self) -> bool:
        """Return whether the same request may be answered otherwise now: by a broker that is not ours.

        Raises `BrokerUnavailable` if it cannot read what this client has written.
        """
        if (await self.identity()).is_ours:
            return False
        path = f"/entities/{_in_path(self._presence_id)}"
        try:
            await self._request("GET", path)
        except NotFound:
            await self._write_presence()
            try:
                await self._request("GET", path)
            except NotFound as error:
                raise self._without_data(error) from None
        except BrokerFault as error:
            raise self._without_data(error) from None
        return True

    async def _write_presence(self) -> None:
        try:
            presence = {
                "id": self._presence_id,
                "type": _PRESENCE,
                "purpose": {"type": "Property", "value": _PURPOSE},
            }
            await self._request("POST", "/entities", body=presence)
        except AlreadyExists:
            return
        except BrokerError as error:
            raise self._without_data(error) from None

    def _without_data(self, error: BrokerError) -> BrokerUnavailable:
        return BrokerUnavailable(
            503,
            "Broker without its data",
            f"{self.url} can neither read nor store {self._presence_id}: is its database away, or is it no "
            f"NGSI-LD broker? Until then nothing counts as missing ({error.status} {error.title}: "
            f"{error.detail})",
        )

    async def _request(
        self, method: str, path: str, params: Mapping[str, Any] | None = None, body: Any = None
    ) -> HttpResponse:
        """Send a request with the credentials for this broker; return its response if it succeeded."""
        query = f"?{urlencode(params, quote_via=quote, safe=':,')}" if params else ""
        url = replace(self._base, target=f"{self._base.target}{path}{query}")
        headers = self._headers if body is None else self._with_body
        if isinstance(body, Mapping) and "@context" in body:
            headers = self._with_context
        content = b"" if body is None else orjson.dumps(body)
        given, own = await self._given()
        response = await self._send(method, url, (*headers, *own.items()), content)
        if response.status == HTTPStatus.UNAUTHORIZED and given is not None and given.renew(own):
            given, own = await self._given()
            response = await self._send(method, url, (*headers, *own.items()), content)
        if 200 <= response.status < 300:
            if response.headers.get("content-type", "").startswith("text/html"):
                raise _no_broker(response, self.url)
            return response
        refusal = _refusal(response, f"{method} {path}")
        if response.status in _NO_ACCESS and not (await self.identity()).is_ours:
            refusal.detail = f"{refusal.detail}; the broker {self.url} wants credentials: {HOW_TO_SET}"
        if response.status == HTTPStatus.UNAUTHORIZED:
            # The clocks differ, or accounts has just been set up: that is no property of the request.
            raise BrokerUnavailable(refusal.status, refusal.title, refusal.detail, refusal.type)
        raise refusal

    async def _given(self) -> tuple[Credentials | None, Mapping[str, str]]:
        """Return what gives the credentials for this broker, and their headers."""
        if self._others is not None:
            return self._others, await _headers_of(self._others)
        if self.credentials is None:
            return None, _NO_CREDENTIALS
        own = await _headers_of(self.credentials)
        if own and not (await self.identity()).is_ours:
            return None, _NO_CREDENTIALS
        return self.credentials, own

    async def _send(
        self, method: str, url: Address, headers: Iterable[tuple[str, str]], content: bytes
    ) -> HttpResponse:
        try:
            if self._transport is None:
                return await self._http.request(method, url, list(headers), content, self._timeout_s)
            return await self._send_by(self._transport, method, url.target, headers, content)
        except (SendError, httpx.TransportError, asyncio.IncompleteReadError) as error:
            self._identity = None
            reason = str(error) or type(error).__name__
            raise BrokerUnreachable(
                503, "Broker unavailable", f"{self.url} does not answer: {reason}"
            ) from error

    async def _send_by(
        self,
        transport: httpx.AsyncBaseTransport,
        method: str,
        target: str,
        headers: Iterable[tuple[str, str]],
        content: bytes,
    ) -> HttpResponse:
        timeout = httpx.Timeout(self._timeout_s).as_dict()
        url = httpx.URL(self.url).join(target)
        request = httpx.Request(
            method, url, headers=list(headers), content=content, extensions={"timeout": timeout}
        )
        response = await transport.handle_async_request(request)
        try:
            body = await response.aread()
        finally:
            await response.aclose()
        return HttpResponse(response.status_code, dict(response.headers), body)


_TRANSIENT: Final = frozenset(
    {
        HTTPStatus.REQUEST_TIMEOUT,
        HTTPStatus.TOO_EARLY,
        HTTPStatus.TOO_MANY_REQUESTS,
        HTTPStatus.BAD_GATEWAY,
        HTTPStatus.SERVICE_UNAVAILABLE,
        HTTPStatus.GATEWAY_TIMEOUT,
        HTTPStatus.INSUFFICIENT_STORAGE,
    }
)
"""Refusals that concern the moment and not the request."""
_NO_ACCESS: Final = frozenset({HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN})
_NO_SUCH_PATH: Final = frozenset(
    {
        HTTPStatus.BAD_REQUEST,
        HTTPStatus.NOT_FOUND,
        HTTPStatus.METHOD_NOT_ALLOWED,
        HTTPStatus.NOT_ACCEPTABLE,
        HTTPStatus.GONE,
        HTTPStatus.NOT_IMPLEMENTED,
    }
)
"""Answers of a server that does not have a path, and will not have it at the next request."""
_FINAL: Final = frozenset({HTTPStatus.NOT_IMPLEMENTED, HTTPStatus.HTTP_VERSION_NOT_SUPPORTED})
"""Those above 500 that concern the request: the broker will never perform it."""


def _refusal(response: HttpResponse, act: str) -> BrokerError:
    try:
        problem = orjson.loads(response.body)
    except orjson.JSONDecodeError:
        problem = {}
    if not isinstance(problem, dict):
        problem = {}
    status = response.status
    if 300 <= status < 400:
        return BrokerUnavailable(
            status,
            "Redirected",
            f"the broker redirects to {response.headers.get('location', 'nowhere')}, perhaps to sign in: "
            f"set HANDOVER_BROKER_URL to the broker itself; where it wants credentials, {HOW_TO_SET} ({act})",
        )
    title = str(problem.get("title") or _phrase(status))
    detail = str(problem.get("detail") or response.body.decode(errors="replace")[:500])
    kind = str(problem.get("type", "about:blank"))
    return _error_class(status)(status, title, f"{detail} ({act})", kind)


def _error_class(status: int) -> type[BrokerError]:
    if status == HTTPStatus.NOT_FOUND:
        return NotFound
    if status == HTTPStatus.CONFLICT:
        return AlreadyExists
    if status in _TRANSIENT:
        return BrokerUnavailable
    is_fault = status >= HTTPStatus.INTERNAL_SERVER_ERROR and status not in _FINAL
    return BrokerFault if is_fault else BrokerError


async def _headers_of(credentials: Credentials) -> Mapping[str, str]:
    try:
        return await credentials.headers()
    except HandoverError as error:
        raise BrokerUnavailable(503, "No credentials", str(error)) from error


def _finds_nothing(method: str, path: str, params: Mapping[str, Any] | None, response: HttpResponse) -> bool:
    """Return whether a query of entities has no result."""
    if method != "GET" or path != "/entities" or params is None:
        return False
    if params.get("limit") == 0:
        return response.headers.get("ngsild-results-count") == "0"
    return not params.get("offset") and response.body.strip() == b"[]"


def _json(response: HttpResponse, kind: type[AJson], url: str) -> AJson:
    """Return the body as a JSON list or object. Raises `BrokerUnavailable`."""
    try:
        document = orjson.loads(response.body)
    except orjson.JSONDecodeError:
        document = None
    if not isinstance(document, kind):
        raise _no_broker(response, url)
    return document


def _no_broker(response: HttpResponse, url: str) -> BrokerUnavailable:
    return BrokerUnavailable(
        502,
        "No answer of a broker",
        f"{url} answers {response.status} with {response.headers.get('content-type', 'no type')}, which is "
        "no NGSI-LD: perhaps a sign-in page, a proxy, another server; set HANDOVER_BROKER_URL to the broker",
    )


def _phrase(status: int) -> str:
    try:
        return HTTPStatus(status).phrase
    except ValueError:
        return f"Status {status}"


def _require_all_done(
    answer: HttpResponse,
    undone: str,
    describe: Callable[[NgsiLd], str],
    *,
    is_ignored: Callable[[NgsiLd], bool] = lambda _: False,
) -> None:
    """Raise `BrokerError` for the failures in the list `undone` of a partial success.

    Failures for which `is_ignored` is true are ignored.
    """
    failures = [each for each in _failures(answer, undone) if not is_ignored(each)]
    if failures:
        raise _refused_in_part(failures, describe)


def _failures(answer: HttpResponse, undone: str) -> list[NgsiLd]:
    """Return what a partial success left out: the list `undone`."""
    if answer.status != HTTPStatus.MULTI_STATUS:
        return []
    return list(orjson.loads(answer.body).get(undone, []))


def _refused_in_part(failures: Sequence[NgsiLd], describe: Callable[[NgsiLd], str]) -> BrokerError:
    """Return `BrokerUnavailable` if one of the failures concerns the moment: all may be sent again."""
    text = "; ".join(map(describe, failures))
    found = {_error_class(status): status for status in map(_status_of, failures)}
    for kind in (BrokerUnavailable, BrokerFault):
        if kind in found:
            return kind(found[kind], "Unavailable in part", text)
    return BrokerError(400, "Refused in part", text)


def _status_of(error: Mapping[str, Any]) -> int:
    problem = error.get("error")
    status = problem.get("status") if isinstance(problem, Mapping) else None
    return int(status) if isinstance(status, int | str) and str(status).isdecimal() else 0


def _refused(answer: HttpResponse) -> frozenset[str]:
    """Return the ids of the entities that a batch operation refused; raise `BrokerError` if one has no id."""
    errors = _failures(answer, "errors")
    if not all(isinstance(error.get("entityId"), str) for error in errors):
        raise _refused_in_part(errors, _batch_error)
    return frozenset(error["entityId"] for error in errors)


def _in_path(entity_id: str) -> str:
    return quote(entity_id, safe=":")


def _parameter(name: str) -> str:
    return "idPattern" if name == "id_pattern" else name


def _joined(value: Any) -> Any:
    if isinstance(value, bool):
        return str(value).lower()
    return ",".join(value) if isinstance(value, list | tuple | set | frozenset) else value


def _is_not_found(error: Mapping[str, Any]) -> bool:
    problem = error.get("error")
    if not isinstance(problem, Mapping):
        return False
    named = str(problem.get("type", "")).endswith("/ResourceNotFound")
    return named or _status_of(error) == HTTPStatus.NOT_FOUND


def _not_updated(left: Mapping[str, Any]) -> str:
    """Describe attributes that were not updated, in the form of the standard or of Orion-LD."""
    names = left.get("attributeName") or ", ".join(map(str, left.get("attributes") or ()))
    return f"{names}: {left.get('reason') or left.get('title')}"


def _batch_error(error: Mapping[str, Any]) -> str:
    problem = error.get("error", {})
    reason = problem.get("detail") or problem.get("title") if isinstance(problem, Mapping) else problem
    return f"{error.get('entityId')}: {reason}"
