"""The simulated operator: a process that wears a glove and answers Tasks, started from the page.

It is the same program that the demonstration starts. It ends with this server.
"""

import asyncio
import os
import re
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Final, Self

import httpx

from handover.errors import Problem, UsageError
from handover.messages import message
from handover.runtime.python_processes import module_command
from handover.runtime.retry import Backoff
from handover.security.glove_token import site_glove_token
from handover.security.service_access import ServiceAccess
from handover.service_addresses import GESTURE_CONTROLLER
from handover.settings import LIFELINE
from handover.telemetry import get_logger
from handover_web.live.event_log import Event, EventLog, timestamp
from handover_web.live.live_state import LiveState
from handover_web.live.views import OperatorView
from handover_web.settings import WebuiSettings

log = get_logger(__name__)

DEFAULT_GLOVE: Final = "glove-1"
GLOVE_NAME: Final = re.compile(r"^[A-Za-z0-9._-]{1,64}$")
EXIT_NO_RETRY: Final = 2
"""The exit status when a restart would not help."""
STOP_TIMEOUT_S: Final = 2.0
INITIAL_RESTART_S, MAX_RESTART_S = 0.2, 5.0


class SimulatedOperator:
    """At most one process, for one glove; an asynchronous context manager."""

    def __init__(
        self,
        settings: WebuiSettings,
        http: httpx.AsyncClient,
        access: ServiceAccess,
        state: LiveState,
        events: EventLog,
    ) -> None:
        self._settings = settings
        self._access = access
        self._http = http
        self._state = state
        self._events = events
        self._glove = DEFAULT_GLOVE
        self._detail: str | None = None
        self._process: asyncio.subprocess.Process | None = None
        self._watcher: asyncio.Task[None] | None = None
        self._changing = asyncio.Lock()

    async def __aenter__(self) -> Self:
        self._publish()
        return self

    async def __aexit__(self, *_: object) -> None:
        async with self._changing:
            await self._end()

    @property
    def is_running(self) -> bool:
        """Whether it runs, or is about to be restarted."""
        return self._watcher is not None and not self._watcher.done()

    def view(self) -> OperatorView:
        """Return the operator as sent to pages."""
        return {"running": self.is_running, "glove": self._glove, "detail": self._detail}

    async def start(self, glove: str) -> OperatorView:
        """Start the process for `glove`.

        Raises `Problem`: 400 for an invalid name, 409 if it is running or the glove is in use.
        """
        if not GLOVE_NAME.match(glove):
            raise Problem(
                400,
                "No such name",
                message(
                    "page.no_such_name", 'a glove name consists of 1 to 64 of a-z, A-Z, 0-9, ".", "_" or "-"'
                ),
            )
        async with self._changing:
            if self.is_running:
                raise Problem(
                    409,
                    "Operator at work",
                    message(
                        "page.operator_at_work",
                        "the simulated operator is running with {glove}; stop it before you start it "
                        "with {wanted}",
                        glove=self._glove,
                        wanted=glove,
                    ),
                )
            if await self._is_in_use(glove):
                raise Problem(
                    409,
                    "Glove in use",
                    message(
                        "page.glove_in_use",
                        "{glove} is connected, so a person may be wearing it; disconnect it, or choose "
                        "another glove",
                        glove=glove,
                    ),
                )
            self._glove, self._detail = glove, None
            self._watcher = asyncio.create_task(self._keep_running())
            self._record("started", f"simulated operator started with {glove}")
            self._publish()
            return self.view()

    async def stop(self) -> OperatorView:
        """Stop the process; has no effect if it is not running."""
        async with self._changing:
            if self.is_running:
                await self._end()
                self._detail = None
                self._record("stopped", f"simulated operator with {self._glove} stopped")
                self._publish()
            return self.view()

    async def _is_in_use(self, glove: str) -> bool:
        url = self._settings.service_urls[GESTURE_CONTROLLER]
        with suppress(httpx.HTTPError, ValueError):
            response = await self._http.get(f"{url}/gloves/{glove}", timeout=2.0)
            return response.is_success and bool(response.json().get("connected"))
        return False  # the process waits for an unreachable controller

    async def _keep_running(self) -> None:
        backoff = Backoff(INITIAL_RESTART_S, MAX_RESTART_S)
        clock = asyncio.get_running_loop().time
        while True:
            began_s = clock()
            code = await self._run()
            log.warning("simulated operator ended", code=code, output=self._detail)
            if code == EXIT_NO_RETRY:
                self._record("failed", f"simulated operator failed: {self._detail}", "attention")
                self._watcher = None
                self._publish()
                return
            if clock() - began_s > MAX_RESTART_S:
                backoff.reset()
            self._publish()
            await backoff.wait()

    async def _run(self) -> int:
        environment = {**os.environ, LIFELINE: "1", "PYTHONUNBUFFERED": "1"}
        glove_token = site_glove_token(self._settings.glove_token, self._settings.security_folder)
        if glove_token is not None:
            environment["HANDOVER_GLOVE_TOKEN"] = glove_token
        with suppress(UsageError):  # without a token the process reports that it is refused
            access_token = self._access.secret_token()
            if access_token is not None:
                environment["HANDOVER_SERVICE_TOKEN"] = access_token
        if self._settings.tls_authority is not None:
            environment["HANDOVER_TLS_AUTHORITY"] = str(self._settings.tls_authority)
        self._process = process = await asyncio.create_subprocess_exec(
            *self._command(),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
            env=environment,
            start_new_session=True,
        )
        assert process.stderr is not None  # noqa: S101 - it was asked for
        while line := await _line(process.stderr):
            self._detail = line.removeprefix("glove: ")
            log.info("simulated operator", output=line)
            self._publish()
        return await process.wait()

    def _command(self) -> Sequence[str]:
        settings = self._settings
        return [
            *module_command("glove_sdk_bridge"), "simulate",
            "--host", settings.glove_server_host,
            "--port", str(settings.glove_port),
            "--controller", settings.service_urls[GESTURE_CONTROLLER],
            "--glove", self._glove,
            "--tls" if settings.expects_tls(settings.glove_server_host) else "--no-tls",
        ]  # fmt: skip

    async def _end(self) -> None:
        watcher, process = self._watcher, self._process
        self._watcher = self._process = None
        if watcher is not None:
            watcher.cancel()
            await asyncio.wait({watcher})
        if process is None or process.returncode is not None:
            return
        with suppress(ProcessLookupError):
            process.terminate()
        try:
            async with asyncio.timeout(STOP_TIMEOUT_S):
                await process.wait()
        except TimeoutError:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()

    def _publish(self) -> None:
        self._state.publish("operator", self.view())

    def _record(self, act: str, text: str, level: Any = "info") -> None:
        at = timestamp()
        self._events.record(
            Event(
                subject="operator",
                mark=f"{act}@{at}",
                key=f"operator.{act}",
                source=self._glove,
                text=text,
                at=at,
                level=level,
                values={"glove": self._glove, "detail": self._detail or ""},
            )
        )


async def _line(stream: asyncio.StreamReader) -> str:
    """Return the next non-empty line, "" at the end; lines that are too long are skipped."""
    while True:
        try:
            line = await stream.readline()
        except ValueError:
            continue
        if not line or line.strip():
            return line.decode(errors="replace").strip()
