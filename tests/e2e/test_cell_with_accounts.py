"""A whole cell with accounts: set up while it runs, it works on, for people with grants only."""

from pathlib import Path

import httpx
import pytest

from tests.kit.cell import new_cell
from tests.kit.waiting import wait_for
from webui.tests.integration.test_signing_in import Browser, invited, set_up

pytestmark = pytest.mark.nightly

SERVICES = (
    "context_broker",
    "accounts",
    "task_orchestrator",
    "gesture_controller",
    "trajectory_tool",
    "webui",
)


@pytest.mark.slow
def test_a_process_ends_in_a_cell_with_accounts(tmp_path: Path) -> None:
    with new_cell(tmp_path) as cell:
        cell.start(*SERVICES, within_s=120)
        link = set_up(cell)
        local = Browser(cell)
        wait_for(lambda: local.http.get("/api/task-orchestrator/processes").status_code == 401)
        entities = f"{cell.url('context_broker')}/ngsi-ld/v1/types"
        wait_for(lambda: httpx.get(entities, timeout=120).status_code == 401)
        owner = Browser(cell)
        body = {"link": link, "name": "Olga", "password": "correct horse battery"}
        assert owner.begin("/api/session/link-use", body).status_code == 200
        viewer = invited(cell, owner, "Vera", {"role": "viewer", "resource": "*"})
        start = {"definition": "bin-picking"}
        # Until a service has followed the revocations for the first time, it changes nothing (503).
        wait_for(lambda: viewer.send("POST", "/api/task-orchestrator/processes", start).status_code == 403)
        begun = owner.send("POST", "/api/task-orchestrator/processes", start)
        assert begun.status_code == 201, begun.text
        operator = {"glove": "glove-1"}
        wait_for(lambda: viewer.send("POST", "/api/operator", operator).status_code == 403)
        assert owner.send("POST", "/api/operator", operator).status_code == 201
        path = f"/api/task-orchestrator/processes/{begun.json()['id']}"
        wait_for(lambda: viewer.send("GET", path).json()["status"] == "completed", 240)
        robots = viewer.send("GET", "/api/trajectory-tool/robots").json()
        assert [robot["id"] for robot in robots] == ["ur10-1"]
