"""The exchange process: RTDE with one controller at its full rate, apart from the trajectory tool.

`python -m handover_ur.exchange` reads its parameters as one line of JSON from
standard input, and ends when that closes. In each cycle it writes the report to shared memory and sends
heartbeat, mode and joint targets. A byte on standard input means a new setpoint: the joint targets of the
cycle are sent again, so that the controller has them earlier. It stops the joints in two cases, and waits
until the tool ends the motion:

- no setpoint has arrived for `stall_s` while the joints should move;
- the controller stops moving: protective stop, safeguard, or the end of the program.

If this process ends or stalls, the program on the controller stops the joints.
"""

import gc
import json
import math
import os
import select
import socket
import sys
import time
from dataclasses import asdict, dataclass, replace
from typing import Self

from handover.errors import HandoverError
from handover.runtime.control_cycle import runs_in_cycle
from handover_ur import rtde
from handover_ur.rtde import PackageReader, PackageType, ProtocolError, Recipe
from handover_ur.shared_memory import (
    Command,
    Interruption,
    Report,
    SharedMemory,
)
from handover_ur.states import (
    HEARTBEAT_REGISTER,
    MAY_MOVE,
    MODE_REGISTER,
    PROGRAM_ID_REGISTER,
    PROGRAM_STATE_REGISTER,
    TARGET_REGISTER,
    ExchangeMode,
    ProgramState,
    RobotMode,
    RuntimeState,
)
from handover_ur.tracking import CycleClock, TargetTracker

OUTPUTS = (
    "timestamp",
    "actual_q",
    "actual_qd",
    "target_q",
    "target_moment",
    "robot_mode",
    "safety_status",
    "runtime_state",
    "speed_scaling",
    "target_speed_fraction",
    "actual_digital_input_bits",
    "actual_digital_output_bits",
    "actual_TCP_force",
    f"output_int_register_{PROGRAM_STATE_REGISTER}",
    f"output_int_register_{PROGRAM_ID_REGISTER}",
)
TARGETS = tuple(f"input_double_register_{TARGET_REGISTER + joint}" for joint in range(6))
INPUTS = (
    f"input_int_register_{HEARTBEAT_REGISTER}",
    f"input_int_register_{MODE_REGISTER}",
    *TARGETS,
    "tool_digital_output_mask",
    "tool_digital_output",
)
CONNECT_TIMEOUT_S = 2.0
RETRY_EVERY_S = 0.25
END_TIMEOUT_S = 1.0
MAX_HEARTBEAT = 2**30
CB3_HZ, E_SERIES_HZ = 125.0, 500.0


@dataclass(frozen=True, slots=True)
class ExchangeParameters:
    """The parameters of the process; limits of the targets in rad/s and rad/s^2."""

    host: str
    port: int
    stall_s: float
    silence_s: float
    max_rad_s: tuple[float, ...]
    max_rad_s2: tuple[float, ...]
    memory: int
    """The file descriptor of the shared memory."""

    def as_line(self) -> bytes:
        """Return the parameters as the line that the process reads."""
        return json.dumps(asdict(self)).encode() + b"\n"

    @classmethod
    def from_line(cls, line: bytes) -> Self:
        """Return the parameters of such a line."""
        return cls(**json.loads(line))


class LinkError(HandoverError):
    """The connection cannot be established or has ended."""


