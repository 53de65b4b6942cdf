"""The network interfaces of the simulated controller."""

import asyncio
import struct
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from typing import Any

from handover.telemetry import get_logger
from handover_ur import rtde
from handover_ur.rtde import PackageReader, PackageType, ProtocolError, Recipe
from handover_ur.simulator.controller import (
    REGISTERS,
    TOOL_OUTPUT_BIT,
    SimulatedController,
)
from handover_ur.states import RuntimeState

log = get_logger(__name__)

E_SERIES_VERSION, CB3_VERSION = (5, 15, 0, 1), (3, 15, 8, 1)
CB3_HZ = 125.0
MAX_WAITING_BYTES = 65_536
MAX_LINE_BYTES = 4096
SCRIPT_END = b"\nend\n"

_OUTPUTS: Mapping[str, tuple[str, Callable[[SimulatedController], Any]]] = {
    "timestamp": ("DOUBLE", lambda c: c.time_s),
    "actual_q": ("VECTOR6D", lambda c: tuple(c.positions)),
    "actual_qd": ("VECTOR6D", lambda c: tuple(c.velocities)),
    "target_q": ("VECTOR6D", lambda c: tuple(c.target)),
    "target_qd": ("VECTOR6D", lambda c: tuple(c.velocities)),
    "target_moment": ("VECTOR6D", lambda c: tuple(c.torques)),
    "robot_mode": ("INT32", lambda c: int(c.robot_mode)),
    "safety_mode": ("INT32", lambda c: int(c.safety)),
    "safety_status": ("INT32", lambda c: int(c.safety)),
    "runtime_state": ("UINT32", lambda c: int(c.runtime)),
    "speed_scaling": ("DOUBLE", lambda c: c.speed_scaling),
    "target_speed_fraction": ("DOUBLE", lambda c: c.speed_slider),
    "actual_digital_input_bits": ("UINT64", lambda c: c.digital_inputs),
    "actual_TCP_force": ("VECTOR6D", lambda c: (*c.tcp_force_n, 0.0, 0.0, 0.0)),
    "actual_digital_output_bits": ("UINT64", lambda c: c.digital_outputs),
}
_INPUTS = {"tool_digital_output_mask": "UINT8", "tool_digital_output": "UINT8"}


def version_of(controller: SimulatedController) -> tuple[int, int, int, int]:
    """Return the version of the software: the CB3 series has 125 cycles a second."""
    if controller.version is not None:
        return controller.version
    return CB3_VERSION if controller.frequency_hz <= CB3_HZ else E_SERIES_VERSION


def _register(number: int) -> Callable[[SimulatedController], int]:
    return lambda controller: controller.output_ints[number]


_REGISTER_OUTPUTS = {
    f"output_int_register_{number}": ("INT32", _register(number)) for number in range(REGISTERS)
}
_REGISTER_INPUTS = {f"input_int_register_{number}": "INT32" for number in range(REGISTERS)} | {
    f"input_double_register_{number}": "DOUBLE" for number in range(REGISTERS)
}


