"""What has no meaning, met by the running control cycle: the robot stands or holds, and a code says why."""

import math
import re
from collections.abc import Callable
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pytest

from handover.control.speed_limits import Allowed
from handover_humanoid import control_process
from handover_humanoid.behaviours.component_state import PHASES, Behaviour, Fault
from handover_humanoid.behaviours.walking import footsteps_of
from handover_humanoid.components.robot import JointCommand, RobotSensors
from handover_humanoid.cycle.loop import HoldReason, Mode
from handover_humanoid.model.humanoid import Humanoid
from handover_humanoid.model.reading import read_folder
from handover_humanoid.robots import COMAN, humanoid
from handover_humanoid.routes.input_socket import shortfall
from handover_humanoid.running import motion as motion_module
from handover_humanoid.running.humanoid_control import FAULTS, HOLDS
from handover_humanoid.running.inputs import PersonInputs, WishMessage
from handover_humanoid.running.live import LiveDocument
from handover_humanoid.running.motion import Motion
from services.whole_body_control.tests.unit.running_cycle import Cycle

STANDING = {"speed_share": 1.0, "behaviour": float(Behaviour.WALKING)}
WALKING = {**STANDING, "ahead_mps": 0.1}
UPRIGHT_M = 0.4
Change = Callable[[str], str]


@pytest.fixture
def stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, Change], Humanoid]:
    """Makes a model of a stranger, COMAN with one file changed, that of the control process."""

    def model(file: str, change: Change) -> Humanoid:
        changed = copytree(COMAN, tmp_path / "robot") / file
        changed.write_text(change(changed.read_text()))
        changed_model = read_folder(changed.parent)
        monkeypatch.setattr(control_process, "humanoid", lambda _: changed_model)
        return changed_model

    return model


def stretched(srdf: str) -> str:
    """Return the SRDF with every joint at 0 in all poses."""
    return re.sub(r'(<joint name="[^"]*" value=")[^"]*', r"\g<1>0", srdf)


def test_a_robot_with_straight_legs_stands_does_not_walk_and_says_why(
    stranger: Callable[[str, Change], Humanoid], tmp_path: Path
) -> None:
    model = stranger("coman.srdf", stretched)
    assert 'The pose "stand" stretches left_leg and right_leg' in model.notes[-1]
    cycle = Cycle(tmp_path / "ports")
    assert cycle.run(0.5, STANDING)["fault"] == Fault.NONE
    for wish in (WALKING, {**STANDING, "behaviour": float(Behaviour.ASSISTED_WALKING)}):
        state = cycle.run(1.0, wish)
        assert (state["fault"], state["mode"]) == (Fault.STRETCHED, Mode.FOLLOWING)
        assert (state["phase"], state["behaviour"]) == (PHASES.index("standing"), Behaviour.WALKING)
    assert cycle.loop.robot.height_m > UPRIGHT_M


def test_limits_that_contradict_the_contacts_are_relaxed_and_reported(
    stranger: Callable[[str, Change], Humanoid], tmp_path: Path
) -> None:
    """Joints that are too slow for a step: the contacts hold, or the limits of the joints, not both."""
    stranger("coman.urdf", lambda urdf: re.sub('velocity="4"', 'velocity="0.02"', urdf))
    cycle = Cycle(tmp_path / "ports")
    assert cycle.run(0.5, STANDING)["fault"] == Fault.NONE
    for _ in range(30):
        state = cycle.run(0.1, WALKING)
        if state["fault"] == Fault.RELAXED:
            break
    assert state["fault"] == Fault.RELAXED
    assert max(value for name, value in state.items() if name.startswith("slack.")) >= 1e-4
    assert cycle.loop.robot.height_m > UPRIGHT_M


def gyroscope(sensors: RobotSensors) -> None:
    sensors.gyroscope[0] = np.nan


def knee(sensors: RobotSensors) -> None:
    sensors.positions[sensors.positions.argmax()] = np.nan


@pytest.mark.parametrize("mode", ["impedance", "torque"])
@pytest.mark.parametrize("spoiled", [gyroscope, knee])
def test_a_robot_whose_sensor_fails_for_good_holds_its_joints_and_does_not_sink(
    mode: str, spoiled: Callable[[RobotSensors], None], tmp_path: Path
) -> None:
    cycle = Cycle(tmp_path, mode=mode)
    before = cycle.run(1.0, STANDING)
    cycle.spoil(spoiled)
    state = cycle.run(2.0, WALKING)
    assert (state["mode"], state["fault"], state["hold"]) == (Mode.HOLDING, Fault.SENSORS, HoldReason.FAULTS)
    assert state["robot_time_s"] > before["robot_time_s"] + 1.9, "the state is written on"
    assert cycle.loop.robot.true_configuration()[2] == pytest.approx(before["base.z"], abs=0.01)


def test_a_sensor_that_fails_in_a_step_and_returns_lets_the_step_be_finished(tmp_path: Path) -> None:
    cycle = Cycle(tmp_path)
    for _ in range(100):
        if cycle.run(0.02, WALKING)["phase"] == PHASES.index("single"):
            break
    is_lost = True

    def lost(sensors: RobotSensors) -> None:
        if is_lost:
            gyroscope(sensors)

    cycle.spoil(lost)
    assert cycle.run(0.05, WALKING)["fault"] == Fault.SENSORS
    is_lost = False
    state = cycle.run(3.0, STANDING)
    assert (state["mode"], state["fault"]) == (Mode.FOLLOWING, Fault.NONE)
    assert state["phase"] == PHASES.index("standing")
    assert cycle.loop.robot.height_m > UPRIGHT_M


