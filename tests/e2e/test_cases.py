"""The case studies as processes: from one command, as trials on the page, and without human state."""

import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, expect

from handover_cases.machine import Case
from handover_cell.cases.case import PURPOSES, load_case
from tests.e2e.conftest import OpenPage
from tests.kit.cell import Cell
from tests.kit.waiting import scaled, wait_for

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(900)]

SHORT_S = 20.0
PATIENCE_S = 300.0


def test_one_command_runs_a_case_and_prints_the_figures_of_the_paper_beside_ours(cell: Cell) -> None:
    ended = subprocess.run(
        [sys.executable, "-m", "handover_cell", "case", "wheelchair", "--once", f"--duration={SHORT_S:.0f}"],
        env=cell.environment,
        cwd=cell.data_dir,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=scaled(PATIENCE_S),
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "speed falls although the lean stays" in ended.stdout
    assert "yes (figure 3c)" in ended.stdout
    assert "FAILED" not in ended.stdout


@pytest.fixture
def case(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Case]:
    monkeypatch.setenv("HANDOVER_ASSISTIVE_MACHINES", "")  # a case sets it
    return load_case


@pytest.fixture
def machines(cell: Cell, case: Callable[[str], Case]) -> Cell:
    """All that the cases need, with their simulated people."""
    cell.extra["HANDOVER_ASSISTIVE_MACHINES"] = "wheelchair,bed,bin-picking"
    cell.extra["HANDOVER_HEALTH_STRAIN_WINDOW_S"] = "10"
    cell.start("context_broker", "task_orchestrator", "trajectory_tool", "human_state", within_s=90.0)
    cell.start("assistive_devices", "webui", within_s=90.0)
    with httpx.Client(base_url=cell.url("human_state"), timeout=120, trust_env=False) as rest:
        for name in ("wheelchair", "bed", "bin-picking"):
            add_person(rest, case(name))
    return cell


def add_person(rest: httpx.Client, case: Case) -> None:
    person, ends = case.person, (datetime.now(UTC) + timedelta(days=1)).isoformat()
    rest.put(f"/people/{person}", json=dict(case.person_settings)).raise_for_status()
    consent = {"purposes": PURPOSES, "ends": ends, "givenBy": "a test"}
    rest.put(f"/people/{person}/consent", json=consent).raise_for_status()
    for one in case.sensors:
        sensor = {"person": person, "driver": "simulated", "settings": dict(one.settings)}
        rest.put(f"/sensors/{one.name}", json=sensor).raise_for_status()
    rest.put(f"/people/{person}/robots/{case.robot}").raise_for_status()


def test_trials_pass_on_the_page_and_a_killed_human_state_stops_a_wheelchair(
    machines: Cell,
    open_page: OpenPage,
    keep: Callable[[Page, str], Path],
    accessible: Callable[[Page], None],
) -> None:
    with httpx.Client(base_url=machines.url("assistive_devices"), timeout=120, trust_env=False) as rest:

        def seen(name: str) -> dict[str, Any]:
            answer: dict[str, Any] = rest.get(f"/machines/{name}").raise_for_status().json()
            return answer

        for name in ("bed", "bin-picking"):
            rest.post(f"/machines/{name}/trial", json={"durationS": SHORT_S}).raise_for_status()
        assert rest.post("/machines/bed/trial", json={}).status_code == 409, "one runs already"
        assert rest.post("/machines/boat/stop").status_code == 404
        page = open_page("/care/cases?case=bed")
        for name in ("bed", "bin-picking"):
            wait_for(lambda name=name: not seen(name)["trial"]["isRunning"], PATIENCE_S)  # type: ignore[misc]
            trial = seen(name)["trial"]
            assert trial["passed"], trial
        expect(page.get_by_role("region", name="Trial")).to_contain_text("Passed")
        expect(page.get_by_role("region", name="Vital signs")).to_contain_text("Heart rate")
        keep(page, "cases-bed")
        accessible(page)
        page.close()

        rest.post("/machines/wheelchair/trial", json={}).raise_for_status()
        wait_for(lambda: speed_of(seen("wheelchair")) > 0.8, PATIENCE_S)
        machines.kill("human_state")
        before = seen("wheelchair")["limit"]["fraction"]

        def has_stopped() -> bool:
            now = seen("wheelchair")
            assert now["limit"]["fraction"] <= before + 0.16, "3 s of 5 % a second are left from before"
            return now["limit"]["needsReset"] and not now["isMoving"]

        wait_for(has_stopped, PATIENCE_S)
        rest.post("/machines/wheelchair/stop").raise_for_status()
        assert "a person stopped" in seen("wheelchair")["trial"]["failure"]


def speed_of(machine: dict[str, Any]) -> float:
    return float(next(one["value"] for one in machine["values"] if one["name"] == "speed"))