class Connection:
    """An RTDE connection, set up and started. Raises `LinkError`, `ProtocolError` or `RecipeError`."""

    def __init__(self, host: str, port: int, silence_s: float) -> None:
        self._silence_s = silence_s
        try:
            self._socket = socket.create_connection((host, port), CONNECT_TIMEOUT_S)
        except OSError as error:
            raise LinkError(f"{host}:{port}: {error.strerror or error}") from None
        self._packages = PackageReader()
        self._waiting: list[rtde.Package] = []
        self.last_text = ""
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._set_up()
        except BaseException:
            self.close()
            raise

    def _set_up(self) -> None:
        version = PackageType.REQUEST_PROTOCOL_VERSION
        if not rtde.parse_accepted(self._ask(version, rtde.request_protocol_version())):
            raise LinkError("the controller does not speak RTDE version 2; update its software")
        answer = self._ask(PackageType.GET_URCONTROL_VERSION, rtde.package(PackageType.GET_URCONTROL_VERSION))
        self.version = rtde.parse_version(answer)
        if not self.version.is_supported:
            raise LinkError(
                f"the controller has the software {self.version}; the driver needs PolyScope 5.4 or newer of "
                "the e-Series, or 3.10 or newer of the CB3 series; update the controller (PolyScope X, 10.x, "
                "is not supported)"
            )
        self.frequency_hz = self.version.frequency_hz
        outputs = self._ask(PackageType.SETUP_OUTPUTS, rtde.setup_outputs(OUTPUTS, self.frequency_hz))
        self.outputs: Recipe = rtde.parse_recipe(outputs, OUTPUTS)
        self._inputs = rtde.parse_recipe(
            self._ask(PackageType.SETUP_INPUTS, rtde.setup_inputs(INPUTS)), INPUTS
        )
        if not rtde.parse_accepted(self._ask(PackageType.START, rtde.package(PackageType.START))):
            raise LinkError("the controller does not start the RTDE synchronization")

    def _ask(self, kind: PackageType, request: bytes) -> bytes:
        deadline_s = time.monotonic() + CONNECT_TIMEOUT_S
        self._send(request)
        while True:
            for package in self._receive(deadline_s - time.monotonic()):
                if package.kind == kind:
                    return package.payload
                self._note(package)

    @runs_in_cycle
    def _receive(self, timeout_s: float) -> list[rtde.Package]:
        self._socket.settimeout(max(timeout_s, 0.001))
        try:
            received = self._socket.recv(65_536)
        except TimeoutError:
            raise LinkError("the controller does not answer") from None
        except OSError as error:
            raise LinkError(f"the connection failed: {error.strerror or error}") from None
        if not received:
            raise LinkError("the controller has closed the connection")
        return self._packages.feed(received)

    @runs_in_cycle
    def _note(self, package: rtde.Package) -> None:
        if package.kind == PackageType.TEXT_MESSAGE:
            self.last_text = rtde.parse_text_message(package.payload).text

    @runs_in_cycle
    def _send(self, data: bytes) -> None:
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise LinkError(f"the connection failed: {error.strerror or error}") from None

    def fileno(self) -> int:
        """Return the descriptor, for `select`."""
        return self._socket.fileno()

    @runs_in_cycle
    def latest(self) -> tuple[rtde.Values | None, int]:
        """Return the latest values that have arrived, and how many packages with values."""
        data = []
        for package in self._receive(self._silence_s):
            if package.kind == PackageType.DATA_PACKAGE:
                data.append(package)
            else:
                self._note(package)
        return (self.outputs.decode(data[-1].payload) if data else None), len(data)

    @runs_in_cycle
    def send(self, heartbeat: int, mode: ExchangeMode, targets: tuple[float, ...], command: Command) -> None:
        """Write the input registers and the tool outputs."""
        values: rtde.Values = dict(zip(TARGETS, targets, strict=True))
        values[INPUTS[0]], values[INPUTS[1]] = heartbeat, int(mode)
        values["tool_digital_output_mask"] = command.tool_output_mask
        values["tool_digital_output"] = command.tool_outputs
        self._send(self._inputs.encode(values))

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


