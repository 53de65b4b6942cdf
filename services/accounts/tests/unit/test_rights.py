"""Rights: grants, tokens, revocations, deletion, and that nobody gains a grant without one."""

import asyncio
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from handover.security.access_tokens import read_public_keys
from handover.security.caller import InvalidToken
from handover.security.permissions import Permission
from handover.security.revocations import FollowedRevocations
from handover.security.secret_tokens import token_hash
from handover_accounts import signing_keys
from handover_accounts.set_up import set_up
from handover_accounts.settings import AccountsSettings
from handover_accounts.signing_keys import ADOPTED_AFTER_S, SigningKeys
from handover_accounts.storage.changes import Store
from services.accounts.tests.unit.conftest import HOME, PASSWORD, Accounts, running

UR10 = "urn:ngsi-ld:Device:demo:ur10-1"


async def subject_of(accounts: Accounts, session: str) -> str:
    return accounts.caller(await accounts.token_of(session)).subject


async def follow(accounts: Accounts, revocations: FollowedRevocations) -> None:
    """Apply the stream as another service does."""
    path = f"/revocations?after={revocations.position}"
    secret = accounts.service_secret("trajectory-tool")
    revocations.apply((await accounts.call("GET", path, token=secret)).json())


async def test_a_grant_that_is_removed_ends_the_tokens_that_have_it(accounts: Accounts) -> None:
    owner = await accounts.owner()
    session = await accounts.member("Anna", ("engineer", UR10))
    anna = accounts.caller(await accounts.token_of(session))
    assert anna.may(Permission.MOVE_ROBOTS, UR10)
    elsewhere = FollowedRevocations()
    await follow(accounts, elsewhere)
    assert not elsewhere.is_revoked(anna)
    users = (await accounts.call("GET", "/users", token=owner)).json()
    grant = next(user["grants"][0]["id"] for user in users if user["name"] == "Anna")
    assert (await accounts.call("DELETE", f"/grants/{grant}", token=owner)).status_code == 204
    await follow(accounts, elsewhere)
    assert elsewhere.is_revoked(anna)
    now = accounts.caller(await accounts.token_of(session))
    assert not now.grants
    assert not elsewhere.is_revoked(now)


async def test_a_waiting_follower_learns_of_a_revocation_at_once(accounts: Accounts) -> None:
    owner = await accounts.owner()
    session = await accounts.member("Anna")
    subject = await subject_of(accounts, session)
    secret = accounts.service_secret("trajectory-tool")
    position = (await accounts.call("GET", "/revocations", token=secret)).json()["position"]
    waiting = asyncio.create_task(
        accounts.call("GET", f"/revocations?after={position}&waitS=30", token=secret)
    )
    await asyncio.sleep(0)
    assert (await accounts.call("DELETE", f"/users/{subject}", token=owner)).status_code == 200
    async with asyncio.timeout(25):
        document = (await waiting).json()
    assert subject in {name for _, name in document["revoked"]}


async def names_of_links(accounts: Accounts, owner: str, subject: str) -> dict[int, str | None]:
    """Return the names by record of what links have done for a user."""
    records = (await accounts.call("GET", f"/audit?resource={subject}", token=owner)).json()
    return {one["seq"]: one["subjectName"] for one in records if one["subject"].startswith("link-")}


