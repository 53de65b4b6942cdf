"""Signing in at an OpenID Connect provider: a real one, on a port of this machine."""

import json
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit
from uuid import uuid4

import httpx
import pytest

from handover.errors import UsageError
from handover.security.permissions import Grant, Role
from handover_accounts.openid_connect.claims import name_of, role_mapping
from handover_accounts.set_up import set_up
from handover_accounts.settings import AccountsSettings
from services.accounts.tests.unit.conftest import HOME, Accounts, running
from tests.kit.openid_provider import Client, OpenIdProvider, openid_provider

CALLBACK = "https://cell.example/api/session/provider/callback"
UR10 = "urn:ngsi-ld:Device:demo:ur10-1"
ROLES = f"handover-admins=admin, line-1=engineer@{UR10}, line-1=operator"


@pytest.fixture(scope="module")
def provider() -> OpenIdProvider:
    return openid_provider()


@asynccontextmanager
async def accounts_with(
    folder: Path, provider: OpenIdProvider, client: Client, **given: Any
) -> AsyncIterator[Accounts]:
    settings = AccountsSettings(
        data_dir=folder,
        oidc_issuer=provider.issuer,
        oidc_client_id=client.client_id,
        oidc_client_secret=client.secret,
        oidc_name="Plant sign-on",
        oidc_roles=ROLES,
        _env_file=None,
        **{"oidc_create_users": True, **given},
    )
    made = set_up(settings, ["webui", "accounts"])
    async with running(settings, made.owner_link or "") as accounts:
        yield accounts


async def begin(accounts: Accounts, address: str = HOME) -> dict[str, Any]:
    answer = await accounts.as_page(
        "POST", "/provider-sign-ins", {"redirectUri": CALLBACK, "address": address}
    )
    assert answer.status_code == 201, answer.text
    return dict(answer.json())


async def finish(
    accounts: Accounts, begun: Mapping[str, Any], back: httpx.URL, **other: str
) -> httpx.Response:
    query = {name: values[0] for name, values in parse_qs(urlsplit(str(back)).query).items()}
    body = {
        "secret": begun["secret"],
        "state": query["state"],
        "code": query["code"],
        "address": HOME,
    } | other
    return await accounts.as_page("POST", "/provider-sign-ins/finish", body)


async def sign_in(accounts: Accounts, provider: OpenIdProvider, name: str) -> httpx.Response:
    begun = await begin(accounts)
    return await finish(accounts, begun, provider.sign_in(begun["location"], name))


def a_name() -> str:
    return f"anna-{uuid4().hex[:8]}"


@pytest.mark.nightly
@pytest.mark.parametrize("is_public", [False, True])
async def test_a_person_signs_in_at_the_provider_and_gets_the_grants_of_its_groups(
    tmp_path: Path, provider: OpenIdProvider, is_public: bool
) -> None:
    name = a_name()
    provider.add_user(name, "line-1", "somebody else's group")
    client = provider.add_client(CALLBACK, is_public=is_public)
    async with accounts_with(tmp_path, provider, client) as accounts:
        options = await accounts.as_page("GET", "/sign-in-options")
        assert options.json() == {"provider": "Plant sign-on"}
        begun = await begin(accounts)
        query = parse_qs(urlsplit(begun["location"]).query)
        assert query["code_challenge_method"] == ["S256"]
        assert {"state", "nonce", "code_challenge"} <= query.keys()
        opened = await finish(accounts, begun, provider.sign_in(begun["location"], name))
        assert opened.status_code == 201, opened.text
        anna = accounts.caller(await accounts.token_of(opened.json()["session"]))
        assert anna.name == name
        assert set(anna.grants) == {Grant(Role.ENGINEER, UR10), Grant(Role.OPERATOR)}
        records = await accounts.call("GET", "/audit", token=await accounts.owner())
        opened_by = [one for one in records.json() if one["action"] == "session.opened"]
        assert {one["method"] for one in opened_by} >= {"openid"}


