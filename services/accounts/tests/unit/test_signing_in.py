"""Signing in: links, passwords, sessions, access tokens, and limits before a password is hashed."""

import asyncio
import time

import httpx
import pytest

from handover.security.caller import CallerKind
from handover.security.guard import routes_without_requirement
from handover.security.permissions import Grant, Role
from handover_accounts.app import make_app
from handover_accounts.set_up import owner_link, set_up
from handover_accounts.settings import AccountsSettings
from handover_accounts.sign_in_limits import FREE_ATTEMPTS, MAX_DELAY_S, SignInLimits
from services.accounts.tests.unit.conftest import ATTACKER, HOME, PASSWORD, Accounts, running

ATTEMPTS = 1000
UR10 = "urn:ngsi-ld:Device:demo:ur10-1"


def test_every_route_asks_for_a_permission(settings: AccountsSettings) -> None:
    assert routes_without_requirement(make_app(settings)) == []


async def test_the_owner_comes_by_a_link_that_works_once(accounts: Accounts) -> None:
    link = accounts.owner_link
    preview = (await accounts.as_page("POST", "/links/preview", {"link": link})).json()
    assert preview["purpose"] == "owner"
    owner = accounts.caller(await accounts.owner())
    assert (owner.kind, owner.name) == (CallerKind.USER, "Olga")
    assert {grant.role for grant in owner.grants} == set(Role) - {Role.SERVICE, Role.PERFORMER}
    again = await accounts.as_page("POST", "/links/use", {"link": link, "name": "Eve", "password": PASSWORD})
    assert again.status_code == 404
    assert set_up(accounts.settings, ["webui"]).owner_link is None, "an owner exists"
    assert owner_link(accounts.settings).startswith("hnd_link_"), "a lost password can be recovered"


async def test_an_invited_person_has_the_grants_of_the_invitation(accounts: Accounts) -> None:
    session = await accounts.member("Anna", ("operator", "*"), ("engineer", UR10))
    anna = accounts.caller(await accounts.token_of(session))
    assert set(anna.grants) == {Grant(Role.OPERATOR), Grant(Role.ENGINEER, UR10)}
    signed_in = await accounts.sign_in("  ANNA ")
    assert signed_in.status_code == 201, "names are compared without case and spaces"


@pytest.mark.parametrize(("name", "password"), [("Olga", "wrong password"), ("Nobody", PASSWORD)])
async def test_a_wrong_name_and_a_wrong_password_have_the_same_answer(
    accounts: Accounts, name: str, password: str
) -> None:
    await accounts.owner()
    refused = await accounts.sign_in(name, password)
    assert refused.status_code == 401
    assert refused.json()["detail"] == "the name or the password is wrong; correct it"


@pytest.mark.parametrize("password", ["short", "aaaaaaaaaaaaaaa", "Olga12345"])
async def test_a_weak_password_is_refused_and_the_link_remains(accounts: Accounts, password: str) -> None:
    body = {"link": accounts.owner_link, "name": "Olga", "password": password, "address": HOME}
    assert (await accounts.as_page("POST", "/links/use", body)).status_code == 422
    assert await accounts.owner()


async def test_a_thousand_attempts_shut_nobody_out(accounts: Accounts) -> None:
    await accounts.owner()
    await accounts.member("Anna")

    async def attempt() -> httpx.Response:
        return await accounts.sign_in("Anna", "wrong password", ATTACKER)

    attack = asyncio.gather(*(attempt() for _ in range(ATTEMPTS)))
    began_s = time.monotonic()
    for address in (HOME, "198.51.100.4"):
        signed_in = await accounts.sign_in("Anna", address=address)
        assert signed_in.status_code == 201, signed_in.text
    took_s = time.monotonic() - began_s
    answers = await attack
    statuses = [answer.status_code for answer in answers]
    assert statuses.count(401) <= FREE_ATTEMPTS + 10, "a few more, should this take minutes"
    assert {*statuses} == {401, 429}, next(one.text for one in answers if one.status_code not in {401, 429})
    assert all(int(answer.headers["retry-after"]) >= 1 for answer in answers if answer.status_code == 429)
    assert took_s < 60, "with the attack of a whole second in the same event loop"


def test_the_delay_grows_and_ends() -> None:
    limits, now_s, waits = SignInLimits(), 1000.0, []
    for _ in range(FREE_ATTEMPTS + 12):
        wait_s = limits.attempt(ATTACKER, "anna", now_s)
        if wait_s is not None:
            waits.append(wait_s)
            now_s += wait_s
            assert limits.attempt(ATTACKER, "anna", now_s) is None
    assert waits == sorted(waits)
    assert 2 <= waits[-1] <= MAX_DELAY_S
    assert limits.attempt(HOME, "anna", now_s) is None, "another address"
    assert limits.attempt(ATTACKER, "anna", now_s + 2 * 3600) is None, "never for ever"


def test_the_addresses_of_an_ipv6_network_count_together() -> None:
    limits = SignInLimits()
    answers = [limits.attempt(f"2001:db8::{number:x}", "anna", 5.0) for number in range(20)]
    assert answers.count(None) == FREE_ATTEMPTS


def password_change(session: str, current: str = PASSWORD, address: str = HOME) -> dict[str, str]:
    new = "a different sentence"
    return {"session": session, "current": current, "new": new, "address": address, "device": "Firefox"}


