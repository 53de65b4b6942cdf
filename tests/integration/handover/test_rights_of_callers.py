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

from handover.cli.services import application_of, service_named
from handover.security.access_tokens import SigningKey, key_set
from handover.security.caller import Caller, CallerKind
from handover.security.guard import Requirement, _walk
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.security.permissions import Grant, Permission, Role
from services.task_orchestrator.app import make_app
from tests.integration.task_orchestrator.rest import settings_in
from tests.kit.ports import next_free_port

KEY = SigningKey.generate()
OTHER_ROBOT = "urn:ngsi-ld:Device:demo:ur10-2"
Call = tuple[str, str, str, dict[str, object]]
"""Service, method, path and body."""

PERSON = {"name": "Anna"}
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
    ("task-orchestrator", "PUT", "/mapping", {"entries": [], "by": "Anna", "version": 0}),
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
)
EVERYTHING = (*MOVING, *COMPLETING, *OF_STUDIES)

WITH_AN_EFFECT = {
    Permission.MOVE_ROBOTS,
    Permission.PERFORM_TASKS,
    Permission.RUN_PROCESSES,
    Permission.CONDUCT_STUDIES,
    Permission.READ_STUDIES,
}

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
        yield {name: an_app(name) for name in sorted({call[0] for call in EVERYTHING})}


def an_app(name: str) -> FastAPI:
    app = application_of(service_named(name))
    assert app is not None
    app.state.guard._revocations = Uninterrupted()
    return app


async def answered(apps: dict[str, FastAPI], call: Call, grants: Sequence[Grant]) -> int:
    service, method, path, body = call
    token = KEY.issue(Caller(CallerKind.USER, "subject-1", "Eve", tuple(grants)), valid_s=60)
    transport = httpx.ASGITransport(apps[service])
    async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
        answer = await client.request(method, path, json=body, headers={"Authorization": f"Bearer {token}"})
    return answer.status_code


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


def routes_with_an_effect(apps: dict[str, FastAPI]) -> list[tuple[str, str, str]]:
    """Return service, method and path of every route that asks one of these permissions.

    The orchestrator looks the resource up in its database; its routes are called where it runs, below.
    """
    return [
        (service, name.partition(" ")[0].split(",")[0], path)
        for service, app in apps.items()
        if service != "task-orchestrator"
        for path, name, asked in _walk(app.routes, "")
        if isinstance(asked, Requirement) and asked.permission in WITH_AN_EFFECT and "WebSocket" not in name
    ]


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_route_of_any_service_answers_a_user_whose_roles_lack_its_permission(
    apps: dict[str, FastAPI], data: st.DataObject
) -> None:
    routes = routes_with_an_effect(apps)
    assert len(routes) > 20
    assert {service for service, _, _ in routes} == apps.keys() - {"task-orchestrator"}
    chosen = data.draw(st.lists(st.sampled_from(routes), min_size=1, max_size=12))
    grants = data.draw(st.sampled_from([(), (Grant(Role.VIEWER),), (Grant(Role.ADMIN),)]))
    names = st.sampled_from(["ur10-1", "glove-1", "one", "urn:ngsi-ld:Task:demo:t1", "0", "*", "%2E%2E"])
    calls = [
        (service, method, re.sub(r"\{[^}]*\}", lambda _: data.draw(names), path), {})
        for service, method, path in chosen
    ]

    async def refused() -> list[int]:
        return [await answered(apps, call, grants) for call in calls]

    assert asyncio.run(refused()) == [403] * len(calls)


@pytest.mark.parametrize("call", [call for call in MOVING if "ur10-1" in call[2]], ids=lambda call: call[2])
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
