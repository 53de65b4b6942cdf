"""`handover robot check`: the motions of a process, performed dry, with an exit code for CI."""

import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from handover.command_line.main import app
from handover_robots.planning import is_available
from handover_robots.robots import ur10
from tests.kit.paths import REPOSITORY

pytestmark = pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")

BIN_PICKING = REPOSITORY / "services/task_orchestrator/handover_processes/processes/bin_picking.bpmn"

PROCESS = """<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL"
  xmlns:handover="urn:handover:bpmn" id="file" targetNamespace="urn:x">
  <bpmn:process id="moves" isExecutable="true">
    <bpmn:startEvent id="start"/>
    <bpmn:sequenceFlow id="a" sourceRef="start" targetRef="first"/>
    <bpmn:serviceTask id="first" name="First move"><bpmn:extensionElements>
      <handover:task definition="moveTo"><handover:involves resource="Device:{robot}"/>
        <handover:parameter name="operation" value="moveTo"/>{parameter}
      </handover:task></bpmn:extensionElements></bpmn:serviceTask>
    <bpmn:sequenceFlow id="b" sourceRef="first" targetRef="end"/>
    <bpmn:endEvent id="end"/>
  </bpmn:process>
</bpmn:definitions>"""


@pytest.fixture
def check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HANDOVER_DATA_DIR", str(tmp_path / "data"))

    def run(process: Path | str, *options: str) -> Any:
        if isinstance(process, str):
            file = tmp_path / "moves.bpmn"
            file.write_text(process)
            process = file
        return CliRunner().invoke(app, ["robot", "check", str(process), *options])

    return run


def moves(target: dict[str, Any], robot: str = "ur10-1") -> str:
    ((name, value),) = target.items()
    written = json.dumps(value).replace('"', "&quot;")
    return PROCESS.format(robot=robot, parameter=f'<handover:parameter name="{name}" value="{written}"/>')


def sequence(*processes: str) -> str:
    """Return the activities of processes as one process, one after the other."""
    tasks = [
        re.search(r"<bpmn:serviceTask.*</bpmn:serviceTask>", process, re.DOTALL)
        .group()
        .replace("first", f"t{number}")  # type: ignore[union-attr]
        for number, process in enumerate(processes)
    ]
    nodes = ["start", *(f"t{number}" for number in range(len(tasks))), "end"]
    flows = "".join(
        f'<bpmn:sequenceFlow id="f{number}" sourceRef="{source}" targetRef="{target}"/>'
        for number, (source, target) in enumerate(pairwise(nodes))
    )
    head = processes[0].partition("<bpmn:sequenceFlow")[0]
    return head + "".join(tasks) + flows + '<bpmn:endEvent id="end"/></bpmn:process></bpmn:definitions>'


def test_the_process_of_the_demo_is_in_order_among_obstacles(check: Any, tmp_path: Path) -> None:
    cell = tmp_path / "cell.yaml"
    scene = ur10.FOLDER / "bin_picking_with_obstacles.yaml"
    cell.write_text(f"robots: {{ur10-1: {{model: ur10}}}}\nscene: {scene}\n")
    done = check(BIN_PICKING, "--cell", str(cell), "--json")
    assert done.exit_code == 0, done.output
    steps = json.loads(done.output)
    assert [step["operation"] for step in steps] == ["home", "scan", "pick", "place", "home"]
    assert all(step["faults"] == [] and step["skipped"] is None for step in steps)
    assert all(step["duration_s"] > 1.0 for step in steps[1:])
    assert all(0.0 < step["nearest"]["distance_m"] < 0.1 for step in steps[1:])
    assert steps[0]["nearest"] is None, "it is at home"
    assert {step["nearest"]["second"] for step in steps[1:]} <= {"upper_arm", "wrist_2", "fixture-1", "bin-1"}
    assert not (tmp_path / "data" / "trajectory_tool").exists()


@pytest.mark.parametrize("driver", ["simulated", "physics"])
@pytest.mark.parametrize("model", ["ur5e", "panda"])
def test_the_process_of_the_demo_is_in_order_in_the_cell_of_each_robot(
    check: Any, tmp_path: Path, model: str, driver: str
) -> None:
    cell = tmp_path / "cell.yaml"
    cell.write_text(f"robots: {{arm-1: {{model: {model}, driver: {driver}}}}}")
    done = check(BIN_PICKING, "--cell", str(cell), "--set", "robot=Device:arm-1", "--json")
    assert done.exit_code == 0, done.output
    steps = json.loads(done.output)
    assert [step["operation"] for step in steps] == ["home", "scan", "pick", "place", "home"]
    assert all(step["faults"] == [] and step["skipped"] is None for step in steps)


def test_a_robot_away_from_the_origin_or_of_another_driver_has_no_scene_of_its_own(
    check: Any, tmp_path: Path
) -> None:
    cell = tmp_path / "cell.yaml"
    for entry in ("base: {position: [1, 0, 0]}", "driver: ur, settings: {host: 192.0.2.1}"):
        cell.write_text(f"robots: {{arm-1: {{model: ur5e, {entry}}}}}")
        done = check(BIN_PICKING, "--cell", str(cell), "--set", "robot=Device:arm-1")
        assert done.exit_code == 1, done.output
        assert 'there is no bin "bin-1"; the cell has none' in done.output


@pytest.mark.parametrize(
    ("target", "fault"),
    [
        ({"joints": [9, 0, 0, 0, 0, 0]}, "shoulder_pan_joint cannot be at 9.000 rad"),
        ({"joints": [1e300, 0, 0, 0, 0, 0]}, "shoulder_pan_joint cannot be at 1e+300 rad"),
        ({"pose": {"position": [3, 0, 0.3]}}, "the wrist would be"),
        ({"named": "lunch"}, 'has no position "lunch"'),
        ({"joints": [0, -1.57, 2.9, 0, 0, 0]}, "touches"),
    ],
)
def test_a_motion_that_cannot_be_done_fails_the_check(check: Any, target: dict[str, Any], fault: str) -> None:
    done = check(moves(target))
    assert done.exit_code == 1, done.output
    assert "FAILED" in done.output
    assert fault in done.output


def test_robots_of_one_cell_are_in_the_way_of_each_other_until_they_have_left(
    check: Any, tmp_path: Path
) -> None:
    cell = tmp_path / "cell.yaml"
    cell.write_text(
        "robots: {left: {model: ur5e}, right: {model: panda, base: {position: [1, 0, 0], yaw_deg: 180}}}"
    )
    middle = {"pose": {"position": [0.47, 0.02, 0.25]}}
    steps = [("left", middle), ("right", middle), ("left", {"named": "home"}), ("right", middle)]
    done = check(sequence(*(moves(target, robot) for robot, target in steps)), "--cell", str(cell), "--json")
    assert done.exit_code == 1, done.output
    report = json.loads(done.output)
    assert [step["robot"] for step in report] == [robot for robot, _ in steps]
    assert [bool(step["faults"]) for step in report] == [False, True, False, False]
    assert "touches left" in str(report[1]["faults"])


def test_the_cycle_time_can_be_limited(check: Any) -> None:
    process = moves({"joints": [0.5, -1.5, 1.5, -1.5, -1.5, 0]})
    assert check(process).exit_code == 0
    slow = check(process, "--max-cycle", "0.1")
    assert slow.exit_code == 1
    assert "(too long)" in slow.output


def test_a_process_without_a_robot_of_the_cell_is_refused(check: Any) -> None:
    done = check(moves({"joints": [0] * 6}, robot="other-1"))
    assert done.exit_code != 0
    assert "no activity of a robot of this cell" in str(done.exception or done.output)
