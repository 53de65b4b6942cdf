"""Statistics and filters over REST, on SQLite and PostgreSQL."""

import csv
import io
from typing import Any

import httpx
import pytest
from lxml import etree

from handover.tasks.event_log import XES
from services.task_orchestrator.tests.integration.cell import Cell, eventually
from services.task_orchestrator.tests.unit.drawing import activity, drawing, end, path, start

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("statistics")]

FILE = drawing(
    start() + activity("scan") + activity("pick") + end() + path("start", "scan", "pick", "end"),
    name="measured",
)


def answer(running: Cell, path_: str, **query: Any) -> httpx.Response:
    response = running.api.get(path_, params=query)
    assert response.status_code == 200, response.text
    return response


@pytest.mark.nightly
@pytest.mark.usefixtures("database_url")
def test_statistics_count_what_has_happened(running: Cell) -> None:
    running.api.post(
        "/definitions", content=FILE, headers={"Content-Type": "application/xml"}
    ).raise_for_status()
    for number in range(3):
        body = {
            "definition": "measured",
            "key": f"order {number}",
            "parameters": {"order": {"total": number}},
        }
        process = running.api.post("/processes", json=body).json()["id"]
        eventually(lambda of=process: running.look(of)["status"] == "completed", f"the end of {process}")

    report = answer(running, "/statistics/elements", definition="measured").json()
    assert (report["processes"]["started"], report["processes"]["completed"]) == (3, 3)
    assert [each["element"] for each in report["elements"]] == ["scan", "pick"]
    for each in report["elements"]:
        assert (each["completed"], each["failed"], each["working"]) == (3, 0, 0)
        assert each["meanMs"] == pytest.approx(
            each["waitingMs"] + each["workingMs"] + each["pausedMs"], abs=2
        )
    (of_definition,) = [
        each for each in answer(running, "/statistics/definitions").json() if each["definition"] == "measured"
    ]
    assert of_definition == report["processes"]
    points = answer(running, "/statistics/throughput", definition="measured").json()["points"]
    assert sum(point["completed"] for point in points) == 3
    assert len(points) in {168, 169}
    worked = answer(running, "/statistics/resources", definition="measured").json()["resources"]
    assert worked[0]["resource"] == "urn:ngsi-ld:Device:demo:glove-1"
    means = sum(each["workingMs"] * 3 for each in report["elements"])
    assert worked[0]["workingMs"] == pytest.approx(means, abs=10)
    assert answer(running, "/statistics/incidents", definition="measured").json() == []

    table = answer(running, "/statistics/elements", definition="measured", format="csv")
    assert "elements.csv" in table.headers["Content-Disposition"]
    rows = list(csv.DictReader(io.StringIO(table.content.decode("utf-8-sig"))))
    assert [(row["element"], row["completed"]) for row in rows] == [("scan", "3"), ("pick", "3")]
    log = etree.fromstring(answer(running, "/event-log", definition="measured", key="order 1").content)
    assert len(log.findall(f"{{{XES}}}trace")) == 1
    transitions = [
        each.get("value") for each in log.findall(f".//{{{XES}}}string[@key='lifecycle:transition']")
    ]
    assert transitions.count("complete") == 2, "a state between may pass unseen"

    page = answer(running, "/processes", variable="order.total>=1", definition="measured", limit=1)
    assert [each["key"] for each in page.json()] == ["order 2"]
    following = running.api.get(page.links["next"]["url"])
    assert [each["key"] for each in following.json()] == ["order 1"]
    assert running.api.get(following.links["next"]["url"]).json() == []


@pytest.mark.parametrize(
    ("path_", "query", "status", "part"),
    [
        ("/statistics/elements", {"definition": "nothing"}, 404, "nothing"),
        ("/statistics/elements", {}, 422, "definition"),
        ("/statistics/definitions", {"since": "2020-01-01T00:00:00Z"}, 422, "366 days"),
        (
            "/statistics/throughput",
            {"since": "2026-01-01T00:00:00Z", "until": "2026-06-01T00:00:00Z", "step": "hour"},
            422,
            "by day",
        ),
        (
            "/statistics/resources",
            {"since": "2026-01-02T00:00:00Z", "until": "2026-01-01T00:00:00Z"},
            422,
            "swap",
        ),
        ("/processes", {"variable": "=3"}, 422, "no condition"),
        ("/processes", {"colour": "red"}, 422, "colour"),
        ("/processes", {"before": "nobody"}, 404, "nobody"),
        ("/event-log", {"limit": 5000}, 422, "limit"),
    ],
)
def test_bad_requests_name_what_is_wrong(
    running: Cell, path_: str, query: dict[str, Any], status: int, part: str
) -> None:
    refused = running.api.get(path_, params=query)
    assert refused.status_code == status
    assert part in refused.text
