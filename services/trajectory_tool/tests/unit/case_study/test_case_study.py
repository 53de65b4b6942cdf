"""The case study of shared control: trials by seed, and the table that compares them."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handover_robots.case_study import report, study
from handover_robots.case_study.operators import DELAY_S, DeadManControl, Supervisor, View
from handover_robots.case_study.trial import Mode, Outcome
from handover_robots.control.recording import COLUMNS
from handover_robots.model.poses import NO_TURN, Frame


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize("mode", [Mode.AUTONOMOUS, Mode.SHARED])
def test_a_trial_is_determined_by_its_seed_and_recorded(mode: Mode, tmp_path: Path) -> None:
    first = study.perform("cube", mode, 1, tmp_path)
    again = study.perform("cube", mode, 1)
    assert replace(first, cpu_s=0) == replace(again, cpu_s=0)
    assert first.is_success
    assert 5 < first.time_s < 60
    (recording,) = tmp_path.rglob("*.csv")
    rows = np.genfromtxt(recording, delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert set(COLUMNS) <= set(rows.dtype.names or ())
    velocity = (1 - rows["mix"]) * rows["gamma"] * rows["human_z"] + rows["mix"] * rows["robot_z"]
    assert velocity == pytest.approx(rows["blended_z"], abs=1e-3), "equation 1 holds in each cycle"


def outcome(thing: str, mode: Mode, *, is_success: bool) -> Outcome:
    return Outcome(thing, mode, 1, is_success, 10.0, 1, "released", "", None, 0.5)


def test_the_table_has_the_paper_beside_what_was_measured(tmp_path: Path) -> None:
    outcomes = [
        outcome("apple", Mode.AUTONOMOUS, is_success=True),
        outcome("apple", Mode.AUTONOMOUS, is_success=False),
        outcome("jacket", Mode.SHARED, is_success=True),
    ]
    table = report.text(outcomes)
    apple = next(line for line in table.splitlines() if line.startswith("apple"))
    assert apple.split("|")[0].split() == ["apple", "18.0", "s", "80.0%", "28.0", "s", "100.0%"]
    assert "10.0 s  50%" in apple
    assert "77.5%" in table
    assert "92.5%" in table
    report.write(outcomes, tmp_path)
    with (tmp_path / "trials.csv").open(encoding="utf-8") as file:
        assert [row["thing"] for row in csv.DictReader(file)] == ["apple", "apple", "jacket"]
    written = json.loads((tmp_path / "results.json").read_text())
    assert written["measured"]["autonomous"]["apple"] == {"trials": 2, "success": 0.5, "meanTimeS": 10.0}


def view(**attributes: object) -> View:
    shown = {"goal_distance_m": None, "holds": None, "needs_release": False, **attributes}
    return View(Frame(NO_TURN, (0.0, 0.0, 0.0)), **shown)  # type: ignore[arg-type]


def test_the_supervisor_closes_at_the_goal_and_ends_without_a_part() -> None:
    operator = Supervisor()
    assert operator.next(view(), 0.0) == {"held": False}
    assert operator.next(view(goal_distance_m=0.2), 1.0) == {"held": True, "mix": 1.0}
    assert operator.next(view(goal_distance_m=0.0005), 2.0)["gripper"] == "close"
    operator.acted(view(), 3.0)
    assert operator.outcome == "nothing gripped"


def test_an_operator_releases_the_control_a_while_after_a_stop() -> None:
    control = DeadManControl()
    assert control.is_released(view(), 0.0)
    assert not control.is_released(view(), 1.0)
    assert not control.is_released(view(needs_release=True), 2.0)
    assert control.is_released(view(needs_release=True), 2.1 + DELAY_S)
    assert not control.is_released(view(), 3.0)