async def test_a_deleted_user_leaves_a_verifiable_chain_without_their_name(accounts: Accounts) -> None:
    owner = await accounts.owner()
    session = await accounts.member("Anna Zimmer", ("operator", "*"))
    subject = await subject_of(accounts, session)
    person = "urn:ngsi-ld:Person:demo:anna"
    body = {"person": person}
    assert (await accounts.call("PATCH", f"/users/{subject}", body, token=owner)).status_code == 204
    link = (await accounts.call("POST", f"/users/{subject}/password-link", token=owner)).json()["link"]
    session = await accounts.use_link(link)
    before = await names_of_links(accounts, owner, subject)
    assert before
    assert set(before.values()) == {"Anna Zimmer"}, "a link that sets a password acts for its user"
    await accounts.sign_in("Anna Zimmer", "wrong password", "198.51.100.4")
    answer = await accounts.call("DELETE", f"/users/{subject}", token=owner)
    remains = {one["what"]: one for one in answer.json()["remains"]}
    assert remains["auditRecords"]["count"] > 3
    assert person in remains
    assert await names_of_links(accounts, owner, subject) == dict.fromkeys(before)
    assert (await accounts.sign_in("Anna Zimmer")).status_code == 401
    assert (await accounts.as_page("POST", "/session-tokens", {"session": session})).status_code == 401
    verified = (await accounts.call("GET", "/audit/verification", token=owner)).json()
    assert verified["fault"] is None
    assert verified["records"] > 10
    for file in Path(accounts.settings.data_dir).glob("accounts.db*"):
        stored = file.read_bytes()
        # the attempt after the deletion names somebody who is no user then
        assert stored.count(b"Anna Zimmer") <= 1, file.name


async def test_tokens_are_shown_once_stored_hashed_and_revocable(accounts: Accounts) -> None:
    owner = await accounts.owner()
    body = {"kind": "script", "name": "Nightly export", "grants": [{"role": "viewer"}], "validDays": 30}
    issued = (await accounts.call("POST", "/tokens", body, token=owner)).json()
    listed = (await accounts.call("GET", "/tokens", token=owner)).text
    assert issued["subject"] in listed
    assert issued["token"] not in listed
    assert token_hash(issued["token"]) not in listed
    secret = accounts.service_secret("trajectory-tool")
    asked = {"token": issued["token"]}
    found = (await accounts.call("POST", "/introspection", asked, token=secret)).json()
    assert (found["active"], found["kind"], found["name"]) == (True, "script", "Nightly export")
    assert (await accounts.call("GET", "/me", token=issued["token"])).json()["name"] == "Nightly export"
    assert (await accounts.call("GET", "/users", token=issued["token"])).status_code == 403
    assert (await accounts.call("DELETE", f"/tokens/{issued['subject']}", token=owner)).status_code == 204
    assert (await accounts.call("GET", "/me", token=issued["token"])).status_code == 401
    gone = (await accounts.call("POST", "/introspection", asked, token=secret)).json()
    assert gone == {"active": False}


async def test_a_token_has_its_new_grants_at_once(accounts: Accounts) -> None:
    owner = await accounts.owner()
    issued = (
        await accounts.call("POST", "/tokens", {"kind": "script", "name": "Night shift"}, token=owner)
    ).json()
    assert (await accounts.call("GET", "/users", token=issued["token"])).status_code == 403
    body = {"subject": issued["subject"], "role": "admin", "resource": "*"}
    assert (await accounts.call("POST", "/grants", body, token=owner)).status_code == 201
    assert (await accounts.call("GET", "/users", token=issued["token"])).status_code == 200


async def test_a_service_exchanges_its_secret_but_not_its_access_token(accounts: Accounts) -> None:
    secret = accounts.service_secret("trajectory-tool")
    issued = (await accounts.call("POST", "/service-tokens", {}, token=secret)).json()
    caller = accounts.caller(issued["token"])
    assert (caller.kind, caller.name) == ("service", "trajectory-tool")
    assert (await accounts.call("POST", "/service-tokens", {}, token=issued["token"])).status_code == 403
    owner = await accounts.owner()
    assert (await accounts.call("POST", "/service-tokens", {}, token=owner)).status_code == 403
    assert (await accounts.call("GET", "/users", token=issued["token"])).status_code == 403