class Exchange:
    """The cycles of one connection after another, until standard input closes."""

    def __init__(self, parameters: ExchangeParameters, memory: SharedMemory) -> None:
        self._parameters = parameters
        self._memory = memory
        self._tracker = TargetTracker(parameters.max_rad_s, parameters.max_rad_s2)
        self._clock = CycleClock()
        self._report = Report()
        self._heartbeat = 0
        self._is_servoing = False
        self._cycle_at_s = self._cycle_s = 0.0
        self._interruption = Interruption.STOPPED  # a motion of an earlier process is not continued

    def run(self) -> None:
        """Connect, exchange, and connect again after a failure."""
        connections = 0
        parameters = self._parameters
        while True:
            try:
                connection = Connection(parameters.host, parameters.port, parameters.silence_s)
            except HandoverError as error:
                self._disconnected(str(error))
            else:
                connections += 1
                self._report = replace(
                    self._report, connections=connections, frequency_hz=connection.frequency_hz, reason=""
                )
                try:
                    if self._exchange(connection):
                        return
                except HandoverError as error:
                    self._disconnected(str(error))
                finally:
                    connection.close()
            if self._input_closed(RETRY_EVERY_S):
                return

    def _disconnected(self, reason: str) -> None:
        if self._is_servoing:
            self._interruption = Interruption.STOPPED
        self._is_servoing = False
        self._report = replace(
            self._report, is_connected=False, reason=reason, interruption=self._interruption
        )
        self._memory.write_report(self._report)

    @staticmethod
    def _input_closed(within_s: float) -> bool:
        readable, _, _ = select.select([sys.stdin], [], [], within_s)
        return bool(readable) and not _read_wakes()

    @runs_in_cycle
    def _exchange(self, connection: Connection) -> bool:
        """Run cycles; return True when standard input has closed. Raises `LinkError` or `ProtocolError`."""
        silence_s = self._parameters.silence_s
        reported_s = time.monotonic()
        while True:
            readable, _, _ = select.select([connection, sys.stdin], [], [], silence_s)
            if sys.stdin in readable:
                if not _read_wakes():
                    self._end_program(connection)
                    return True
                if connection not in readable:
                    self._send_again(connection)
                    continue
            if not readable:
                raise LinkError(f"the controller has sent nothing for {silence_s:g} s")
            values, cycles = connection.latest()
            if values is not None:
                reported_s = time.monotonic()
                self._cycle(connection, values, cycles)
            elif time.monotonic() - reported_s > silence_s:
                raise LinkError(f"the controller has sent no complete report for {silence_s:g} s")

    def _end_program(self, connection: Connection) -> None:
        """Let the program on the controller end, so that the arm stops before the watchdog expires."""
        deadline_s = time.monotonic() + END_TIMEOUT_S
        state = f"output_int_register_{PROGRAM_STATE_REGISTER}"
        while time.monotonic() < deadline_s:
            connection.send(
                self._next_heartbeat(), ExchangeMode.END, tuple(self._tracker.positions), Command()
            )
            values, _ = connection.latest()
            if values is not None and values[state] not in {ProgramState.READY, ProgramState.SERVOING}:
                return

    @runs_in_cycle
    def _cycle(self, connection: Connection, values: rtde.Values, cycles: int) -> None:
        now_s = time.monotonic()
        report = self._report = self._reported(values, now_s, cycles)
        command = self._memory.read_command()
        mode, targets = self._decide(report, command, values["target_q"], now_s, cycles)
        connection.send(self._next_heartbeat(), mode, targets, command)
        lag_rad = self._tracker.lag_rad if mode is ExchangeMode.SERVO else 0.0
        self._report = replace(self._report, interruption=self._interruption, lag_rad=lag_rad)
        self._memory.write_report(self._report)

    @runs_in_cycle
    def _send_again(self, connection: Connection) -> None:
        """Send the targets of this cycle for a newer setpoint."""
        command = self._memory.read_command()
        if self._is_servoing and command.mode is ExchangeMode.SERVO and self._cycle_s > 0:
            setpoint = (command.positions, command.velocities, command.accelerations)
            age_s = self._cycle_at_s - command.stamp_s
            targets = self._tracker.step_again(setpoint, age_s, self._cycle_s)
            connection.send(self._next_heartbeat(), ExchangeMode.SERVO, targets, command)

    @runs_in_cycle
    def _decide(
        self, report: Report, command: Command, target_q: object, now_s: float, cycles: int
    ) -> tuple[ExchangeMode, tuple[float, ...]]:
        """Return the mode and the joint targets of this cycle."""
        cycle_s = 1.0 / report.frequency_hz
        at_s = self._clock.next_s(now_s, cycles, cycle_s)
        if command.mode is not ExchangeMode.SERVO:
            self._is_servoing = False
            self._interruption = Interruption.NONE
            return command.mode, tuple(self._tracker.positions)
        if not _may_move(report, command):
            self._interruption = Interruption.STOPPED
        elif now_s - command.stamp_s > self._parameters.stall_s:
            self._interruption = self._interruption or Interruption.STALLED
        if self._interruption is not Interruption.NONE:
            self._is_servoing = False
            return ExchangeMode.HOLD, tuple(self._tracker.positions)
        if not self._is_servoing:
            self._is_servoing = True
            assert isinstance(target_q, tuple)  # noqa: S101 - the recipe has a vector
            self._tracker.start(target_q)
        setpoint = (command.positions, command.velocities, command.accelerations)
        self._cycle_at_s, self._cycle_s = at_s, cycle_s * cycles
        return ExchangeMode.SERVO, self._tracker.step(setpoint, at_s - command.stamp_s, self._cycle_s)

    @runs_in_cycle
    def _next_heartbeat(self) -> int:
        self._heartbeat = self._heartbeat % MAX_HEARTBEAT + 1
        return self._heartbeat

    @runs_in_cycle
    def _reported(self, values: rtde.Values, now_s: float, cycles: int) -> Report:
        number: dict[str, float] = {}
        vector: dict[str, tuple[float, ...]] = {}
        for name, value in values.items():
            if isinstance(value, tuple):
                vector[name] = value
            else:
                number[name] = value
        if not all(map(math.isfinite, (*vector["actual_q"], *vector["target_q"]))):
            raise ProtocolError("the controller reports joint positions that are not numbers")
        last = self._report
        return Report(
            stamp_s=now_s,
            wall_s=time.time(),
            is_connected=True,
            connections=last.connections,
            controller_s=number["timestamp"],
            positions=vector["actual_q"],
            velocities=vector["actual_qd"],
            torques=vector["target_moment"],
            robot_mode=int(number["robot_mode"]),
            safety_status=int(number["safety_status"]),
            runtime_state=int(number["runtime_state"]),
            program_state=int(number[f"output_int_register_{PROGRAM_STATE_REGISTER}"]),
            program_id=int(number[f"output_int_register_{PROGRAM_ID_REGISTER}"]),
            speed_fraction=number["speed_scaling"] * number["target_speed_fraction"],
            speed_slider=number["target_speed_fraction"],
            digital_inputs=int(number["actual_digital_input_bits"]),
            digital_outputs=int(number["actual_digital_output_bits"]),
            interruption=last.interruption,
            frequency_hz=last.frequency_hz,
            skipped_cycles=last.skipped_cycles + cycles - 1,
            wrist_force_n=math.hypot(*vector["actual_TCP_force"][:3]),
        )


def _may_move(report: Report, command: Command) -> bool:
    """Return whether the controller runs the program of the command and may move."""
    return (
        report.safety_status in MAY_MOVE
        and report.robot_mode == RobotMode.RUNNING
        and report.runtime_state == RuntimeState.PLAYING
        and report.program_id == command.program_id
    )


def _read_wakes() -> bytes:
    """Return the bytes on standard input; none when it has closed."""
    return os.read(sys.stdin.fileno(), 4096)


def main() -> None:
    """Run the process."""
    parameters = ExchangeParameters.from_line(sys.stdin.buffer.readline())
    gc.disable()
    Exchange(parameters, SharedMemory(parameters.memory)).run()


if __name__ == "__main__":
    main()
