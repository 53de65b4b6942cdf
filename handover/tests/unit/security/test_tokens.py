"""Access tokens need our signature, algorithm, issuer and audience; secret tokens match by hash."""

import base64
import json
import time
from typing import Any

import jwt
import pytest
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1
from cryptography.hazmat.primitives.asymmetric.ec import generate_private_key as new_ec_key
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from handover.errors import UsageError
from handover.security.access_tokens import LEEWAY_S, PublicKeys, RetiredKey, SigningKey, key_set
from handover.security.caller import Caller, CallerKind, InvalidToken
from handover.security.permissions import Grant, Role
from handover.security.secret_tokens import is_secret_token, is_token, kind_of, new_token, token_hash

KEY = SigningKey.generate()
KEYS = PublicKeys.parse(key_set(KEY))
ANNA = Caller(
    CallerKind.USER,
    "subject-7",
    "Anna",
    (Grant(Role.OPERATOR), Grant(Role.ENGINEER, "urn:ngsi-ld:Device:demo:ur10-*")),
    person="urn:ngsi-ld:Person:demo:anna",
    session="session-3",
    revision=12,
)


def changed_claims(**claims: Any) -> str:
    """Return a token with our key, whose claims were changed before it was signed."""
    payload = jwt.decode(KEY.issue(ANNA, valid_s=60), options={"verify_signature": False})
    for name, value in claims.items():
        if value is None:
            payload.pop(name)
        else:
            payload[name] = value
    return jwt.encode(payload, KEY._key, algorithm="EdDSA", headers={"kid": KEY.key_id})


def test_a_token_names_its_caller_with_all_grants() -> None:
    found = KEYS.verify(KEY.issue(ANNA, valid_s=60))
    assert found.expires_s is not None
    assert (found.kind, found.subject, found.name, found.grants) == (
        ANNA.kind,
        ANNA.subject,
        ANNA.name,
        ANNA.grants,
    )
    assert (found.person, found.session, found.revision) == (ANNA.person, ANNA.session, ANNA.revision)


def test_a_proof_of_a_pin_is_of_use_for_its_task_only_and_is_no_access_token() -> None:
    anna, task = str(ANNA.person), "urn:ngsi-ld:Task:demo:p-1"
    proof = KEY.prove_pin(anna, task)
    assert KEYS.pin_person(proof, task) == anna
    with pytest.raises(InvalidToken, match="another Task"):
        KEYS.pin_person(proof, "urn:ngsi-ld:Task:demo:p-2")
    with pytest.raises(InvalidToken, match=r"exp|audience"):
        KEYS.verify(proof)
    with pytest.raises(InvalidToken):
        KEYS.pin_person(KEY.issue(ANNA, valid_s=60), task)


def test_a_retired_key_verifies_proofs_of_its_time_and_nothing_else() -> None:
    anna, task, now_s = str(ANNA.person), "urn:ngsi-ld:Task:demo:p-1", time.time()
    proof, token = KEY.prove_pin(anna, task), KEY.issue(ANNA, valid_s=60)

    def keys(since_s: float, until_s: float) -> PublicKeys:
        retired = RetiredKey(KEY.public_jwk, since_s, until_s)
        return PublicKeys.parse(key_set(SigningKey.generate(), retired=[retired]))

    assert keys(now_s - 3600, now_s + 1).pin_person(proof, task) == anna
    with pytest.raises(InvalidToken, match="another Task"):
        keys(now_s - 3600, now_s + 1).pin_person(proof, "urn:ngsi-ld:Task:demo:p-2")
    with pytest.raises(InvalidToken, match="unknown key"):
        keys(now_s - 3600, now_s + 1).verify(token)
    with pytest.raises(InvalidToken, match="unknown key"):
        PublicKeys.parse(key_set(SigningKey.generate())).pin_person(proof, task)
    far_s = LEEWAY_S + 3600
    for since_s, until_s in ((now_s - 2 * far_s, now_s - far_s), (now_s + far_s, now_s + 2 * far_s)):
        with pytest.raises(InvalidToken, match="not in use"):
            keys(since_s, until_s).pin_person(proof, task)


def test_a_key_that_was_stored_signs_the_same_tokens() -> None:
    again = SigningKey.from_pem(KEY.pem())
    assert KEYS.verify(again.issue(ANNA, valid_s=60)).subject == ANNA.subject


OTHER_TOKENS = {
    "empty": "",
    "no token": "no.token.at-all",
    "of another key": SigningKey.generate().issue(ANNA, valid_s=60),
    "expired": KEY.issue(ANNA, valid_s=-60),
    "wrong signature": KEY.issue(ANNA, valid_s=60)[:-4] + "AAAA",
    "for another audience": changed_claims(aud="another"),
    "of another issuer": changed_claims(iss="another"),
    "without a subject": changed_claims(sub=None),
    "without an end": changed_claims(exp=None),
    "with an unknown role": changed_claims(grants=[["emperor", "*"]]),
    "of an unknown kind": changed_claims(kind="god"),
    "of the future": changed_claims(iat=int(time.time()) + 3600),
    "too long": "x" * 40_000,
}


@pytest.mark.parametrize("token", OTHER_TOKENS.values(), ids=OTHER_TOKENS)
def test_any_other_token_is_refused(token: str) -> None:
    with pytest.raises(InvalidToken):
        KEYS.verify(token)


def test_the_header_of_a_token_never_chooses_the_algorithm() -> None:
    payload = jwt.decode(KEY.issue(ANNA, valid_s=60), options={"verify_signature": False})
    unsigned = jwt.encode(payload, None, algorithm="none", headers={"kid": KEY.key_id})
    with pytest.raises(InvalidToken):
        KEYS.verify(unsigned)
    x = json.loads(key_set(KEY))["keys"][0]["x"]
    secret = base64.urlsafe_b64decode(x + "==")  # the public key as the secret of an HMAC
    with pytest.raises(InvalidToken):
        KEYS.verify(jwt.encode(payload, secret, algorithm="HS256", headers={"kid": KEY.key_id}))


DAMAGED_DOCUMENTS = {
    "nothing": b"",
    "a list": b"[]",
    "no keys": b"{}",
    "an empty list of keys": b'{"keys": []}',
    "a key without a value": b'{"keys": [{"kty": "OKP"}]}',
    "no text": b"\xff",
    "retired keys only": key_set(retired=[RetiredKey(KEY.public_jwk, 0.0, 1.0)]),
}


@pytest.mark.parametrize("document", DAMAGED_DOCUMENTS.values(), ids=DAMAGED_DOCUMENTS)
def test_damaged_public_keys_are_refused(document: bytes) -> None:
    with pytest.raises(UsageError):
        PublicKeys.parse(document)


def test_a_signing_key_of_another_kind_is_refused() -> None:
    ec = new_ec_key(SECP256R1()).private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    with pytest.raises(UsageError, match="Ed25519"):
        SigningKey.from_pem(ec)
    with pytest.raises(UsageError, match="PEM"):
        SigningKey.from_pem(b"key")


def test_secret_tokens_differ_and_match_their_hash_only() -> None:
    token, other = new_token("device"), new_token("device")
    assert token != other
    assert is_secret_token(token)
    assert kind_of(token) == "device"
    assert is_token(token, token_hash(token))
    assert not is_token(other, token_hash(token))
    assert not is_secret_token(KEY.issue(ANNA, valid_s=60))
