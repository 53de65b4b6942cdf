"""An OpenID Connect provider: discovery, authorization requests, the exchange of codes, ID tokens.

Authlib builds and reads the messages (OpenID Connect Core 1.0, RFC 6749, 7636, 9207). They are sent by the
HTTP client of this package, which follows no redirects and bounds time and size. The keys of the provider are
read again when an ID token names an unknown one.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

import orjson

from handover.errors import HandoverError, UsageError
from handover.network.http_client import BodyReadingHttpClient, SendError
from handover.network.outbound_policy import is_loopback
from handover_accounts.settings import AccountsSettings

if TYPE_CHECKING:
    from joserfc.jwk import KeySet

TIMEOUT_S: Final = 8.0
MAX_ANSWER_BYTES: Final = 512 * 1024
METADATA_S: Final = 3600.0
"""Age at which the metadata and the keys of the provider are read again."""
MIN_KEY_AGE_S: Final = 30.0
"""The keys are read again for an unknown one at most this often."""
LEEWAY_S: Final = 30
"""Tolerated difference between our clock and that of the provider."""
SIGNED_BY_KEYS: Final = ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "Ed25519")
"""Signatures with a key that the provider publishes; a secret of this client is never one of those."""
_ENDPOINTS: Final = ("authorization_endpoint", "token_endpoint", "jwks_uri", "userinfo_endpoint")


class ProviderError(HandoverError):
    """The provider does not answer, or its answer cannot be accepted."""


@dataclass(frozen=True, slots=True)
class AuthorizationRequest:
    """One sign-in that is under way; only the browser that began it may finish it."""

    state: str
    nonce: str
    verifier: str
    redirect_uri: str


@dataclass(frozen=True, slots=True)
class ProvenIdentity:
    """Who signed in at the provider; `id_token` is its proof, for signing out there."""

    issuer: str
    subject: str
    claims: Mapping[str, Any]
    id_token: str


class OpenIdProvider:
    """The provider of the settings."""

    def __init__(self, settings: AccountsSettings) -> None:
        self._settings = settings
        self._issuer = str(settings.oidc_issuer)
        self._http = BodyReadingHttpClient(ca_files=settings.ca_files, max_response_bytes=MAX_ANSWER_BYTES)
        self._metadata: dict[str, Any] | None = None
        self._metadata_s = 0.0
        self._keys: KeySet | None = None
        self._keys_s = 0.0

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    async def location(self, request: AuthorizationRequest) -> str:
        """Return the address at which the browser begins to sign in. Raises `ProviderError`."""
        from authlib.oauth2.rfc6749.parameters import prepare_grant_uri  # noqa: PLC0415
        from authlib.oauth2.rfc7636 import create_s256_code_challenge  # noqa: PLC0415

        metadata = await self.metadata()
        return str(
            prepare_grant_uri(
                metadata["authorization_endpoint"],
                self._settings.oidc_client_id,
                "code",
                redirect_uri=request.redirect_uri,
                scope=self._settings.oidc_scopes,
                state=request.state,
                nonce=request.nonce,
                code_challenge=create_s256_code_challenge(request.verifier),
                code_challenge_method="S256",
            )
        )

    async def identity(self, request: AuthorizationRequest, code: str, iss: str | None) -> ProvenIdentity:
        """Exchange the code that the browser brought back. Raises `ProviderError`."""
        metadata = await self.metadata()
        is_iss_required = metadata.get("authorization_response_iss_parameter_supported") is True
        if (iss is not None or is_iss_required) and iss != metadata["issuer"]:
            raise ProviderError(
                f'the answer is of the issuer "{(iss or "")[:100]}", not {metadata["issuer"]}'
            )
        tokens = await self._exchange(metadata, request, code)
        id_token, access_token = tokens.get("id_token"), tokens.get("access_token")
        if not isinstance(id_token, str):
            raise ProviderError("the provider gave no ID token; the scope must contain openid")
        claims = await self._verified(metadata, id_token, request.nonce, access_token)
        subject = claims.get("sub")
        if not isinstance(subject, str) or not 0 < len(subject) <= 255:
            raise ProviderError("the ID token has no subject (sub) of 1 to 255 characters")
        more = await self._user_info(metadata, access_token, subject)
        return ProvenIdentity(str(metadata["issuer"]), subject, {**more, **claims}, id_token)

    async def sign_out_location(self, id_token: str, return_to: str) -> str | None:
        """Return the address at which the browser signs out at the provider, if it has one."""
        from authlib.common.urls import add_params_to_uri  # noqa: PLC0415

        endpoint = (await self.metadata()).get("end_session_endpoint")
        if not isinstance(endpoint, str):
            return None
        parameters = {
            "id_token_hint": id_token,
            "client_id": self._settings.oidc_client_id,
            "post_logout_redirect_uri": return_to,
        }
        return str(add_params_to_uri(_checked_url("end_session_endpoint", endpoint), parameters.items()))

    async def metadata(self) -> Mapping[str, Any]:
        """Return the metadata of the provider, by discovery or from a file. Raises `ProviderError`."""
        from authlib.oidc.discovery import get_well_known_url  # noqa: PLC0415

        now_s = time.monotonic()
        if self._metadata is not None and now_s - self._metadata_s < METADATA_S:
            return self._metadata
        file = self._settings.oidc_metadata_file
        if file is not None:
            document = _read_metadata(file)
        else:
            document = await self._ask("GET", get_well_known_url(self._issuer, external=True))
        if str(document.get("issuer", "")).rstrip("/") != self._issuer.rstrip("/"):
            raise ProviderError(
                f'the provider names itself "{document.get("issuer")}" and HANDOVER_OIDC_ISSUER is '
                f'"{self._issuer}"; set it to the same address'
            )
        required = _ENDPOINTS[: 2 if self._settings.oidc_token_secret is not None else 3]
        for name in _ENDPOINTS:
            if name in document or name in required:
                _checked_url(name, document.get(name))
        self._metadata, self._metadata_s = document, now_s
        return document

    async def _exchange(
        self, metadata: Mapping[str, Any], request: AuthorizationRequest, code: str
    ) -> dict[str, Any]:
        from authlib.oauth2.auth import ClientAuth  # noqa: PLC0415
        from authlib.oauth2.rfc6749.parameters import prepare_token_request  # noqa: PLC0415

        secret = self._settings.oidc_client_secret
        methods = metadata.get("token_endpoint_auth_methods_supported") or ["client_secret_basic"]
        method = "client_secret_basic" if "client_secret_basic" in methods else "client_secret_post"
        client = ClientAuth(
            self._settings.oidc_client_id,
            None if secret is None else secret.get_secret_value(),
            "none" if secret is None else method,
        )
        form = prepare_token_request(
            "authorization_code", redirect_uri=request.redirect_uri, code=code, code_verifier=request.verifier
        )
        headers = {"Content-Type": "application/x-www-form-urlencoded"}
        url, headers, form = client.prepare("POST", metadata["token_endpoint"], headers, form)
        return await self._ask("POST", url, headers, form)

    async def _verified(
        self, metadata: Mapping[str, Any], id_token: str, nonce: str, access_token: Any
    ) -> dict[str, Any]:
        from authlib.oidc.core import CodeIDToken  # noqa: PLC0415
        from joserfc import jwt  # noqa: PLC0415
        from joserfc.errors import JoseError  # noqa: PLC0415
        from joserfc.jwk import OctKey  # noqa: PLC0415

        secret = self._settings.oidc_token_secret
        try:
            if secret is not None:
                key = OctKey.import_key(secret.get_secret_value())
                decoded = jwt.decode(id_token, key, algorithms=["HS256"])
            else:
                keys = await self._key_set(metadata, id_token)
                decoded = jwt.decode(id_token, keys, algorithms=list(SIGNED_BY_KEYS))
            client_id = self._settings.oidc_client_id
            claims = CodeIDToken(
                decoded.claims,
                decoded.header,
                options={
                    "iss": {"essential": True, "value": metadata["issuer"]},
                    "aud": {"essential": True, "value": client_id},
                },
                params={
                    "client_id": client_id,
                    "nonce": nonce if self._settings.oidc_nonce else None,
                    "access_token": access_token,
                },
            )
            claims.validate(leeway=LEEWAY_S)
        except (JoseError, ValueError, TypeError, KeyError) as error:
            raise ProviderError(f"the ID token is invalid: {error}") from None
        return dict(claims)

    async def _key_set(self, metadata: Mapping[str, Any], id_token: str) -> "KeySet":
        from joserfc import jws  # noqa: PLC0415
        from joserfc.jwk import KeySet  # noqa: PLC0415

        key_id = jws.extract_compact(id_token.encode()).protected.get("kid")
        now_s = time.monotonic()
        age_s = now_s - self._keys_s
        is_known = self._keys is not None and (
            key_id is None or any(key.kid == key_id for key in self._keys.keys)
        )
        if self._keys is None or age_s > METADATA_S or (not is_known and age_s > MIN_KEY_AGE_S):
            key_set = await self._ask("GET", str(metadata["jwks_uri"]))
            self._keys, self._keys_s = KeySet.import_key_set(_signing_keys(key_set)), now_s
        return self._keys

    async def _user_info(
        self, metadata: Mapping[str, Any], access_token: Any, subject: str
    ) -> Mapping[str, Any]:
        endpoint = metadata.get("userinfo_endpoint")
        if not isinstance(endpoint, str) or not isinstance(access_token, str):
            return {}
        user_info = await self._ask("GET", endpoint, {"Authorization": f"Bearer {access_token}"})
        if user_info.get("sub") != subject:  # OpenID Connect Core 5.3.2
            raise ProviderError("the user info is of another subject than the ID token")
        return user_info

    async def _ask(
        self, method: str, url: str, headers: Mapping[str, str] | None = None, form: str = ""
    ) -> dict[str, Any]:
        all_headers = [("Accept", "application/json"), *(headers or {}).items()]
        try:
            answer = await self._http.request(method, url, all_headers, form.encode(), TIMEOUT_S)
            document = orjson.loads(answer.body) if answer.body else {}
        except (SendError, OSError, orjson.JSONDecodeError) as error:
            raise ProviderError(f"the provider at {url}: {error}") from None
        if not 200 <= answer.status < 300 or not isinstance(document, dict):
            reason = document.get("error", "") if isinstance(document, dict) else "no JSON object"
            raise ProviderError(f"the provider at {url} answered {answer.status} {str(reason)[:100]}".strip())
        return document


def _signing_keys(key_set: Mapping[str, Any]) -> Any:
    keys = key_set.get("keys")
    signing = [key for key in keys if isinstance(key, dict)] if isinstance(keys, list) else []
    signing = [key for key in signing if key.get("use", "sig") == "sig" and key.get("kty") != "oct"]
    if not signing:
        raise ProviderError("the provider publishes no key for signatures")
    return {"keys": signing}


def _read_metadata(file: Path) -> dict[str, Any]:
    try:
        metadata = orjson.loads(file.read_bytes())
    except (OSError, orjson.JSONDecodeError) as error:
        raise UsageError(f"HANDOVER_OIDC_METADATA_FILE: {file} cannot be read: {error}") from None
    if not isinstance(metadata, dict):
        raise UsageError(f"HANDOVER_OIDC_METADATA_FILE: {file} is no JSON object")
    return metadata


def _checked_url(name: str, url: Any) -> str:
    """Return an address of the provider; raise `ProviderError` unless it is https or on this machine."""
    parts = urlsplit(url) if isinstance(url, str) else None
    host = (parts.hostname if parts is not None else None) or ""
    is_local = host == "localhost" or is_loopback(host)
    if parts is None or not host or parts.scheme not in ({"https", "http"} if is_local else {"https"}):
        raise ProviderError(f'the {name} of the provider, "{str(url)[:100]}", must be an https address')
    return str(url)
