"""Both applications on both robots, with nothing different but the name and the gains; and a third one."""

import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from handover.errors import UsageError
from handover_humanoid.behaviours.simulated_throw import SimulatedThrow
from handover_humanoid.behaviours.simulated_walk import SimulatedWalk
from handover_humanoid.behaviours.walking import WalkingController
from handover_humanoid.components.robot import JointCommand, Robot, RobotSensors
from handover_humanoid.cycle.robot_link import Driver, PortRobot
from handover_humanoid.cycle.watchdog import Safety
from handover_humanoid.drivers import DriverContext
from handover_humanoid.model.humanoid import Humanoid
from handover_humanoid.model.kinematics import Array, Kinematics
from handover_humanoid.model.packaged import adapted, packaged_file
from handover_humanoid.model.reading import read_folder
from handover_humanoid.patterns.footsteps import Wish
from handover_humanoid.patterns.intention import (
    ArmState,
    IntentionLimits,
    IntentionReference,
    arm_state,
    hand_place,
)
from handover_humanoid.patterns.throwing import ThrowPlanner
from handover_humanoid.robots import humanoid
from handover_humanoid.simulation.ball import RADIUS_M, build_with_ball
from handover_humanoid.simulation.simulated_robot import SimulatedRobot
from tests.kit.paths import REPOSITORY

ROBOTS = ("coman", "talos")
GUIDE = REPOSITORY / "docs/how-to/connect-a-humanoid.md"
SIDES = ("left", "right")
CONTROL_S = 0.004


@pytest.fixture(scope="module", params=ROBOTS)
def robot(request: pytest.FixtureRequest) -> Humanoid:
    """Return a humanoid, or skip with the reason why its model is not there."""
    try:
        return humanoid(request.param)
    except UsageError as error:
        pytest.skip(str(error))


def blocks(heading: str) -> dict[str, str]:
    """Return the first block of each language of a section of the documentation."""
    section = GUIDE.read_text(encoding="utf-8").split(f"\n## {heading}\n")[1].split("\n## ")[0]
    snippets = re.findall(r"```(\w+)\n(.*?)```", section, re.DOTALL)
    return dict(reversed(snippets))


class Person:
    """Moves both hands of the robot ahead, by kinematics: what intention detection sees of a person."""

    def __init__(self, robot: Humanoid) -> None:
        self._kinematics = Kinematics(robot)
        self._q = self._kinematics.standing("stand")
        self._hands = {f"{side}_arm": robot.end_effectors[f"{side}_hand"] for side in SIDES}
        self._kinematics.update(self._q)
        self._rest = {arm: hand_place(self._kinematics, hand) for arm, hand in self._hands.items()}
        states = {arm: self._state(arm) for arm in self._hands}
        volumes = [np.prod(np.linalg.svd(state.jacobian, compute_uv=False)) for state in states.values()]
        self._reference = IntentionReference(IntentionLimits(0.7 * float(min(volumes))))
        assert not self._reference.update(states, CONTROL_S).is_active

    def _state(self, arm: str) -> ArmState:
        return arm_state(self._kinematics, arm, self._hands[arm], self._rest[arm])

    def pull(self, ahead_m: float) -> None:
        """Move the hands ahead of their rest pose, or as far as the arms go."""
        robot = self._kinematics.humanoid
        for _ in range(300):
            for arm in self._hands:
                state = self._state(arm)
                error = np.array([ahead_m, 0.0, 0.0]) - state.displacement
                step = np.linalg.lstsq(state.jacobian, 0.05 * error, rcond=0.05)[0]
                joints = np.array(robot.indices(arm))
                lower, upper = (
                    np.array([getattr(robot.joints[joint], end) for joint in joints])
                    for end in ("lower", "upper")
                )
                self._q[7 + joints] = np.clip(self._q[7 + joints] + step, lower, upper)
                self._kinematics.update(self._q)

    def velocity(self) -> Array:
        """Return the reference of the centre of mass after one control period."""
        return self._reference.update({arm: self._state(arm) for arm in self._hands}, CONTROL_S).velocity


def test_it_walks_where_a_person_pulls_its_hands_and_stops(robot: Humanoid) -> None:
    controller = WalkingController(robot)
    walk = SimulatedWalk(controller, SimulatedRobot(robot, controller.start))
    person, span_m = Person(robot), 0.6 * controller.start[2]
    start = walk.robot.true_configuration()[0]
    person.pull(span_m)
    record = walk.run(3.5, lambda time_s: Wish(person.velocity() if time_s > 0.2 else np.zeros(2)))
    assert not record.has_fallen
    assert not {state.fault for state in record.states} - {""}
    assert walk.robot.true_configuration()[0] > start + 0.08
    assert record.planned_room_m.min() > 0.0099
    assert record.tracking_rms_m() < 0.02
    still = walk.run(2.4, lambda _: Wish(np.zeros(2)))
    assert not still.has_fallen
    assert still.states[-1].stance.phase == "standing"


