"""Every process has a name for people, and its number is never used twice."""

from pathlib import Path

import pytest

from services.task_orchestrator.tests.integration.rest import XML, service, settings_in
from services.task_orchestrator.tests.unit.drawing import ONE_STEP, drawing

TITLED = (
    '<bpmn:extensionElements><handover:process title="Order ${order.number}"/></bpmn:extensionElements>'
    f"{ONE_STEP}"
)


@pytest.mark.nightly
async def test_processes_are_numbered_by_definition_across_restarts_deletions_and_versions(
    tmp_path: Path,
) -> None:
    settings = settings_in(tmp_path)
    named = drawing(ONE_STEP).replace(b'id="p"', b'id="p" name="Fill"')
    async with service(settings) as api:
        await api.post("/definitions", content=named, headers=XML)
        await api.post("/definitions", content=drawing(ONE_STEP, name="q"), headers=XML)
        first, keyed, other, third = [
            (await api.post("/processes", json=body)).json()
            for body in (
                {"definition": "p"},
                {"definition": "p", "key": "order 7"},
                {"definition": "q"},
                {"definition": "p", "key": "m5y1zabc-1a2b3c4d"},
            )
        ]
        assert [each["number"] for each in (first, keyed, other, third)] == [1, 2, 1, 3]
        assert [each["name"] for each in (first, keyed, other, third)] == [
            *("Fill 1", "Fill · order 7", "q 1", "Fill 3")
        ]
        refused = await api.post("/processes", json={"definition": "p", "parameters": {"1": 1}})
        assert refused.status_code == 422
        assert third["id"] in [each["id"] for each in (await api.get("/processes?search=3")).json()]
    async with service(settings) as api:
        await api.post("/definitions", content=named.replace(b"Fill", b"Fill up"), headers=XML)
        later = (await api.post("/processes", json={"definition": "p"})).json()
        assert (later["name"], later["version"]) == ("Fill up 4", 2)


async def test_the_title_of_the_definition_names_its_processes(tmp_path: Path) -> None:
    async with service(settings_in(tmp_path)) as api:
        await api.post("/definitions", content=drawing(TITLED), headers=XML)
        order = {"order": {"number": 12}}
        started = await api.post("/processes", json={"definition": "p", "parameters": order, "key": "k"})
        assert started.json()["name"] == "Order 12"
        later = (await api.post("/processes", json={"definition": "p"})).json()
        assert (later["name"], later["incidents"]) == ("p 2", [])
        given = {"by": "Olga", "variables": {"order": {"number": 13}}}
        changed = await api.post(f"/processes/{later['id']}/variables", json=given)
        assert changed.json()["name"] == "Order 13"
        given["variables"] = {"order": {"number": 14}}
        again = await api.post(f"/processes/{later['id']}/variables", json=given)
        assert again.json()["name"] == "Order 13"  # a name stays
        assert [each["name"] for each in (await api.get("/processes?search=order%201")).json()] == [
            *("Order 13", "Order 12")
        ]
        constant = TITLED.replace("${order.number}", "of ours")
        refused = await api.post("/definitions", content=drawing(constant), headers=XML)
        assert refused.status_code == 422
        assert "would name every process the same; write an expression" in refused.text
