"""Accounts as an ASGI application on its own database, set up as `handover accounts set-up` does."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from pydantic import TypeAdapter

from handover.security.caller import Caller
from handover.security.keys_in_force import KeysInForce
from handover.security.service_access import service_token_file
from handover_accounts import passwords
from handover_accounts.app import make_app
from handover_accounts.directory import Directory
from handover_accounts.routes.views import UserToken
from handover_accounts.set_up import set_up
from handover_accounts.settings import AccountsSettings

MEMORY_KIB = 512
"""Of a hash in these tests, which make hundreds."""
PASSWORD = "correct horse battery"
ATTACKER = "203.0.113.9"
HOME = "192.0.2.7"


@dataclass
class Accounts:
    """The service, and clients with the tokens of callers."""

    settings: AccountsSettings
    http: httpx.AsyncClient
    directory: Directory
    owner_link: str

    async def call(self, method: str, path: str, body: Any = None, *, token: str) -> httpx.Response:
        headers = {"Authorization": f"Bearer {token}"}
        return await self.http.request(method, path, json=body, headers=headers)

    def service_secret(self, service: str = "webui") -> str:
        return service_token_file(self.settings, service).read_text().strip()

    async def as_page(self, method: str, path: str, body: Any = None) -> httpx.Response:
        """Send a request of the page server."""
        return await self.call(method, path, body, token=self.service_secret())

    async def sign_in(self, name: str, password: str = PASSWORD, address: str = HOME) -> httpx.Response:
        return await self.as_page(
            "POST", "/sessions", {"name": name, "password": password, "address": address, "device": "Firefox"}
        )

    async def use_link(self, link: str, name: str | None = None, password: str = PASSWORD) -> str:
        """Use a link; return the token of the session."""
        body = {"link": link, "password": password, "address": HOME, "device": "Firefox"}
        answer = await self.as_page("POST", "/links/use", body | ({"name": name} if name else {}))
        assert answer.status_code == 201, answer.text
        return str(answer.json()["session"])

    async def token_of(self, session: str) -> str:
        answer = await self.as_page("POST", "/session-tokens", {"session": session})
        assert answer.status_code == 200, answer.text
        TypeAdapter(UserToken).validate_python(answer.json(), extra="forbid")  # as it is documented
        return str(answer.json()["token"])

    async def owner(self) -> str:
        """Return an access token of the owner, who is made with the first call."""
        if self.owner_link:
            session, self.owner_link = await self.use_link(self.owner_link, "Olga"), ""
        else:
            session = (await self.sign_in("Olga")).json()["session"]
        return await self.token_of(session)

    async def member(self, name: str, *grants: tuple[str, str]) -> str:
        """Invite a person; return the token of their session."""
        body = {"grants": [{"role": role, "resource": on} for role, on in grants]}
        answer = await self.call("POST", "/invitations", body, token=await self.owner())
        assert answer.status_code == 201, answer.text
        return await self.use_link(answer.json()["link"], name)

    def caller(self, token: str) -> Caller:
        keys = KeysInForce(self.settings.security_folder).keys()
        assert keys is not None
        return keys.verify(token)


@asynccontextmanager
async def running(settings: AccountsSettings, owner_link: str = "") -> AsyncIterator[Accounts]:
    app = make_app(settings)
    transport = httpx.ASGITransport(app)
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=transport, base_url="http://localhost") as http,
    ):
        yield Accounts(settings, http, app.state.directory, owner_link)


@pytest.fixture(autouse=True)
def fast_hashes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(passwords, "MEMORY_KIB", MEMORY_KIB)


@pytest.fixture
def settings(tmp_path: Path) -> AccountsSettings:
    return AccountsSettings(data_dir=tmp_path, _env_file=None)


@pytest.fixture
async def accounts(settings: AccountsSettings) -> AsyncIterator[Accounts]:
    made = set_up(settings, ["webui", "trajectory-tool", "accounts"])
    async with running(settings, made.owner_link or "") as found:
        yield found
