"""The acts of people who are signed in have their name, verified; a name that a client gives is not."""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.database import connect
from handover.security.access_tokens import SigningKey, key_set
from handover.security.caller import Caller, CallerKind
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.security.permissions import Grant, Role
from handover.security.revocations import FollowedRevocations
from handover_processes.app import make_app
from handover_processes.storage.store import Store
from services.task_orchestrator.tests.integration.rest import XML, settings_in
from services.task_orchestrator.tests.unit.drawing import ONE_STEP, drawing
from services.task_orchestrator.tests.unit.earlier_tables import take_back

KEY = SigningKey.generate()
ROSA = Caller(CallerKind.USER, "s1", "Rosa", (Grant(Role.ENGINEER),))
GIVEN = {"by": "Somebody else"}


def signed_in(caller: Caller = ROSA) -> dict[str, str]:
    return {"Authorization": f"Bearer {KEY.issue(caller, valid_s=3600)}"}


@pytest.fixture
async def api(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[httpx.AsyncClient]:
    """An orchestrator of a cell with accounts; the revocations are known to it."""
    (tmp_path / "security").mkdir()
    (tmp_path / "security" / PUBLIC_KEYS_FILE).write_bytes(key_set(KEY))
    monkeypatch.setattr(FollowedRevocations, "is_current", lambda _: True)
    app = make_app(settings_in(tmp_path))
    transport = httpx.ASGITransport(app)
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=transport, base_url="http://localhost", headers=signed_in()) as client,
    ):
        yield client


async def started(api: httpx.AsyncClient) -> str:
    deployed = await api.post("/definitions", content=drawing(ONE_STEP), headers=XML)
    assert deployed.is_success, deployed.text
    answer = await api.post("/processes", json={"definition": "p"})
    assert answer.status_code == 201, answer.text
    return str(answer.json()["id"])


async def act(api: httpx.AsyncClient, path: str, **body: Any) -> Any:
    answer = await api.post(path, json={**GIVEN, **body})
    assert answer.is_success, answer.text
    return answer.json()


@pytest.mark.nightly
async def test_each_act_of_a_person_who_is_signed_in_is_verified(api: httpx.AsyncClient) -> None:
    process = await started(api)
    await act(api, f"/processes/{process}/pause")
    await act(api, f"/processes/{process}/resume")
    await act(api, "/pause")
    await act(api, "/resume")
    await act(api, f"/processes/{process}/variables", variables={"a": 1})
    comment = await act(api, f"/processes/{process}/comments", text="It is heavy.")
    mapping = await api.put("/mapping", json={"entries": [], **GIVEN})
    cancelled = await act(api, f"/processes/{process}/cancel")
    assert [one["act"] for one in cancelled["acts"]] == [
        *("pause", "resume", "pause", "resume", "setVariables", "cancel"),
    ]
    shown = [*cancelled["acts"], comment, mapping.json()]
    assert {(one["by"], one["verified"]) for one in shown} == {("Rosa", True)}


async def test_a_name_that_a_service_gives_is_not_verified(api: httpx.AsyncClient) -> None:
    process = await started(api)
    api.headers.update(signed_in(Caller(CallerKind.SERVICE, "s2", "webui", (Grant(Role.SERVICE),))))
    answer = await api.post(f"/processes/{process}/pause", json=GIVEN)
    (shown,) = answer.json()["acts"]
    assert (shown["by"], shown["verified"]) == ("Somebody else", False)


async def test_acts_of_an_earlier_release_stay_unverified(tmp_path: Path) -> None:
    settings = settings_in(tmp_path)
    store = Store(connect(settings.database("orchestrator")))
    store.migrate()
    with store.engine.begin() as connection:
        take_back(connection, 1)
        connection.exec_driver_sql(
            'INSERT INTO orchestrator_task_acts (id, process, task, kind, "by", at, text) '
            "VALUES ('c1', 'p-1', NULL, 'comment', 'Anna', '2026-05-04T08:00:00.000Z', 'Heavy')"
        )
    store.close()
    again = Store(connect(settings.database("orchestrator")))
    again.migrate()
    (comment,) = again.task_acts("p-1")
    assert (comment.by, comment.verified) == ("Anna", False)
    again.close()
