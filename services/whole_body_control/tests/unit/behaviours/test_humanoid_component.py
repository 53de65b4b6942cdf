"""In one control cycle the humanoid walks, throws balls, and is led by the hands of a person."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from handover_humanoid.behaviours.component_state import PHASES, BallPhase, Behaviour, Fault
from handover_humanoid.behaviours.humanoid_component import HumanoidComponent
from handover_humanoid.components.robot import JointCommand, RobotSensors
from handover_humanoid.cycle.loop import Mode
from handover_humanoid.cycle.wish import WISH
from handover_humanoid.model.kinematics import Kinematics
from handover_humanoid.patterns.regions import SIDES, Footprint, Side
from handover_humanoid.patterns.throwing import PlannedThrow, ThrowPlanner
from handover_humanoid.robots import humanoid
from handover_humanoid.simulation.simulated_robot import SimulatedRobot
from services.whole_body_control.tests.unit.running_cycle import Cycle

COMAN = humanoid("coman")
TARGET = np.array([0.8, 0.1, 0.5])


@pytest.fixture(scope="module")
def cycle(tmp_path_factory: pytest.TempPathFactory) -> Cycle:
    return Cycle(tmp_path_factory.mktemp("ports"))


@pytest.fixture(scope="module")
def throw() -> PlannedThrow:
    model = humanoid("coman")
    kinematics = Kinematics(model)
    return ThrowPlanner(kinematics, kinematics.standing("stand"), model.grips["right_hand"]).plan(TARGET)


WALKING = {"speed_share": 1.0, "behaviour": float(Behaviour.WALKING)}
JUGGLING = {"speed_share": 1.0, "behaviour": float(Behaviour.JUGGLING)}
ASSISTED = {"speed_share": 1.0, "behaviour": float(Behaviour.ASSISTED_WALKING)}


def thrown(number: int, throw: PlannedThrow) -> dict[str, float]:
    wish = {**JUGGLING, "throw_number": float(number), "hand": 1.0}
    wish |= {f"target_{axis}_m": value for axis, value in zip("xyz", TARGET.tolist(), strict=True)}
    wish |= {"flight_s": throw.flight_s, "swing_s": throw.swing_s, "follow_s": throw.follow_s}
    wish |= {f"release_{index}_rad": float(value) for index, value in enumerate(throw.release)}
    return wish | {f"velocity_{index}_radps": float(value) for index, value in enumerate(throw.velocity)}


def on_feet(state: Mapping[str, float], name: str) -> tuple[float, float]:
    """Return a place of the ground in the frame between the soles."""
    x, y = state[f"{name}.x"] - state["feet.x"], state[f"{name}.y"] - state["feet.y"]
    cosine, sine = np.cos(state["feet.yaw"]), np.sin(state["feet.yaw"])
    return float(cosine * x + sine * y), float(cosine * y - sine * x)


def test_it_walks_then_throws_from_where_it_stands_then_walks_again(
    cycle: Cycle, throw: PlannedThrow
) -> None:
    walked = cycle.run(3.0, {**WALKING, "ahead_mps": 0.1, "yaw_radps": 0.15})
    while_walking = cycle.run(0.1, JUGGLING)
    assert while_walking["behaviour"] == Behaviour.WALKING  # never while it takes a step
    stands = cycle.run(4.0, WALKING)
    assert stands["base.x"] > 0.1 < walked["base.x"]
    assert abs(stands["feet.yaw"]) > 0.1
    before = cycle.run(0.5, JUGGLING)
    assert before["behaviour"] == Behaviour.JUGGLING
    landed = cycle.run(4.5, thrown(1, throw))
    assert (landed["ball_phase"], landed["throw_number"]) == (BallPhase.LANDED, 1)
    x, y = on_feet(
        {**landed, **{name: before[name] for name in ("feet.x", "feet.y", "feet.yaw")}}, "ball_landed"
    )
    assert np.hypot(x - TARGET[0], y - TARGET[1]) < 0.2  # nothing was practised
    again = cycle.run(0.5, thrown(1, throw))
    assert again["throw_phase"] == 0  # the same number is the same throw
    walked = cycle.run(4.0, {**WALKING, "ahead_mps": 0.1})
    assert (walked["mode"], walked["behaviour"]) == (Mode.FOLLOWING, Behaviour.WALKING)
    assert walked["com.x"] > landed["com.x"] + 0.1
    assert cycle.run(4.0, WALKING)["phase"] == 0


def test_a_foot_lands_where_the_state_says(cycle: Cycle) -> None:
    model, walk = Kinematics(COMAN), {**WALKING, "ahead_mps": 0.08, "yaw_radps": 0.12}
    planned: dict[Side, np.ndarray] = {}
    landed: dict[Side, np.ndarray] = {}
    swings: set[Side] = set()
    for _ in range(60):
        state = cycle.run(0.05, walk)
        if state["phase"] == PHASES.index("single"):
            swing: Side = "left" if state["support_left"] < state["support_right"] else "right"
            if state[f"support_{swing}"] < 0.05:
                swings.add(swing)
                planned[swing] = np.array([state[f"{swing}_landing.{axis}"] for axis in ("x", "y", "yaw")])
        for side in SIDES:
            if side in swings and state[f"support_{side}"] > 0.5:
                swings.remove(side)
                base = [state[f"base.{axis}"] for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")]
                model.update(np.array([*base, *(state[f"joint.{name}"] for name in COMAN.joint_names)]))
                foot = Footprint.below(side, model.pose(COMAN.contacts[f"{side}_sole"].link))
                landed[side] = np.array([foot.x, foot.y, foot.yaw])
                assert landed[side] == pytest.approx(planned[side], abs=0.03)
    assert set(landed) == set(SIDES)
    stands = cycle.run(4.0, WALKING)
    assert stands["phase"] == PHASES.index("standing")
    assert all(np.isnan(stands[f"{side}_landing.x"]) for side in SIDES)


def test_a_cancelled_throw_is_followed_through_with_the_ball_in_the_hand(
    cycle: Cycle, throw: PlannedThrow
) -> None:
    cycle.run(0.5, JUGGLING)
    begun = cycle.run(0.8, thrown(2, throw))
    assert begun["ball_phase"] == BallPhase.HELD
    ended = cycle.run(4.0, {**thrown(2, throw), "stop": 1.0, "cancel": 1.0})
    assert (ended["ball_phase"], ended["throw_phase"]) == (BallPhase.HELD, 0)
    refused = cycle.run(0.2, thrown(3, throw) | {"release_0_rad": 9.0})
    assert (refused["throw_phase"], refused["fault"]) == (6, Fault.THROW_REFUSED)
    assert cycle.run(1.0, WALKING)["behaviour"] == Behaviour.WALKING


def test_a_ball_that_leaves_the_room_is_lost_and_the_robot_stands(cycle: Cycle, throw: PlannedThrow) -> None:
    cycle.run(0.5, JUGGLING)
    state = cycle.run(0.1, thrown(4, throw))
    for _ in range(40):
        if state["ball_phase"] == BallPhase.FLYING:
            break
        state = cycle.run(0.1, thrown(4, throw))
    assert state["ball_phase"] == BallPhase.FLYING
    cycle.loop.robot.put_ball(np.array([9.0, 0.0, 2.0]), np.zeros(3))
    state = cycle.run(4.0, thrown(4, throw))
    assert (state["ball_phase"], np.isnan(state["ball_landed.x"])) == (BallPhase.LOST, True)
    assert (state["mode"], state["throw_phase"], state["fault"]) == (Mode.FOLLOWING, 0, Fault.NONE)
    begun = cycle.run(0.8, thrown(5, throw))
    assert begun["ball_phase"] == BallPhase.HELD  # it throws the next one
    cycle.run(4.0, {**thrown(5, throw), "stop": 1.0, "cancel": 1.0})
    assert cycle.run(1.0, WALKING)["behaviour"] == Behaviour.WALKING


def at_hands(state: Mapping[str, float], rest: Mapping[str, np.ndarray], ahead_m: float) -> dict[str, float]:
    """Return the hands of a person who stands `ahead_m` farther than the rest pose of the arms."""
    x, y = on_feet(state, "base")
    person = {}
    for side, (dx, dy, dz) in rest.items():
        place = (x + dx + ahead_m, y + dy, state["base.z"] + dz)
        person |= {f"{side}.held": 1.0}
        person |= {f"{side}.{axis}_m": float(value) for axis, value in zip("xyz", place, strict=True)}
    return person


@pytest.mark.nightly
def test_hands_lead_it_ahead_and_back_and_a_hard_pull_opens_its_hands(cycle: Cycle) -> None:
    assistance = cycle.loop.controller.assistance
    assert assistance is not None
    state = cycle.run(3.0, ASSISTED)
    for ahead_m in (0.25, -0.15):
        before = state["com.x"]
        for _ in range(25):
            rest = {side: assistance.rest(side) for side in SIDES}
            state = cycle.run(0.2, ASSISTED, at_hands(state, rest, ahead_m))
        assert np.hypot(state["velocity_reference.x"], state["velocity_reference.y"]) > 0.05
        assert (state["com.x"] - before) * ahead_m > 0
        state = cycle.run(4.0, ASSISTED)  # it is let go, and stands
        assert state["phase"] == 0
    pulled = {
        f"{side}.{name}": value for side in SIDES for name, value in (("held", 2.0), ("force_x_n", 6.0))
    }
    assert cycle.run(3.0, ASSISTED, pulled)["phase"] != 0
    state = cycle.run(5.0, WALKING, pulled)  # the end of a session: the person pulls on, and it stands
    assert (state["behaviour"], state["phase"]) == (Behaviour.WALKING, 0)
    state = cycle.run(2.5, ASSISTED)
    hard: dict[str, float] = {}
    for side in ("left", "right"):
        hard |= {f"{side}.held": 2.0, f"{side}.force_x_n": 80.0}
    state = cycle.run(1.0, ASSISTED, hard)
    assert (state["fault"], state["left_hand.force.x"]) == (Fault.PULLED_HARD, 0)
    assert (state["mode"], state["phase"]) == (Mode.FOLLOWING, 0)
    assert cycle.run(0.2, ASSISTED)["fault"] == Fault.NONE


def test_a_robot_that_has_fallen_holds_its_joints_and_says_so(tmp_path: Path) -> None:
    cycle = Cycle(tmp_path)
    cycle.run(0.2, WALKING)
    cycle.loop.robot.push(np.array([40.0, 0.0, 0.0]))
    state = cycle.run(3.0, WALKING)
    assert (state["mode"], state["fault"]) == (Mode.DOWN, Fault.FALLEN)
    assert cycle.loop.fault == "the robot has fallen"


def test_a_robot_without_a_simulated_world_refuses_to_be_led_and_stands() -> None:
    component = HumanoidComponent(COMAN)
    robot = SimulatedRobot(COMAN, component.start)
    sensors, command, state = RobotSensors(COMAN), JointCommand(COMAN), np.zeros(len(component.fields))
    wish = {"behaviour": float(Behaviour.ASSISTED_WALKING), "ahead_mps": 0.1, "speed_share": 1.0}
    for _ in range(60):
        robot.read(sensors)
        component.follow(np.array([wish.get(name, 0.0) for name in WISH]), None)
        assert component.step(sensors, command) == ""
        assert not command.is_led
        for _ in range(5):
            robot.write(command)
            robot.wait()
    component.write_state(state)
    shown = dict(zip(component.fields, state, strict=True))
    assert (shown["behaviour"], shown["phase"]) == (Behaviour.WALKING, 0)
    assert shown["fault"] == Fault.NOT_OFFERED
