"""Access tokens: short-lived tokens (JWT, RFC 7519), signed by `accounts`, verified by each service itself.

The algorithm is pinned to EdDSA with Ed25519 (RFC 8037): the header of a token never chooses it. The public
keys are a JSON Web Key Set in the file `public-keys.json` of the security directory, so that a service
verifies tokens while `accounts` is down, and a new key is in use before the old one is removed.

A proof about a Task (who performed it, whose PIN was given for it) does not expire, since the Task may be
read years later. So the set keeps the public part of a key that signs no more, with the time in which it
signed (`iat` and `exp`, as the historical keys of OpenID Federation 1.0). It verifies proofs of that time,
and no access token.
"""

import base64
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import jwt
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
)

from handover.errors import UsageError
from handover.security.caller import Caller, CallerKind, InvalidToken
from handover.security.permissions import Grant, Role

ALGORITHM: Final = "EdDSA"
ISSUER: Final = "handover-accounts"
AUDIENCE: Final = "handover"
PIN_AUDIENCE: Final = "handover-pin"
"""Of proofs of a PIN, so that none is accepted as an access token."""
PERFORMER_AUDIENCE: Final = "handover-performer"
"""Of proofs of who performed a Task."""
USER_TOKEN_S: Final = 60.0
"""Life of the token for which the page server exchanges a session."""
SERVICE_TOKEN_S: Final = 300.0
MAX_TOKEN_CHARACTERS: Final = 32_000
LEEWAY_S: Final = 5.0
"""Tolerated difference between the clocks of two machines."""


class SigningKey:
    """The private key of `accounts`."""

    def __init__(self, key: Ed25519PrivateKey) -> None:
        self._key = key
        public = key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)
        self.public_jwk = _jwk(public)
        self.key_id: str = self.public_jwk["kid"]

    @classmethod
    def generate(cls) -> "SigningKey":
        """Return a new key."""
        return cls(Ed25519PrivateKey.generate())

    @classmethod
    def from_pem(cls, pem: bytes) -> "SigningKey":
        """Return the key in `pem`; raise `UsageError` if it is not an Ed25519 key."""
        try:
            key = load_pem_private_key(pem, None)
        except ValueError as error:
            raise UsageError(f"the signing key is no private key in PEM: {error}") from None
        if not isinstance(key, Ed25519PrivateKey):
            raise UsageError("the signing key must be an Ed25519 key")
        return cls(key)

    def pem(self) -> bytes:
        """Return the private key; it belongs into a file that only its owner can read."""
        return self._key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())

    def issue(self, caller: Caller, *, valid_s: float) -> str:
        """Return a token for `caller` that expires in `valid_s` seconds."""
        now_s = time.time()
        claims: dict[str, Any] = {
            "iss": ISSUER,
            "aud": AUDIENCE,
            "sub": caller.subject,
            "iat": int(now_s),
            "exp": int(now_s + valid_s),
            "kind": caller.kind,
            "name": caller.name,
            "grants": [[grant.role, grant.resource] for grant in caller.grants],
            "rev": caller.revision,
        }
        if caller.person is not None:
            claims["person"] = caller.person
        if caller.session is not None:
            claims["sid"] = caller.session
        return self._signed(claims)

    def prove_pin(self, person: str, task: str) -> str:
        """Return a proof that `person` has given the own PIN for `task`."""
        return self._proof(PIN_AUDIENCE, person, task)

    def prove_performer(self, person: str, task: str) -> str:
        """Return a proof that one of our services has identified `person` as who performed `task`."""
        return self._proof(PERFORMER_AUDIENCE, person, task)

    def _proof(self, audience: str, person: str, task: str) -> str:
        """Return a proof, which does not expire.

        It is of use for this Task only, and a finished Task never reopens.
        """
        issued = {"iss": ISSUER, "aud": audience, "iat": int(time.time())}
        return self._signed({**issued, "sub": person, "task": task})

    def _signed(self, claims: dict[str, Any]) -> str:
        return jwt.encode(claims, self._key, algorithm=ALGORITHM, headers={"kid": self.key_id})


@dataclass(frozen=True, slots=True)
class RetiredKey:
    """The public part of a key that has signed from `since_s` to `until_s` (Unix time)."""

    public_jwk: Mapping[str, str]
    since_s: float
    until_s: float

    @property
    def dated_jwk(self) -> dict[str, Any]:
        """The key with its time, for the key set."""
        return {**self.public_jwk, "iat": int(self.since_s), "exp": int(self.until_s)}


@dataclass(frozen=True, slots=True)
class _RetiredPublicKey:
    key: Ed25519PublicKey
    since_s: float
    until_s: float

    def was_in_use(self, at_s: float) -> bool:
        return self.since_s - LEEWAY_S <= at_s <= self.until_s + LEEWAY_S


