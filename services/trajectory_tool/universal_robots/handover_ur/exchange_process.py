"""The exchange process as seen from the trajectory tool: started, supervised, commanded."""

import asyncio
import os
import subprocess
import time
from contextlib import suppress
from dataclasses import replace
from threading import Lock

from handover.runtime.control_cycle import runs_in_cycle
from handover.runtime.python_processes import module_command
from handover.telemetry import get_logger
from handover_robots.model.trajectory import Limits, Setpoint
from handover_ur.exchange import ExchangeParameters
from handover_ur.options import UrOptions
from handover_ur.shared_memory import Command, Report, SharedMemory
from handover_ur.states import ExchangeMode, robot_mode, safety_status

log = get_logger(__name__)

CHECK_EVERY_S = 0.2
END_TIMEOUT_S = 3.0
RECOVERY_ACCELERATION = 2.0
"""After a gap the joints may accelerate so many times as much as the limits of motions allow."""


class ExchangeProcess:
    """The process and the memory shared with it; an asynchronous context manager while it runs."""

    def __init__(self, options: UrOptions, limits: Limits) -> None:
        self._options = options
        self._limits = limits
        self._lock = Lock()
        self._command = Command()
        self._memory: SharedMemory | None = None
        self._last_report = Report()
        self._process: subprocess.Popen[bytes] | None = None
        self._supervision: asyncio.Task[None] | None = None

    async def __aenter__(self) -> "ExchangeProcess":
        self._memory = SharedMemory.create()
        self._command = Command(stamp_s=time.monotonic())
        self._memory.write_command(self._command)
        self._start()
        self._supervision = asyncio.create_task(self._supervise())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._supervision is not None:
            self._supervision.cancel()
            with suppress(asyncio.CancelledError):
                await self._supervision
        await asyncio.to_thread(self._end)
        self._last_report = self.report()
        with self._lock:
            memory, self._memory = self._memory, None
            if memory is not None:
                memory.close()

    @property
    def pid(self) -> int | None:
        """Return the id of the process."""
        return None if self._process is None else self._process.pid

    def report(self) -> Report:
        """Return the last report; thread-safe."""
        with self._lock:
            if self._memory is not None:
                try:
                    self._last_report = self._memory.read_report()
                except OSError as error:  # the process has ended while it wrote
                    self._last_report = replace(self._last_report, is_connected=False, reason=str(error))
            return self._last_report

    @runs_in_cycle
    def servo(self, setpoint: Setpoint, program_id: int) -> None:
        """Command a setpoint to the program; thread-safe."""
        self._write(
            stamp_s=time.monotonic(),
            mode=ExchangeMode.SERVO,
            program_id=program_id,
            positions=setpoint.positions,
            velocities=setpoint.velocities,
            accelerations=setpoint.accelerations,
        )
        process = self._process
        if process is not None and process.stdin is not None:
            with suppress(OSError, ValueError):  # the pipe is full, or the process has ended
                process.stdin.write(b".")

    def hold(self) -> None:
        """End a motion: the joints stop if they move, and the program waits; thread-safe."""
        self._write(stamp_s=time.monotonic(), mode=ExchangeMode.HOLD)

    def set_tool_outputs(self, mask: int, outputs: int) -> None:
        """Set the tool outputs of `mask`; thread-safe."""
        self._write(tool_output_mask=mask, tool_outputs=outputs)

    def _write(self, **changes: object) -> None:
        with self._lock:
            self._command = self._command._replace(**changes)  # type: ignore[arg-type]
            if self._memory is not None:
                self._memory.write_command(self._command)

    def _start(self) -> None:
        memory = self._memory
        assert memory is not None  # noqa: S101 - created on entry
        parameters = ExchangeParameters(
            host=self._options.host,
            port=self._options.rtde_port,
            stall_s=self._options.watchdog_s,
            silence_s=self._options.silence_s,
            max_rad_s=self._limits.velocity,
            max_rad_s2=tuple(RECOVERY_ACCELERATION * limit for limit in self._limits.acceleration),
            memory=memory.descriptor,
        )
        self._process = subprocess.Popen(  # noqa: S603 - our own module
            module_command("handover_ur.exchange"),
            stdin=subprocess.PIPE,
            bufsize=0,
            pass_fds=[memory.descriptor],
        )
        assert self._process.stdin is not None  # noqa: S101 - a pipe
        self._process.stdin.write(parameters.as_line())
        os.set_blocking(self._process.stdin.fileno(), False)

    def _end(self) -> None:
        process = self._process
        if process is None or process.stdin is None:
            return
        with suppress(OSError):
            process.stdin.close()
        try:
            process.wait(END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    async def _supervise(self) -> None:
        """Start the process again when it has ended, and log what the controller reports."""
        seen: tuple[object, ...] = ()
        while True:
            await asyncio.sleep(CHECK_EVERY_S)
            process = self._process
            if process is not None and process.poll() is not None:
                assert process.stdin is not None  # noqa: S101 - a pipe
                process.stdin.close()
                log.error("exchange process ended", status=process.returncode, host=self._options.host)
                self._start()
            report = self.report()
            mode, safety = robot_mode(report.robot_mode), safety_status(report.safety_status)
            now = (report.is_connected, mode, safety, report.reason)
            if now != seen:
                seen = now
                log.info(
                    "controller state",
                    host=self._options.host,
                    connected=report.is_connected,
                    robot_mode=mode.name,
                    safety_status=safety.name,
                    reason=report.reason,
                )