async def test_the_last_admin_remains(accounts: Accounts) -> None:
    owner = await accounts.owner()
    users = (await accounts.call("GET", "/users", token=owner)).json()
    olga = users[0]
    admin = next(grant["id"] for grant in olga["grants"] if grant["role"] == "admin")
    assert (await accounts.call("DELETE", f"/grants/{admin}", token=owner)).status_code == 409
    assert (await accounts.call("DELETE", f"/users/{olga['subject']}", token=owner)).status_code == 409
    await accounts.member("Anna", ("admin", "*"))
    assert (await accounts.call("DELETE", f"/grants/{admin}", token=owner)).status_code == 204


async def test_a_request_for_an_account_is_answered_by_an_admin(accounts: Accounts) -> None:
    owner = await accounts.owner()
    body = {"name": "Bela", "contact": "bela@example.org", "note": "night shift", "address": HOME}
    assert (await accounts.as_page("POST", "/account-requests", body)).status_code == 204
    listed = (await accounts.call("GET", "/account-requests", token=owner)).json()
    assert [(one["name"], one["note"]) for one in listed] == [("Bela", "night shift")]
    path = f"/account-requests/{listed[0]['id']}"
    assert (await accounts.call("DELETE", path, token=owner)).status_code == 204
    assert (await accounts.call("DELETE", path, token=owner)).status_code == 404


async def test_the_audit_names_who_did_what_and_asks_for_its_permission(accounts: Accounts) -> None:
    owner = await accounts.owner()
    session = await accounts.member("Anna", ("engineer", "*"))
    records = (await accounts.call("GET", "/audit?action=grant.added", token=owner)).json()
    assert records[0]["text"] == "engineer for *"
    assert records[0]["resourceName"] == "Anna"
    anna = await accounts.token_of(session)
    for path in ("/audit", "/audit/verification", "/audit/export"):
        assert (await accounts.call("GET", path, token=anna)).status_code == 403
    table = await accounts.call("GET", "/audit/export", token=owner)
    assert len(table.text.splitlines()) > 5
    exported = (await accounts.call("GET", "/audit?action=audit.exported", token=owner)).json()
    assert len(exported) == 1


async def test_what_was_acknowledged_is_there_after_a_crash(settings: AccountsSettings) -> None:
    made = set_up(settings, ["webui", "trajectory-tool"])
    async with running(settings, made.owner_link or "") as accounts:
        owner = await accounts.owner()
        session = await accounts.member("Anna")
        subject = await subject_of(accounts, session)
        await accounts.call("DELETE", f"/users/{subject}", token=owner)
        position = accounts.directory.revocations.position
        other = Store(settings.database("accounts"))  # a second process, with no part in the first
        with other.read() as connection:
            assert other.audit.verify(connection).fault is None
        other.close()
    async with running(settings) as accounts:
        assert accounts.directory.revocations.position == position
        accounts.owner_link = ""
        assert (await accounts.sign_in("Olga")).status_code == 201
        assert (await accounts.sign_in("Anna")).status_code == 401


def test_a_new_signing_key_is_published_before_it_signs(tmp_path: Path) -> None:
    keys = SigningKeys(tmp_path / "keys.json", tmp_path / "security")
    assert not keys.exist()
    assert keys.create()
    assert not keys.create()
    first = keys.signing_key().key_id
    second = keys.rotate()
    assert first != second
    assert keys.signing_key().key_id == first, (
        f"for {ADOPTED_AFTER_S:g} s, until each service has the new key"
    )
    assert (tmp_path / "security" / "public-keys.json").read_text().count('"kid"') == 2
    assert (tmp_path / "keys.json").stat().st_mode & 0o077 == 0
    assert SigningKeys(tmp_path / "keys.json", tmp_path / "security").signing_key().key_id == first