async def test_a_new_password_ends_the_other_sessions(accounts: Accounts) -> None:
    owner = await accounts.owner()
    here = await accounts.member("Anna", ("operator", "*"))
    there = (await accounts.sign_in("Anna")).json()["session"]
    wrong = await accounts.as_page("POST", "/password-changes", password_change(here, "guess"))
    assert wrong.status_code == 403
    audit = await accounts.call("GET", "/audit?action=passwordChange.failed", token=owner)
    assert [(one["outcome"], one["text"]) for one in audit.json()] == [("refused", f"from {HOME}")]
    joined = (await accounts.call("GET", "/audit?action=link.used", token=owner)).json()
    names = {one["subjectName"] for one in joined}
    assert "Anna" in names
    assert None not in names, "the subject of what a link did is the link"
    assert (await accounts.as_page("POST", "/password-changes", password_change(here))).status_code == 204
    ended = await accounts.as_page("POST", "/session-tokens", {"session": there})
    assert ended.status_code == 401
    late = await accounts.as_page("POST", "/password-changes", password_change(there))
    assert late.status_code == 401
    assert await accounts.token_of(here)
    assert (await accounts.sign_in("Anna")).status_code == 401
    assert (await accounts.sign_in("Anna", "a different sentence")).status_code == 201


async def test_attempts_to_change_a_password_count_for_the_address_of_the_person(accounts: Accounts) -> None:
    await accounts.owner()
    stolen = await accounts.member("Anna")
    for _ in range(FREE_ATTEMPTS + 12):  # a few more, should a hash take longer than the delay
        guess = await accounts.as_page(
            "POST", "/password-changes", password_change(stolen, "guess", ATTACKER)
        )
        if guess.status_code != 403:
            break
    assert guess.status_code == 429
    assert int(guess.headers["retry-after"]) >= 1
    own = await accounts.as_page("POST", "/password-changes", password_change(stolen))
    assert own.status_code == 204, "the person changes it from home at once"
    token = await accounts.token_of(stolen)
    by_herself = await accounts.call("POST", "/password-changes", password_change(stolen), token=token)
    assert by_herself.status_code == 403, "only the page server says where a person is"


async def test_sessions_are_listed_with_place_and_device_and_can_be_ended(accounts: Accounts) -> None:
    await accounts.owner()
    here = await accounts.member("Anna")
    there = (await accounts.sign_in("Anna", address="198.51.100.4")).json()["session"]
    token = await accounts.token_of(here)
    listed = (await accounts.call("GET", "/me/sessions", token=token)).json()
    assert {(one["address"], one["device"]) for one in listed} == {
        (HOME, "Firefox"),
        ("198.51.100.4", "Firefox"),
    }
    other = next(one["id"] for one in listed if not one["isThis"])
    assert (await accounts.call("DELETE", f"/me/sessions/{other}", token=token)).status_code == 204
    assert (await accounts.as_page("POST", "/session-tokens", {"session": there})).status_code == 401
    olga = await accounts.owner()
    stranger = next(one["id"] for one in (await accounts.call("GET", "/me/sessions", token=olga)).json())
    foreign = await accounts.call("DELETE", f"/me/sessions/{stranger}", token=token)
    assert foreign.status_code == 404, "a session of another user"


async def test_sessions_end_by_idleness_and_by_age(settings: AccountsSettings) -> None:
    made = set_up(settings, ["webui"])
    short = settings.model_copy(update={"session_idle_h": 0.2 / 3600})
    async with running(short, made.owner_link or "") as accounts:
        session = await accounts.use_link(accounts.owner_link, "Olga")
        async with asyncio.timeout(60):
            while (await accounts.as_page("POST", "/session-tokens", {"session": session})).is_success:
                await asyncio.sleep(0.3)  # longer than the idle time


async def test_sign_out_ends_the_access_token_too(accounts: Accounts) -> None:
    await accounts.owner()
    session = await accounts.member("Anna")
    token = await accounts.token_of(session)
    assert (await accounts.call("GET", "/me", token=token)).status_code == 200
    assert (await accounts.as_page("POST", "/sign-out", {"session": session})).status_code == 200
    assert (await accounts.call("GET", "/me", token=token)).status_code == 401
    assert (await accounts.as_page("POST", "/sign-out", {"session": session})).status_code == 200


async def test_only_the_page_server_opens_sessions(accounts: Accounts) -> None:
    owner = await accounts.owner()
    body = {"name": "Olga", "password": PASSWORD}
    for token in (owner, accounts.service_secret("trajectory-tool")):
        for path, content in (("/sessions", body), ("/session-tokens", {"session": "x"})):
            assert (await accounts.call("POST", path, content, token=token)).status_code == 403
    assert (await accounts.http.post("/sessions", json=body)).status_code == 401


async def test_without_accounts_nobody_signs_in_and_the_local_owner_reads(
    settings: AccountsSettings,
) -> None:
    async with running(settings) as accounts:
        me = (await accounts.http.get("/me")).json()
        assert (me["kind"], me["hasAccounts"]) == ("local", False)
        assert (await accounts.http.get("/users")).json() == []
        invited = await accounts.http.post("/invitations", json={})
        assert invited.status_code == 409
        assert "handover accounts set-up" in invited.json()["detail"]
