"""The simulated operator: a hand in a glove that does what the Tasks ask for, started from the page.

It is a process of its own, the same that the demonstration starts, and never outlives this server.
"""

import asyncio
import os
import re
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Final, Self

import httpx

from handover.errors import Problem
from handover.messages import message
from handover.retry import Backoff
from handover.settings import LIFELINE
from handover.telemetry import get_logger
from webui.events import EventLog, Happening, now
from webui.settings import CONTROLLER, WebuiSettings
from webui.world import World

log = get_logger(__name__)

FIRST_GLOVE: Final = "glove-1"
GLOVE_NAME: Final = re.compile(r"^[A-Za-z0-9._-]{1,64}$")
NO_USE: Final = 2
"""What it ends with when starting it again would not help."""
STOP_WITHIN_S: Final = 2.0
INITIAL_RESTART_S, MAX_RESTART_S = 0.2, 5.0


class SimulatedOperator:
    """At most one, for one glove; an asynchronous context manager while it may run."""

    def __init__(
        self, settings: WebuiSettings, http: httpx.AsyncClient, world: World, events: EventLog
    ) -> None:
        self._settings = settings
        self._http = http
        self._world = world
        self._events = events
        self._glove = FIRST_GLOVE
        self._detail: str | None = None
        self._process: asyncio.subprocess.Process | None = None
        self._watcher: asyncio.Task[None] | None = None
        self._changing = asyncio.Lock()

    async def __aenter__(self) -> Self:
        self._tell()
        return self

    async def __aexit__(self, *_: object) -> None:
        async with self._changing:
            await self._end()

    @property
    def running(self) -> bool:
        """Say whether it runs, or is about to run again."""
        return self._watcher is not None and not self._watcher.done()

    def view(self) -> dict[str, Any]:
        """Return the operator as pages get it."""
        return {"running": self.running, "glove": self._glove, "detail": self._detail}

    async def start(self, glove: str) -> dict[str, Any]:
        """Put the glove on and begin.

        Raises `Problem`: 400 for a name that no glove has, 409 if one runs or somebody wears the glove.
        """
        if not GLOVE_NAME.match(glove):
            raise Problem(
                400,
                "No such name",
                message("page.no_such_name", 'a glove is named by 1 to 64 letters, digits, ".", "_" or "-"'),
            )
        async with self._changing:
            if self.running:
                raise Problem(
                    409,
                    "Operator at work",
                    message(
                        "page.operator_at_work",
                        "the simulated operator wears {glove}; stop it first to start it with {wanted}",
                        glove=self._glove,
                        wanted=glove,
                    ),
                )
            if await self._is_worn(glove):
                raise Problem(
                    409,
                    "Glove in use",
                    message(
                        "page.glove_in_use",
                        "{glove} is connected, so somebody wears it; take it off first, or choose "
                        "another glove",
                        glove=glove,
                    ),
                )
            self._glove, self._detail = glove, None
            self._watcher = asyncio.create_task(self._keep_running())
            self._say("started", f"the simulated operator puts on {glove}")
            self._tell()
            return self.view()

    async def stop(self) -> dict[str, Any]:
        """Take the glove off; does nothing if it is not worn."""
        async with self._changing:
            if self.running:
                await self._end()
                self._detail = None
                self._say("stopped", f"the simulated operator takes off {self._glove}")
                self._tell()
            return self.view()

    async def _is_worn(self, glove: str) -> bool:
        url = self._settings.service_urls[CONTROLLER]
        with suppress(httpx.HTTPError, ValueError):
            answer = await self._http.get(f"{url}/gloves/{glove}", timeout=2.0)
            return answer.is_success and bool(answer.json().get("connected"))
        return False  # the operator waits for a controller that is away

    async def _keep_running(self) -> None:
        backoff = Backoff(INITIAL_RESTART_S, MAX_RESTART_S)
        clock = asyncio.get_running_loop().time
        while True:
            began_s = clock()
            code = await self._run()
            log.warning("simulated operator ended", code=code, said=self._detail)
            if code == NO_USE:
                self._say("failed", f"the simulated operator cannot work: {self._detail}", "attention")
                self._watcher = None
                self._tell()
                return
            if clock() - began_s > MAX_RESTART_S:
                backoff.reset()
            self._tell()
            await backoff.wait()

    async def _run(self) -> int:
        environment = {**os.environ, LIFELINE: "1", "PYTHONUNBUFFERED": "1"}
        if self._settings.glove_token is not None:
            environment["HANDOVER_GLOVE_TOKEN"] = self._settings.glove_token.get_secret_value()
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
            log.info("simulated operator", said=line)
            self._tell()
        return await process.wait()

    def _command(self) -> Sequence[str]:
        settings = self._settings
        return [
            sys.executable, "-m", "glove_sdk_bridge", "simulate",
            "--host", settings.gloves_awaited_at,
            "--port", str(settings.glove_port),
            "--controller", settings.service_urls[CONTROLLER],
            "--glove", self._glove,
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
            async with asyncio.timeout(STOP_WITHIN_S):
                await process.wait()
        except TimeoutError:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()

    def _tell(self) -> None:
        self._world.tell("operator", self.view())

    def _say(self, act: str, text: str, level: Any = "info") -> None:
        at = now()
        self._events.record(
            Happening(
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
    """Return the next line that says something, empty at the end; of a line that is too long, nothing."""
    while True:
        try:
            line = await stream.readline()
        except ValueError:
            continue
        if not line or line.strip():
            return line.decode(errors="replace").strip()
