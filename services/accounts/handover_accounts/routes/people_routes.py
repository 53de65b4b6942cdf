"""Routes for admins: users, grants, sessions, invitations, tokens, requests for accounts."""

import json
import time
from typing import Annotated, Any, Final, cast

from fastapi import FastAPI, Query
from sqlalchemy import Connection, delete, select

from handover.errors import Problem
from handover.security.caller import Caller, CallerKind
from handover.security.guard import require
from handover.security.permissions import Permission
from handover_accounts.directory import Directory
from handover_accounts.routes.bodies import NewGrant, NewInvitation, NewToken, UserChange
from handover_accounts.routes.own_routes import session_view
from handover_accounts.routes.views import (
    AccountRequestView,
    DeletedUser,
    GrantView,
    IssuedToken,
    LinkView,
    NewLink,
    SessionView,
    TokenView,
    UserView,
    time_of,
)
from handover_accounts.storage import links, secret_token_store, sessions, tables, users
from handover_accounts.storage.changes import Change
from handover_accounts.storage.grants import add_grant, checked_grant, grant_rows, remove_grant

MAX_PAGE: Final = 500

Admin = Annotated[Caller, require(Permission.MANAGE_PEOPLE)]


def add_user_routes(app: FastAPI, directory: Directory) -> None:
    """Add the routes of users, their grants and sessions."""
    limits = directory.session_limits

    @app.get("/users", tags=["people"])
    async def list_users(
        _: Admin,
        after: Annotated[str, Query(max_length=64)] = "",
        limit: Annotated[int, Query(ge=1, le=MAX_PAGE)] = MAX_PAGE,
    ) -> list[UserView]:
        """List the users by name; `after` is the name of the last user of the page before."""

        def read(connection: Connection) -> list[UserView]:
            grants = grant_rows(connection)
            now_s = time.time()
            opened: dict[str, list[float]] = {}
            for row in connection.execute(select(tables.sessions)).mappings():
                if limits.ends_s(row) > now_s:
                    opened.setdefault(row["subject"], []).append(row["seen_s"])
            key = tables.users.c.name_key
            query = select(tables.users).where(key > users.name_key(after)).order_by(key).limit(limit)
            rows = connection.execute(query).mappings()
            return [_user_view(dict(row), grants, opened.get(row["subject"], [])) for row in rows]

        return await directory.read(read)

    @app.patch("/users/{subject}", status_code=204, tags=["people"])
    async def change_user(caller: Admin, subject: str, body: UserChange) -> None:
        """Set the Person entity of a user."""
        await directory.change(caller.subject, lambda change: users.set_person(change, subject, body.person))

    @app.delete("/users/{subject}", tags=["people"])
    async def delete_user(caller: Admin, subject: str) -> DeletedUser:
        """Delete a user; return what remains and why. 409 for the last admin."""
        result = await directory.change(caller.subject, lambda change: users.delete_user(change, subject))
        await directory.read(lambda _: directory.store.empty_journal())
        return cast("DeletedUser", result)

    @app.post("/users/{subject}/password-link", status_code=201, tags=["people"])
    async def password_link(caller: Admin, subject: str) -> NewLink:
        """Make a one-time link with which a user sets a new password."""
        return await _new_link(directory, caller, links.PASSWORD, subject=subject)

    @app.get("/users/{subject}/sessions", tags=["people"])
    async def list_sessions(caller: Admin, subject: str) -> list[SessionView]:
        """List the sessions of a user with their places and devices."""
        rows = await directory.read(lambda connection: sessions.sessions_of(connection, subject, limits))
        return [session_view(row, limits, caller) for row in rows]

    @app.delete("/users/{subject}/sessions", status_code=204, tags=["people"])
    async def end_sessions(caller: Admin, subject: str) -> None:
        """End all sessions of a user."""

        def end(change: Change) -> None:
            users.find(change.connection, subject)
            users.end_sessions_of(change, subject)
            change.is_recorded = True  # there may be none

        await directory.change(caller.subject, end)

    @app.delete("/users/{subject}/sessions/{session}", status_code=204, tags=["people"])
    async def end_session(caller: Admin, subject: str, session: str) -> None:
        """End one session of a user."""
        await directory.change(
            caller.subject, lambda change: sessions.end_session(change, session, subject=subject)
        )

    @app.post("/grants", status_code=201, tags=["people"])
    async def grant(caller: Admin, body: NewGrant) -> GrantView:
        """Grant a role to a user or token, for the resources that a pattern includes."""
        added = checked_grant(body.role, body.resource)

        def add(change: Change) -> str:
            _require_subject(change.connection, body.subject)
            return add_grant(change, body.subject, added)

        return {
            "id": await directory.change(caller.subject, add),
            "role": added.role,
            "resource": added.resource,
        }

    @app.delete("/grants/{grant}", status_code=204, tags=["people"])
    async def remove(caller: Admin, grant: str) -> None:
        """Remove a grant; 409 for the last admin."""
        await directory.change(caller.subject, lambda change: remove_grant(change, grant))