async def test_grants_follow_the_provider_and_those_of_an_admin_remain(
    tmp_path: Path, provider: OpenIdProvider
) -> None:
    name = a_name()
    provider.add_user(name, "line-1")
    async with accounts_with(tmp_path, provider, provider.add_client(CALLBACK)) as accounts:
        first = accounts.caller(
            await accounts.token_of((await sign_in(accounts, provider, name)).json()["session"])
        )
        given = {"subject": first.subject, "role": "researcher"}
        assert (
            await accounts.call("POST", "/grants", given, token=await accounts.owner())
        ).status_code == 201
        provider.set_groups(name)
        again = accounts.caller(
            await accounts.token_of((await sign_in(accounts, provider, name)).json()["session"])
        )
        assert again.subject == first.subject
        assert again.grants == (Grant(Role.RESEARCHER),)
        assert accounts.directory.revocations.is_revoked(first), "what the provider took away ends at once"


async def test_users_are_made_only_where_the_setting_allows_else_an_admin_connects_them(
    tmp_path: Path, provider: OpenIdProvider
) -> None:
    name = a_name()
    subject_there = provider.add_user(name)
    client = provider.add_client(CALLBACK)
    async with accounts_with(tmp_path, provider, client, oidc_create_users=False) as accounts:
        refused = await sign_in(accounts, provider, name)
        assert (refused.status_code, refused.json()["title"]) == (403, "No account")
        session = await accounts.member(name)
        anna = accounts.caller(await accounts.token_of(session))
        path, owner = f"/users/{anna.subject}/identity", await accounts.owner()
        mine = await accounts.call(
            "PUT", path, {"subject": subject_there}, token=await accounts.token_of(session)
        )
        assert mine.status_code == 403, "nobody connects the own account"
        assert (await accounts.call("PUT", path, {"subject": subject_there}, token=owner)).status_code == 204
        signed_in = await sign_in(accounts, provider, name)
        assert accounts.caller(await accounts.token_of(signed_in.json()["session"])).subject == anna.subject
        assert (await accounts.call("DELETE", f"/users/{anna.subject}", token=owner)).status_code == 200
        assert (await sign_in(accounts, provider, name)).status_code == 403, "a deleted user has no identity"


async def test_a_name_that_another_account_has_is_never_taken_over(
    tmp_path: Path, provider: OpenIdProvider
) -> None:
    name = a_name()
    provider.add_user(name, "handover-admins")
    async with accounts_with(tmp_path, provider, provider.add_client(CALLBACK)) as accounts:
        await accounts.member(name)
        refused = await sign_in(accounts, provider, name)
        assert (refused.status_code, refused.json()["title"]) == (409, "Name in use")


async def test_a_sign_in_is_finished_once_by_the_browser_that_began_it(
    tmp_path: Path, provider: OpenIdProvider
) -> None:
    name = a_name()
    provider.add_user(name)
    async with accounts_with(tmp_path, provider, provider.add_client(CALLBACK)) as accounts:
        mine, other = await begin(accounts), await begin(accounts)
        back = provider.sign_in(mine["location"], name)
        stolen = await finish(accounts, other, back)
        assert (stolen.status_code, stolen.json()["title"]) == (403, "Wrong state")
        assert (await finish(accounts, mine, back, iss="https://evil.example")).status_code == 503
        mine = await begin(accounts)
        back = provider.sign_in(mine["location"], name)
        assert (await finish(accounts, mine, back)).status_code == 201
        assert (await finish(accounts, mine, back)).status_code == 403, "a code cannot be replayed"


async def test_a_code_of_another_sign_in_is_refused_by_pkce_and_by_the_nonce(
    tmp_path: Path, provider: OpenIdProvider
) -> None:
    name = a_name()
    provider.add_user(name)
    async with accounts_with(tmp_path, provider, provider.add_client(CALLBACK)) as accounts:
        attacker, victim = await begin(accounts), await begin(accounts)
        back = provider.sign_in(attacker["location"], name)
        state = parse_qs(urlsplit(victim["location"]).query)["state"][0]
        injected = await finish(accounts, victim, back, state=state)
        assert injected.status_code == 503
        assert "invalid_grant" in injected.json()["detail"]


