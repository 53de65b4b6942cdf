"""Service access: the credentials that a service sends with its own requests, and its requests to `accounts`.

A service has a secret token: the setting `HANDOVER_SERVICE_TOKEN`, or the file `service-tokens/<service>` in
the security directory. `accounts` exchanges it for an access token of five minutes. A program that is no
service of the cell, a script for example, has another secret token in that setting, and sends it as it is.
"""

import asyncio
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import orjson

from handover.errors import HandoverError, UsageError
from handover.http_client import BodyReadingHttpClient, SendError
from handover.security.caller import CallerKind
from handover.security.keys_in_force import KeysInForce
from handover.security.secret_tokens import is_secret_token, kind_of
from handover.settings import Settings

SERVICE_TOKENS_FOLDER: Final = "service-tokens"
REQUEST_TIMEOUT_S: Final = 4.0
UNAUTHORIZED: Final = 401
MAX_ANSWER_BYTES: Final = 1024 * 1024
_RENEW_AT: Final = 0.5
"""Part of the life of a token after which it is renewed."""


def service_token_file(settings: Settings, service: str) -> Path:
    """Return the file of the token of `service` in the security directory."""
    return settings.security_folder / SERVICE_TOKENS_FOLDER / service


def read_service_token(file: Path) -> str:
    """Return the secret token in a file. Raises `OSError`, `UsageError` if it holds none."""
    token = file.read_bytes().strip().decode("ascii", "replace")
    if not is_secret_token(token):
        raise UsageError(
            f"{file} is damaged: it holds no token; run `handover accounts set-up`, which writes a new one, "
            "and start the service again"
        )
    return token


class AccountsUnavailable(HandoverError):
    """`accounts` does not answer, or refuses; `problem` are the problem details of a refusal."""

    def __init__(self, reason: str, problem: Mapping[str, Any] | None = None) -> None:
        super().__init__(reason)
        self.problem = problem


@dataclass(frozen=True, slots=True)
class _IssuedToken:
    token: str
    renew_s: float
    expires_s: float


class ServiceAccess:
    """The access of the service `service` to the other services; safe to share within one event loop."""

    def __init__(self, settings: Settings, service: str, *, keys: KeysInForce | None = None) -> None:
        self._settings = settings
        self._service = service
        self._keys = keys or KeysInForce(settings.security_folder)
        self._http = BodyReadingHttpClient(ca_files=settings.ca_files, max_response_bytes=MAX_ANSWER_BYTES)
        self._issued: _IssuedToken | None = None
        self._renewing = asyncio.Lock()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    async def headers(self) -> dict[str, str]:
        """Return the headers for a request to another service; empty while no account exists.

        Raises `AccountsUnavailable` if there is no valid token, `UsageError` without a secret token.
        """
        if self._keys.keys() is None:
            return {}
        return {"Authorization": f"Bearer {await self._token()}"}

    def secret_token(self) -> str | None:
        """Return the secret token, for a program that cannot exchange it; None while no account exists.

        Raises `UsageError` if there is none.
        """
        return None if self._keys.keys() is None else self._secret()

    async def _token(self) -> str:
        issued = self._issued
        if issued is not None and time.monotonic() < issued.renew_s:
            return issued.token
        async with self._renewing:
            issued = self._issued
            if issued is not None and time.monotonic() < issued.renew_s:
                return issued.token
            try:
                self._issued = await self._exchange()
            except AccountsUnavailable:
                if issued is None or time.monotonic() >= issued.expires_s:
                    raise
                return issued.token
            return self._issued.token

    async def _exchange(self) -> _IssuedToken:
        asked_s, secret = time.monotonic(), self._secret()
        if is_secret_token(secret) and kind_of(secret) != CallerKind.SERVICE:
            return _IssuedToken(secret, math.inf, math.inf)
        try:
            document = await self.call("POST", "/service-tokens", {}, bearer=secret)
        except AccountsUnavailable as error:
            if (error.problem or {}).get("status") != UNAUTHORIZED:
                raise
            raise AccountsUnavailable(
                f"accounts does not know the token of {self._service} in {self._token_source()}; run "
                "`handover accounts set-up`, which writes a new one, and start the service again",
                error.problem,
            ) from None
        life_s = float(document["expiresInS"])
        return _IssuedToken(str(document["token"]), asked_s + life_s * _RENEW_AT, asked_s + life_s)

    def _secret(self) -> str:
        if self._settings.service_token is not None:
            return self._settings.service_token.get_secret_value()
        file = self._token_file()
        try:
            return read_service_token(file)
        except OSError as error:
            raise UsageError(
                f"{self._service} has no service token: {file}: {error.strerror}; run `handover accounts "
                "set-up`, or set HANDOVER_SERVICE_TOKEN"
            ) from None

    def _token_file(self) -> Path:
        return self._settings.service_token_file or service_token_file(self._settings, self._service)

    def _token_source(self) -> str:
        if self._settings.service_token is not None:
            return "HANDOVER_SERVICE_TOKEN"
        return str(self._token_file())

    async def call(
        self,
        method: str,
        path: str,
        body: Mapping[str, Any] | None = None,
        *,
        bearer: str | None = None,
        timeout_s: float = REQUEST_TIMEOUT_S,
    ) -> dict[str, Any]:
        """Send a request to `accounts`; return its JSON object. Raises `AccountsUnavailable`."""
        token = bearer if bearer is not None else await self._token()
        headers = [("Authorization", f"Bearer {token}"), ("Accept", "application/json")]
        if body is not None:
            headers.append(("Content-Type", "application/json"))
        url = f"{self._settings.accounts}{path}"
        try:
            response = await self._http.request(
                method, url, headers, b"" if body is None else orjson.dumps(body), timeout_s
            )
            document = orjson.loads(response.body) if response.body else {}
        except (SendError, OSError, orjson.JSONDecodeError) as error:
            raise AccountsUnavailable(f"accounts at {url}: {error}") from None
        if response.status >= 300:
            problem = document if isinstance(document, dict) else {}
            detail = problem.get("detail", "")
            raise AccountsUnavailable(f"accounts at {url} answered {response.status}: {detail}", problem)
        if not isinstance(document, dict):
            raise AccountsUnavailable(f"accounts at {url} answered no JSON object")
        return document
