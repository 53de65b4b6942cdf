"""The simulated controller: states, registers, the running program and six joints, cycle by cycle.

No I/O and no clock: `step` advances everything by one cycle. Joints follow `servoj` with a first-order lag;
the real arm has dynamics of its own. A protective stop is triggered by a target that jumps, exceeds a limit,
or departs from the joints. It ends the program.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from handover_ur.program import JOINTS
from handover_ur.simulator.urscript import Cycles, Program, ScriptError
from handover_ur.states import MAY_MOVE, RobotMode, RuntimeState, UrSafetyStatus

UR10_SPEED_RAD_S = (2.0944, 2.0944, math.pi, math.pi, math.pi, math.pi)
POSITION_LIMIT_RAD = 2 * math.pi + 0.006
SERVO_LAG_S = 0.01
SAFETY_STOP_RAD_S2 = 30.0
PROGRAM_STOP_RAD_S2 = 10.0
MAX_DEVIATION_RAD = 0.35
JUMP_CYCLES = 10
"""A target that would need the speed limit for so many cycles counts as a jump."""
INERTIA_KGM2 = 1.0
"""Of each joint, for the torques that are reported; gravity, friction and load are not simulated."""
REGISTERS = 48
TOOL_OUTPUT_BIT = 16

Joints = tuple[float, ...]


@dataclass
class _Watchdog:
    """A variable that must be written at a minimum frequency."""

    variable: str
    period_s: float
    action: str
    written_s: float


class SimulatedController:
    """Six joints at rest at `joints`, powered and with released brakes unless `running` is False."""

    def __init__(
        self,
        joints: Joints,
        *,
        speed_limits: Joints = UR10_SPEED_RAD_S,
        frequency_hz: float = 500.0,
        running: bool = True,
        model: str = "UR10",
    ) -> None:
        self.model = model
        self.version: tuple[int, int, int, int] | None = None
        """The version of the software; that of the series if absent."""
        self.cycle_s = 1.0 / frequency_hz
        self.frequency_hz = frequency_hz
        self.time_s = 0.0
        self.positions = list(joints)
        self.velocities = [0.0] * JOINTS
        self.target = list(joints)
        self.torques = [0.0] * JOINTS
        self.robot_mode = RobotMode.RUNNING if running else RobotMode.POWER_OFF
        self.safety = UrSafetyStatus.NORMAL
        self.runtime = RuntimeState.STOPPED
        self.in_remote_control = True
        self.speed_slider = 1.0
        self.speed_scaling = 1.0
        self.program_name = ""
        self.messages: list[str] = []
        """What the pendant shows, the latest last."""
        self.peak_speed_rad_s = 0.0
        self.programs_started = 0
        self.payload_kg = 0.0
        self.payload_centre_m: Joints = (0.0, 0.0, 0.0)
        self.input_ints = [0] * REGISTERS
        self.input_floats = [0.0] * REGISTERS
        self.output_ints = [0] * REGISTERS
        self.digital_outputs = 0
        self.digital_inputs = 0
        self.tcp_force_n: Joints = (0.0, 0.0, 0.0)
        """The force at the tool that is measured."""
        self.on_cycle: list[Callable[[], None]] = []
        self._speed_limits = speed_limits
        self._running: Cycles | None = None
        self._watchdogs: list[_Watchdog] = []
        self._servo: list[float] | None = None
        self._stop_rad_s2: float | None = None
        self._paused_by_safeguard = False

    # One cycle

    def step(self) -> None:
        """Advance by one control cycle."""
        self.time_s += self.cycle_s
        self._check_watchdogs()
        if self.runtime is RuntimeState.PLAYING:
            self._advance_program()
        self._move()
        for notify in self.on_cycle:
            notify()

    def _advance_program(self) -> None:
        running = self._running
        assert running is not None  # noqa: S101 - a program runs in this state
        try:
            next(running)
        except StopIteration:
            self.stop_program()
        except ScriptError as error:
            self.messages.append(f"Runtime error: {error}")
            self.stop_program()

    def _move(self) -> None:
        before = list(self.velocities)
        if self._servo is not None:
            self._follow_servo(self._servo)
        else:
            self._decelerate(self._stop_rad_s2 or PROGRAM_STOP_RAD_S2)
        self.torques = [
            INERTIA_KGM2 * (now - then) / self.cycle_s
            for now, then in zip(self.velocities, before, strict=True)
        ]
        fastest = max(map(abs, self.velocities))
        self.peak_speed_rad_s = max(self.peak_speed_rad_s, fastest)

    def _follow_servo(self, servo: list[float]) -> None:
        share = min(self.cycle_s / SERVO_LAG_S, 1.0)
        for joint, goal in enumerate(servo):
            limit = self._speed_limits[joint] * self.speed_fraction
            wanted = (goal - self.positions[joint]) * share / self.cycle_s
            velocity = min(max(wanted, -limit), limit)
            self.velocities[joint] = velocity
            self.positions[joint] += velocity * self.cycle_s
            self.target[joint] = self.positions[joint]
            if abs(goal - self.positions[joint]) > MAX_DEVIATION_RAD:
                self.protective_stop(f"joint {joint}: the position deviates from the path")
                return

    def _decelerate(self, rad_s2: float) -> None:
        fastest = max(map(abs, self.velocities))
        if fastest == 0.0:
            return
        rest = max(fastest - rad_s2 * self.cycle_s, 0.0) / fastest
        for joint in range(JOINTS):
            self.velocities[joint] *= rest
            self.positions[joint] += self.velocities[joint] * self.cycle_s
            self.target[joint] = self.positions[joint]

    def _check_watchdogs(self) -> None:
        if self.runtime is not RuntimeState.PLAYING:
            return
        for watchdog in self._watchdogs:
            if self.time_s - watchdog.written_s > watchdog.period_s and watchdog.action == "stop":
                self.messages.append(f"RTDE watchdog: {watchdog.variable} was not written")
                self.stop_program()
                return

    @property
    def speed_fraction(self) -> float:
        """Return the fraction of the speed at which programs run."""
        return self.speed_slider * self.speed_scaling

    @property
    def is_at_rest(self) -> bool:
        """Return whether no joint moves."""
        return not any(self.velocities)

    # Programs

    def load_script(self, script: str) -> None:
        """Run a script as received on the script interface; what cannot run is ignored, with a message."""
        if not self.in_remote_control:
            self.messages.append("A script was ignored: the controller is in local control")
            return
        if self.robot_mode is not RobotMode.RUNNING or self.safety not in MAY_MOVE:
            self.messages.append("A script was ignored: the robot is not running")
            return
        try:
            program = Program(script, self._functions())
        except ScriptError as error:
            self.messages.append(f"Syntax error: {error}")
            return
        self.stop_program()
        self.program_name = program.name
        self._running = program.run()
        self.runtime = RuntimeState.PLAYING
        self.programs_started += 1

    def stop_program(self) -> None:
        """End the program; the joints decelerate."""
        self._servo = self._stop_rad_s2 = None
        self._running = None
        self._watchdogs = []
        self._paused_by_safeguard = False
        self.runtime = RuntimeState.STOPPED

    def _functions(self) -> dict[str, Callable[..., Any]]:
        return {
            "servoj": self._servoj,
            "stopj": self._stopj,
            "sync": self._sync,
            "read_input_integer_register": lambda number: self.input_ints[number],
            "read_input_float_register": lambda number: self.input_floats[number],
            "write_output_integer_register": self._write_output_int,
            "rtde_set_watchdog": self._set_watchdog,
            "set_payload": self._set_payload,
            "textmsg": lambda *parts: self.messages.append("".join(map(str, parts))),
        }

    def _servoj(  # noqa: PLR0917 - the arguments of the function of URScript
        self, q: list[float], a: float, v: float, t: float, lookahead_time: float, gain: float
    ) -> Cycles:
        if not (0.03 <= lookahead_time <= 0.2 and 100 <= gain <= 2000 and a == v == 0 and t > 0):
            raise ScriptError("servoj has an argument out of range")
        if not all(map(math.isfinite, q)) or len(q) != JOINTS:
            raise ScriptError("servoj has a target that is not six numbers")
        before = self._servo or self.positions
        for joint, goal in enumerate(q):
            step = abs(goal - before[joint])
            if step > JUMP_CYCLES * self._speed_limits[joint] * self.cycle_s:
                self.protective_stop(f"joint {joint}: sudden change in target position by {step:.3f} rad")
                break
            if abs(goal) > POSITION_LIMIT_RAD:
                self.protective_stop(f"joint {joint}: the position limit is exceeded")
                break
        else:
            self._servo = list(q)
        elapsed_s = 0.0
        while elapsed_s < t - 1e-9:
            yield
            elapsed_s += self.cycle_s * max(self.speed_fraction, 1e-3)

    def _stopj(self, a: float) -> Cycles:
        self._servo, self._stop_rad_s2 = None, float(a)
        yield
        while not self.is_at_rest:
            yield
        self._stop_rad_s2 = None

    @staticmethod
    def _sync() -> Cycles:
        yield

    def _write_output_int(self, number: int, value: int) -> None:
        self.output_ints[number] = value

    def _set_watchdog(self, variable: str, min_frequency_hz: float, action: str = "pause") -> None:
        self._watchdogs.append(_Watchdog(variable, 1.0 / min_frequency_hz, action, self.time_s))

    def _set_payload(self, mass_kg: float, centre_m: list[float]) -> None:
        self.payload_kg, self.payload_centre_m = mass_kg, tuple(centre_m)

    def written(self, variable: str) -> None:
        """Note that an RTDE client has written an input variable."""
        for watchdog in self._watchdogs:
            if watchdog.variable == variable:
                watchdog.written_s = self.time_s

    # States that a person or a safety device changes

    def power_on(self) -> None:
        """Power the arm; its brakes stay closed."""
        if self.robot_mode is RobotMode.POWER_OFF and self.safety in MAY_MOVE:
            self.robot_mode = RobotMode.IDLE

    def power_off(self) -> None:
        """Switch the arm off."""
        self.stop_program()
        self.robot_mode = RobotMode.POWER_OFF

    def release_brakes(self) -> None:
        """Release the brakes of a powered arm."""
        if self.robot_mode is RobotMode.IDLE and self.safety in MAY_MOVE:
            self.robot_mode = RobotMode.RUNNING

    def protective_stop(self, reason: str) -> None:
        """Stop the arm and end the program, as a real controller does for a collision."""
        self.messages.append(f"Protective stop: {reason}")
        self._halt(UrSafetyStatus.PROTECTIVE_STOP)

    def emergency_stop(self) -> None:
        """Stop the arm and switch it off."""
        self._halt(UrSafetyStatus.ROBOT_EMERGENCY_STOP)
        self.robot_mode = RobotMode.POWER_OFF

    def safeguard_stop(self) -> None:
        """Stop the arm and pause the program until `release_safeguard`."""
        self.safety = UrSafetyStatus.SAFEGUARD_STOP
        self._servo, self._stop_rad_s2 = None, SAFETY_STOP_RAD_S2
        if self.runtime is RuntimeState.PLAYING:
            self.runtime, self._paused_by_safeguard = RuntimeState.PAUSED, True

    def release_safeguard(self) -> None:
        """End a safeguard stop; the program continues by itself, as on a real controller."""
        if self.safety is UrSafetyStatus.SAFEGUARD_STOP:
            self.safety = UrSafetyStatus.NORMAL
            if self._paused_by_safeguard:
                self.runtime, self._paused_by_safeguard = RuntimeState.PLAYING, False

    def clear_stop(self) -> None:
        """End a protective or emergency stop, as a person does at the pendant."""
        if self.safety in {UrSafetyStatus.PROTECTIVE_STOP, UrSafetyStatus.ROBOT_EMERGENCY_STOP}:
            self.safety = UrSafetyStatus.NORMAL

    def move_by_hand(self, displacements: Joints) -> None:
        """Move the joints as a person does in free-drive: in local control, without a program."""
        self.stop_program()
        for joint, displacement in enumerate(displacements):
            self.positions[joint] += displacement
            self.target[joint] = self.positions[joint]
            self.velocities[joint] = 0.0

    def _halt(self, status: UrSafetyStatus) -> None:
        self.stop_program()
        self.safety = status
        self._stop_rad_s2 = SAFETY_STOP_RAD_S2
