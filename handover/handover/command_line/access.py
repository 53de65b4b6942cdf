"""The credentials of the command line: the token of the service `cli`, or `HANDOVER_SERVICE_TOKEN`."""

import asyncio
from collections.abc import AsyncGenerator, Callable
from typing import Any, Final

import httpx

from handover.errors import UsageError
from handover.network.tls_trust import client_context, handshake_fault, speaks_tls
from handover.security.service_access import AccountsUnavailable, ServiceAccess
from handover.settings import Settings

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


def _reason(name: str, answer: httpx.Response) -> str:
    try:
        return str(answer.json()["detail"])
    except (ValueError, KeyError, TypeError):
        return f"the {name} answered {answer.status_code}"


def ask_service(
    name: str,
    settings: Settings,
    method: str,
    url: str,
    path: str,
    *,
    refusal: Callable[[httpx.Response], str] | None = None,
    **request: Any,
) -> httpx.Response:
    """Send a request to the service `name` at `url`; raise `UsageError` if it is away or refuses.

    `refusal` returns the text for an answer that is an error; by default its `detail`.
    """
    headers = {**request.pop("headers", {}), **access_headers(settings)}
    try:
        answer = httpx.request(
            method,
            f"{url}{path}",
            headers=headers,
            timeout=30,
            trust_env=False,
            verify=client_context(*settings.ca_files),
            **request,
        )
    except httpx.TransportError as error:
        raise no_answer(name, url, error) from None
    if answer.is_success:
        return answer
    raise UsageError(refusal(answer) if refusal else _reason(name, answer))


def no_answer(name: str, url: str, error: Exception) -> UsageError:
    """Return why the service `name` was not reached at `url`, and the way out."""
    fault = handshake_fault(error, url)
    if fault is None and speaks_tls(url):
        fault = (
            f"the {name} at {url} speaks TLS, and the settings here have no certificate; run this command in "
            "the folder of the cell, whose .env has them, or set HANDOVER_TLS_CERTIFICATE and "
            "HANDOVER_TLS_AUTHORITY as there (`handover settings` prints them)"
        )
    return UsageError(fault or f"the {name} does not answer at {url}; start it with: handover up")
