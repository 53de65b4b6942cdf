"""`handover body` against a real process of the service."""

import uuid

import httpx
import pytest
from typer.testing import CliRunner

from handover_body.command_line.body import app
from services.human_state.tests.integration.conftest import HEART_RATE, consent
from tests.kit.cell import Cell

pytest.importorskip("mcap", reason="the extra [human-state] is not installed")
pytestmark = pytest.mark.slow


@pytest.mark.nightly
def test_a_person_is_listed_and_deleted_and_what_is_refused_is_named(shared_cell: Cell) -> None:
    shared_cell.run("context_broker")
    shared_cell.run("human_state")
    name = f"cli-{uuid.uuid4().hex[:8]}"
    with httpx.Client(base_url=shared_cell.url("human_state"), timeout=120, trust_env=False) as rest:
        rest.put(f"/people/{name}", json={"age": 40}).raise_for_status()
        rest.put(f"/people/{name}/consent", json=consent("live", "recording")).raise_for_status()
        sensor = {"person": name, "driver": "simulated", "settings": HEART_RATE}
        rest.put(f"/sensors/{name}", json=sensor).raise_for_status()

    def body(*arguments: str) -> str:
        made = CliRunner().invoke(app, list(arguments), env=shared_cell.environment)
        return made.output if made.exception is None else f"{made.output}{made.exception}"

    listed = body("people")
    assert name in listed
    assert "live, recording" in listed
    assert "simulated" in body("discover", "simulated")
    assert f"handover body record {name}" in body("record", name, "--stop")
    assert "HANDOVER_HEALTH_RECORDING_KEY" in body("record", name)
    assert "mcap, xdf, fhir" in body("export", name, "R-0000000000000000", "--format", "edf")
    assert "deleted" in body("delete", name, "--everything", "--yes")
    assert name not in body("people")