@pytest.mark.parametrize("spoiled", [gyroscope, knee])
def test_a_sensor_that_fails_for_good_in_a_step_lets_it_be_finished_before_the_joints_hold(
    spoiled: Callable[[RobotSensors], None], tmp_path: Path
) -> None:
    """At this moment of a fast step it falls if its joints stop."""
    cycle = Cycle(tmp_path)
    state = cycle.run(2.55, {**STANDING, "ahead_mps": 0.15})
    assert state["phase"] == PHASES.index("single")
    cycle.spoil(spoiled)
    assert cycle.run(0.1, WALKING)["fault"] == Fault.SENSORS
    state = cycle.run(4.0, WALKING)
    assert (state["mode"], state["fault"], state["hold"]) == (Mode.HOLDING, Fault.SENSORS, HoldReason.FAULTS)
    assert state["phase"] == PHASES.index("standing")
    assert cycle.loop.robot.height_m > UPRIGHT_M


def test_velocities_beyond_all_reach_walk_it_as_fast_as_it_can(tmp_path: Path) -> None:
    cycle = Cycle(tmp_path)
    state = cycle.run(2.5, {**STANDING, "ahead_mps": 1e300, "left_mps": -1e300, "yaw_radps": 1e300})
    assert (state["mode"], state["fault"]) == (Mode.FOLLOWING, Fault.NONE)
    assert cycle.loop.robot.height_m > UPRIGHT_M


def test_an_error_of_the_controller_and_a_refused_command_hold_the_joints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cycle = Cycle(tmp_path)
    cycle.run(0.1, STANDING)

    def refuse(_: JointCommand) -> None:
        raise ValueError("no")

    with monkeypatch.context() as patch:
        patch.setattr(cycle.loop.robot, "write", refuse)
        state = cycle.run(0.1, STANDING)
    assert (state["mode"], state["hold"]) == (Mode.HOLDING, HoldReason.REFUSED)
    assert "refused a command" in cycle.loop.fault
    second = Cycle(tmp_path / "second")
    monkeypatch.setattr(second.loop.controller, "_walk", lambda *_: 1 / 0)
    state = second.run(1.0, STANDING)
    assert (state["mode"], state["hold"]) == (Mode.HOLDING, HoldReason.FAILED)
    assert second.loop.robot.height_m > UPRIGHT_M


@pytest.mark.parametrize(
    ("values", "code"),
    [
        *(({"fault": float(fault)}, f"fault{int(fault)}") for fault in Fault if fault),
        *(({"hold": float(hold)}, f"hold{int(hold)}") for hold in HoldReason if hold in HOLDS),
        ({"fault": float(Fault.SENSORS), "hold": float(HoldReason.FAULTS)}, "fault1"),
    ],
)
def test_every_reason_is_shown_with_the_code_of_its_message(values: dict[str, float], code: str) -> None:
    live = LiveDocument("coman-1", [], Motion(), PersonInputs())
    live.shown.faults, live.shown.holds = FAULTS, HOLDS
    shown = live.of(values, None)["fault"]
    assert shown["code"] == code
    assert shown["message"]
    assert shown["messageCode"].startswith("humanoid.")


def test_a_wish_of_which_less_is_walked_is_answered_with_what_is_walked_and_why(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(motion_module, "HOLD_TIMEOUT_S", math.inf)  # a slow machine loses no message
    motion = Motion(footsteps_of(humanoid("coman")))
    motion.limit = Allowed("body", fraction=1.0)

    def answer(ahead: float, yaw: float = 0.0, *, held: bool = True) -> dict[str, Any] | None:
        wish = WishMessage(kind="wish", ahead=ahead, yaw=yaw, held=held)
        motion.walk(wish.ahead, wish.left, wish.yaw, is_held=held)
        return shortfall(motion, wish)

    assert answer(0.2, held=False) is None
    assert answer(0.1) is None
    assert answer(0.2, 0.4) == {
        "kind": "walked",
        "ahead": 0.125,
        "left": 0.0,
        "yaw": 0.25,
        "because": "steps",
    }
    assert answer(0.005) == {"kind": "walked", "ahead": 0.0, "left": 0.0, "yaw": 0.0, "because": "steps"}
    motion.limit = Allowed("body", fraction=0.5)
    assert answer(0.1) == {"kind": "walked", "ahead": 0.05, "left": 0.0, "yaw": 0.0, "because": "limit"}
    motion.stop("Aino", "enough")
    assert answer(0.1) == {"kind": "walked", "ahead": 0.0, "left": 0.0, "yaw": 0.0, "because": "stopped"}
    motion.reset()
    assert (answer(0.1) or {})["because"] == "needsRelease"


def test_relaxed_constraints_are_shown_with_their_slack() -> None:
    live = LiveDocument("coman-1", [], Motion(), PersonInputs())
    state = {"slack.joint limits": 0.25, "slack.contact of l_sole": 0.0, "slack.other": np.nan}
    assert live.of(state, None)["relaxed"] == [{"constraint": "joint limits", "slack": 0.25}]
