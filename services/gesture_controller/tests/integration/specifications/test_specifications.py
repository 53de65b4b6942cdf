"""What a Task asks is looked up in the Task, the broker and the specification database, in that order."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from handover.command_line.main import app
from services.gesture_controller.tests.integration.people.test_people import asked, ends
from tests.kit.waiting import until

pytestmark = pytest.mark.slow


@pytest.fixture
def cell(cell: Any, tmp_path: Path) -> Any:
    """A cell with a specification database that is not there yet."""
    cell.extra["HANDOVER_SPECIFICATION_URL"] = f"sqlite:///{tmp_path / 'plans.db'}"
    cell.extra["HANDOVER_SPECIFICATION_TIMEOUT_S"] = "1"
    return cell


@pytest.fixture
def fill(tmp_path: Path) -> Callable[[str], None]:
    """Import definitions as a planner does."""

    def take_in(text: str) -> None:
        (tmp_path / "plans.yaml").write_text(text)
        url = f"sqlite:///{tmp_path / 'plans.db'}"
        said = CliRunner().invoke(
            app, ["specification", "import", str(tmp_path / "plans.yaml"), "--url", url]
        )
        assert said.exit_code == 0, said.output
        assert "definitions written to" in said.output

    return take_in


async def test_task_broker_and_database_are_asked_in_that_order(
    bench: Any, fill: Callable[[str], None], tmp_path: Path
) -> None:
    lost = await bench.put("t0")
    await ends(bench, lost, "failed")
    assert "names neither a gesture nor a commandId" in (await bench.outputs(lost))["reason"]
    fill("confirm: {description: Look into the plan, commandId: 8}")
    first = await bench.put("t1")
    task = await asked(bench, first)
    assert (task["description"], task["gesture"], task["commandId"]) == ("Look into the plan", "Horns", 8)
    bench.press("complete", by="Anna").raise_for_status()
    await bench.broker.create(
        {
            "id": "urn:ngsi-ld:TaskDefinition:demo:confirm",
            "type": "TaskDefinition",
            "name": {"type": "Property", "value": "Confirm"},
            "gesture": {"type": "Property", "value": "Ring straight"},
        }
    )
    second = await bench.put("t2")
    task = await asked(bench, second)
    assert (task["description"], task["gesture"]) == ("Look into the plan", "Ring straight")
    bench.press("complete", by="Anna").raise_for_status()
    third = await bench.put("t3", gesture="Thumbs up", description="Mine")
    assert (await asked(bench, third))["description"] == "Mine"
    bench.press("complete", by="Anna").raise_for_status()
    await ends(bench, third, "completed")


@pytest.mark.nightly
async def test_an_unavailable_database_raises_an_alert_and_recovers(
    bench: Any, fill: Callable[[str], None], tmp_path: Path
) -> None:
    (tmp_path / "plans.db").write_text("this is no database, whatever its name says" * 100)
    lost = await bench.put("t1")
    await ends(bench, lost, "failed")
    reason = (await bench.outputs(lost))["reason"]
    assert "names neither a gesture nor a commandId" in reason
    assert "plans.db" in reason

    async def alerted() -> bool:
        return any(
            one["subCategory"]["value"] == "specificationDatabaseUnavailable" and "validTo" not in one
            for one in await bench.alerts()
        )

    await until(alerted)
    assert bench.screen.get("/specifications").json()["state"] == "away"
    second = await bench.put("t2", commandId=3)
    assert (await asked(bench, second))["description"] == "confirm"
    bench.press("complete", by="Anna").raise_for_status()
    (tmp_path / "plans.db").unlink()
    fill("confirm: {description: Look into the plan, gesture: Horns}")
    third = await bench.put("t3")
    assert (await asked(bench, third))["gesture"] == "Horns"

    async def over() -> bool:
        return not await alerted()

    await until(over)
    assert bench.screen.get("/specifications").json()["state"] == "ok"
