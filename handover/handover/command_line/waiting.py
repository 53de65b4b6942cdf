"""Waiting for files that another command makes, before a service starts: secrets, certificates, tokens.

In containers, `handover secrets make` or `handover secure` may run at the same time.
"""

import os
import time
from collections.abc import Iterable
from pathlib import Path

from handover.command_line.secrets import SECRETS
from handover.errors import UsageError
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.settings import PREFIX, SECRETS_DIR

READY_TIMEOUT_S = 60.0
CHECK_EVERY_S = 0.1


def wait_for_secrets(settings: Iterable[str], *, timeout_s: float = READY_TIMEOUT_S) -> None:
    """Wait until the secrets exist that the environment names without a value, among `settings`.

    So a container names what is mounted in it, and waits for nothing else. `handover secrets make` may run at
    the same time. Returns at once without `HANDOVER_SECRETS_DIR`. Raises `UsageError` after the timeout.
    """
    folder = os.environ.get(SECRETS_DIR)
    deadline_s = time.monotonic() + timeout_s
    needed = {f"{PREFIX}{name}".upper() for name in settings}
    for name in SECRETS if folder else ():
        if name in needed and os.environ.get(name) == "":
            file = Path(folder or "") / name
            _wait_for(file, deadline_s, f"there is no secret {file}", "handover secrets make")


def wait_for_security(*settings: str, timeout_s: float = READY_TIMEOUT_S) -> None:
    """Wait until the files in these settings, authority, token and the keys of accounts exist.

    It does not wait for a setting without a value. In containers `handover secure` may run at the same
    time. Raises `UsageError` after the timeout.
    """
    names = (*settings, "HANDOVER_TLS_AUTHORITY", "HANDOVER_SERVICE_TOKEN_FILE")
    files = {name: Path(value) for name in names if (value := os.environ.get(name))}
    security = os.environ.get("HANDOVER_SECURITY_DIR")
    if security:
        files["HANDOVER_SECURITY_DIR"] = Path(security) / PUBLIC_KEYS_FILE
    deadline_s = time.monotonic() + timeout_s
    for name, file in files.items():
        fault = f"{name} is {os.environ[name]}, and there is no file {file}"
        _wait_for(file, deadline_s, fault, "handover secure")


def _wait_for(file: Path, deadline_s: float, fault: str, command: str) -> None:
    """Wait until a file exists; raise `UsageError` with the command that makes it after the deadline."""
    while not file.exists():
        if time.monotonic() > deadline_s:
            raise UsageError(f"{fault}; make it with: {command} (containers: docker compose up init)")
        time.sleep(CHECK_EVERY_S)
