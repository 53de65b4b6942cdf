"""A broker with accounts as processes, and callers with the tokens of scripts and services."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from handover.security.caller import CallerKind
from handover.security.permissions import Grant, Role
from handover.security.service_access import service_token_file
from handover_accounts.set_up import opened_store, set_up
from handover_accounts.settings import AccountsSettings
from handover_accounts.storage import grants, secret_token_store, users
from tests.kit.cell import Cell, new_cell
from tests.kit.waiting import wait_for

SERVICES = ("context-broker", "human-state", "trajectory-tool")


class SecuredBroker:
    """The broker and accounts of a cell; callers are HTTP clients of the broker's API."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        self.settings = AccountsSettings.load(data_dir=cell.data_dir)
        self._clients: list[httpx.Client] = []

    def set_up(self) -> None:
        """End local mode; there is an admin, so that every grant of others can be removed."""
        set_up(self.settings, SERVICES)
        with opened_store(self.settings) as store, store.change("test", "test") as change:
            grants.add_grant(change, users.add_user(change, "Olga", None), Grant(Role.ADMIN))

    def start(self) -> None:
        self.cell.start("accounts", "context_broker", within_s=90)

    def client(self, token: str, **headers: str) -> httpx.Client:
        made = httpx.Client(
            base_url=f"{self.cell.url('context_broker')}/ngsi-ld/v1",
            headers={"Authorization": f"Bearer {token}", **headers},
            timeout=120,
            trust_env=False,
        )
        self._clients.append(made)
        return made

    def service(self, name: str = "human-state", **headers: str) -> httpx.Client:
        return self.client(service_token_file(self.settings, name).read_text().strip(), **headers)

    def script(self, *roles: Role | Grant) -> tuple[str, str]:
        """Issue a token with grants; return its subject and the token."""
        given = tuple(one if isinstance(one, Grant) else Grant(one) for one in roles)
        with opened_store(self.settings) as store, store.change("test", "test") as change:
            return secret_token_store.issue(change, CallerKind.SCRIPT, "a script", given, None)

    def caller(self, *roles: Role | Grant, **headers: str) -> httpx.Client:
        return self.client(self.script(*roles)[1], **headers)

    def remove_grant(self, subject: str, role: Role) -> None:
        with opened_store(self.settings) as store, store.change("test", "test") as change:
            for row in grants.grant_rows(change.connection)[subject]:
                if row["role"] == role:
                    grants.remove_grant(change, row["id"])

    def revoke(self, subject: str) -> None:
        with opened_store(self.settings) as store, store.change("test", "test") as change:
            secret_token_store.revoke_token(change, subject)

    def audit(self, **chosen: str) -> list[dict[str, Any]]:
        auditor = self.caller(Role.ADMIN)
        answer = auditor.get(f"{self.cell.url('context_broker')}/audit", params=chosen)
        assert answer.status_code == 200, answer.text
        return list(answer.json())

    def close(self) -> None:
        for client in self._clients:
            client.close()


@contextmanager
def secured_broker(folder: Path, extra: Mapping[str, str] | None = None) -> Iterator[SecuredBroker]:
    """Yield a broker with accounts, whose first user is an admin."""
    with new_cell(folder) as cell:
        cell.extra["HANDOVER_OUTBOUND_ALLOW"] = "127.0.0.0/8"
        cell.extra.update(extra or {})
        broker = SecuredBroker(cell)
        broker.set_up()
        broker.start()
        # Until it has the revocations of accounts, it changes nothing (503).
        nothing = "/entities/urn:ngsi-ld:Nothing:1?local=true"
        wait_for(lambda: broker.service().delete(nothing).status_code == 404)
        try:
            yield broker
        finally:
            broker.close()
