"""Signing in at an OpenID Connect provider: the browser goes there and comes back with a code.

The browser that begins gets a cookie with the secret of this sign-in, so that nobody else can finish it, and
nobody can be signed in as somebody else. The cookie is `SameSite=Lax`: the way back is a navigation from the
site of the provider. The result is an address of the page, which says in the user's language what failed.
"""

from typing import Annotated, Final

from fastapi import FastAPI, Query, Request
from fastapi.responses import RedirectResponse

from handover.errors import Problem
from handover_web.http.page_guard import PageGuard
from handover_web.routes.sessions import is_secure, own_address, place, set_session

PATH: Final = "/api/session/provider"
CALLBACK: Final = f"{PATH}/callback"
_FAULTS: Final = {"No account": "noAccount", "Name in use": "nameInUse", "Sign-in expired": "expired"}
"""Names of failures for the page, by the title of the problem; of any other it is `failed`."""


def add_provider_sign_in(app: FastAPI, guard: PageGuard) -> None:
    """Add the routes, which a browser opens."""

    @app.get(PATH, tags=["session"], status_code=303, response_class=RedirectResponse)
    async def begin(request: Request) -> RedirectResponse:
        """Send the browser to the provider."""
        body = {"redirectUri": f"{own_address(guard, request)}{CALLBACK}", **place(request)}
        try:
            begun = await guard.ask_accounts("/provider-sign-ins", body)
        except Problem as problem:
            return _to_page(problem)
        response = RedirectResponse(str(begun["location"]), 303)
        response.set_cookie(
            _cookie(guard),
            str(begun["secret"]),
            max_age=int(begun["maxAgeS"]),
            path=PATH,
            secure=is_secure(guard, request),
            httponly=True,
            samesite="lax",
        )
        return response

    @app.get(CALLBACK, tags=["session"], status_code=303, response_class=RedirectResponse)
    async def finish(
        request: Request,
        state: Annotated[str, Query(max_length=200)] = "",
        code: Annotated[str, Query(max_length=4000)] = "",
        iss: Annotated[str | None, Query(max_length=300)] = None,
    ) -> RedirectResponse:
        """Sign in with what the provider sent with the browser, and show the page."""
        secret = request.cookies.get(_cookie(guard), "")[:100]
        body = {"secret": secret, "state": state, "code": code, "iss": iss, **place(request)}
        try:
            opened = await guard.ask_accounts("/provider-sign-ins/finish", body)
        except Problem as problem:  # 422 if the provider refused, or this browser has begun no sign-in
            response = _to_page(problem)
        else:
            response = RedirectResponse("/", 303)
            set_session(guard, request, response, opened)
        response.delete_cookie(_cookie(guard), path=PATH, secure=is_secure(guard, request), httponly=True)
        return response


def _to_page(problem: Problem) -> RedirectResponse:
    return RedirectResponse(f"/#signIn={_FAULTS.get(problem.title, 'failed')}", 303)


def _cookie(guard: PageGuard) -> str:
    return f"{guard.cookie_name}_sign_in"
