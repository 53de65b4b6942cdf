"""The guard of a service: requires permissions of the callers of its routes.

A route without a `Requirement` is a defect; `routes_without_requirement` finds them, and a test fails for
each that is not in the short list of public ones. What a list contains concerns everything, so a list
requires its permission for `*`; a route about one entity requires it for that entity.
"""

import inspect
from collections.abc import Awaitable, Callable, Iterable, Iterator
from typing import Any, Final

from fastapi import Depends, FastAPI
from fastapi.routing import APIRoute, APIWebSocketRoute
from starlette.requests import HTTPConnection
from starlette.routing import BaseRoute, Mount
from starlette.types import Scope

from handover.errors import Problem
from handover.http.api_docs import DOCS_PATHS
from handover.security.audit_trail import AuditedRequest, AuditTrail, current_request
from handover.security.authentication import Guard
from handover.security.caller import Caller, CallerKind
from handover.security.permissions import Permission
from handover.security.resource_patterns import ANY_RESOURCE

__all__ = [
    "Guard",
    "OtherCredential",
    "Requirement",
    "require",
    "require_by_handler",
    "require_by_request",
    "require_signed_in",
    "require_somewhere",
    "token_in_query",
]

PUBLIC_PATHS: Final = frozenset(
    {
        "/healthz",
        "/readyz",
        "/metrics",
        "/context.jsonld",
        "/openapi.json",
        *DOCS_PATHS,
    }
)
"""The routes of every service that ask nothing of their callers."""
_CALLER: Final = "handover.caller"
_REQUIRED: Final = "handover.required"
_ON_GRANTS: Final = "handover.on_grants"

Resources = str | tuple[str, ...]
"""An entity id or `*`, or several of which one suffices."""
ResourceOf = Callable[[HTTPConnection], Resources | Awaitable[Resources]]
PermissionOf = Callable[[HTTPConnection], Permission]


class Requirement:
    """A FastAPI dependency: requires a permission of the caller, and returns the caller.

    `shown` names the resource in the documentation. Without a permission it only requires that the caller is
    authenticated.
    """

    def __init__(
        self,
        permission: Permission | None,
        resource: ResourceOf | None,
        *,
        by_handler: bool,
        shown: str,
        permission_of: PermissionOf | None = None,
    ) -> None:
        self.permission = permission
        self.by_handler = by_handler
        self._permission_of = permission_of
        self._resource = resource
        self._shown = shown

    def __str__(self) -> str:
        """Return what the route asks, for the documentation."""
        return f"`{self.permission}` {self._shown}" if self.permission else f"signed in {self._shown}"

    async def __call__(self, connection: HTTPConnection) -> Caller:
        """Return the caller; raise `Problem` 401 or 403."""
        guard = guard_of(connection)
        caller = await authenticated(connection)
        if self.permission is None:
            return caller
        permission = self.permission if self._permission_of is None else self._permission_of(connection)
        act = self._act(connection, caller, permission)
        if self.by_handler:
            guard.require_somewhere(caller, permission)
            connection.scope[_REQUIRED] = permission, None
        else:
            resources = await self._resources(connection)
            if act is not None:
                act.resource = _used(caller, permission, resources)
            require_any(guard, caller, permission, resources)
            connection.scope[_REQUIRED] = permission, resources
        if connection.scope["type"] == "websocket":
            guard.places.take(caller, permission, connection.scope)
            if act is not None:
                await act.trail.open(act)
        return caller

    def _act(
        self, connection: HTTPConnection, caller: Caller, permission: Permission
    ) -> AuditedRequest | None:
        """Return the act that the audit trail records, if the service has one."""
        act = current_request()
        trail = getattr(connection.app.state, "audit", None)
        if connection.scope["type"] == "websocket" and isinstance(trail, AuditTrail):
            act = AuditedRequest(
                trail, f"WebSocket {connection.scope['route'].path}"[:64], connection.url.path
            )
        if act is not None:
            act.caller, act.permission = caller, permission
        return act

    async def _resources(self, connection: HTTPConnection) -> Resources:
        if self._resource is None:
            return ANY_RESOURCE
        resources = self._resource(connection)
        return await resources if inspect.isawaitable(resources) else resources


def _used(caller: Caller, permission: Permission, resources: Resources) -> str:
    if isinstance(resources, str):
        return resources
    allowed = (resource for resource in resources if caller.may(permission, resource))
    return next(allowed, resources[0] if resources else ANY_RESOURCE)


class OtherCredential:
    """A FastAPI dependency that marks a route whose handler checks another credential than a token.

    The broker sends the key of the subscription, for example (`handover.subscriptions.notifications`).
    """

    def __init__(self, credential: str) -> None:
        self._credential = credential

    def __str__(self) -> str:
        """Return what the route asks, for the documentation."""
        return self._credential

    async def __call__(self) -> None:
        """Do nothing: the handler checks the credential."""


async def token_in_query(connection: HTTPConnection) -> None:
    """A FastAPI dependency before `require`, for clients that can send no header: accepts `?token=TOKEN`.

    Addresses end up in histories and in the logs of proxies, so such a client has a token with few grants.
    """
    token, headers = connection.query_params.get("token"), connection.scope["headers"]
    if token and not any(name == b"authorization" for name, _ in headers):
        bearer = f"Bearer {token}".encode("latin-1", "replace")
        connection.scope["headers"] = [*headers, (b"authorization", bearer)]


def require(permission: Permission, resource: ResourceOf | None = None) -> Any:
    """Return a dependency that requires `permission` for `resource`; without one, for every resource."""
    shown = f"for {resource.__doc__}" if resource is not None else "for every resource"
    return Depends(Requirement(permission, resource, by_handler=False, shown=shown))


