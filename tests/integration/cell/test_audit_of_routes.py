"""Every route that changes something is recorded before its act, or is one of those that only lower.

The services are those that `handover up` can start; a new one is included without a change here.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import wraps
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.routing import APIRoute
from sqlalchemy import text

import handover.serving.service
from handover.errors import Problem
from handover.extensions import Service, application_of
from handover.security.act_recording import audited, recorded_with_change, way_of
from handover.security.audit_trail import AuditTrail, Way, begin_request
from handover.security.caller import LOCAL_OWNER
from handover.security.permissions import Permission
from handover.services import all_services
from tests.integration.cell.test_rights_of_routes import environment  # noqa: F401 - a fixture

OWN_LOG = {"context-broker", "accounts"}
"""Services whose changes are no routes with a trail: the broker has operations, accounts one transaction."""
WITH_CHANGE = {"task-orchestrator"}
"""Services whose acts are recorded in the transaction of the change, and only there."""
LOWERING: dict[str, set[str]] = {
    "task-orchestrator": {
        "POST /processes/{process_id}/cancel",
        "POST /processes/{process_id}/pause",
        "POST /definitions/{name}/suspend",
        "POST /pause",
    },
    "gesture-controller": {"POST /gloves/{glove}/pause"},
    "trajectory-tool": {
        "DELETE /robots/{robot}/control",
        "PUT /robots/{robot}/limits/mode",
        "PUT /robots/{robot}/limits/safe-speed",
        "PUT /robots/{robot}/limits/stop",
    },
    "device-gateway": {
        "DELETE /devices/{device}/commands/{command}",
        "DELETE /devices/{device}/control",
        "DELETE /robots/{robot}/control",
    },
    "assistive-devices": {"POST /machines/{case}/stop"},
    "whole-body-control": {"POST /stop", "POST /sessions/{session}/pause", "POST /sessions/{session}/end"},
}
"""The routes that are carried out also while they cannot be recorded. Each of them stops, pauses, cancels,
lowers a limit or releases the control; none of them starts a motion."""
SERVICES = [service for service in all_services() if service.name not in OWN_LOG]


@pytest.fixture
def called(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The handlers that were called: each is replaced by one that only notes its name."""
    names: list[str] = []

    def noting(endpoint: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(endpoint)
        async def note(*_: Any, **__: Any) -> None:
            names.append(endpoint.__name__)

        return audited(note)

    monkeypatch.setattr(handover.serving.service, "audited", noting)
    return names


@pytest.fixture(params=SERVICES, ids=lambda service: service.name)
def service(request: pytest.FixtureRequest) -> Service:
    chosen: Service = request.param
    return chosen


@pytest.fixture
def app(service: Service, called: list[str], environment: Path) -> FastAPI:  # noqa: F811
    made = application_of(service)
    assert made is not None
    return made


def changing(app: FastAPI) -> Iterator[tuple[str, APIRoute]]:
    for route in app.routes:
        if isinstance(route, APIRoute) and (methods := route.methods - {"GET", "HEAD"}):
            yield f"{','.join(sorted(methods))} {route.path}", route


@pytest.mark.nightly
async def test_a_route_whose_intent_cannot_be_recorded_is_not_carried_out(
    app: FastAPI, service: Service, called: list[str]
) -> None:
    trail = app.state.audit
    assert isinstance(trail, AuditTrail), f"{service.name} has no audit trail; give one to create_app"
    assert (trail.usual_way is Way.WITH_CHANGE) == (service.name in WITH_CHANGE)
    await trail.read(lambda connection: connection.execute(text(f"DROP TABLE {table(trail)}")))
    routes = dict(changing(app))
    assert routes
    lowering = LOWERING.get(service.name, set())
    assert lowering <= routes.keys(), "a route of this list is none any more"
    for name, route in routes.items():
        act = begin_request(trail, name, route.path)
        act.caller, act.permission = LOCAL_OWNER, Permission.CONFIGURE
        called.clear()
        if is_marked_lowering(route.endpoint):
            assert name in lowering, f"{name} is carried out without a record: add it, if it only lowers"
            continue
        assert name not in lowering, f"{name} must be carried out also without a record: `@lowers()`"
        if trail.usual_way is Way.WITH_CHANGE:
            continue
        with pytest.raises(Problem, match="so the request is refused"):
            await route.endpoint()
        assert called == [], name


@pytest.mark.nightly
async def test_what_only_lowers_is_carried_out_without_a_record(
    app: FastAPI, service: Service, called: list[str]
) -> None:
    trail = app.state.audit
    await trail.read(lambda connection: connection.execute(text(f"DROP TABLE {table(trail)}")))
    for name, route in changing(app):
        if name not in LOWERING.get(service.name, set()):
            continue
        act = begin_request(trail, name, route.path)
        act.caller, act.permission = LOCAL_OWNER, Permission.CONFIGURE
        called.clear()
        if not lowers_always(route.endpoint):
            continue  # by its body: tests of the limits of robots
        await route.endpoint()
        assert called == [route.endpoint.__name__], name
        assert await trail.finish(act, 200) is False
        assert act.way is Way.AFTER


def table(trail: AuditTrail) -> str:
    return f"{trail.service.replace('-', '_')}_audit"


def is_marked_lowering(endpoint: Callable[..., Any]) -> bool:
    return hasattr(endpoint, "is_lowering")


def lowers_always(endpoint: Callable[..., Any]) -> bool:
    try:
        return way_of(endpoint, _Anything(), Way.BEFORE) is Way.AFTER
    except (LookupError, AttributeError, TypeError, Problem):
        return False


class _Anything(Mapping[str, Any]):
    """Parameters that nobody looks at."""

    def __getitem__(self, name: str) -> Any:
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        return iter(())

    def __len__(self) -> int:
        return 0


def test_a_mark_of_a_handler_is_that_of_its_route() -> None:
    @recorded_with_change
    async def endpoint() -> None: ...

    assert way_of(audited(endpoint), {}, Way.BEFORE) is Way.WITH_CHANGE
