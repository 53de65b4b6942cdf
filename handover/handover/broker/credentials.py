"""Credentials for a broker of others: a token from a file, headers, or OAuth 2.0 client credentials.

OAuth: RFC 6749, clauses 2.3.1 and 4.4, as Keyrock and Keycloak offer it to programs before a PEP proxy.
"""

import asyncio
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass, replace
from http import HTTPStatus
from pathlib import Path
from typing import Any, Final, Protocol
from urllib.parse import quote_plus, urlencode, urlsplit

import orjson

from handover.errors import HandoverError
from handover.network.http_client import BodyReadingHttpClient, SendError
from handover.network.outbound_policy import is_loopback
from handover.runtime.clocks import Lifetime
from handover.settings import Settings
from handover.telemetry import get_logger

log = get_logger(__name__)

HOW_TO_SET: Final = "set HANDOVER_BROKER_TOKEN_FILE, HANDOVER_BROKER_HEADERS or HANDOVER_BROKER_OAUTH_URL"
REQUEST_TIMEOUT_S: Final = 10.0
MAX_ANSWER_BYTES: Final = 1024 * 1024
MIN_AGE_S: Final = 1.0
"""A younger token that is refused is not renewed."""
USUAL_LIFE_S: Final = 300.0
"""The life of a token for which the server says none."""
_RENEW_AT: Final = 0.5


class CredentialsUnavailable(HandoverError):
    """There are no credentials now; the message says what to correct."""


class BrokerCredentials:
    """The credentials of the settings for the broker of `HANDOVER_BROKER_URL`."""

    def __init__(self, settings: Settings) -> None:
        self._headers = settings.other_broker_headers()
        self._tokens: _Tokens | None = None
        if settings.broker_token_file is not None:
            self._tokens = _FileTokens(settings.broker_token_file)
        elif settings.broker_oauth_url:
            self._tokens = _OAuthTokens(settings)
        url = urlsplit(settings.broker_url)
        if url.scheme == "http" and not is_loopback(url.hostname or ""):
            log.warning("the credentials of the broker are sent without TLS", url=settings.broker_url)

    async def headers(self) -> Mapping[str, str]:
        """Return the headers of a request. Raises `CredentialsUnavailable`."""
        if self._tokens is None:
            return self._headers
        return {**self._headers, "Authorization": f"Bearer {await self._tokens.token()}"}

    def renew(self, refused: Mapping[str, str]) -> bool:
        """Forget a token that was refused with 401; return whether the next `headers` may differ."""
        return self._tokens is not None and self._tokens.renew(
            refused.get("Authorization", "").removeprefix("Bearer ")
        )

    def close(self) -> None:
        """Close the connections."""
        if self._tokens is not None:
            self._tokens.close()


def credentials_of(settings: Settings) -> BrokerCredentials | None:
    """Return the credentials for the broker that the settings name; None without any."""
    has_any = settings.broker_token_file or settings.broker_oauth_url or settings.broker_headers
    return BrokerCredentials(settings) if has_any else None


class _Tokens(Protocol):
    async def token(self) -> str: ...

    def renew(self, refused: str) -> bool: ...

    def close(self) -> None: ...


