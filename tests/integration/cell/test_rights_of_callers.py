"""No sequence of calls without a grant moves a robot, completes a Task or reads a study.

Each call is answered by the real application of its service, with accounts, and with a token that is valid.
"""

import asyncio
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from handover.database import connect
from handover.extensions import application_of
from handover.security.access_tokens import SigningKey, key_set
from handover.security.caller import Caller, CallerKind
from handover.security.guard import Requirement, _walk
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.security.permissions import Grant, Permission, Role
from handover.services import all_services, service_named
from handover.serving.leadership import OnlyLeading
from handover_humanoid.running.sessions.store import SessionStore
from handover_humanoid.settings import WholeBodySettings
from handover_processes.app import make_app
from services.task_orchestrator.tests.integration.rest import settings_in
from tests.integration.cell.test_rights_of_routes import open_stream
from tests.kit.ports import next_free_port

KEY = SigningKey.generate()
OTHER_ROBOT = "urn:ngsi-ld:Device:demo:ur10-2"
Call = tuple[str, str, str, dict[str, object] | None]
"""Service, method (`STREAM` for a WebSocket), path and body."""

PERSON = {"name": "Anna"}
SESSION = "session-of-anna"
"""A session with the humanoid that is stored before the calls."""
MOVING: Sequence[Call] = (
    ("trajectory-tool", "POST", "/robots/ur10-1/confirm", {}),
    ("trajectory-tool", "POST", "/robots/urn:ngsi-ld:Device:demo:ur10-1/confirm", {}),
    ("trajectory-tool", "POST", "/robots/ur10-1/gripper/free", {}),
    ("trajectory-tool", "POST", "/robots/ur10-1/limits/reset", PERSON),
    ("trajectory-tool", "POST", "/robots/ur10-1/limits/confirm-clear", PERSON),
    ("trajectory-tool", "POST", "/robots/ur10-1/limits/sources/band/remove", {**PERSON, "reason": "x"}),
    ("trajectory-tool", "PUT", "/robots/ur10-1/limits/mode", {**PERSON, "mode": "normal"}),
    ("trajectory-tool", "PUT", "/cell/scene", {"name": "empty"}),
    ("task-orchestrator", "POST", "/processes", {"definition": "bin-picking"}),
    ("task-orchestrator", "POST", "/messages", {"name": "start"}),
    ("task-orchestrator", "POST", "/signals", {"name": "start"}),
    ("task-orchestrator", "POST", "/resume", {"by": "Anna"}),
    ("device-gateway", "POST", "/devices/ur10-1/commands", {"name": "moveTo", "kind": "motion"}),
    ("device-gateway", "DELETE", "/devices/ur10-1/commands/one", {}),
    ("device-gateway", "POST", "/devices/pad-1/control", {"robot": "ur10-1"}),
    ("device-gateway", "DELETE", "/devices/pad-1/control", {"robot": "ur10-1"}),
    ("device-gateway", "POST", "/robots/ur10-1/control/hand-over", {}),
    ("device-gateway", "STREAM", "/robots/ur10-1/control", {}),
    ("trajectory-tool", "STREAM", "/robots/ur10-1/control", {}),
    ("trajectory-tool", "STREAM", "/robots/ur10-1/speed_limits", {}),
    ("trajectory-tool", "STREAM", "/robots/ur10-1/people", {}),
    ("webui", "STREAM", "/api/trajectory-tool/robots/ur10-1/control", {}),
    ("webui", "STREAM", "/api/device-gateway/robots/ur10-1/control", {}),
    ("human-state", "PUT", "/people/anna/robots/ur10-1", {}),
    ("human-state", "DELETE", "/people/anna/robots/ur10-1", {}),
    ("task-orchestrator", "PUT", "/mapping", {"entries": [], "by": "Anna", "version": 0}),
    ("whole-body-control", "POST", "/stop", {}),
    ("whole-body-control", "POST", "/reset", {}),
    ("whole-body-control", "POST", "/restart", {}),
    ("whole-body-control", "POST", "/behaviour", {"name": "juggle"}),
    ("whole-body-control", "POST", "/throws", {}),
    ("whole-body-control", "DELETE", "/limits/band", {}),
    ("whole-body-control", "POST", "/sessions", {"application": "juggle", "person": "anna"}),
    ("whole-body-control", "POST", f"/sessions/{SESSION}/resume", {}),
    ("whole-body-control", "STREAM", "/input", {}),
    ("whole-body-control", "STREAM", "/input?role=patient", {}),
    ("whole-body-control", "STREAM", "/input?role=therapist", {}),
    ("assistive-devices", "POST", "/machines/bed/start", {}),
    ("assistive-devices", "POST", "/machines/bed/stop", {}),
    ("assistive-devices", "POST", "/machines/bed/reset", {}),
    ("assistive-devices", "POST", "/machines/bed/trial", {"durationS": 60}),
)
COMPLETING: Sequence[Call] = (
    ("gesture-controller", "POST", "/gloves/glove-1/complete", {"by": "Anna"}),
    ("gesture-controller", "POST", "/tests", {"glove": "glove-1"}),
)
OF_STUDIES: Sequence[Call] = (
    ("study", "GET", "/sessions", {}),
    ("study", "GET", "/sessions/one", {}),
    ("study", "GET", "/analysis", {}),
    ("study", "GET", "/answers.csv", {}),
    ("study", "GET", "/report.pdf", {}),
    ("study", "POST", "/sessions", {}),
    ("study", "DELETE", "/sessions/one", {}),
    ("gesture-controller", "GET", "/study-conditions", {}),
    ("human-state", "GET", "/people/anna", {}),
    ("human-state", "GET", "/people/anna/history/heartRate", {}),
    ("human-state", "GET", "/people/anna/recordings", {}),
    ("human-state", "GET", "/people/anna/recordings/R-2f6c1d8e90ab4c57/file", {}),
    ("human-state", "GET", "/people/anna/recordings/R-2f6c1d8e90ab4c57/bundle", {}),
    ("human-state", "POST", "/people/anna/recordings", {"label": "x", "startedBy": "Eve"}),
    ("human-state", "DELETE", "/people/anna/recordings/R-2f6c1d8e90ab4c57", {}),
    ("human-state", "STREAM", "/limits", {}),
    ("human-state", "STREAM", "/people/anna/live", {}),
    ("human-state", "STREAM", "/people/anna/values", {}),
    ("webui", "STREAM", "/api/human-state/people/anna/live", {}),
    ("whole-body-control", "GET", f"/sessions/{SESSION}", {}),
    ("whole-body-control", "GET", f"/sessions/{SESSION}/report", {}),
    ("whole-body-control", "GET", "/sessions?person=anna", {}),
    ("whole-body-control", "GET", "/persons/anna/progress", {}),
    ("assistive-devices", "GET", "/machines", {}),
    ("assistive-devices", "GET", "/machines/bed", {}),
    ("assistive-devices", "GET", "/machines/bed/history", {}),
)
EVERYTHING = (*MOVING, *COMPLETING, *OF_STUDIES)

