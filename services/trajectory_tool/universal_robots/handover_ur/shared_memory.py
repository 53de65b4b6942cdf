"""The memory that the trajectory tool and its exchange process share: the last command and the last report.

Each has one writer. When the checksum differs, the writer was not finished, and the reader reads again.
"""

import mmap
import os
import struct
import tempfile
import zlib
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any, NamedTuple

from handover_ur.states import ExchangeMode

ZEROS = (0.0,) * 6
_REASON_BYTES = 240
_MAX_ATTEMPTS = 1000
_CHECKSUM = struct.Struct("=I")


class Interruption(IntEnum):
    """Why the exchange process has stopped a motion; it holds until the tool ends the motion."""

    NONE = 0
    STALLED = 1
    STOPPED = 2


class Command(NamedTuple):
    """What the tool commands; times on the monotonic clock in s."""

    stamp_s: float = 0.0
    mode: ExchangeMode = ExchangeMode.HOLD
    program_id: int = 0
    positions: tuple[float, ...] = ZEROS
    velocities: tuple[float, ...] = ZEROS
    accelerations: tuple[float, ...] = ZEROS
    tool_output_mask: int = 0
    tool_outputs: int = 0


@dataclass(frozen=True, slots=True)
class Report:
    """What the controller has reported; `stamp_s` on the monotonic clock, `wall_s` since 1970, both in s."""

    stamp_s: float = 0.0
    wall_s: float = 0.0
    is_connected: bool = False
    connections: int = 0
    controller_s: float = 0.0
    positions: tuple[float, ...] = ZEROS
    velocities: tuple[float, ...] = ZEROS
    torques: tuple[float, ...] = ZEROS
    """The torques of the joints in Nm that the controller computes (`target_moment`)."""
    robot_mode: int = -1
    safety_status: int = 0
    runtime_state: int = 0
    program_state: int = 0
    program_id: int = 0
    speed_fraction: float = 1.0
    speed_slider: float = 1.0
    digital_inputs: int = 0
    digital_outputs: int = 0
    interruption: int = 0
    frequency_hz: float = 0.0
    skipped_cycles: int = 0
    lag_rad: float = 0.0
    """How far the joint targets are behind the setpoints, at most."""
    wrist_force_n: float = 0.0
    reason: str = ""


class Record:
    """One value in shared memory, with a checksum."""

    def __init__(self, memory: mmap.mmap, offset: int, layout: struct.Struct) -> None:
        self._memory = memory
        self._offset = offset
        self._layout = layout

    @property
    def end(self) -> int:
        """Return the offset behind the record."""
        return self._offset + self._layout.size + _CHECKSUM.size

    def write(self, *values: Any) -> None:
        """Replace the value."""
        content = self._layout.pack(*values)
        self._memory[self._offset : self.end] = content + _CHECKSUM.pack(zlib.crc32(content))

    def read(self) -> tuple[Any, ...]:
        """Return the last complete value. Raises `OSError` when the writer has died while it wrote."""
        for _ in range(_MAX_ATTEMPTS):
            raw = self._memory[self._offset : self.end]
            content = raw[: self._layout.size]
            if _CHECKSUM.unpack_from(raw, self._layout.size)[0] == zlib.crc32(content):
                return self._layout.unpack(content)
        raise OSError("the shared memory has an incomplete record")


_COMMAND = struct.Struct("=dii18dii")
_REPORT = struct.Struct(f"=dd?Id18diiiiiddQQidQdd{_REASON_BYTES}s")


class SharedMemory:
    """The command and the report; `descriptor` is inherited by the exchange process."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, SIZE_BYTES)
        self._command = Record(self._memory, 0, _COMMAND)
        self._report = Record(self._memory, self._command.end, _REPORT)

    @classmethod
    def create(cls) -> "SharedMemory":
        """Return new memory without a name, with an initial command and report."""
        if hasattr(os, "memfd_create"):
            descriptor = os.memfd_create("handover-ur")
        else:
            with tempfile.TemporaryFile() as file:
                descriptor = os.dup(file.fileno())
        os.ftruncate(descriptor, SIZE_BYTES)
        memory = cls(descriptor)
        memory.write_command(Command())
        memory.write_report(Report())
        return memory

    def close(self) -> None:
        """Release the memory."""
        self._memory.close()
        os.close(self.descriptor)

    def write_command(self, command: Command) -> None:
        """Replace the command."""
        self._command.write(
            command.stamp_s,
            command.mode,
            command.program_id,
            *command.positions,
            *command.velocities,
            *command.accelerations,
            command.tool_output_mask,
            command.tool_outputs,
        )

    def read_command(self) -> Command:
        """Return the last command."""
        stamp_s, mode, program_id, *rest = self._command.read()
        q, qd, qdd = tuple(rest[:6]), tuple(rest[6:12]), tuple(rest[12:18])
        return Command(stamp_s, ExchangeMode(mode), program_id, q, qd, qdd, rest[18], rest[19])

    def write_report(self, report: Report) -> None:
        """Replace the report."""
        self._report.write(
            report.stamp_s,
            report.wall_s,
            report.is_connected,
            report.connections,
            report.controller_s,
            *report.positions,
            *report.velocities,
            *report.torques,
            report.robot_mode,
            report.safety_status,
            report.runtime_state,
            report.program_state,
            report.program_id,
            report.speed_fraction,
            report.speed_slider,
            report.digital_inputs,
            report.digital_outputs,
            report.interruption,
            report.frequency_hz,
            report.skipped_cycles,
            report.lag_rad,
            report.wrist_force_n,
            report.reason.encode()[:_REASON_BYTES],
        )

    def read_report(self) -> Report:
        """Return the last report."""
        values = self._report.read()
        flat = [*values[:5], values[5:11], values[11:17], values[17:23], *values[23:-1]]
        reason = values[-1].rstrip(b"\0").decode(errors="ignore")
        return Report(**dict(zip(_REPORT_FIELDS, [*flat, reason], strict=True)))


_REPORT_FIELDS = tuple(field.name for field in fields(Report))
SIZE_BYTES = _COMMAND.size + _REPORT.size + 2 * _CHECKSUM.size