class _FileTokens:
    """The token in a file, which another program may replace."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._read: tuple[tuple[int, int, int], str] | None = None

    async def token(self) -> str:
        try:
            state = self._file.stat()
            version = (state.st_mtime_ns, state.st_size, state.st_ino)
            if self._read is None or self._read[0] != version:
                self._read = (version, self._file.read_text("ascii").strip())
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "it is no token"
            raise CredentialsUnavailable(
                f"HANDOVER_BROKER_TOKEN_FILE is {self._file}, which cannot be read: {reason}; write the "
                "token of the broker into it"
            ) from None
        token = self._read[1]
        if not token.isprintable() or not token or " " in token:
            raise CredentialsUnavailable(
                f"HANDOVER_BROKER_TOKEN_FILE is {self._file}, which holds no token; write the token of the "
                "broker into it, and nothing else"
            )
        return token

    def renew(self, refused: str) -> bool:
        """Read the file at the next request; a program may just have replaced it."""
        read, self._read = self._read, None
        return read is not None and read[1] != refused

    def close(self) -> None: ...


@dataclass(frozen=True, slots=True)
class _Issued:
    token: str
    life: Lifetime


class _OAuthTokens:
    """Access tokens that a server issues to a client with a secret."""

    def __init__(self, settings: Settings) -> None:
        self._url = settings.broker_oauth_url or ""
        self._client = settings.broker_oauth_client or ""
        secret = settings.broker_oauth_secret
        pair = f"{quote_plus(self._client)}:{quote_plus(secret.get_secret_value() if secret else '')}"
        self._authorization = f"Basic {b64encode(pair.encode()).decode()}"
        scope = {"scope": settings.broker_oauth_scope} if settings.broker_oauth_scope else {}
        self._body = urlencode({"grant_type": "client_credentials", **scope}).encode()
        self._http = BodyReadingHttpClient(ca_files=settings.ca_files, max_response_bytes=MAX_ANSWER_BYTES)
        self._issued: _Issued | None = None
        self._renewing = asyncio.Lock()

    async def token(self) -> str:
        if (issued := self._fresh()) is not None:
            return issued.token
        async with self._renewing:
            if (issued := self._fresh()) is not None:
                return issued.token
            old = self._issued
            try:
                self._issued = await self._request()
            except CredentialsUnavailable:
                if old is None or old.life.is_over():
                    raise
                return old.token
            return self._issued.token

    def _fresh(self) -> _Issued | None:
        issued = self._issued
        return None if issued is None or issued.life.is_over(_RENEW_AT) else issued

    async def _request(self) -> _Issued:
        asked = Lifetime.begin(USUAL_LIFE_S)
        headers = [
            ("Accept", "application/json"),
            ("Authorization", self._authorization),
            ("Content-Type", "application/x-www-form-urlencoded"),
        ]
        try:
            response = await self._http.request("POST", self._url, headers, self._body, REQUEST_TIMEOUT_S)
        except (SendError, OSError) as error:
            raise CredentialsUnavailable(f"HANDOVER_BROKER_OAUTH_URL {self._url}: {error}") from None
        try:
            document: Any = orjson.loads(response.body)
        except orjson.JSONDecodeError:
            document = None
        if not isinstance(document, dict):
            raise CredentialsUnavailable(
                f"HANDOVER_BROKER_OAUTH_URL {self._url} answers {response.status} and no JSON object; set "
                "the address of the token endpoint"
            )
        if response.status != HTTPStatus.OK:
            reason = " ".join(
                str(document[name]) for name in ("error", "error_description") if document.get(name)
            )
            raise CredentialsUnavailable(
                f"HANDOVER_BROKER_OAUTH_URL {self._url} refuses the client {self._client!r} with "
                f"{response.status} ({reason or 'no reason'}); correct HANDOVER_BROKER_OAUTH_CLIENT, "
                "HANDOVER_BROKER_OAUTH_SECRET or HANDOVER_BROKER_OAUTH_SCOPE"
            )
        token, life_s = document.get("access_token"), document.get("expires_in")
        if not isinstance(token, str) or not token.isascii() or not token.isprintable():
            raise CredentialsUnavailable(
                f"HANDOVER_BROKER_OAUTH_URL {self._url} answers no access_token; set the address of the "
                "token endpoint"
            )
        if isinstance(life_s, int | float) and life_s > 0:
            asked = replace(asked, life_s=float(life_s))
        return _Issued(token, asked)

    def renew(self, refused: str) -> bool:
        """Forget the token, unless it has just been issued: then another is refused, too."""
        issued = self._issued
        if issued is None or issued.token != refused:
            return True
        if issued.life.age_s() < MIN_AGE_S:
            return False
        self._issued = None
        return True

    def close(self) -> None:
        self._http.close()