def add_invitation_routes(app: FastAPI, directory: Directory) -> None:
    """Add the routes of invitations and of requests for accounts."""

    @app.get("/invitations", tags=["people"])
    async def list_links(_: Admin) -> list[LinkView]:
        """List the open links: invitations, links for a new password or for an owner."""
        rows = await directory.read(links.link_rows)
        return [
            {
                "id": row["id"],
                "purpose": row["purpose"],
                "name": row["name"],
                "grants": [{"role": role, "resource": on} for role, on in json.loads(row["grants"])],
                "createdAt": time_of(row["created_s"]),
                "expiresAt": time_of(row["expires_s"]),
            }
            for row in rows
        ]

    @app.post("/invitations", status_code=201, tags=["people"])
    async def invite(caller: Admin, body: NewInvitation) -> NewLink:
        """Make a one-time link with which a person chooses name and password."""
        name = None if body.name is None else users.checked_name(body.name)
        grants = tuple(checked_grant(grant.role, grant.resource) for grant in body.grants)
        return await _new_link(directory, caller, links.INVITATION, name=name, grants=grants)

    @app.delete("/invitations/{link}", status_code=204, tags=["people"])
    async def withdraw(caller: Admin, link: str) -> None:
        """Make an open link invalid."""
        await directory.change(caller.subject, lambda change: links.withdraw_link(change, link))

    @app.get("/account-requests", tags=["people"])
    async def list_requests(_: Admin) -> list[AccountRequestView]:
        """List the requests for accounts, oldest first; an invitation answers one."""
        query = select(tables.requests).order_by(tables.requests.c.created_s)
        rows = await directory.read(lambda connection: connection.execute(query).mappings().all())
        return [
            {
                "id": row["id"],
                "name": row["name"],
                "contact": row["contact"],
                "note": row["note"],
                "createdAt": time_of(row["created_s"]),
            }
            for row in rows
        ]

    @app.delete("/account-requests/{request}", status_code=204, tags=["people"])
    async def close_request(caller: Admin, request: str) -> None:
        """Delete a request for an account, answered or refused."""

        def close(change: Change) -> None:
            table = tables.requests
            if change.connection.execute(delete(table).where(table.c.id == request)).rowcount == 0:
                raise Problem(404, "Not found", "there is no such request; another admin may have closed it")
            change.record("account.requestClosed", request)

        await directory.change(caller.subject, close)


def add_token_routes(app: FastAPI, directory: Directory) -> None:
    """Add the routes of tokens."""

    @app.get("/tokens", tags=["people"])
    async def list_tokens(_: Admin) -> list[TokenView]:
        """List the tokens of scripts, devices and services, the newest first."""

        def read(connection: Connection) -> list[TokenView]:
            grants = grant_rows(connection)
            return [
                {
                    "subject": row["subject"],
                    "kind": row["kind"],
                    "name": row["name"],
                    "createdAt": time_of(row["created_s"]),
                    "expiresAt": time_of(row["expires_s"]),
                    "usedAt": time_of(row["used_s"]),
                    "grants": cast("list[GrantView]", grants.get(row["subject"], [])),
                }
                for row in secret_token_store.token_rows(connection)
            ]

        return await directory.read(read)

    @app.post("/tokens", status_code=201, tags=["people"])
    async def issue(caller: Admin, body: NewToken) -> IssuedToken:
        """Issue a token for a script or device; it is shown only in this answer."""
        directory.require_accounts()
        name = users.checked_name(body.name)
        grants = tuple(checked_grant(grant.role, grant.resource) for grant in body.grants)
        expires_s = None if body.valid_days is None else time.time() + body.valid_days * 86400

        def add(change: Change) -> tuple[str, str]:
            return secret_token_store.issue(change, CallerKind(body.kind), name, grants, expires_s)

        subject, token = await directory.change(caller.subject, add)
        return {"subject": subject, "token": token}

    @app.delete("/tokens/{subject}", status_code=204, tags=["people"])
    async def revoke(caller: Admin, subject: str) -> None:
        """Revoke a token; services refuse it within two seconds."""
        await directory.change(
            caller.subject, lambda change: secret_token_store.revoke_token(change, subject)
        )


async def _new_link(directory: Directory, caller: Caller, purpose: str, **content: Any) -> NewLink:
    directory.require_accounts()
    valid_s = directory.settings.link_valid_h * 3600
    link_id, secret, expires_s = await directory.change(
        caller.subject, lambda change: links.make_link(change, purpose, valid_s=valid_s, **content)
    )
    return {"id": link_id, "link": secret, "expiresAt": time_of(expires_s)}


def _require_subject(connection: Connection, subject: str) -> None:
    for table in (tables.users, tables.tokens):
        query = select(table.c.subject).where(table.c.subject == subject)
        if connection.execute(query).scalar() is not None:
            return
    raise Problem(404, "Not found", f'there is no user or token "{subject[:64]}"')


def _user_view(row: dict[str, Any], grants: dict[str, list[dict[str, Any]]], opened: list[float]) -> UserView:
    return {
        "subject": row["subject"],
        "name": row["name"],
        "person": row["person"],
        "createdAt": time_of(row["created_s"]),
        "grants": cast("list[GrantView]", grants.get(row["subject"], [])),
        "sessions": len(opened),
        "seenAt": time_of(max(opened, default=None)),
    }
