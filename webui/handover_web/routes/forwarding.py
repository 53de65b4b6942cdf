"""What goes through to the services, and the files of the page."""

from fastapi import FastAPI, Request, Response

from handover.errors import Problem
from handover.http.body_limit import max_body
from handover.security.guard import require_signed_in
from handover.service_addresses import BROKER
from handover.serving.service import ANY_TYPE, accepts, method_not_allowed, methods_of
from handover_web.http.other_broker import OtherBroker
from handover_web.http.page_files import PageFiles
from handover_web.http.proxy import METHODS, ServiceProxy

MAX_PROXIED_BODY_BYTES = 4 * 1024 * 1024


def add_forwarding(app: FastAPI, proxy: ServiceProxy, other_broker: OtherBroker) -> None:
    """Forward what has no route of its own; add it after those that have."""
    methods = list(METHODS)
    signed_in = [require_signed_in()]  # the service itself requires the permission

    @app.api_route(
        "/api/{service}/{path:path}", methods=methods, include_in_schema=False, dependencies=signed_in
    )
    @accepts(*ANY_TYPE)  # the service itself decides, and may accept less
    @max_body(MAX_PROXIED_BODY_BYTES)
    async def forward(service: str, path: str, request: Request) -> Response:  # noqa: ARG001
        if not proxy.serves(service):
            _require_other_path(request)
        encoded = _encoded_path(request, service)
        answer = await other_broker.answer(encoded, request) if service == BROKER else None
        return await proxy.forward(service, encoded, request) if answer is None else answer

    @app.api_route("/api/{rest:path}", methods=methods, include_in_schema=False, dependencies=signed_in)
    @accepts(*ANY_TYPE)
    async def not_found(rest: str, request: Request) -> Response:
        _require_other_path(request)
        raise Problem(404, "Not found", f"there is no route /api/{rest}")


def add_page(app: FastAPI, files: PageFiles) -> None:
    """Answer every other path with the page; add it last."""

    @app.api_route("/{address:path}", methods=["GET", "HEAD"], include_in_schema=False)
    async def page(address: str, request: Request) -> Response:
        return await files.respond(address, request.headers)


def _require_other_path(request: Request) -> None:
    """Raise `Problem` 405 at the path of a route of this server, which has other methods."""
    if request.method not in methods_of(request):
        raise method_not_allowed(request)


def _encoded_path(request: Request, service: str) -> str:
    """Return the path within the service, still percent-encoded: an encoded slash separates nothing."""
    raw = bytes(request.scope.get("raw_path") or request.scope["path"].encode())
    return raw.partition(b"?")[0].decode("latin-1").removeprefix(f"/api/{service}/")
