"""Signing in and out: the routes that set and delete the session cookie."""

from typing import Annotated, Any

from fastapi import FastAPI, Request, Response
from pydantic import ConfigDict, Field
from typing_extensions import TypedDict

from handover.errors import Problem
from handover.formats.strict_json import StrictModel
from handover.security.caller import CallerKind
from handover.security.guard import require_signed_in
from handover.security.permissions import Permission
from handover_web.http.page_guard import PageGuard

Name = Annotated[str, Field(min_length=1, max_length=64)]
Password = Annotated[str, Field(min_length=1, max_length=200)]
Link = Annotated[str, Field(min_length=1, max_length=100)]


class _Body(StrictModel):
    model_config = ConfigDict(extra="forbid")


class SignInRequest(_Body):
    """A name and a password."""

    name: Name
    password: Password


class LinkRequest(_Body):
    """The secret of a one-time link."""

    link: Link


class LinkUseRequest(LinkRequest):
    """A one-time link with the password, and the name of a new user."""

    name: Name | None = None
    password: Password


class PasswordChangeRequest(_Body):
    """The current and the new password."""

    current: Password
    new: Password


class AccountRequest(_Body):
    """A request for an account."""

    name: Name
    contact: Annotated[str, Field(max_length=200)] = ""
    note: Annotated[str, Field(max_length=1000)] = ""


class SignOutRequest(_Body):
    """The PIN with which a station is signed out."""

    pin: Annotated[str, Field(max_length=100)] | None = None


class StationRequest(_Body):
    """The station as which a screen is signed in."""

    station: Annotated[str, Field(min_length=1, max_length=64)]


class SignedInUser(TypedDict):
    """The user of a session; `permissions` are those of at least one grant.

    `isStation`: the screen is signed in as a station, whose user is the person who has joined it.
    """

    subject: str
    name: str
    person: str | None
    permissions: list[str]
    isLocal: bool
    isStation: bool


class SessionView(TypedDict):
    """Whether people sign in here, and who has; the CSRF token is sent with what changes something.

    `provider` is the OpenID Connect provider where people may sign in, for a page where nobody has.
    """

    hasAccounts: bool
    user: SignedInUser | None
    csrf: str | None
    provider: str | None


class SignedOut(TypedDict):
    """Where the browser signs out at the provider, or null."""

    location: str | None


def add_sessions(app: FastAPI, guard: PageGuard) -> None:
    """Add the routes."""

    @app.get("/api/session", tags=["session"])
    async def session(request: Request) -> SessionView:
        """Return who is signed in."""
        return await _view(guard, dict(request.scope["headers"]), request)

    @app.post("/api/session", tags=["session"])
    async def sign_in(body: SignInRequest, request: Request, response: Response) -> SessionView:
        """Sign in: 401 for a wrong name or password, 429 after too many attempts."""
        content = {"name": body.name, "password": body.password, **place(request)}
        return await _begin(guard, request, response, await guard.ask_accounts("/sessions", content))

    @app.delete("/api/session", tags=["session"], dependencies=[require_signed_in()])
    async def sign_out(request: Request, response: Response, body: SignOutRequest | None = None) -> SignedOut:
        """Sign out, with the address where the browser then signs out at the provider.

        A station needs the PIN of the person who has joined it, or of an engineer: 403 without, 429 after
        too many attempts.
        """
        token = guard.session_of(dict(request.scope["headers"]))
        location = None
        if token is not None:
            content = {"session": token, "returnTo": f"{own_address(guard, request)}/"}
            if body is not None and body.pin is not None:
                content["pin"] = body.pin
            location = (await guard.ask_accounts("/sign-out", content))["location"]
            guard.forget(token)
        secure = is_secure(guard, request)
        response.delete_cookie(_cookie(guard, request), path="/", secure=secure, httponly=True)
        return {"location": location}

    @app.put("/api/session/password", status_code=204, tags=["session"], dependencies=[require_signed_in()])
    async def change_password(body: PasswordChangeRequest, request: Request) -> None:
        """Change the own password; all other sessions end: 403 for a wrong one, 429 after many attempts."""
        content = {"session": _own_session(guard, request), **body.model_dump(), **place(request)}
        await guard.ask_accounts("/password-changes", content)

    @app.post("/api/session/station", tags=["session"], dependencies=[require_signed_in()])
    async def become_station(body: StationRequest, request: Request, response: Response) -> SessionView:
        """Sign this screen in as a station, in place of the engineer who is signed in."""
        token = _own_session(guard, request)
        content = {"session": token, "station": body.station, **place(request)}
        opened = await guard.ask_accounts("/station-sessions", content)
        guard.forget(token)
        return await _begin(guard, request, response, opened)

    @app.post("/api/session/link", tags=["session"])
    async def preview(body: LinkRequest) -> dict[str, Any]:
        """Return what a one-time link is for."""
        return await guard.ask_accounts("/links/preview", {"link": body.link})

    @app.post("/api/session/link-use", tags=["session"])
    async def use_link(body: LinkUseRequest, request: Request, response: Response) -> SessionView:
        """Use a one-time link, and sign in."""
        content = {"link": body.link, "password": body.password, **place(request)}
        if body.name is not None:
            content["name"] = body.name
        return await _begin(guard, request, response, await guard.ask_accounts("/links/use", content))

    @app.post("/api/session/request", status_code=204, tags=["session"])
    async def ask_for_account(body: AccountRequest, request: Request) -> None:
        """Ask for an account; an admin decides."""
        await guard.ask_accounts("/account-requests", {**body.model_dump(), **place(request)})