def require_by_request(
    permission_of: PermissionOf, resource: ResourceOf, *, least: Permission, shown: str
) -> Any:
    """Return a dependency for a route whose parameters choose the permission that it requires.

    `least` is the permission without parameters, and `shown` the whole rule, for the documentation.
    """
    made = Requirement(least, resource, by_handler=False, shown=shown, permission_of=permission_of)
    return Depends(made)


def require_by_handler(permission: Permission, shown: str = "for what the body names") -> Any:
    """Return a dependency for routes whose resource stands in the body.

    It requires `permission` for any resource; the handler calls `Guard.require` with the resource.
    """
    return Depends(Requirement(permission, None, by_handler=True, shown=shown))


def require_somewhere(permission: Permission) -> Any:
    """Return a dependency for what is the same for all resources: `permission` for any one suffices."""
    return Depends(Requirement(permission, None, by_handler=True, shown="for any resource"))


def require_any(guard: Guard, caller: Caller, permission: Permission, resources: Resources) -> None:
    """Raise `Problem` unless `caller` has `permission` for one of `resources`."""
    if isinstance(resources, str):
        guard.require(caller, permission, resources)
    elif not any(caller.may(permission, resource) for resource in resources):
        guard.require(caller, permission, resources[0] if resources else ANY_RESOURCE)
    else:
        guard.require_current(permission)


def require_signed_in() -> Any:
    """Return a dependency for what every caller may do with what is their own: it requires no permission."""
    return Depends(Requirement(None, None, by_handler=False, shown="of the caller"))


def in_path(kind: str, name: str) -> Callable[[HTTPConnection], str]:
    """Return the resource whose name or id is the path parameter `name`, an entity of type `kind`."""

    def resource(connection: HTTPConnection) -> str:
        return guard_of(connection).settings.entity_id(kind, str(connection.path_params[name]))

    resource.__doc__ = f"{kind} `{{{name}}}`"
    return resource


def guard_of(connection: HTTPConnection) -> Guard:
    """Return the guard of the application that answers `connection`."""
    guard = getattr(connection.app.state, "guard", None)
    if not isinstance(guard, Guard):
        raise TypeError("this application has no guard; give one to create_app")
    return guard


async def authenticated(connection: HTTPConnection) -> Caller:
    """Return the caller of `connection`; raise `Problem` 401. Each request authenticates once."""
    kept = connection.scope.get(_CALLER)
    if isinstance(kept, Caller):
        return kept
    headers = dict(connection.scope["headers"])
    caller = await guard_of(connection).authenticate(_address(connection.scope), headers)
    connection.scope[_CALLER] = caller
    return caller


async def still_allowed(guard: Guard, scope: Scope) -> None:
    """Raise `Problem` if the caller of an open connection may not have it any more.

    A connection whose caller is not authenticated yet, or which asks nothing, is allowed.
    """
    caller = scope.get(_CALLER)
    if not isinstance(caller, Caller):
        return
    before, caller = caller, await guard.renewed(caller, _address(scope), dict(scope["headers"]))
    scope[_CALLER] = caller
    if caller.grants != before.grants and _ON_GRANTS in scope:
        scope[_ON_GRANTS](caller)
    permission, resources = scope.get(_REQUIRED, (None, None))
    if permission is None:
        return
    if caller.kind is not CallerKind.SERVICE:
        guard.require_current(permission)
    if resources is None:
        is_held = caller.may_somewhere(permission)
    else:
        listed = (resources,) if isinstance(resources, str) else resources
        is_held = any(caller.may(permission, resource) for resource in listed)
    if not is_held:
        raise Problem(403, "Not allowed", f'the permission "{permission}" was removed; ask an admin for it')


def on_new_grants(connection: HTTPConnection, act: Callable[[Caller], None]) -> None:
    """Call `act` with the caller of an open connection when its grants have changed."""
    connection.scope[_ON_GRANTS] = act


def _address(scope: Scope) -> str | None:
    client = scope.get("client")
    return str(client[0]) if client else None


def routes_without_requirement(app: FastAPI, public: Iterable[str] = ()) -> list[str]:
    """Return the routes of `app` that ask nothing of their callers, besides the public ones."""
    paths = PUBLIC_PATHS | frozenset(public)
    return [name for path, name, asked in _walk(app.routes, "") if asked is None and path not in paths]


def requirements(app: FastAPI) -> dict[str, str]:
    """Return what each route of `app` asks of its callers, by method and path, for the documentation."""
    return {
        name: "–" if asked is None else str(asked)
        for path, name, asked in _walk(app.routes, "")
        if path not in PUBLIC_PATHS
    }


def _walk(
    routes: Iterable[BaseRoute], prefix: str
) -> Iterator[tuple[str, str, Requirement | OtherCredential | None]]:
    for route in routes:
        path = prefix + getattr(route, "path", "")
        if isinstance(route, Mount):
            yield from _walk(route.routes, path)
        elif isinstance(route, APIRoute):
            yield path, f"{','.join(sorted(route.methods or ()))} {path}", _asked(route)
        elif isinstance(route, APIWebSocketRoute):
            yield path, f"WebSocket {path}", _asked(route)
        else:
            yield path, f"{type(route).__name__} {path}", None


def _asked(route: APIRoute | APIWebSocketRoute) -> Requirement | OtherCredential | None:
    pending = list(route.dependant.dependencies)
    while pending:
        dependency = pending.pop()
        if isinstance(dependency.call, Requirement | OtherCredential):
            return dependency.call
        pending.extend(dependency.dependencies)
    return None
