"""Routes of the OpenID Connect provider: for the page server, and for admins who connect accounts."""

from typing import Annotated, cast

from fastapi import FastAPI

from handover.http.body_limit import max_body
from handover.security.caller import Caller
from handover.security.guard import require
from handover.security.permissions import Permission
from handover_accounts.openid_connect.identities import BrowserAnswer
from handover_accounts.openid_connect.provider_sign_in import ProviderSignIn
from handover_accounts.routes.bodies import (
    IdentityChange,
    ProviderAnswer,
    ProviderSignInBegin,
    SessionEnd,
)
from handover_accounts.routes.service_routes import MAX_BODY_BYTES, Verifier, require_page_server
from handover_accounts.routes.views import OpenedSession, ProviderLocation, SignedOut, SignInOptions


def add_provider_routes(app: FastAPI, provider: ProviderSignIn) -> None:
    """Add the routes."""

    @app.get("/sign-in-options", tags=["page server"])
    async def options(caller: Verifier) -> SignInOptions:
        """Return how people may sign in besides by a password: the name of the provider, or null."""
        require_page_server(caller)
        return {"provider": provider.name}

    @app.post("/provider-sign-ins", status_code=201, tags=["page server"])
    @max_body(MAX_BODY_BYTES)
    async def begin(caller: Verifier, body: ProviderSignInBegin) -> ProviderLocation:
        """Begin to sign in at the provider: where the browser goes, and a secret for its cookie."""
        require_page_server(caller)
        return cast("ProviderLocation", await provider.begin(body.redirect_uri, body.address))

    @app.post("/provider-sign-ins/finish", status_code=201, tags=["page server"])
    @max_body(MAX_BODY_BYTES)
    async def finish(caller: Verifier, body: ProviderAnswer) -> OpenedSession:
        """Open a session with what the browser brought back: 403 for another sign-in or no account."""
        require_page_server(caller)
        answer = BrowserAnswer(body.secret, body.state, body.code, body.iss)
        opened = await provider.finish(answer, body.address, body.device)
        return cast("OpenedSession", opened)

    @app.post("/sign-out", tags=["page server"])
    @max_body(MAX_BODY_BYTES)
    async def sign_out(caller: Verifier, body: SessionEnd) -> SignedOut:
        """End a session; `location` is where the browser signs out at the provider, if it signed in there.

        403 for a station without the PIN of the person who has joined it or of an engineer, 429 after too
        many attempts.
        """
        require_page_server(caller)
        return {"location": await provider.end_session(body.session, body.return_to, body.pin)}

    @app.put("/users/{subject}/identity", status_code=204, tags=["people"])
    async def connect(
        caller: Annotated[Caller, require(Permission.MANAGE_PEOPLE)], subject: str, body: IdentityChange
    ) -> None:
        """Let a user sign in as a subject of the provider; null for none."""
        await provider.set_identity(caller.subject, subject, body.subject)