def _own_session(guard: PageGuard, request: Request) -> str:
    """Return the session of a request; raise `Problem` 409 if it was authenticated by a token instead."""
    token = guard.session_of(dict(request.scope["headers"]))
    if token is None:
        raise Problem(409, "No session", "this is for people at the page; sign in there first")
    return token


async def _begin(
    guard: PageGuard, request: Request, response: Response, opened: dict[str, Any]
) -> SessionView:
    """Set the cookie of a session that was opened."""
    set_session(guard, request, response, opened)
    access = await guard.access_of(str(opened["session"]))
    return {
        "hasAccounts": True,
        "user": _user(access.caller, is_station=access.is_station),
        "csrf": access.csrf,
        "provider": None,
    }


def set_session(guard: PageGuard, request: Request, response: Response, opened: dict[str, Any]) -> None:
    """Set the cookie of a session that was opened."""
    response.set_cookie(
        _cookie(guard, request),
        str(opened["session"]),
        max_age=int(opened["maxAgeS"]),
        path="/",
        secure=is_secure(guard, request),
        httponly=True,
        samesite="strict",
    )


async def _view(guard: PageGuard, headers: dict[bytes, bytes], request: Request) -> SessionView:
    if not guard.has_accounts():
        caller = await guard.authenticate(request.client.host if request.client else None, headers)
        return {"hasAccounts": False, "user": _user(caller), "csrf": None, "provider": None}
    token = guard.session_of(headers)
    if token is None:
        return await _signed_out(guard)
    try:
        access = await guard.access_of(token)
        access.require_place(request.client.host if request.client else None)
    except Problem as problem:
        if problem.status != 401:
            raise
        return await _signed_out(guard)
    return {
        "hasAccounts": True,
        "user": _user(access.caller, is_station=access.is_station),
        "csrf": access.csrf,
        "provider": None,
    }


async def _signed_out(guard: PageGuard) -> SessionView:
    try:
        provider = (await guard.ask_accounts("/sign-in-options"))["provider"]
    except Problem:  # without accounts the page is shown, and says so when somebody signs in
        provider = None
    return {"hasAccounts": True, "user": None, "csrf": None, "provider": provider}


def _user(caller: Any, *, is_station: bool = False) -> SignedInUser:
    return {
        "subject": caller.subject,
        "name": caller.name,
        "person": caller.person,
        "permissions": [permission for permission in Permission if caller.may_somewhere(permission)],
        "isLocal": caller.kind is CallerKind.LOCAL,
        "isStation": is_station,
    }


def own_address(guard: PageGuard, request: Request) -> str:
    """Return the address of this server as the browser knows it: that of the TLS proxy, or the request's."""
    return (guard.settings.tls_proxy_url or str(request.base_url)).rstrip("/")


def place(request: Request) -> dict[str, str]:
    """Return where a person is: the address and the browser."""
    return {
        "address": request.client.host if request.client else "",
        "device": request.headers.get("user-agent", "")[:300],
    }


def is_secure(guard: PageGuard, request: Request) -> bool:
    """Return whether browsers reach this server over TLS, its own or that of a proxy."""
    return request.url.scheme == "https" or guard.settings.tls_proxy_url is not None


def _cookie(guard: PageGuard, request: Request) -> str:
    """Return the name of the cookie; `__Host-` binds it to this host, and needs TLS."""
    return f"__Host-{guard.cookie_name}" if is_secure(guard, request) else guard.cookie_name
