"""Routes for services: tokens, introspection, revocations; and for the page server: sessions and links."""

import json
import secrets
import time
from typing import Annotated, Any, Final, cast

from fastapi import FastAPI, Query, Request, Response
from sqlalchemy import Connection, func, insert, select

from handover.errors import Problem
from handover.http.body_limit import max_body
from handover.security.caller import Caller, CallerKind
from handover.security.guard import require
from handover.security.permissions import Permission
from handover.security.secret_tokens import is_secret_token
from handover.serving.service import json_response
from handover_accounts.directory import NOBODY, Directory
from handover_accounts.routes.bodies import (
    LinkBody,
    LinkUse,
    NewAccountRequest,
    PasswordChange,
    SessionBody,
    SignIn,
    SubjectBody,
    TokenBody,
)
from handover_accounts.routes.views import (
    Introspection,
    LinkPreview,
    OpenedSession,
    Revocations,
    ServiceToken,
    UserToken,
    time_of,
)
from handover_accounts.storage import links, tables, users
from handover_accounts.storage.changes import Change

PAGE_SERVER: Final = "webui"
"""The service that may open sessions of people and act for them."""
MAX_WAIT_S: Final = 30.0
MAX_REQUESTS: Final = 200
MAX_BODY_BYTES: Final = 16 * 1024

Verifier = Annotated[Caller, require(Permission.VERIFY_CALLERS)]


def add_service_routes(app: FastAPI, directory: Directory) -> None:
    """Add the routes that only services may use."""

    @app.post("/service-tokens", tags=["services"])
    @max_body(MAX_BODY_BYTES)
    async def service_token(caller: Verifier, request: Request) -> ServiceToken:
        """Exchange the secret token of a service (Authorization: Bearer) for an access token."""
        token = request.headers.get("authorization", "").partition(" ")[2].strip()
        if not is_secret_token(token) or caller.kind is not CallerKind.SERVICE:
            raise Problem(403, "No secret token", "send the secret token of the service, not an access token")
        return cast("ServiceToken", await directory.service_token(caller))

    @app.post("/introspection", tags=["services"], dependencies=[require(Permission.VERIFY_CALLERS)])
    @max_body(MAX_BODY_BYTES)
    async def introspection(body: TokenBody) -> Introspection:
        """Return whose secret token it is (RFC 7662)."""
        return cast("Introspection", await directory.introspect(body.token))

    @app.post("/subjects/lookups", tags=["services"], dependencies=[require(Permission.VERIFY_CALLERS)])
    @max_body(MAX_BODY_BYTES)
    async def look_up(body: SubjectBody) -> Introspection:
        """Return the present grants of a user or a token, for what a service does in its name later.

        `active` is false for one that does not exist any more; `revision` is there always.
        """
        return cast("Introspection", await directory.look_up(body.subject))

    @app.get("/revocations", tags=["services"], dependencies=[require(Permission.VERIFY_CALLERS)])
    async def revocations(
        after: Annotated[int, Query(ge=0, le=2**62)] = 0,
        waitS: Annotated[float, Query(ge=0, le=MAX_WAIT_S)] = 0,  # noqa: N803
    ) -> Revocations:
        """Return the revocations after a number; wait for the first if there is none."""
        return cast("Revocations", await directory.revocations_after(after, waitS))


def add_page_server_routes(app: FastAPI, directory: Directory) -> None:
    """Add the routes that only the page server may use, which says where a person is."""

    @app.post("/sessions", status_code=201, tags=["page server"])
    @max_body(MAX_BODY_BYTES)
    async def sign_in(caller: Verifier, body: SignIn) -> OpenedSession:
        """Open a session: 401 for a wrong name or password, 429 with Retry-After for too many attempts."""
        require_page_server(caller)
        opened = await directory.sign_in(body.name, body.password, body.address, body.device)
        return cast("OpenedSession", opened)

    @app.post("/session-tokens", tags=["page server"], response_model=UserToken)
    @max_body(MAX_BODY_BYTES)
    async def session_token(caller: Verifier, body: SessionBody) -> Response:
        """Exchange a session for an access token of 60 s: 401 for a session that has ended."""
        require_page_server(caller)
        return json_response(await directory.user_token(body.session))

    @app.post("/password-changes", status_code=204, tags=["page server"])
    @max_body(MAX_BODY_BYTES)
    async def change_password(caller: Verifier, body: PasswordChange) -> None:
        """Change the password of the user of a session; the other sessions end.

        401 for a session that has ended, 403 for a wrong current password, 422 for a weak new one, 429 with
        Retry-After for too many attempts.
        """
        require_page_server(caller)
        await directory.change_password(body.session, body.current, body.new, body.address)

    @app.post("/links/preview", tags=["page server"])
    @max_body(MAX_BODY_BYTES)
    async def preview(caller: Verifier, body: LinkBody) -> LinkPreview:
        """Return what a one-time link is for: 404 for one that is invalid."""
        require_page_server(caller)

        def found(connection: Connection) -> tuple[dict[str, Any], str | None]:
            link = links.find_link(connection, body.link)
            name = (
                link["name"] if link["subject"] is None else users.find(connection, link["subject"])["name"]
            )
            return link, name

        link, name = await directory.read(found)
        return {
            "purpose": link["purpose"],
            "name": name,
            "grants": [{"role": role, "resource": resource} for role, resource in json.loads(link["grants"])],
            "expiresAt": time_of(link["expires_s"]),
        }

    @app.post("/links/use", status_code=201, tags=["page server"])
    @max_body(MAX_BODY_BYTES)
    async def use(caller: Verifier, body: LinkUse) -> OpenedSession:
        """Use a one-time link: a new user or a new password, and a session."""
        require_page_server(caller)
        opened = await directory.use_link(body.link, body.name, body.password, body.address, body.device)
        return cast("OpenedSession", opened)

    @app.post("/account-requests", status_code=204, tags=["page server"])
    @max_body(MAX_BODY_BYTES)
    async def ask_for_account(caller: Verifier, body: NewAccountRequest) -> None:
        """Note that a person asks for an account; an admin decides."""
        require_page_server(caller)
        directory.require_accounts()
        directory.admit_attempt(body.address, "account request")
        name = users.checked_name(body.name)
        await directory.change(NOBODY, lambda change: _note_request(change, name, body))


def _note_request(change: Change, name: str, body: NewAccountRequest) -> None:
    table = tables.requests
    if change.connection.execute(select(func.count()).select_from(table)).scalar_one() >= MAX_REQUESTS:
        raise Problem(
            429, "Too many requests", "many requests for accounts wait already; ask an admin directly"
        )
    request_id = f"request-{secrets.token_hex(8)}"
    change.connection.execute(
        insert(table).values(
            id=request_id, name=name, contact=body.contact, note=body.note, created_s=time.time()
        )
    )
    change.record("account.requested", request_id)


def require_page_server(caller: Caller) -> None:
    """Raise `Problem` 403 unless the page server asks."""
    if caller.kind is not CallerKind.SERVICE or caller.name != PAGE_SERVER:
        raise Problem(403, "Not allowed", f"only the page server ({PAGE_SERVER}) may act for people")
