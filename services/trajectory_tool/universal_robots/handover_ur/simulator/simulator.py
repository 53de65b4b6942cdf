"""The simulated controller as a server: interfaces on one address, and control cycles in real time."""

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, fields
from typing import Self

from handover_ur.simulator.controller import SimulatedController
from handover_ur.simulator.servers import (
    DashboardServer,
    RobotiqServer,
    RtdeServer,
    ScriptServer,
)

END_TIMEOUT_S = 1.0

Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


@dataclass(frozen=True, slots=True)
class Ports:
    """The ports of a controller; the defaults are those of a real one."""

    rtde: int = 30004
    dashboard: int = 29999
    script: int = 30002
    robotiq: int = 63352


class Simulator:
    """An asynchronous context manager while it listens and its cycles run.

    A late cycle is not made up for: the controller's time then runs slower than the clock. With `max_wait_s`,
    each cycle also waits so long for the inputs of the clients. Then a busy machine does not let watchdogs
    expire.
    """

    def __init__(
        self,
        controller: SimulatedController,
        host: str,
        ports: Ports | None = None,
        *,
        max_wait_s: float = 0.0,
    ) -> None:
        self.controller = controller
        self.rtde = RtdeServer(controller)
        self.robotiq = RobotiqServer(controller)
        self.script = ScriptServer(controller)
        self.dashboard = DashboardServer(controller)
        self.host = host
        self.ports = ports or Ports()
        self._servers: list[asyncio.Server] = []
        self._clients: dict[asyncio.Task[None], asyncio.StreamWriter] = {}
        self._cycles: asyncio.Task[None] | None = None
        self._max_wait_s = max_wait_s

    async def __aenter__(self) -> Self:
        for field in fields(Ports):
            serve = self._tracked(getattr(self, field.name).serve)
            port = getattr(self.ports, field.name)
            self._servers.append(await asyncio.start_server(serve, self.host, port))
        self._cycles = asyncio.create_task(self._run())
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._cycles is not None  # noqa: S101 - set on entry
        self._cycles.cancel()
        for server in self._servers:
            server.close()
        for writer in self._clients.values():
            writer.transport.abort()
        if self._clients:
            await asyncio.wait(self._clients, timeout=END_TIMEOUT_S)

    def _tracked(self, serve: Serve) -> Serve:
        async def serve_client(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            task = asyncio.current_task()
            assert task is not None  # noqa: S101 - this is a coroutine of a task
            self._clients[task] = writer
            try:
                await serve(reader, writer)
            finally:
                del self._clients[task]

        return serve_client

    async def restart(self, off_s: float) -> None:
        """Restart the controller: connections end, and the arm is powered off afterwards."""
        self.controller.power_off()
        self.rtde.refuses = True
        self.rtde.drop_clients()
        await asyncio.sleep(off_s)
        self.rtde.refuses = False

    async def _run(self) -> None:
        cycle_s, due_s = self.controller.cycle_s, time.monotonic()
        step: Callable[[], None] = self.controller.step
        while True:
            step()
            if self._max_wait_s:
                await self.rtde.await_inputs(self._max_wait_s)
            due_s += cycle_s
            now_s = time.monotonic()
            if now_s > due_s + cycle_s:
                due_s = now_s
            await asyncio.sleep(max(due_s - now_s, 0.0))
