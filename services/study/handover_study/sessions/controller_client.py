"""An HTTP client for the study conditions of the gesture controller."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self
from urllib.parse import quote

import httpx

from handover.broker import Credentials
from handover.errors import HandoverError
from handover.network.tls_trust import client_context

TIMEOUT = httpx.Timeout(3.0)


class ControllerUnavailable(Exception):
    """The gesture controller does not respond, or rejects a request."""


class ControllerClient:
    """Reads and writes the study conditions of the controller at `url`; an asynchronous context manager.

    Each request carries the `credentials`.
    """

    def __init__(self, url: str, credentials: Credentials, ca_files: Sequence[Path] = ()) -> None:
        self._url = url
        self._credentials = credentials
        self._ca_files = ca_files
        self._http: httpx.AsyncClient | None = None

    async def __aenter__(self) -> Self:
        self._http = httpx.AsyncClient(
            base_url=self._url,
            timeout=TIMEOUT,
            trust_env=False,
            verify=client_context(*self._ca_files),
        )
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._http is not None:
            await self._http.aclose()
            self._http = None

    async def conditions(self) -> dict[str, dict[str, Any]]:
        """Return the conditions by session; raises `ControllerUnavailable`."""
        response = await self._request("GET", "/study-conditions")
        conditions: dict[str, dict[str, Any]] = response.json()
        return conditions

    async def set_condition(self, session: str, condition: dict[str, Any]) -> None:
        """Set the condition of a session; raises `ControllerUnavailable`."""
        await self._request("PUT", f"/study-conditions/{quote(session)}", condition)

    async def remove_condition(self, session: str) -> None:
        """Remove the condition of a session; raises `ControllerUnavailable`."""
        await self._request("DELETE", f"/study-conditions/{quote(session)}")

    async def _request(self, method: str, path: str, body: dict[str, Any] | None = None) -> httpx.Response:
        if self._http is None:
            raise ControllerUnavailable("the client is closed")
        try:
            own = await self._credentials.headers()
            response = await self._http.request(method, path, json=body, headers=dict(own))
            if response.status_code == httpx.codes.UNAUTHORIZED and self._credentials.renew(own):
                own = await self._credentials.headers()
                response = await self._http.request(method, path, json=body, headers=dict(own))
            response.raise_for_status()
        except (httpx.HTTPError, HandoverError) as error:
            raise ControllerUnavailable(f"{self._url}: {str(error) or type(error).__name__}") from None
        return response