def test_it_throws_a_ball_to_where_it_is_asked(robot: Humanoid) -> None:
    kinematics = Kinematics(robot)
    planner = ThrowPlanner(kinematics, kinematics.standing("stand"), robot.grips["right_hand"])
    game = SimulatedThrow(robot, build_with_ball(robot))
    target = np.array([0.8, 0.0, 0.5])
    record = game.throw(planner.plan(target))
    assert np.linalg.norm(record.landed - target) < 0.1
    assert np.linalg.norm(record.landed - record.predicted) < 0.06
    assert game.robot.ball.position[2] < 3 * RADIUS_M
    rotation = game.robot.true_configuration()[3:7]
    assert 2 * np.hypot(rotation[0], rotation[1]) < 0.05, "the robot stands"


def test_the_next_humanoid_is_a_folder_of_thirty_lines_and_walks(tmp_path: Path) -> None:
    """That of the documentation: iCub, whose root link faces backwards, and some links have no inertia."""
    written = blocks("Add a humanoid")
    (tmp_path / "robot.yaml").write_text(written["yaml"])
    (tmp_path / "icub.srdf").write_text(written["xml"])
    assert len(written["yaml"].splitlines()) + len(written["xml"].splitlines()) <= 30
    try:
        icub = read_folder(tmp_path)
    except UsageError as error:
        pytest.skip(str(error))
    controller = WalkingController(icub)
    walk = SimulatedWalk(controller, SimulatedRobot(icub, controller.start))
    record = walk.run(4.0, lambda time_s: Wish(np.array([0.04 if time_s > 0.5 else 0.0, 0.0])))
    assert not record.has_fallen
    assert not {state.fault for state in record.states} - {""}
    assert walk.robot.true_configuration()[0] > controller.start[0] + 0.05, "ahead, as its soles face"


def test_a_driver_of_thirty_lines_moves_the_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """That of the documentation, on a simulated robot as the controller of a manufacturer."""
    model = humanoid("coman")
    simulated = SimulatedRobot(model, Kinematics(model).standing("stand"))

    class Controller:
        def __init__(self, address: str, joints: tuple[str, ...]) -> None:
            assert (address, joints) == ("10.0.0.7", model.joint_names)

        def measure(self, sensors: RobotSensors) -> float:
            simulated.wait()
            simulated.read(sensors)
            return sensors.time_s

        def age_s(self) -> float:
            return 0.001

        def send(self, *parts: Array) -> None:
            command = JointCommand(model)
            kinds = ("positions", "velocities", "torques", "stiffness", "damping")
            for kind, part in zip(kinds, parts, strict=True):
                getattr(command, kind)[:] = part
            simulated.write(command)

    controller = ModuleType("my_robot.controller")
    controller.Controller = Controller  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "my_robot", ModuleType("my_robot"))
    monkeypatch.setitem(sys.modules, "my_robot.controller", controller)
    code, scope = blocks("A driver of your own")["python"], dict[str, Any]()
    assert len([line for line in code.splitlines() if line.strip()]) <= 30
    exec(code, scope)
    robot: Robot = scope["MyRobot"](DriverContext(model, {"address": "10.0.0.7"}))
    driver, command = Driver(robot, tmp_path), JointCommand(model)
    link = PortRobot(model, tmp_path, robot.period_s)
    command.positions[:] = model.pose("hands_forward")
    for _ in range(300):
        link.write(command)
        if driver.cycle() is Safety.FOLLOWING:
            break
    for _ in range(300):
        link.write(command)
        driver.cycle()
    elbow = model.index("LElbj")
    assert simulated.true_configuration()[7 + elbow] == pytest.approx(command.positions[elbow], abs=0.1)
    command.is_led = True
    link.write(command)
    driver.cycle()
    assert "assisted walking is for simulated robots only" in driver.refusal


def test_a_model_of_a_package_that_is_not_there_names_the_extra() -> None:
    with pytest.raises(UsageError, match=r'no-such-data; pip install .* "handover-cell\[talos\]"'):
        packaged_file("no-such-data", "robot.urdf", "talos")


def test_names_that_the_urdf_lacks_are_listed() -> None:
    urdf = '<robot name="r"><link name="base"/></robot>'
    with pytest.raises(UsageError, match=r'no joint "wrist".*\n.*no link "hand"'):
        adapted(urdf, ["wrist"], {"hand": [((0, 0, 0), (0, 0, 1), 0.1)]})
