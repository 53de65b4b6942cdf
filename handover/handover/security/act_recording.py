"""When the change of a route is recorded: before it, with it, or after it; see `audit_trail`.

@app.post("/robots/{robot}/stop", dependencies=[require(Permission.MOVE_ROBOTS)])
@lowers()
async def stop(robot: str) -> RobotView: ...
"""

import inspect
from collections.abc import Callable, Mapping
from functools import partial, wraps
from typing import Any, Final, TypeVar

import orjson
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from handover.security.audit_trail import RECORDED_HEADER, Way, current_request

Endpoint = TypeVar("Endpoint", bound=Callable[..., Any])
IsLowering = Callable[[Mapping[str, Any]], bool]
"""Returns whether a request only lowers, by the parameters of its handler."""

_WAY: Final = "recorded_way"
_IS_LOWERING: Final = "is_lowering"


def recorded_with_change(endpoint: Endpoint) -> Endpoint:
    """Mark a route whose handler does no more than one transaction that calls `record_request`."""
    setattr(endpoint, _WAY, Way.WITH_CHANGE)
    return endpoint


def lowers(is_lowering: IsLowering = lambda _: True) -> Callable[[Endpoint], Endpoint]:
    """Return a decorator for a route that only lowers, always or for the requests that `is_lowering` names.

    Such a request is carried out also while it cannot be recorded. The others are recorded as usual.
    """

    def marked(endpoint: Endpoint) -> Endpoint:
        setattr(endpoint, _IS_LOWERING, is_lowering)
        return endpoint

    return marked


def way_of(endpoint: Callable[..., Any], parameters: Mapping[str, Any], usual: Way) -> Way:
    """Return when a request with these parameters of its handler is recorded."""
    is_lowering = getattr(endpoint, _IS_LOWERING, None)
    if is_lowering is not None and is_lowering(parameters):
        return Way.AFTER
    way: Way = getattr(endpoint, _WAY, usual)
    return way


def audited(endpoint: Callable[..., Any]) -> Callable[..., Any]:
    """Return a handler that is called once the intent is recorded, where that is the way of the route."""
    is_async = inspect.iscoroutinefunction(endpoint)
    call = endpoint if is_async else partial(run_in_threadpool, endpoint)

    @wraps(endpoint)
    async def act(*args: Any, **parameters: Any) -> Any:
        request = current_request()
        if request is not None:
            request.way = way_of(endpoint, parameters, request.trail.usual_way)
            await request.begin()
        return await call(*args, **parameters)

    return act


def unrecorded(response: Response) -> Response:
    """Return a response that says that the act was carried out and is not recorded yet."""
    document: Any = orjson.loads(response.body) if response.body else {}
    headers = {
        name: value
        for name, value in response.headers.items()
        if name not in {"content-length", "content-type"}
    }
    headers[RECORDED_HEADER] = "false"
    if not isinstance(document, dict):
        return Response(response.body, response.status_code, headers, response.media_type)
    status = 200 if response.status_code == 204 else response.status_code
    content = orjson.dumps({**document, "recorded": False})
    return Response(content, status, headers, media_type="application/json")