class RtdeServer:
    """The RTDE interface; one output recipe for each client, and each input belongs to one client."""

    def __init__(self, controller: SimulatedController) -> None:
        self._controller = controller
        self._sessions: set[_Session] = set()
        self._owners: dict[str, _Session] = {}
        self.output_delay_s = 0.0
        """Outputs are sent so much later than they were measured."""
        self.refuses = False
        """Connections are closed at once, as while a controller restarts."""
        self._received = asyncio.Event()
        controller.on_cycle.append(self._send_outputs)

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one client until it disconnects or violates the protocol."""
        session = _Session(self._controller, writer, self._owners)
        if self.refuses:
            writer.close()
            return
        self._sessions.add(session)
        packages = PackageReader()
        try:
            while received := await reader.read(65_536):
                for package in packages.feed(received):
                    session.receive(package.kind, package.payload)
                self._received.set()
                await writer.drain()
        except (ProtocolError, ConnectionError) as error:
            log.info("RTDE client dropped", error=str(error))
        finally:
            self._sessions.discard(session)
            self._received.set()
            for name in [name for name, owner in self._owners.items() if owner is session]:
                del self._owners[name]
            writer.close()

    async def await_inputs(self, timeout_s: float) -> None:
        """Wait until a client that gets outputs has answered the last ones with inputs."""
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                while any(session.awaits_inputs for session in self._sessions):
                    self._received.clear()
                    await self._received.wait()

    def broadcast(self, data: bytes) -> None:
        """Send bytes to all clients, whatever the protocol says."""
        for session in self._sessions:
            session.send(data)

    def drop_clients(self) -> None:
        """Close all connections, as a network fault does."""
        for session in list(self._sessions):
            session.writer.transport.abort()

    def _send_outputs(self) -> None:
        for session in self._sessions:
            encoded = session.output()
            if encoded is None:
                continue
            if self.output_delay_s > 0:
                asyncio.get_running_loop().call_later(self.output_delay_s, session.send, encoded)
            else:
                session.send(encoded)


class _Session:
    """One RTDE client: its recipes, and whether outputs are sent."""

    def __init__(
        self,
        controller: SimulatedController,
        writer: asyncio.StreamWriter,
        owners: "dict[str, _Session]",
    ) -> None:
        self.writer = writer
        self._controller = controller
        self._owners = owners
        self._outputs: Recipe | None = None
        self._inputs: dict[int, Recipe] = {}
        self._every = 1
        self._cycle = 0
        self._started = self._has_sent_inputs = False
        self.awaits_inputs = False
        """Whether outputs were sent after the last inputs, to a client that has sent inputs before."""

    def send(self, encoded: bytes) -> None:
        """Send a package, unless the client reads too slowly."""
        transport = self.writer.transport
        if not transport.is_closing() and transport.get_write_buffer_size() < MAX_WAITING_BYTES:
            self.writer.write(encoded)

    def output(self) -> bytes | None:
        """Return the data package of this cycle; None if none is due."""
        self._cycle += 1
        if not self._started or self._outputs is None or self._cycle % self._every:
            return None
        outputs = {**_OUTPUTS, **_REGISTER_OUTPUTS}
        self.awaits_inputs = self._has_sent_inputs
        return self._outputs.encode(
            {name: outputs[name][1](self._controller) for name in self._outputs.names}
        )

    def receive(self, kind: int, payload: bytes) -> None:
        """Process a package of the client. Raises `ProtocolError`."""
        match kind:
            case PackageType.DATA_PACKAGE:
                self._write_inputs(payload)
            case PackageType.REQUEST_PROTOCOL_VERSION:
                accepted = payload == struct.pack(">H", rtde.PROTOCOL_VERSION)
                self._answer(PackageType.REQUEST_PROTOCOL_VERSION, bytes((accepted,)))
            case PackageType.GET_URCONTROL_VERSION:
                self._answer(
                    PackageType.GET_URCONTROL_VERSION, struct.pack(">IIII", *version_of(self._controller))
                )
            case PackageType.SETUP_OUTPUTS:
                self._answer(PackageType.SETUP_OUTPUTS, self._set_up_outputs(payload))
            case PackageType.SETUP_INPUTS:
                self._answer(PackageType.SETUP_INPUTS, self._set_up_inputs(payload))
            case PackageType.START | PackageType.PAUSE:
                self._started = kind == PackageType.START and self._outputs is not None
                accepted = kind == PackageType.PAUSE or self._started
                self._answer(PackageType(kind), bytes((accepted,)))
            case PackageType.TEXT_MESSAGE:
                self._controller.messages.append(rtde.parse_text_message(payload).text)
            case _:
                raise ProtocolError(f"the type {kind} is unknown")

    def _answer(self, kind: PackageType, payload: bytes) -> None:
        self.writer.write(rtde.package(kind, payload))

    def _set_up_outputs(self, payload: bytes) -> bytes:
        if len(payload) < 8:
            raise ProtocolError("the output recipe has no frequency")
        (frequency_hz,) = struct.unpack_from(">d", payload)
        names = rtde.parse_names(payload[8:])
        outputs = {**_OUTPUTS, **_REGISTER_OUTPUTS}
        types = [outputs[name][0] if name in outputs else "NOT_FOUND" for name in names]
        highest_hz = self._controller.frequency_hz
        if "NOT_FOUND" not in types and 1 <= frequency_hz <= highest_hz:
            self._outputs, self._every = Recipe(1, names, types), round(highest_hz / frequency_hz)
        return b"\x01" + ",".join(types).encode()

    def _set_up_inputs(self, payload: bytes) -> bytes:
        names = rtde.parse_names(payload)
        inputs = _REGISTER_INPUTS | _INPUTS
        types = [
            "NOT_FOUND" if name not in inputs else "IN_USE" if name in self._owners else inputs[name]
            for name in names
        ]
        recipe_id = 0
        if not rtde.UNKNOWN_TYPES & set(types):
            recipe_id = len(self._inputs) + 1
            self._inputs[recipe_id] = Recipe(recipe_id, names, types)
            self._owners.update(dict.fromkeys(names, self))
        return bytes((recipe_id,)) + ",".join(types).encode()

    def _write_inputs(self, payload: bytes) -> None:
        self.awaits_inputs, self._has_sent_inputs = False, True
        recipe = self._inputs.get(payload[0] if payload else 0)
        if recipe is None:
            raise ProtocolError("a data package has an unknown recipe")
        values = recipe.decode(payload)
        for name, value in values.items():
            number = int(name.rsplit("_", 1)[-1]) if name[-1].isdigit() else 0
            if name.startswith("input_int"):
                self._controller.input_ints[number] = int(value)  # type: ignore[arg-type]
            elif name.startswith("input_double"):
                self._controller.input_floats[number] = float(value)  # type: ignore[arg-type]
            self._controller.written(name)
        mask = int(values.get("tool_digital_output_mask", 0))  # type: ignore[arg-type]
        bits = int(values.get("tool_digital_output", 0))  # type: ignore[arg-type]
        kept = self._controller.digital_outputs & ~(mask << TOOL_OUTPUT_BIT)
        self._controller.digital_outputs = kept | ((bits & mask) << TOOL_OUTPUT_BIT)


class DashboardServer:
    """The dashboard: one line for each command and each answer."""

    def __init__(self, controller: SimulatedController) -> None:
        self._controller = controller

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one client."""
        writer.write(b"Connected: Universal Robots Dashboard Server\n")
        await _serve_lines(reader, writer, self._answer)

    async def _answer(self, line: str) -> str:  # noqa: PLR0911 - one return for each command
        controller = self._controller
        changes: Mapping[str, tuple[str, Callable[[], None]]] = {
            "power on": ("Powering on", controller.power_on),
            "power off": ("Powering off", controller.power_off),
            "brake release": ("Brake releasing", controller.release_brakes),
            "unlock protective stop": ("Protective stop releasing", controller.clear_stop),
            "stop": ("Stopped", controller.stop_program),
        }
        command = line.strip().lower()
        if command in changes:
            if not controller.in_remote_control:
                return f'Command "{command}" is not allowed in local control'
            text, change = changes[command]
            change()
            return text
        match command:
            case "robotmode":
                return f"Robotmode: {controller.robot_mode.name}"
            case "safetystatus":
                return f"Safetystatus: {controller.safety.name}"
            case "is in remote control":
                return str(controller.in_remote_control).lower()
            case "running":
                return f"Program running: {str(controller.runtime is RuntimeState.PLAYING).lower()}"
            case "programstate":
                return f"{controller.runtime.name} {controller.program_name or '<unnamed>'}"
            case "get robot model":
                return controller.model
            case "get serial number":
                return "20170000000"
            case "polyscopeversion":
                return f"URSoftware {'.'.join(map(str, version_of(controller)))}"
            case _:
                return f"could not understand: '{command[:100]}'"


