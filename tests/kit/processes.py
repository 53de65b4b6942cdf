"""Services as real processes: started, waited for, killed, stopped."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import httpx

from tests.kit import lifeline
from tests.kit.waiting import scaled, wait_for

MAX_LOG_EXCERPT = 3000


def clean_environment() -> dict[str, str]:
    """Return the environment without settings of Handover, which a developer's shell may contain."""
    return {name: value for name, value in os.environ.items() if not name.startswith("HANDOVER_")}


def module_command(module: str) -> list[str]:
    """Return the command that runs a module with this interpreter."""
    return [sys.executable, "-m", module]


def spawn(
    command: Sequence[str], environment: Mapping[str, str], log: Path, folder: Path
) -> subprocess.Popen[bytes]:
    """Start a process in `folder` that ends with the test run; its output is appended to `log`."""
    with log.open("ab") as output:
        return subprocess.Popen(
            list(command),
            env={**environment, **lifeline.ENVIRONMENT},
            cwd=folder,
            stdin=lifeline.STDIN,
            stdout=output,
            stderr=output,
        )


def answer(
    process: subprocess.Popen[bytes] | None, url: str, log: Callable[[], str]
) -> httpx.Response | None:
    """Return the answer of `url`, None while nothing listens; fail if the process has ended."""
    assert process is None or process.poll() is None, f"the process has ended: {log()[-MAX_LOG_EXCERPT:]}"
    try:
        return httpx.get(url, trust_env=False, timeout=scaled(5))
    except httpx.TransportError:
        return None


def wait_ready(
    process: subprocess.Popen[bytes] | None, url: str, log: Callable[[], str], within_s: float = 30.0
) -> None:
    """Wait until `url` answers with success."""

    def is_ready() -> bool:
        answered = answer(process, url, log)
        return answered is not None and answered.is_success

    wait_for(is_ready, within_s, lambda: f"{url} is not ready: {log()[-MAX_LOG_EXCERPT:]}")


def kill(process: subprocess.Popen[bytes]) -> None:
    """End a process as a power cut would."""
    process.send_signal(signal.SIGKILL)
    process.wait()


def stop(process: subprocess.Popen[bytes], within_s: float = 10.0) -> None:
    """End a process in good order; kill it and raise TimeoutExpired if it does not end in time."""
    process.terminate()
    try:
        process.wait(scaled(within_s))
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        raise
