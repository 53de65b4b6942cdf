"""Service access: the credentials that a service sends with its own requests, and its requests to `accounts`.

A service has a secret token: the setting `HANDOVER_SERVICE_TOKEN`, or the file `service-tokens/<service>` in
the security directory. `accounts` exchanges it for an access token of five minutes. It is renewed at half of
its life, by the steady and by the wall clock, by which others check it; a request that is answered 401 all
the same is repeated once with another token (`BrokerClient`, `ServiceAccess.send`). A program that is no
service of the cell, a script for example, has another secret token in that setting, and sends it as it is.
"""

import asyncio
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

import orjson

from handover.errors import HandoverError, UsageError
from handover.network.http_client import BodyReadingHttpClient, HttpResponse, NoResponse, SendError
from handover.runtime.clocks import Lifetime
from handover.security.caller import CallerKind
from handover.security.keys_in_force import KeysInForce
from handover.security.secret_tokens import is_secret_token, kind_of
from handover.settings import SERVICE_TOKENS_FOLDER, Settings

REQUEST_TIMEOUT_S: Final = 4.0
UNAUTHORIZED: Final = 401
INTERNAL_ERROR: Final = 500
UNAVAILABLE: Final = 503
MAX_ANSWER_BYTES: Final = 1024 * 1024
_RENEW_AT: Final = 0.5
"""Part of the life of a token after which it is renewed."""
MIN_TOKEN_AGE_S: Final = 1.0
"""A younger token that is refused is not renewed."""


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


def has_component_token(settings: Settings) -> bool:
    """Return whether the settings have the token of a component of others."""
    token = "" if settings.service_token is None else settings.service_token.get_secret_value()
    return is_secret_token(token) and kind_of(token) != CallerKind.SERVICE


class AccountsUnavailable(HandoverError):
    """`accounts` does not answer, or refuses; `problem` are the problem details of a refusal.

    `may_have_acted`: the request was sent, and `accounts` may have carried it out.
    """

    def __init__(
        self, reason: str, problem: Mapping[str, Any] | None = None, *, may_have_acted: bool = False
    ) -> None:
        super().__init__(reason)
        self.problem = problem
        self.may_have_acted = may_have_acted


@dataclass(frozen=True, slots=True)
class _IssuedToken:
    token: str
    life: Lifetime

    @property
    def is_fresh(self) -> bool:
        """Whether it need not be renewed yet."""
        return not self.life.is_over(_RENEW_AT)


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
        if self._keys.keys() is None and not self._is_remote_component():
            return {}
        return {"Authorization": f"Bearer {await self._token()}"}

    def secret_token(self) -> str | None:
        """Return the secret token, for a program that cannot exchange it; None while no account exists.

        Raises `UsageError` if there is none.
        """
        return None if self._keys.keys() is None else self._secret()

    async def _token(self) -> str:
        issued = self._issued
        if issued is not None and issued.is_fresh:
            return issued.token
        async with self._renewing:
            issued = self._issued
            if issued is not None and issued.is_fresh:
                return issued.token
            try:
                self._issued = await self._exchange()
            except AccountsUnavailable:
                if issued is None or issued.life.is_over():
                    raise
                return issued.token
            return self._issued.token

    async def _exchange(self) -> _IssuedToken:
        asked, secret = Lifetime.begin(math.inf), self._secret()
        if is_secret_token(secret) and kind_of(secret) != CallerKind.SERVICE:
            return _IssuedToken(secret, asked)
        try:
            document = await self.call("POST", "/service-tokens", {}, bearer=secret)
        except AccountsUnavailable as error:
            error.may_have_acted = False  # the request for which it is was not sent
            if (error.problem or {}).get("status") != UNAUTHORIZED:
                raise
            raise AccountsUnavailable(
                f"accounts does not know the token of {self._service} in {self._token_source()}; run "
                "`handover accounts set-up`, which writes a new one, and start the service again",
                error.problem,
            ) from None
        return _IssuedToken(str(document["token"]), replace(asked, life_s=float(document["expiresInS"])))

    def renew(self, refused: Mapping[str, str]) -> bool:
        """Forget the credentials that were `refused` with 401; return whether the next `headers` differ.

        A token that has just been issued is not renewed: then another one is refused, too. A request without
        credentials is refused by a service that noticed the first account before this one.
        """
        if not refused:
            return self._keys.keys_now() is not None
        issued = self._issued
        if issued is None or refused.get("Authorization") != f"Bearer {issued.token}":
            return True
        if not math.isfinite(issued.life.life_s) or issued.life.age_s() < MIN_TOKEN_AGE_S:
            return False
        self._issued = None
        return True

    async def send(
        self,
        http: BodyReadingHttpClient,
        method: str,
        url: str,
        headers: Iterable[tuple[str, str]],
        body: bytes,
        *,
        timeout_s: float,
    ) -> HttpResponse:
        """Send a request with our credentials to a service; repeat it once if they are refused with 401.

        Raises `SendError`, `OSError`, `AccountsUnavailable`, `UsageError`.
        """
        listed = list(headers)
        own = await self.headers()
        response = await http.request(method, url, [*listed, *own.items()], body, timeout_s)
        if response.status == UNAUTHORIZED and self.renew(own):
            own = await self.headers()
            response = await http.request(method, url, [*listed, *own.items()], body, timeout_s)
        return response

    def _is_remote_component(self) -> bool:
        """Return whether this is a component on another machine, which does not see if accounts exist."""
        return self.is_component() and not self._settings.security_folder.is_dir()

    def is_component(self) -> bool:
        """Return whether the settings have the token of a component of others."""
        return has_component_token(self._settings)

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
        headers = [("Accept", "application/json")]
        if body is not None:
            headers.append(("Content-Type", "application/json"))
        url = f"{self._settings.accounts}{path}"
        content = b"" if body is None else orjson.dumps(body)
        try:
            if bearer is None:
                response = await self.send(self._http, method, url, headers, content, timeout_s=timeout_s)
            else:
                headers.append(("Authorization", f"Bearer {bearer}"))
                response = await self._http.request(method, url, headers, content, timeout_s)
            document = orjson.loads(response.body) if response.body else {}
        except (SendError, OSError, orjson.JSONDecodeError) as error:
            is_sent = isinstance(error, NoResponse | orjson.JSONDecodeError)
            raise AccountsUnavailable(f"accounts at {url}: {error}", may_have_acted=is_sent) from None
        if response.status >= 300:
            problem = document if isinstance(document, dict) else {}
            detail = problem.get("detail", "")
            raise AccountsUnavailable(
                f"accounts at {url} answered {response.status}: {detail}",
                problem,
                may_have_acted=response.status >= INTERNAL_ERROR and response.status != UNAVAILABLE,
            )
        if not isinstance(document, dict):
            raise AccountsUnavailable(f"accounts at {url} answered no JSON object")
        return document
