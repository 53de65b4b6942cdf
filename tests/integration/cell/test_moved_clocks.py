"""A cell with accounts works on when its wall clock jumps: suspend and resume, NTP, a wrong time zone."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.kit.cell import Cell
from tests.kit.moved_clock import clocked_cell
from tests.kit.waiting import wait_for
from webui.tests.integration.test_signing_in import Browser, set_up

pytestmark = pytest.mark.slow

SERVICES = ("context_broker", "accounts", "gesture_controller", "webui")
HOURS_S = 7200


class Entities:
    """The broker, as a script with a token sees it."""

    def __init__(self, cell: Cell) -> None:
        self._url = f"{cell.url('context_broker')}/ngsi-ld/v1/entities"
        link = f'<{cell.settings.context_url}>; rel="http://www.w3.org/ns/json-ld#context"'
        self.headers = {"Link": f'{link}; type="application/ld+json"'}

    def put_task(self, name: str) -> str:
        glove = {"type": "Relationship", "object": "urn:ngsi-ld:Device:demo:glove-1"}
        task = {
            "id": f"urn:ngsi-ld:Task:demo:{name}",
            "type": "Task",
            "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:confirm"},
            "status": {"type": "Property", "value": "pending", "observedAt": "2026-01-01T12:00:00Z"},
            "involves": {"type": "Property", "value": [glove]},
            "workParameters": {"type": "Property", "value": {"description": "Confirm", "commandId": 3}},
        }
        wait_for(lambda: self._is_created(task), 90, "the broker refuses changes")
        return str(task["id"])

    def _is_created(self, task: dict[str, Any]) -> bool:
        """Create a Task; 503 says that nothing was done, while the broker cannot ask accounts."""
        answer = httpx.post(self._url, json=task, headers=self.headers, timeout=120, trust_env=False)
        assert answer.status_code in {201, 503}, answer.text
        return answer.status_code == 201

    def _read(self, task: str) -> httpx.Response | None:
        """Return the answer of the broker; None while it cannot ask accounts about the token."""
        answer = httpx.get(f"{self._url}/{task}", headers=self.headers, timeout=120, trust_env=False)
        if answer.status_code == 503:
            return None
        assert answer.status_code == 200, answer.text
        return answer

    def of(self, task: str) -> dict[str, Any]:
        """Return the status and the outputs of a Task."""
        answer = wait_for(lambda: self._read(task), 90, "the broker refuses to be read")
        entity: dict[str, Any] = answer.json()
        outputs = entity.get("outputParameters", {}).get("value", {})
        return {"status": entity["status"]["value"], "outcome": outputs.get("outcome"), "outputs": outputs}


@pytest.mark.nightly
@pytest.mark.parametrize("seconds", [HOURS_S, -HOURS_S])
def test_a_task_that_is_done_after_a_jump_of_the_clock_is_completed(tmp_path: Path, seconds: int) -> None:
    with clocked_cell(tmp_path) as (cell, clock), ExitStack() as stack:
        cell.start(*SERVICES, within_s=120)
        local = httpx.Client(base_url=cell.url("gesture_controller"), timeout=120, trust_env=False)
        stack.callback(local.close)
        local.put("/gloves/glove-1", json={"hand": "right"}).raise_for_status()
        entities = Entities(cell)
        link = set_up(cell)
        wait_for(lambda: local.get("/gloves").status_code == 401, 60, "the accounts are not in force")
        owner = Browser(cell)
        stack.callback(owner.http.close)
        body = {"link": link, "name": "Olga", "password": "correct horse battery"}
        assert owner.begin("/api/session/link-use", body).status_code == 200
        script = {"kind": "script", "name": "reader", "grants": [{"role": "engineer", "resource": "*"}]}
        token = owner.send("POST", "/api/accounts/tokens", script).json()["token"]
        entities.headers["Authorization"] = f"Bearer {token}"

        def asked() -> Any:
            """Return the Task that the glove asks for; the page shows its button from then on."""
            view = owner.send("GET", "/api/gesture-controller/gloves/glove-1")
            return view.is_success and (view.json()["task"] or {}).get("id")

        def complete(task: str) -> None:
            """Complete the Task, repeated while the rights are not known: 503 says that nothing was done."""
            url, body = "/api/gesture-controller/gloves/glove-1/complete", {"task": task, "by": "Olga"}
            answers: list[httpx.Response] = []

            def is_done() -> bool:
                answers.append(owner.send("POST", url, body))
                said = [f"{one.status_code} {one.text}" for one in answers]
                assert answers[-1].status_code in {200, 503}, said
                return answers[-1].is_success

            wait_for(is_done, 90, lambda: answers[-1].text)

        for number, moved_s in enumerate((seconds, 0)):
            # In force before the jump: what the services have exchanged and remembered so far.
            wait_for(lambda: owner.send("GET", "/api/gesture-controller/gloves").is_success, 60)
            task = entities.put_task(f"confirm-{number}")
            # `inProgress` is earlier: the controller has accepted the Task, and reads what it asks for.
            wait_for(lambda: asked() == task, 90, "the Task is not asked")  # noqa: B023
            clock.move(moved_s)
            complete(task)
            wait_for(lambda: entities.of(task)["status"] in {"completed", "failed"}, 120, "it hangs")  # noqa: B023
            ended = entities.of(task)
            assert (ended["status"], ended["outcome"]) == ("completed", "ok"), ended
            assert owner.send("GET", "/api/session").json()["user"]["name"] == "Olga", "still signed in"
