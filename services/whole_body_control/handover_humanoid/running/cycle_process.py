"""The process of the control cycle: started, found again, watched, and stopped by the service.

How it works:

1. The service starts it in a session of its own, with its output in a file and nothing inherited, so that the
   end of the service, also by SIGKILL, does not reach it. The wish then gets old, and the robot stands.
2. A service that starts looks for the process that an earlier one has left: its id is in a file beside the
   ports, and counts only if that process has this deployment on its command line.
3. A process that ends by itself is reported, and started again only at the request of a person.
4. Ports that an ended process has left are removed before the next one starts: their layout may differ.
"""

import asyncio
import os
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import yaml

from handover.errors import Problem
from handover.messages import message
from handover.runtime.python_processes import module_command
from handover.settings import LIFELINE
from handover.telemetry import get_logger
from handover_humanoid.metrics import CYCLE_ENDS, CYCLE_RUNS
from handover_humanoid.settings import WholeBodySettings

log = get_logger(__name__)

MODULE: Final = "handover_humanoid.control_process"
POLL_S: Final = 0.1
STOP_WITHIN_S: Final = 1.5
"""Less than the launcher waits for the service; the process ends by itself once the robot stands."""
_ONE_THREAD: Final = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


class CycleProcess:
    """The control process of one humanoid. `problem` says why it does not run, "" while it does."""

    def __init__(self, settings: WholeBodySettings) -> None:
        self.folder = settings.ports_folder
        self.problem = "the control cycle has not been started yet"
        self.starts = 0
        """How often it was started or found; readers open their ports again when it changes."""
        self._settings = settings
        self._deployment = self.folder / "deployment.yaml"
        self._pid_file = self.folder / "control.pid"
        self._log = settings.data_dir.absolute() / "logs" / f"{settings.humanoid_name}-cycle.log"
        self._child: subprocess.Popen[bytes] | None = None
        self.pid: int | None = None

    @property
    def is_running(self) -> bool:
        """Whether the process exists."""
        if self._child is not None:
            return self._child.poll() is None
        return self.pid is not None and _runs(self.pid, self._deployment)

    def open(self) -> None:
        """Find the process that runs already, or start one."""
        pid = self._left_pid()
        if pid is None:
            self.start()
            return
        self.pid, self.problem = pid, ""
        self.starts += 1
        CYCLE_RUNS.set(1)
        log.info("control cycle found", pid=pid, folder=str(self.folder))

    def start(self) -> None:
        """Start the process. Raises `Problem` 409 while it runs."""
        if self.is_running:
            raise Problem.translated(
                409,
                "Control cycle runs",
                "humanoid.cycle_runs",
                "the control cycle runs; there is nothing to restart",
            )
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        for left in self.folder.iterdir():
            if left.is_file():
                left.unlink()
        self._deployment.write_text(yaml.safe_dump(self._written()), encoding="utf-8")
        self._log.parent.mkdir(parents=True, exist_ok=True)
        environment = {name: value for name, value in os.environ.items() if name != LIFELINE}
        with self._log.open("ab") as output:
            self._child = subprocess.Popen(  # noqa: S603 - our own module
                module_command(MODULE, str(self._deployment)),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                env={**_ONE_THREAD, **environment},
                start_new_session=True,
            )
        self.pid, self.problem = self._child.pid, ""
        self._pid_file.write_text(str(self.pid), encoding="utf-8")
        self.starts += 1
        CYCLE_RUNS.set(1)
        log.info("control cycle started", pid=self.pid, folder=str(self.folder))

    async def watch(self) -> None:
        """Report the end of the process, until cancelled."""
        while True:
            is_reported = bool(self.problem)
            if not is_reported and not self.is_running:
                status = None if self._child is None else self._child.returncode
                self.problem = message(
                    "humanoid.cycle_ended",
                    "the control cycle has ended ({status}); the log {log} may say why. A person restarts it",
                    status=_reason(status),
                    log=str(self._log),
                )
                CYCLE_ENDS.inc()
                CYCLE_RUNS.set(0)
                log.error("control cycle ended", pid=self.pid, status=status)
            await asyncio.sleep(POLL_S)

    async def stop(self, *, is_final: bool = False) -> None:
        """Let the robot stand and the process end; wait a short time for it.

        With `is_final` a process that is still there then is killed: nothing of the robot moves any more.
        """
        if not self.is_running or self.pid is None:
            return
        with suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGTERM)
        with suppress(TimeoutError):
            async with asyncio.timeout(STOP_WITHIN_S):
                while self.is_running:  # noqa: ASYNC110 - a process, no event
                    await asyncio.sleep(POLL_S / 2)
        if is_final and self.is_running:
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
            while self.is_running:  # noqa: ASYNC110 - a process, no event
                await asyncio.sleep(POLL_S / 2)
        CYCLE_RUNS.set(0)

    def _left_pid(self) -> int | None:
        """Return the id of the process that an earlier service has left, None without one."""
        try:
            pid = int(self._pid_file.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        if not _runs(pid, self._deployment):
            return None
        try:
            is_same = yaml.safe_load(self._deployment.read_text(encoding="utf-8")) == self._written()
        except (OSError, yaml.YAMLError):
            is_same = False
        if is_same:
            return pid
        log.warning("a control cycle of another deployment runs; it is stopped", pid=pid)
        os.kill(pid, signal.SIGKILL)  # simulated: nothing falls, and its ports are those of another robot
        while _runs(pid, self._deployment):
            time.sleep(POLL_S)
        return None

    def _written(self) -> dict[str, Any]:
        settings = self._settings
        return {
            "folder": str(self.folder),
            "fifo": settings.humanoid_fifo,
            "components": {
                "robot": {"kind": "mujoco", "humanoid": settings.model_name, "realtime": True},
                "walking": {
                    "kind": "walking",
                    "solver": "fastest",
                    "intention": settings.humanoid_intention,
                    "realtime": True,
                },
            },
        }


def _runs(pid: int, deployment: Path) -> bool:
    """Return whether the process `pid` is the control process of this deployment."""
    try:
        command = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    except OSError:
        return False
    return MODULE.encode() in command and str(deployment).encode() in command


def _reason(status: int | None) -> str:
    if status is None:
        return message("humanoid.exit_unknown", "its exit code is not known")
    if status < 0:
        return message("humanoid.exit_signal", "signal {name}", name=signal.Signals(-status).name)
    return message("humanoid.exit_code", "exit code {code}", code=status)