class PublicKeys:
    """The public keys of `accounts` by id: those in force, and those that sign no more."""

    def __init__(
        self, keys: Mapping[str, Ed25519PublicKey], retired: Mapping[str, _RetiredPublicKey]
    ) -> None:
        self._keys = dict(keys)
        self._retired = dict(retired)

    @classmethod
    def parse(cls, document: bytes) -> "PublicKeys":
        """Return the keys of a JSON Web Key Set; raise `UsageError` if it is invalid or empty."""
        try:
            keys: dict[str, Ed25519PublicKey] = {}
            retired: dict[str, _RetiredPublicKey] = {}
            for jwk in json.loads(document)["keys"]:
                if jwk.get("kty") != "OKP" or jwk.get("crv") != "Ed25519":
                    continue
                key = Ed25519PublicKey.from_public_bytes(_from_base64(jwk["x"]))
                if "exp" in jwk:
                    retired[str(jwk["kid"])] = _RetiredPublicKey(key, float(jwk["iat"]), float(jwk["exp"]))
                else:
                    keys[str(jwk["kid"])] = key
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise UsageError(f"the public keys are no JSON Web Key Set (RFC 7517): {error!r}") from None
        if not keys:
            raise UsageError("the JSON Web Key Set has no Ed25519 key in force")
        return cls(keys, retired)

    def verify(self, token: str) -> Caller:
        """Return the caller of `token`; raise `InvalidToken` with the reason."""
        return _caller_of(_claims(token, self._key_in_force(token), AUDIENCE, "exp"))

    def pin_person(self, proof: str, task: str) -> str:
        """Return the Person who has given the own PIN for `task`; raise `InvalidToken` with the reason."""
        return self._proven_person(proof, task, PIN_AUDIENCE)

    def performer(self, proof: str, task: str) -> str:
        """Return the Person who performed `task`; raise `InvalidToken` with the reason."""
        return self._proven_person(proof, task, PERFORMER_AUDIENCE)

    def _proven_person(self, proof: str, task: str, audience: str) -> str:
        """Return the Person of a proof, whose key may sign no more if it did at the time of the proof."""
        retired = self._retired.get(_key_id(proof))
        key = self._key_in_force(proof) if retired is None else retired.key
        claims = _claims(proof, key, audience, "task")
        if retired is not None and not retired.was_in_use(float(claims["iat"])):
            raise InvalidToken("the proof is of a time in which its key was not in use")
        if claims["task"] != task:
            raise InvalidToken("the proof is of another Task")
        return str(claims["sub"])

    def _key_in_force(self, token: str) -> Ed25519PublicKey:
        key = self._keys.get(_key_id(token))
        if key is None:
            raise InvalidToken("the token is signed by an unknown key; sign in again")
        return key


def _key_id(token: str) -> str:
    if len(token) > MAX_TOKEN_CHARACTERS:
        raise InvalidToken("the token is too long")
    try:
        return str(jwt.get_unverified_header(token).get("kid"))
    except jwt.InvalidTokenError as error:
        raise InvalidToken(f"the token is invalid: {error}") from None


def _claims(token: str, key: Ed25519PublicKey, audience: str, required: str) -> dict[str, Any]:
    try:
        return jwt.decode(
            token,
            key,
            algorithms=[ALGORITHM],
            audience=audience,
            issuer=ISSUER,
            leeway=LEEWAY_S,
            options={"require": [required, "iat", "sub", "aud", "iss"]},
        )
    except jwt.ExpiredSignatureError:
        raise InvalidToken("the token has expired; sign in again") from None
    except jwt.InvalidTokenError as error:
        raise InvalidToken(f"the token is invalid: {error}") from None


def key_set(*keys: SigningKey, retired: Sequence[RetiredKey] = ()) -> bytes:
    """Return the JSON Web Key Set of `keys`, and of those that sign no more."""
    listed = [*(key.public_jwk for key in keys), *(key.dated_jwk for key in retired)]
    return json.dumps({"keys": listed}, indent=1).encode()


def read_public_keys(file: Path) -> PublicKeys:
    """Return the keys of a file; raise `UsageError` if it cannot be read."""
    try:
        return PublicKeys.parse(file.read_bytes())
    except OSError as error:
        raise UsageError(f"the public keys {file} cannot be read: {error.strerror}") from None
    except UsageError as error:
        raise UsageError(f"{file}: {error}; run `handover accounts set-up` again") from None


def _caller_of(claims: Mapping[str, Any]) -> Caller:
    try:
        return Caller(
            kind=CallerKind(claims["kind"]),
            subject=str(claims["sub"]),
            name=str(claims["name"]),
            grants=tuple(Grant(Role(role), str(resource)) for role, resource in claims["grants"]),
            person=claims.get("person"),
            session=claims.get("sid"),
            revision=int(claims["rev"]),
            expires_s=float(claims["exp"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidToken(f"the token lacks a claim of ours: {error!r}") from None


def _jwk(public: bytes) -> dict[str, str]:
    x = base64.urlsafe_b64encode(public).rstrip(b"=").decode()
    return {"kty": "OKP", "crv": "Ed25519", "alg": ALGORITHM, "use": "sig", "kid": x[:16], "x": x}


def _from_base64(text: str) -> bytes:
    return base64.urlsafe_b64decode(text + "=" * (-len(text) % 4))