CHECKED_ELSEWHERE = {"context-broker", "task-orchestrator", "accounts"}
"""The broker has `test_access.py`, accounts `test_rights.py`; the orchestrator looks resources up in its
database, so its routes are called where it runs, below."""
WALKED = sorted({one.name for one in all_services()} - CHECKED_ELSEWHERE)

WITHOUT_A_GRANT = st.sampled_from(
    [
        (),
        (Grant(Role.VIEWER),),
        (Grant(Role.ADMIN),),
        (Grant(Role.ENGINEER, OTHER_ROBOT),),
        (Grant(Role.OPERATOR, OTHER_ROBOT), Grant(Role.RESEARCHER, OTHER_ROBOT)),
        (Grant(Role.ENGINEER, "urn:ngsi-ld:Device:demo:ur10-1?"), Grant(Role.VIEWER)),
    ]
)


class Uninterrupted:
    """A stream of revocations that is current and has none."""

    def is_revoked(self, _: Caller) -> bool:
        return False

    def is_current(self) -> bool:
        return True


@pytest.fixture(scope="module")
def apps(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, FastAPI]]:
    folder = tmp_path_factory.mktemp("cell")
    (folder / "security").mkdir()
    (folder / "security" / PUBLIC_KEYS_FILE).write_bytes(key_set(KEY))
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(folder)
        patched.setenv("HANDOVER_DATA_DIR", str(folder))
        patched.setenv("HANDOVER_GLOVE_PORT", str(next_free_port()))
        names = {call[0] for call in EVERYTHING} | set(WALKED)
        made = {name: an_app(name) for name in sorted(names)}
        store_session(WholeBodySettings())
        yield made


def store_session(settings: WholeBodySettings) -> None:
    store = SessionStore(connect(settings.database("whole-body-control")))
    store.prepare()
    session = {"id": SESSION, "person": settings.entity_id("Person", "anna"), "goal": {}, "report": {}}
    store.add(session | {"humanoid": "coman-1", "application": "juggle", "started_at": "2026-01-01T10:00:00"})


def an_app(name: str) -> FastAPI:
    app = application_of(service_named(name))
    assert app is not None
    app.state.guard._revocations = Uninterrupted()
    # A replica that waits answers nothing; what is asked here is the one that leads.
    app.user_middleware = [one for one in app.user_middleware if one.cls is not OnlyLeading]
    return app


async def answered(apps: dict[str, FastAPI], call: Call, grants: Sequence[Grant]) -> int:
    service, method, path, body = call
    token = KEY.issue(Caller(CallerKind.USER, "subject-1", "Eve", tuple(grants)), valid_s=60)
    if method == "STREAM":
        (first,) = await open_stream(apps[service], path, [(b"authorization", f"Bearer {token}".encode())])
        assert first["type"] == "websocket.close", first
        return int(first["code"]) - 4000
    transport = httpx.ASGITransport(apps[service])
    async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
        answer = await client.request(method, path, json=body, headers={"Authorization": f"Bearer {token}"})
    return answer.status_code