def test_a_proof_of_a_pin_is_verified_after_the_key_was_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(signing_keys, "ADOPTED_AFTER_S", 0.0)
    monkeypatch.setattr(signing_keys, "SUPERSEDED_S", 0.0)
    keys = SigningKeys(tmp_path / "keys.json", tmp_path / "security")
    keys.create()
    proofs = []
    for number in range(3):
        proofs.append(keys.signing_key().prove_pin("anna", f"task-{number}"))
        keys.rotate()
        keys.expire()
    assert (tmp_path / "keys.json").read_text().count("BEGIN PRIVATE KEY") == 1

    def people(folder: Path) -> list[str]:
        known = read_public_keys(folder / "public-keys.json")
        return [known.pin_person(proof, f"task-{number}") for number, proof in enumerate(proofs)]

    assert people(tmp_path / "security") == ["anna"] * 3
    (tmp_path / "security" / "public-keys.json").unlink()
    assert not SigningKeys(tmp_path / "keys.json", tmp_path / "security").create()
    assert people(tmp_path / "security") == ["anna"] * 3, "the private file has them, too"
    keys.rotate(revokes_others=True)
    with pytest.raises(InvalidToken, match="unknown key"):
        people(tmp_path / "security")


CALLS: list[tuple[str, str, Any]] = [
    ("POST", "/grants", {"subject": "{me}", "role": "admin", "resource": "*"}),
    ("POST", "/grants", {"subject": "{me}", "role": "service", "resource": "*"}),
    ("POST", "/invitations", {"grants": [{"role": "admin"}]}),
    ("POST", "/tokens", {"kind": "script", "name": "mine", "grants": [{"role": "admin"}]}),
    ("POST", "/users/{owner}/password-link", {}),
    ("POST", "/users/{me}/password-link", {}),
    ("PATCH", "/users/{owner}", {"person": None}),
    ("DELETE", "/users/{owner}", None),
    ("DELETE", "/users/{owner}/sessions", None),
    ("DELETE", "/grants/{grant}", None),
    ("POST", "/service-tokens", {}),
    ("POST", "/sessions", {"name": "Olga", "password": PASSWORD}),
    ("POST", "/session-tokens", {"session": "{session}"}),
    ("POST", "/links/use", {"link": "x", "name": "Eve", "password": PASSWORD}),
    ("POST", "/introspection", {"token": "{session}"}),
    ("GET", "/users", None),
    ("GET", "/tokens", None),
    ("GET", "/audit", None),
    ("GET", "/revocations", None),
    ("POST", "/password-changes", {"session": "{session}", "current": PASSWORD, "new": PASSWORD}),
    ("DELETE", "/me/sessions", None),
    ("GET", "/me", None),
]


@given(st.lists(st.sampled_from(CALLS), min_size=1, max_size=12))
@hypothesis_settings(
    max_examples=12,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
def test_no_sequence_of_calls_by_a_user_without_a_grant_gains_one(calls: list[tuple[str, str, Any]]) -> None:
    asyncio.run(_gains_nothing(calls))


async def _gains_nothing(calls: list[tuple[str, str, Any]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        settings = AccountsSettings(data_dir=Path(folder), _env_file=None)
        made = set_up(settings, ["webui"])
        async with running(settings, made.owner_link or "") as accounts:
            owner = accounts.caller(await accounts.owner())
            session = await accounts.member("Eve")
            eve = await accounts.token_of(session)
            before = (await accounts.call("GET", "/users", token=await accounts.owner())).json()
            names = {
                "me": accounts.caller(eve).subject,
                "owner": owner.subject,
                "grant": next(one["grants"][0]["id"] for one in before if one["name"] == "Olga"),
                "session": session,
            }
            for method, path, body in calls:
                filled = body if body is None else {key: _filled(one, names) for key, one in body.items()}
                answer = await accounts.call(method, path.format(**names), filled, token=eve)
                allowed = path.startswith("/me")
                assert answer.status_code in ({200, 204, 429, 401} if allowed else {401, 403}), (path, answer)
            after = (await accounts.call("GET", "/users", token=await accounts.owner())).json()
            assert [one["grants"] for one in after] == [one["grants"] for one in before]
            assert not accounts.caller(await accounts.token_of(session)).grants


def _filled(value: Any, names: dict[str, str]) -> Any:
    return value.format(**names) if isinstance(value, str) else value