async def test_id_tokens_that_are_signed_with_a_secret_need_that_setting(
    tmp_path: Path, provider: OpenIdProvider
) -> None:
    name = a_name()
    provider.add_user(name)
    client = provider.add_client(CALLBACK, algorithm="HS256")
    async with accounts_with(tmp_path / "keys", provider, client) as accounts:
        refused = await sign_in(accounts, provider, name)
        assert refused.status_code == 503
        assert "ID token is invalid" in refused.json()["detail"]
    metadata = httpx.get(f"{provider.issuer}/.well-known/openid-configuration", trust_env=False).json()
    file = tmp_path / "metadata.json"
    file.write_text(
        json.dumps({name: metadata[name] for name in ("issuer", "authorization_endpoint", "token_endpoint")})
    )
    given = {"oidc_token_secret": client.secret, "oidc_metadata_file": file, "oidc_nonce": False}
    async with accounts_with(tmp_path / "secret", provider, client, **given) as accounts:
        assert (await sign_in(accounts, provider, name)).status_code == 201
    wrong = given | {"oidc_token_secret": "another secret of thirty-two characters"}
    async with accounts_with(tmp_path / "wrong", provider, client, **wrong) as accounts:
        assert (await sign_in(accounts, provider, name)).status_code == 503


async def test_a_sign_out_ends_both_sessions(tmp_path: Path, provider: OpenIdProvider) -> None:
    name = a_name()
    provider.add_user(name)
    async with accounts_with(tmp_path, provider, provider.add_client(CALLBACK)) as accounts:
        with httpx.Client(trust_env=False, timeout=60) as browser:
            begun = await begin(accounts)
            opened = await finish(accounts, begun, provider.sign_in(begun["location"], name, browser))
            body = {"session": opened.json()["session"], "returnTo": "https://cell.example/"}
            location = (await accounts.as_page("POST", "/sign-out", body)).json()["location"]
            assert (
                await accounts.as_page("POST", "/session-tokens", {"session": body["session"]})
            ).status_code == 401
            back = browser.get(location)
            assert back.headers["location"] == "https://cell.example/"
            again = browser.get((await begin(accounts))["location"])
            assert "/login/" in again.headers["location"], "the provider asks for the password again"


async def test_without_the_provider_people_sign_in_with_their_password(tmp_path: Path) -> None:
    nowhere = OpenIdProvider("http://127.0.0.1:9")
    async with accounts_with(tmp_path, nowhere, Client("handover", None)) as accounts:
        await accounts.owner()
        answer = await accounts.as_page(
            "POST", "/provider-sign-ins", {"redirectUri": CALLBACK, "address": HOME}
        )
        assert answer.status_code == 503
        assert (await accounts.sign_in("Olga")).status_code == 201


@pytest.mark.parametrize(
    ("claims", "claim"),
    [
        ({"groups": ["a", "line-1"]}, "groups"),
        ({"groups": "line-1"}, "groups"),
        ({"realm_access": {"roles": ["line-1"]}}, "realm_access.roles"),
        ({"roles": [{"id": "9", "name": "line-1"}]}, "roles"),
        ({"https://example.org/roles": ["line-1"]}, "https://example.org/roles"),
    ],
)
def test_the_claim_of_roles_has_the_forms_of_keycloak_and_keyrock(claims: dict[str, Any], claim: str) -> None:
    mapping = role_mapping(claim, ["line-1=operator"])
    assert mapping.grants_of(claims) == (Grant(Role.OPERATOR),)
    assert mapping.grants_of({"groups": [1, None, {}], "realm_access": "line-1"}) == ()


@pytest.mark.parametrize(
    "entry", ["operator", "=operator", "line-1=king", "line-1=operator@two words", "a=service"]
)
def test_a_mapping_that_is_none_is_refused_at_the_start(entry: str) -> None:
    with pytest.raises(UsageError, match="HANDOVER_OIDC_ROLES"):
        role_mapping("groups", [entry])


def test_the_name_is_the_first_claim_that_can_be_one() -> None:
    assert name_of({"preferred_username": "<script>", "name": "Anna Zimmer", "sub": "7"}) == "Anna Zimmer"