class ScriptServer:
    """The primary, secondary or real-time interface, of which only scripts are accepted."""

    def __init__(self, controller: SimulatedController) -> None:
        self._controller = controller

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Run each script that the client sends: everything up to a line "end" without indentation."""
        waiting = bytearray()
        try:
            while received := await reader.read(65_536):
                waiting += received
                while (at := waiting.find(SCRIPT_END)) >= 0:
                    script = waiting[: at + len(SCRIPT_END)].decode(errors="replace")
                    del waiting[: at + len(SCRIPT_END)]
                    self._controller.load_script(script)
                if len(waiting) > 1_000_000:
                    break
        except ConnectionError:
            pass
        finally:
            writer.close()


class RobotiqServer:
    """The socket of the Robotiq URCap: `SET name value …` and `GET name`; fingers take time to move.

    An object stops the fingers at `object_at`, a position from 0 (open) to 255 (closed).
    """

    FULL_STROKE_S = 0.4

    def __init__(self, controller: SimulatedController) -> None:
        self.variables = dict.fromkeys(("ACT", "GTO", "ATR", "FOR", "SPE", "POS", "PRE", "FLT"), 0)
        self.object_at: int | None = None
        self._position = 0.0
        self._controller = controller
        controller.on_cycle.append(self._move)

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one client."""
        await _serve_lines(reader, writer, self._answer)

    async def _answer(self, line: str) -> str:
        match line.split():
            case ["SET", *pairs] if pairs and len(pairs) % 2 == 0:
                return self._set(dict(zip(pairs[::2], pairs[1::2], strict=True)))
            case ["GET", name] if name in {*self.variables, "STA", "OBJ"}:
                return f"{name} {self._get(name)}"
            case _:
                return "?"

    def _set(self, assignments: Mapping[str, str]) -> str:
        if not all(name in self.variables and value.isdigit() for name, value in assignments.items()):
            return "?"
        self.variables.update({name: min(int(value), 255) for name, value in assignments.items()})
        self.variables["PRE"] = self.variables["POS"]
        return "ack"

    def _get(self, name: str) -> int:
        match name:
            case "POS":
                return round(self._position)
            case "STA":
                return 3 if self.variables["ACT"] else 0
            case "OBJ":
                return self._object()
            case _:
                return self.variables[name]

    def _object(self) -> int:
        requested = self.variables["PRE"]
        if round(self._position) == requested:
            return 3
        if self.object_at is not None and round(self._position) == self.object_at < requested:
            return 2
        return 0

    def _move(self) -> None:
        if not (self.variables["ACT"] and self.variables["GTO"]):
            return
        requested = float(self.variables["PRE"])
        step = 255.0 / self.FULL_STROKE_S * self._controller.cycle_s
        moved = self._position + min(max(requested - self._position, -step), step)
        if self.object_at is not None and self._position <= self.object_at < moved:
            moved = float(self.object_at)
        self._position = moved


async def _serve_lines(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, answer: Callable[[str], Awaitable[str]]
) -> None:
    with suppress(ConnectionError, ValueError, asyncio.LimitOverrunError):
        while line := await reader.readline():
            if len(line) > MAX_LINE_BYTES:
                break
            writer.write(f"{await answer(line.decode(errors='replace'))}\n".encode())
            await writer.drain()
    writer.close()