@pytest.mark.nightly
@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)  # the applications keep no state of a refused call
@given(grants=WITHOUT_A_GRANT, calls=st.lists(st.sampled_from(EVERYTHING), min_size=1, max_size=12))
def test_no_sequence_of_calls_without_a_grant_has_an_effect(
    apps: dict[str, FastAPI], grants: tuple[Grant, ...], calls: list[Call]
) -> None:
    async def refused() -> list[int]:
        return [await answered(apps, call, grants) for call in calls]

    assert asyncio.run(refused()) == [403] * len(calls)


Route = tuple[str, str, str, Permission | None]
"""Service, method, path and permission; None if the handler looks which one it is."""
DELETE_A_PERSON: Sequence[Route] = (
    ("human-state", "DELETE", "/people/{person}", None),
    ("whole-body-control", "DELETE", "/persons/{person}", None),
)
"""Routes by which persons delete their own data, and those with `managePeople` the data of anybody."""


SEE_WHO_LOOKED: Sequence[Route] = (("human-state", "GET", "/people/{person}/accesses", None),)
"""Routes by which persons see who looked at their data, and those with `readAudit` that of anybody."""


def routes_of(apps: dict[str, FastAPI]) -> list[Route]:
    """Return the routes that ask a permission; those of human state do so unless it is the own person.

    A test of gestures is looked up in the database of a running controller for its glove.
    """
    return [
        (service, "STREAM" if "WebSocket" in name else name.partition(" ")[0].split(",")[0], path, permission)
        for service in WALKED
        for path, name, asked in _walk(apps[service].routes, "")
        if isinstance(asked, Requirement)
        and ((permission := asked.permission) is not None or "{person}" in path)
        and not (service == "gesture-controller" and path.startswith("/tests/{"))
    ]


@pytest.mark.nightly
@pytest.mark.parametrize("role", [None, Role.VIEWER, Role.ADMIN])
async def test_no_route_of_any_service_answers_a_user_whose_roles_lack_its_permission(
    apps: dict[str, FastAPI], role: Role | None
) -> None:
    held = role.permissions if role else frozenset()
    allowed = (
        *(DELETE_A_PERSON if Permission.MANAGE_PEOPLE in held else ()),
        *(SEE_WHO_LOOKED if Permission.READ_AUDIT in held else ()),
    )
    routes = [one for one in routes_of(apps) if one[3] not in held and one not in allowed]
    assert {service for service, *_ in routes} >= set(WALKED) - ({"alert-router"} if role else set())
    grants = (Grant(role),) if role else ()
    for service, method, path, permission in routes:
        for name in ("ur10-1", "urn:ngsi-ld:Task:demo:t1", "%2E%2E"):
            status = await answered(apps, (service, method, re.sub(r"\{[^}]*\}", name, path), None), grants)
            is_refused = status == 403 or (permission is None and status == 422)  # the body is read before
            assert is_refused, (service, method, path, name, status)


@pytest.mark.parametrize(
    "call",
    [call for call in MOVING if call[0] == "trajectory-tool" and call[1] != "STREAM" and "ur10-1" in call[2]],
    ids=lambda call: call[2],
)
async def test_a_grant_for_one_robot_moves_that_robot_and_no_other(
    apps: dict[str, FastAPI], call: Call
) -> None:
    service, method, path, body = call
    grants = [Grant(Role.ENGINEER, OTHER_ROBOT)]
    other = (service, method, path.replace("ur10-1", "ur10-2"), body)
    assert await answered(apps, call, grants) == 403
    assert await answered(apps, other, grants) != 403, "the grant includes this robot"


async def test_a_task_of_a_process_needs_a_grant_for_it(tmp_path: Path) -> None:
    """The orchestrator reads in its database which resources a Task has, so it runs here."""
    (tmp_path / "security").mkdir()
    (tmp_path / "security" / PUBLIC_KEYS_FILE).write_bytes(key_set(KEY))
    app = make_app(settings_in(tmp_path))
    app.state.guard._revocations = Uninterrupted()
    calls = [f"/tasks/one/{act}" for act in ("claim", "complete", "decline", "return")]
    calls += ["/processes/one/cancel", "/processes/one/tokens/1/skip"]
    async with app.router.lifespan_context(app):
        for path in calls:
            call = ("task-orchestrator", "POST", path, {"by": "Anna", "why": "x"})
            assert await answered({"task-orchestrator": app}, call, [Grant(Role.VIEWER)]) == 403
            assert (
                await answered({"task-orchestrator": app}, call, [Grant(Role.OPERATOR, OTHER_ROBOT)]) == 403
            )
