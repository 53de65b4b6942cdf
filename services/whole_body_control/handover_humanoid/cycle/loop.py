"""The loop of the control cycle: ports in, sensors, controller, command, ports out; no other I/O.

A cycle is a period of the robot (500 Hz): the joints get a command in each. The controller with its stack of
tasks has a longer period (100 Hz), and the pattern generator within it a still longer one (10 Hz); in the
cycles between, the joints follow the velocities of the last command.

The wish comes from a process that may stall or be killed. When it is older than `WISH_TIMEOUT_S`, or not
finite, the robot is to stand still: the controller finishes its step and stands on both feet. A
controller that raises an error, or has no valid sensors for `MAX_FAULTS` of its periods, is stopped for good:
the joints hold the last command. So do those of a robot that has fallen, or that refuses a command. The state
says why by `HoldReason`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Generic, Protocol, TypeVar

import numpy as np

from handover.runtime.control_cycle import runs_in_cycle
from handover_humanoid.components.modes import ModeConversion, require_mode
from handover_humanoid.components.robot import Interpolation, JointCommand, Robot, RobotSensors
from handover_humanoid.cycle.ports import PortReader, PortWriter
from handover_humanoid.cycle.timing import FIGURES, Timing
from handover_humanoid.model.humanoid import JointMode
from handover_humanoid.model.kinematics import Array

WISH_TIMEOUT_S = 0.3
MAX_FAULTS = 10
WARM_UP_CYCLES = 250
STATUS = ("robot_time_s", "mode", "wish_age_s", "robot_delay_s", "hold")


class Mode(IntEnum):
    """What the cycle does: follows the wish, stands since there is none, or holds the joints for good, after
    a fault or a fall. The page has 3 for a robot that a person has stopped."""

    FOLLOWING = 0
    STANDING = 1
    HOLDING = 2
    DOWN = 4

    @property
    def is_final(self) -> bool:
        """Return whether the joints hold for good."""
        return self in {Mode.HOLDING, Mode.DOWN}


class HoldReason(IntEnum):
    """Why the joints hold for good."""

    NONE = 0
    FAULTS = 1
    """The controller had no valid values for too long; its state says what was wrong."""
    FAILED = 2
    """The controller raised an error, which is in the log."""
    REFUSED = 3
    """The robot refused a command, for a reason that is in the log."""
    FALLEN = 4


class Controller(Protocol):
    """A real-time component that controls the robot."""

    control_s: float
    fields: Sequence[str]
    """The names of its state."""
    is_down: bool
    """Whether the robot has fallen."""

    @runs_in_cycle
    def follow(self, wish: Array | None, person: Array | None) -> None:
        """Accept the values of `WISH` and `PERSON`; None for those that are too old, or not finite."""
        ...

    @runs_in_cycle
    def tune(self, gains: Array | None) -> None:
        """Accept the values of the port `gains`; None for values that were not written, or are not finite."""
        ...

    @runs_in_cycle
    def step(self, sensors: RobotSensors, command: JointCommand) -> str:
        """Compute the next command; return what is wrong, or nothing."""
        ...

    @runs_in_cycle
    def write_state(self, state: Array) -> None:
        """Write the state, as `fields` says."""
        ...


@dataclass(frozen=True, slots=True)
class CyclePorts:
    """The ports of a cycle: wish, person and gains, which it reads, and the state, which it writes."""

    wish: PortReader
    person: PortReader
    gains: PortReader
    state: PortWriter


R = TypeVar("R", bound=Robot)
C = TypeVar("C", bound=Controller)


def state_fields(controller: Controller) -> tuple[str, ...]:
    """Return the names of the values of the port for the state."""
    return (*STATUS, *FIGURES, *controller.fields)


class ControlLoop(Generic[R, C]):
    """The loop; everything that it needs is allocated when it is made.

    Raises `UsageError` for a mode of the joints that the model or the robot does not have.
    """

    def __init__(
        self,
        robot: R,
        controller: C,
        ports: CyclePorts,
        start: Array,
        *,
        is_paced: bool = True,
        mode: JointMode = JointMode.IMPEDANCE,
    ) -> None:
        self._modes = ModeConversion(robot.humanoid, mode)
        require_mode(mode, robot.modes, f"the driver of {robot.humanoid.name}")
        self.robot, self.controller, self._ports = robot, controller, ports
        self._sensors, self._command = RobotSensors(robot.humanoid), JointCommand(robot.humanoid)
        self._command.positions[:] = start
        self._between = Interpolation(robot.humanoid, start, controller.control_s, robot.period_s)
        self.timing, self._is_paced = Timing(robot.period_s), is_paced
        self._faults = 0
        self._state = np.zeros(len(state_fields(controller)))
        self.mode, self.fault, self.hold = Mode.STANDING, "", HoldReason.NONE
        self._is_ending = False

    def warm_up(self) -> None:
        """Run the first cycles, which load what is loaded once, and begin the schedule after them."""
        for _ in range(WARM_UP_CYCLES):
            self.cycle()
        self.timing = Timing(self.robot.period_s)

    def stand(self) -> None:
        """Follow no wish from now on."""
        self._is_ending = True

    @runs_in_cycle
    def cycle(self) -> None:
        """Run one cycle, and wait for the next."""
        if self._between.is_due:
            self._control_period()
        self._send()
        self.robot.wait()
        if self._is_paced:
            self.timing.wait()
        else:
            self.timing.cycles += 1

    @runs_in_cycle
    def _control_period(self) -> None:
        age_s = self._read_wish()
        self.robot.read(self._sensors)
        if self.mode.is_final:
            self._between.rest()
        else:
            self._control()
        state, status = self._state, len(STATUS)
        state[0], state[1], state[2] = self._sensors.time_s, self.mode, age_s
        state[3], state[4] = self.robot.delay_s, self.hold
        self.timing.write_figures(state[status : status + len(FIGURES)])
        self.controller.write_state(state[status + len(FIGURES) :])
        self._ports.state.write(state)

    @runs_in_cycle
    def _read_wish(self) -> float:
        ports = self._ports
        wish, age_s = _newest(ports.wish)
        if self._is_ending:
            wish = None
        self.controller.follow(wish, _newest(ports.person)[0])
        self.controller.tune(_last(ports.gains))
        if not self.mode.is_final:
            self.mode = Mode.STANDING if wish is None else Mode.FOLLOWING
        return age_s

    @runs_in_cycle
    def _control(self) -> None:
        """Compute a command; after too many faults, or an error, rest."""
        try:
            fault = self.controller.step(self._sensors, self._command)
        except Exception as error:  # noqa: BLE001 - whatever is wrong, the joints must hold
            self._stop(f"the controller failed: {error!r}", HoldReason.FAILED)
            return
        if self.controller.is_down:
            self._stop("the robot has fallen", HoldReason.FALLEN, Mode.DOWN)
            return
        if not fault:
            self._faults = 0
            self._between.start(self._command)
            return
        self.fault, self._faults = fault, self._faults + 1
        self._between.rest()
        if self._faults >= MAX_FAULTS:
            self._stop(fault, HoldReason.FAULTS)

    @runs_in_cycle
    def _send(self) -> None:
        try:
            if self._modes.needs_sensors:
                self.robot.read(self._sensors)
            self.robot.write(self._modes.convert(self._between.next(), self._sensors))
        except Exception as error:  # noqa: BLE001 - as above; the robot keeps the last command
            if not self.mode.is_final:  # else the first reason stays, and the state is written on
                self._stop(f"the robot refused a command: {error!r}", HoldReason.REFUSED)

    @runs_in_cycle
    def _stop(self, fault: str, hold: HoldReason, mode: Mode = Mode.HOLDING) -> None:
        self.mode, self.fault, self.hold = mode, fault, hold
        self._between.rest()


@runs_in_cycle
def _newest(port: PortReader) -> tuple[Array | None, float]:
    """Return the values of a port, None for those that are too old or not finite, and their age in s."""
    is_read = port.read()
    age_s = port.age_s()
    is_valid = is_read and age_s < WISH_TIMEOUT_S and bool(np.isfinite(port.values).all())
    return (port.values if is_valid else None), age_s


@runs_in_cycle
def _last(port: PortReader) -> Array | None:
    """Return the values of a port of any age, None for those that are not finite or not written yet."""
    is_valid = port.read() and port.time_ns > 0 and bool(np.isfinite(port.values).all())
    return port.values if is_valid else None
