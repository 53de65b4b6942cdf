"""OAuth 2: client credentials and refresh tokens (RFC 6749, sections 4.4 and 6)."""

import base64
import json
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import quote, urlencode

from handover.network.http_client import BodyReadingHttpClient, HttpResponse
from handover_body.drivers.base import PacketError

TIMEOUT_S: Final = 15.0
RENEW_BEFORE_S: Final = 30.0
DEFAULT_LIFETIME_S: Final = 300.0
MAX_LIFETIME_S: Final = 86_400.0
MAX_ANSWER_BYTES: Final = 4 * 1024 * 1024


class AccessDenied(PacketError):
    """The service of the vendor refuses the credentials or the token."""


@dataclass(frozen=True, slots=True)
class Credentials:
    """What a vendor gave: `refresh_token` where a person has consented there, else the client itself."""

    token_url: str
    client_id: str
    client_secret: str
    scope: str = ""
    refresh_token: str = ""


class OAuthClient:
    """Requests with a bearer token, which is fetched when it is needed and renewed before it ends."""

    def __init__(self, http: BodyReadingHttpClient, credentials: Credentials) -> None:
        self._http = http
        self._credentials = credentials
        self._refresh_token = credentials.refresh_token
        self._token = ""
        self._renew_at_s = 0.0

    async def get(self, url: str, now_s: float) -> Any:
        """Return the JSON at `url`; raise `AccessDenied`, `PacketError` or `SendError`.

        A token that was revoked is renewed once.
        """
        for attempt in (1, 2):
            if not self._token or now_s >= self._renew_at_s:
                await self._renew(now_s)
            headers = [("Authorization", f"Bearer {self._token}"), ("Accept", "application/json")]
            reply = await self._http.request("GET", url, headers, b"", TIMEOUT_S)
            if reply.status != 401:
                break
            self._token = ""
            if attempt == 2:
                raise AccessDenied("the service refuses a new token; check the scope and the consent")
        if reply.status == 403:
            raise AccessDenied("the token has no right to these data; check the scope and the consent")
        return _json_of(reply, "the service")

    async def _renew(self, now_s: float) -> None:
        credentials = self._credentials
        grant = {"grant_type": "client_credentials"}
        if self._refresh_token:
            grant = {"grant_type": "refresh_token", "refresh_token": self._refresh_token}
        if credentials.scope:
            grant["scope"] = credentials.scope
        secret = (
            f"{quote(credentials.client_id, safe='')}:{quote(credentials.client_secret, safe='')}".encode()
        )
        headers = [
            ("Content-Type", "application/x-www-form-urlencoded"),
            ("Accept", "application/json"),
            ("Authorization", f"Basic {base64.b64encode(secret).decode()}"),
        ]
        reply = await self._http.request(
            "POST", credentials.token_url, headers, urlencode(grant).encode(), TIMEOUT_S
        )
        if reply.status in {400, 401, 403}:
            raise AccessDenied(f"the token endpoint refuses the credentials (status {reply.status})")
        content = _json_of(reply, "the token endpoint")
        token = content.get("access_token") if isinstance(content, dict) else None
        if not isinstance(token, str) or not token.isascii() or not token.isprintable() or " " in token:
            raise PacketError("the token endpoint sent no access token")
        lifetime = content.get("expires_in")
        is_number = isinstance(lifetime, int | float) and not isinstance(lifetime, bool)
        lifetime_s = float(lifetime) if is_number and 0 < lifetime <= MAX_LIFETIME_S else DEFAULT_LIFETIME_S
        self._token = token
        self._renew_at_s = now_s + max(1.0, lifetime_s - RENEW_BEFORE_S)
        if isinstance(content.get("refresh_token"), str):
            self._refresh_token = content["refresh_token"]  # it may be replaced at each use


def _json_of(reply: HttpResponse, who: str) -> Any:
    if reply.status != 200:
        raise PacketError(f"{who} answered with the status {reply.status}")
    try:
        return json.loads(reply.body)
    except (ValueError, RecursionError):
        raise PacketError(f"{who} sent no JSON") from None
