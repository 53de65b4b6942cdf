"""A broker of others gets its own credentials and none of ours; people change Tasks by rights of the cell."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest

from tests.kit.cell import Cell, new_cell
from tests.kit.other_broker.running import orion_like
from tests.kit.refusing_proxy import RefusingProxy, refusing_proxy
from tests.kit.waiting import wait_for
from webui.tests.integration.conftest import Viewer
from webui.tests.integration.test_signing_in import Browser, invited, set_up

pytestmark = pytest.mark.slow

PASSWORD = "correct horse battery"
TASK = "urn:ngsi-ld:Task:demo:1"


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[Cell]:
    folder = tmp_path / "cell"
    folder.mkdir()
    with new_cell(folder) as made:
        yield made


@pytest.fixture
def proxy(cell: Cell, tmp_path: Path) -> Iterator[RefusingProxy]:
    """A proxy before a broker that speaks as Orion-LD, which the cell uses."""
    with orion_like(cell.environment, tmp_path) as orion, refusing_proxy(orion) as made:
        cell.extra["HANDOVER_BROKER_URL"] = made.url
        cell.extra["HANDOVER_CONTEXT_URL"] = f"{cell.url('task_orchestrator')}/context.jsonld"
        yield made


def detail_of(cell: Cell, service: str) -> str:
    try:
        return httpx.get(f"{cell.url(service)}/readyz", timeout=120, trust_env=False).text
    except httpx.TransportError:
        return ""


@pytest.mark.nightly
def test_no_credentials_of_ours_reach_it_and_people_have_their_rights(
    cell: Cell, proxy: RefusingProxy
) -> None:
    cell.start("accounts", "task_orchestrator", "gesture_controller", "alert_router", "webui", within_s=120)
    owner = Browser(cell)
    link = set_up(cell)
    wait_for(lambda: owner.http.get("/api/accounts/users").status_code == 401)
    used = owner.begin("/api/session/link-use", {"link": link, "name": "Olga", "password": PASSWORD})
    assert used.status_code == 200, used.text
    viewer = invited(cell, owner, "Anna", {"role": "viewer", "resource": "*"})

    task = {
        "id": TASK,
        "type": "Task",
        "status": {"type": "Property", "value": "paused"},
    }
    context = f'<{cell.extra["HANDOVER_CONTEXT_URL"]}>; rel="http://www.w3.org/ns/json-ld#context"'
    headers = {"Link": f'{context}; type="application/ld+json"'}
    made = httpx.post(f"{proxy.target}/ngsi-ld/v1/entities", json=task, headers=headers, timeout=120)
    assert made.status_code == 201, made.text
    path = f"/api/context-broker/ngsi-ld/v1/entities/{TASK}/attrs"
    wish = {"requestedStatus": {"type": "Property", "value": "inProgress"}}

    refused = viewer.send("POST", path, wish)
    assert refused.status_code == 403, refused.text
    assert owner.send("POST", path, wish).status_code == 204
    there = httpx.get(f"{proxy.target}/ngsi-ld/v1/entities/{TASK}", headers=headers, timeout=120)
    assert there.json()["requestedStatus"]["value"] == "inProgress"
    for method, other in (("GET", "entities?type=Task"), ("DELETE", f"entities/{TASK}")):
        answer = owner.send(method, f"/api/context-broker/ngsi-ld/v1/{other}")
        assert (answer.status_code, answer.json()["title"]) == (403, "Not through this server")

    starts = "/api/task-orchestrator/processes", {"definition": "bin-picking"}
    wait_for(lambda: owner.send("POST", *starts).status_code == 201)  # services follow accounts by then
    wait_for(lambda: any("entityOperations" in at or "entities" in at for at, _ in proxy.accepted))
    assert proxy.tokens == set()


@pytest.mark.nightly
def test_it_gets_the_token_that_it_wants_and_says_what_to_set(
    cell: Cell, proxy: RefusingProxy, tmp_path: Path
) -> None:
    proxy.token = "a-token-of-the-site"
    cell.spawn("task_orchestrator")
    wait_for(
        lambda: "wants credentials: set HANDOVER_BROKER_TOKEN_FILE" in detail_of(cell, "task_orchestrator")
    )
    cell.kill("task_orchestrator")

    file = tmp_path / "token"
    cell.extra["HANDOVER_BROKER_TOKEN_FILE"] = str(file)
    cell.spawn("task_orchestrator")
    wait_for(lambda: f"HANDOVER_BROKER_TOKEN_FILE is {file}" in detail_of(cell, "task_orchestrator"))
    file.write_text("a-token-of-the-site\n")
    cell.wait_ready("task_orchestrator", 120)


@pytest.mark.nightly
def test_the_page_says_what_it_cannot_do_that_its_clock_is_wrong_and_that_it_is_away(
    cell: Cell, proxy: RefusingProxy, look: Callable[[], Viewer]
) -> None:
    cell.start("task_orchestrator", "webui", within_s=120)
    viewer = look()

    def is_so(state: str, said: str) -> bool:
        row = viewer.service("context-broker")
        return row["state"] == state and re.search(said, row["detail"] or "") is not None

    viewer.read_until(lambda: is_so("up", r"^Orion-LD 1\.6\.0; not there: history, .*doctor"), 120)
    proxy.ahead_s = -12 * 3600
    viewer.read_until(lambda: is_so("degraded", r"its clock is 4\d{4} s behind ours"), 120)
    proxy.ahead_s = 0.0
    viewer.read_until(lambda: is_so("up", "not there: history"), 120)
    proxy.token = "a-token-of-the-site"
    viewer.read_until(lambda: is_so("down", "wants credentials: set HANDOVER_BROKER_TOKEN_FILE"), 120)
    proxy.token = None
    viewer.read_until(lambda: is_so("up", "not there: history"), 120)
