"""The credentials of the command line: the token of the service `cli`, or `HANDOVER_SERVICE_TOKEN`."""

import asyncio
from collections.abc import AsyncGenerator
from typing import Any, Final

import httpx

from handover.errors import UsageError
from handover.security.service_access import AccountsUnavailable, ServiceAccess
from handover.settings import Settings
from handover.tls_trust import client_context, handshake_fault

NAME: Final = "cli"


class AccessAuth(httpx.Auth):
    """Adds the credentials of `access` to each request of an asynchronous client."""

    def __init__(self, access: ServiceAccess) -> None:
        self._access = access

    async def async_auth_flow(self, request: httpx.Request) -> AsyncGenerator[httpx.Request, httpx.Response]:
        """Add the headers."""
        request.headers.update(await self._access.headers())
        yield request


def cli_access(settings: Settings) -> ServiceAccess:
    """Return the access of the command line to the services."""
    return ServiceAccess(settings, NAME)


def access_headers(settings: Settings) -> dict[str, str]:
    """Return the headers of a request to a service. Raises `UsageError` if accounts refuses."""

    async def read() -> dict[str, str]:
        async with cli_access(settings) as access:
            return await access.headers()

    try:
        return asyncio.run(read())
    except AccountsUnavailable as error:
        raise UsageError(str(error)) from None


def ask_service(
    name: str, settings: Settings, method: str, url: str, path: str, **request: Any
) -> httpx.Response:
    """Send a request to the service `name` at `url`; raise `UsageError` if it is away or refuses."""
    try:
        answer = httpx.request(
            method,
            f"{url}{path}",
            headers=access_headers(settings),
            timeout=30,
            trust_env=False,
            verify=client_context(*settings.ca_files),
            **request,
        )
    except httpx.TransportError as error:
        raise UsageError(
            handshake_fault(error, url) or f"the {name} does not answer at {url}; start it with: handover up"
        ) from None
    if answer.is_success:
        return answer
    try:
        reason = str(answer.json()["detail"])
    except (ValueError, KeyError, TypeError):
        reason = f"the {name} answered {answer.status_code}"
    raise UsageError(reason)
