"""The connection of a client to its broker: which broker it is, its credentials, and one request.

A broker that is not ours gets no credentials of ours.
"""

import asyncio
import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from http import HTTPStatus
from typing import Any, Final, Protocol, Self
from urllib.parse import quote, urlencode

import httpx
import orjson

from handover.broker.answers import TRANSIENT, no_broker, refusal_of
from handover.broker.credentials import HOW_TO_SET, BrokerCredentials, credentials_of
from handover.broker.errors import BrokerUnavailable, BrokerUnreachable
from handover.broker.identity import (
    CONTEXT_PATH,
    ORION_VERSION_PATH,
    OURS,
    BrokerIdentity,
    identity_in,
    is_our_context,
)
from handover.errors import HandoverError
from handover.network.http_client import Address, BodyReadingHttpClient, HttpResponse, SendError, address
from handover.runtime.clocks import Lifetime
from handover.settings import Settings

JSON = "application/json"
JSON_LD = "application/ld+json"
MAX_RESPONSE_BYTES = 256 * 1024 * 1024

UNCERTAIN_IDENTITY_S: Final = 10.0
"""After this time a broker that has not said clearly which one it is, is asked again."""

_NO_CREDENTIALS: Final[Mapping[str, str]] = {}
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


class Credentials(Protocol):
    """The credentials of a service for its requests, such as `handover.security.service_access`."""

    async def headers(self) -> Mapping[str, str]:
        """Return the headers of a request; empty while no account exists."""
        ...

    def renew(self, refused: Mapping[str, str]) -> bool:
        """Forget headers that were refused with 401; return whether the next `headers` differ."""
        ...


class BrokerConnection:
    """Sends requests to the broker of `settings`, and knows which broker it is."""

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
        if response.status in TRANSIENT:
            raise refusal_of(response, f"GET {path}")
        if response.status >= 300:
            return None, response.status in _NO_SUCH_PATH
        try:
            return orjson.loads(response.body), True
        except orjson.JSONDecodeError:
            return None, False

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
        source, own = await self._given()
        response = await self._send(method, url, (*headers, *own.items()), content)
        if response.status == HTTPStatus.UNAUTHORIZED and source is not None and source.renew(own):
            source, own = await self._given()
            response = await self._send(method, url, (*headers, *own.items()), content)
        if 200 <= response.status < 300:
            if response.headers.get("content-type", "").startswith("text/html"):
                raise no_broker(response, self.url)
            return response
        refusal = refusal_of(response, f"{method} {path}")
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


async def _headers_of(credentials: Credentials) -> Mapping[str, str]:
    try:
        return await credentials.headers()
    except HandoverError as error:
        raise BrokerUnavailable(503, "No credentials", str(error)) from error
