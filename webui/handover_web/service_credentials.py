"""The credentials of the page server for its own requests, which publish the live state of the cell."""

from collections.abc import AsyncGenerator, Iterable

import httpx

from handover.errors import UsageError
from handover.security.service_access import AccountsUnavailable, ServiceAccess


class ServiceCredentials(httpx.Auth):
    """Adds the access token of the page server to requests to our services at `urls`, and to no others.

    Services of other packages and their health pages never get a token. While none can be issued, a request
    fails like one to a service that does not answer.
    """

    def __init__(self, access: ServiceAccess, urls: Iterable[str]) -> None:
        self._access = access
        self._origins = frozenset(_origin(httpx.URL(url)) for url in urls)

    async def async_auth_flow(self, request: httpx.Request) -> AsyncGenerator[httpx.Request, httpx.Response]:
        """Add the token, and another one if it is refused; raise `httpx.RequestError` if there is none."""
        if _origin(request.url) not in self._origins:
            yield request
            return
        own = await self._add_token(request)
        response = yield request
        if response.status_code == httpx.codes.UNAUTHORIZED and self._access.renew(own):
            await self._add_token(request)
            yield request

    async def _add_token(self, request: httpx.Request) -> dict[str, str]:
        try:
            own = await self._access.headers()
        except (AccountsUnavailable, UsageError) as error:
            raise httpx.RequestError(str(error), request=request) from None
        request.headers.update(own)
        return own


def _origin(url: httpx.URL) -> tuple[str, str, int | None]:
    return url.scheme, url.host, url.port
