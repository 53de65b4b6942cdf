"""The simulated controller, cycle by cycle, with the program of the driver."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_ur.program import Payload, ProgramParameters, program
from handover_ur.simulator.controller import SimulatedController
from handover_ur.simulator.urscript import Program, ScriptError
from handover_ur.states import (
    ExchangeMode,
    ProgramState,
    RobotMode,
    RuntimeState,
    UrSafetyStatus,
)

HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
WATCHDOG_S = 0.1
PARAMETERS = ProgramParameters(4711, 0.002, WATCHDOG_S, 8.0, 0.03, 1000.0, Payload(1.5, (0.0, 0.0, 0.05)))


class Driver:
    """Writes registers as the driver does, without a network."""

    def __init__(self) -> None:
        self.controller = SimulatedController(HOME)
        self.heartbeat = 0
        self.controller.load_script(program(PARAMETERS))

    def send(self, mode: ExchangeMode, target: tuple[float, ...] = HOME) -> None:
        self.heartbeat += 1
        self.controller.input_ints[24:26] = [self.heartbeat, mode]
        self.controller.input_floats[24:30] = target
        self.controller.written("input_int_register_24")
        self.controller.step()

    def turn(self, rad_s: float, seconds: float) -> float:
        """Turn the base at constant speed; return the last target."""
        begin, goal = self.controller.positions[0], 0.0
        for cycle in range(round(seconds / 0.002)):
            goal = begin + rad_s * 0.002 * (cycle + 1)
            self.send(ExchangeMode.SERVO, (goal, *HOME[1:]))
        return goal


def test_the_program_reports_its_id_and_sets_the_payload() -> None:
    driver = Driver()
    driver.send(ExchangeMode.HOLD)
    assert driver.controller.output_ints[24:26] == [ProgramState.READY, 4711]
    assert driver.controller.payload_kg == 1.5
    assert driver.controller.payload_centre_m == (0.0, 0.0, 0.05)


def test_the_joints_follow_and_hold_stops_them() -> None:
    driver = Driver()
    goal = driver.turn(1.0, 0.5)
    assert driver.controller.output_ints[24] == ProgramState.SERVOING
    assert driver.controller.positions[0] == pytest.approx(goal, abs=0.02)
    for _ in range(200):
        driver.send(ExchangeMode.HOLD)
    assert driver.controller.is_at_rest
    assert driver.controller.output_ints[24] == ProgramState.READY
    assert driver.controller.positions[0] < goal + 0.1


def test_the_joints_stop_by_themselves_when_no_heartbeat_arrives() -> None:
    driver = Driver()
    driver.turn(1.0, 0.5)
    cycles = 0
    while driver.controller.runtime is RuntimeState.PLAYING:
        driver.controller.step()
        cycles += 1
        assert cycles * 0.002 < WATCHDOG_S + 0.2, "the program continues without its driver"
    assert driver.controller.is_at_rest
    assert driver.controller.output_ints[24] == ProgramState.ENDED_BY_WATCHDOG


def test_a_heartbeat_that_does_not_change_counts_as_none() -> None:
    driver = Driver()
    driver.turn(1.0, 0.5)
    for _ in range(200):
        driver.controller.written("input_int_register_24")
        driver.controller.step()
    assert driver.controller.runtime is RuntimeState.STOPPED
    assert driver.controller.is_at_rest


def test_the_rtde_watchdog_ends_the_program_when_nothing_is_written() -> None:
    controller = SimulatedController(HOME)
    controller.load_script(
        'def idle():\n  rtde_set_watchdog("input_int_register_24", 10, "stop")\n'
        "  while True:\n    sync()\n  end\nend\n"
    )
    for _ in range(60):
        controller.step()
    assert controller.runtime is RuntimeState.STOPPED
    assert "input_int_register_24 was not written" in controller.messages[-1]


def test_a_jump_of_the_target_causes_a_protective_stop_which_only_a_person_ends() -> None:
    driver = Driver()
    driver.turn(1.0, 0.1)
    driver.send(ExchangeMode.SERVO, (1.0, *HOME[1:]))
    controller = driver.controller
    assert controller.safety is UrSafetyStatus.PROTECTIVE_STOP
    assert "sudden change in target position" in controller.messages[-1]
    for _ in range(100):
        controller.step()
    assert controller.is_at_rest
    controller.load_script(program(PARAMETERS))
    assert controller.runtime is RuntimeState.STOPPED
    controller.clear_stop()
    controller.load_script(program(PARAMETERS))
    assert controller.runtime is RuntimeState.PLAYING


def test_a_position_limit_causes_a_protective_stop() -> None:
    controller = SimulatedController((2 * math.pi, *HOME[1:]))
    driver = Driver()
    driver.controller = controller
    controller.load_script(program(PARAMETERS))
    driver.turn(0.5, 0.1)
    assert controller.safety is UrSafetyStatus.PROTECTIVE_STOP
    assert "position limit" in controller.messages[-1]


def test_an_emergency_stop_ends_the_program_and_the_power() -> None:
    driver = Driver()
    driver.turn(1.0, 0.2)
    driver.controller.emergency_stop()
    for _ in range(100):
        driver.controller.step()
    assert driver.controller.is_at_rest
    assert driver.controller.robot_mode is RobotMode.POWER_OFF
    driver.controller.power_on()
    assert driver.controller.robot_mode is RobotMode.POWER_OFF
    driver.controller.clear_stop()
    driver.controller.power_on()
    assert driver.controller.robot_mode is RobotMode.IDLE


def test_a_program_continues_after_a_safeguard_stop() -> None:
    driver = Driver()
    driver.turn(1.0, 0.2)
    driver.controller.safeguard_stop()
    for _ in range(100):
        driver.send(ExchangeMode.HOLD)
    assert driver.controller.is_at_rest
    assert driver.controller.runtime is RuntimeState.PAUSED
    driver.controller.release_safeguard()
    for _ in range(5):
        driver.send(ExchangeMode.HOLD)
    assert driver.controller.runtime is RuntimeState.PLAYING
    assert driver.controller.output_ints[24] == ProgramState.READY


def test_the_speed_slider_slows_a_servo_motion() -> None:
    driver = Driver()
    driver.controller.speed_slider = 0.3
    driver.turn(0.5, 0.5)
    assert driver.controller.safety is UrSafetyStatus.NORMAL
    assert driver.controller.peak_speed_rad_s <= 0.3 * 2.0944 + 1e-9


def test_a_script_does_not_run_in_local_control() -> None:
    controller = SimulatedController(HOME)
    controller.in_remote_control = False
    controller.load_script(program(PARAMETERS))
    assert controller.runtime is RuntimeState.STOPPED
    assert "local control" in controller.messages[-1]


@pytest.mark.parametrize(
    ("script", "why"),
    [
        ("movej([0])", 'begins with "def name'),
        ("def a():\n  sync()\n", "ends without"),
        ("def a():\nend\n", "block is empty"),
        ("def a():\n  open_safe()\nend\n", "no function open_safe"),
        ("def a():\n  x = __import__\nend\n", "'__import__' has no value"),
        ("def a():\n  x = sync.__class__\nend\n", "Attribute is not supported"),
        ("def a():\n  x = [y for y in z]\nend\n", "ListComp is not supported"),
        ("def a():\n  while True:\n    x = 1\n  end\nend\n", "infinite loop"),
        ("def a():\n  x = y\nend\n", "'y' has no value"),
        ("def a():\n  x = 1 / 0\nend\n", "division by zero"),
        ("def a():\n  x = (((((\nend\n", "not understood"),
    ],
)
def test_a_script_that_cannot_run_ends_with_the_reason(script: str, why: str) -> None:
    with pytest.raises(ScriptError, match=why):
        for _ in Program(script, {"sync": lambda: None}).run():
            pass


@given(st.text(alphabet="defwhilnd():=+[]01 \n\t.x", max_size=300))
def test_no_script_causes_anything_but_a_script_error(text: str) -> None:
    try:
        running = Program(text, {}).run()
        for _ in zip(running, range(3), strict=False):
            pass
    except ScriptError:
        pass
