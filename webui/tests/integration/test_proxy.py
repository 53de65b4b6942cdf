"""The proxy: REST of the services through one address, and errors of unreachable services."""

import json
from http.client import HTTPConnection

import httpx
import pytest

from tests.kit.cell import Cell

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell for all of these tests: what they leave in it is in nobody's way."""
    return shared_cell


@pytest.mark.nightly
def test_responses_of_services_are_forwarded_unchanged(cell: Cell, browser: httpx.Client) -> None:
    cell.run("context_broker", "task_orchestrator", "webui")
    deployed = browser.get("/api/task-orchestrator/definitions/bin-picking/bpmn")
    assert deployed.headers["content-type"] == "application/xml"
    again = browser.post(
        "/api/task-orchestrator/definitions",
        content=deployed.content,
        headers={"Content-Type": "application/xml"},
    )
    assert again.status_code == 200

    changed = deployed.content.replace(b"</", b"<!-- another --></", 1)
    uploaded = browser.post(
        "/api/task-orchestrator/definitions",
        content=(changed[start : start + 1000] for start in range(0, len(changed), 1000)),
        headers={"Content-Type": "application/xml"},
    )
    assert uploaded.status_code == 201, uploaded.text
    assert uploaded.json()["version"] == 2

    bad = browser.post(
        "/api/task-orchestrator/definitions",
        content=b"<no-bpmn/>",
        headers={"Content-Type": "application/xml"},
    )
    assert bad.status_code >= 400
    assert bad.headers["content-type"] == "application/problem+json"
    assert bad.headers["x-content-type-options"] == "nosniff"
    too_large = browser.post(
        "/api/task-orchestrator/definitions",
        content=b" " * 12_000_000,
        headers={"Content-Type": "application/xml"},
    )
    assert 400 <= too_large.status_code < 500

    started = browser.post("/api/task-orchestrator/processes", json={"definition": "bin-picking", "key": "k"})
    assert started.status_code == 201
    assert started.headers["location"].startswith("/api/task-orchestrator/processes/")
    found = browser.get(started.headers["location"]).json()
    assert found["key"] == "k"
    by_urn = browser.get(f"/api/task-orchestrator/processes/{found['entity']}")
    assert by_urn.json()["id"] == found["id"]
    listed = browser.get("/api/task-orchestrator/processes", params={"status": "inProgress", "limit": 1})
    assert [row["id"] for row in listed.json()] == [found["id"]]

    lamp = {"id": "urn:ngsi-ld:Device:demo:lamp/1", "type": "Device"}
    assert browser.post("/api/context-broker/ngsi-ld/v1/entities", json=lamp).status_code == 201
    kept = browser.get("/api/context-broker/ngsi-ld/v1/entities/urn:ngsi-ld:Device:demo:lamp%2F1")
    assert kept.json()["id"] == lamp["id"]


def test_errors_name_the_unreachable_service(cell: Cell, browser: httpx.Client) -> None:
    cell.run("webui")
    for service in ("task_orchestrator", "gesture_controller"):
        if cell.runs(service):
            cell.kill(service)
    for path in ("task-orchestrator/definitions", "gesture-controller/gloves", "trajectory-tool/robots"):
        away = browser.get(f"/api/{path}")
        assert away.status_code == 502
        assert away.headers["content-type"] == "application/problem+json"
        assert path.split("/")[0] in away.json()["detail"]
    for path in ("/api/no-such-service/x", "/api/task-orchestrator", "/api/", "/api/live"):
        missing = browser.get(path)
        assert missing.status_code == 404, path
        assert missing.headers["content-type"] == "application/problem+json"
    assert "gesture-controller" in browser.get("/api/no-such-service/x").json()["detail"]


def test_notifications_are_not_forwarded(cell: Cell, browser: httpx.Client) -> None:
    cell.run("context_broker", "gesture_controller", "webui")
    host, port = browser.base_url.host, browser.base_url.port
    for path, status in (
        ("notifications", 404),
        ("%6eotifications", 404),
        ("notifications/", 404),
        ("./notifications", 400),
        ("%2e/notifications", 400),
        ("x/../notifications", 400),
        ("x/%2E%2e/notifications", 400),
        ("x%2f..%2fnotifications", 400),
        ("/notifications", 400),
        (".%5cnotifications", 400),
        (".\\notifications", 400),
    ):
        asked = HTTPConnection(host, port, timeout=120)  # it sends a path as it is
        headers = {"Content-Type": "application/json"}
        asked.request("POST", f"/api/gesture-controller/{path}", json.dumps({"data": []}), headers)
        assert asked.getresponse().status == status, path
        asked.close()
    assert browser.post("/notifications", json={"data": []}).status_code == 403


@pytest.mark.nightly
def test_requests_of_other_origins_are_rejected(cell: Cell, browser: httpx.Client) -> None:
    cell.run("context_broker", "task_orchestrator", "webui")
    before = browser.get("/api/task-orchestrator/processes").json()
    body = json.dumps({"definition": "bin-picking"})
    refused = browser.post(
        "/api/task-orchestrator/processes",
        content=body,
        headers={"Origin": "http://evil.example", "Content-Type": "text/plain"},
    )
    assert refused.status_code == 403
    assert browser.get("/api/task-orchestrator/processes").json() == before
    rebound = browser.get("/api/task-orchestrator/processes", headers={"Host": "evil.example"})
    assert rebound.status_code == 403


def test_the_page_is_served_at_its_routes(cell: Cell, browser: httpx.Client) -> None:
    cell.run("webui")
    for place in ("/", "/work", "/processes/bin-picking-1"):
        page = browser.get(place)
        assert page.status_code == 200
        assert "<!doctype html>" in page.text
        assert page.headers["cache-control"] == "no-cache"
    assert browser.get("/assets/none-0000.js").status_code == 404
    assert browser.post("/work").status_code == 405
