"""A simulated controller of Universal Robots in a thread of its own, on free ports."""

import asyncio
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from handover_ur.simulator.controller import SimulatedController
from handover_ur.simulator.simulator import Ports, Simulator
from tests.kit.ports import next_free_port
from tests.kit.waiting import scaled

T = TypeVar("T")

HOST = "127.0.0.1"
MAX_WAIT_S = 1.0
"""The controller waits so long for the inputs of each cycle, as no real one does."""
PATIENT_S = 20.0
"""A watchdog that does not expire on a busy machine, for tests of something else."""


class RunningController:
    """The simulator while its thread runs; `do` calls a function there, between control cycles."""

    def __init__(self, simulator: Simulator, loop: asyncio.AbstractEventLoop) -> None:
        self.simulator = simulator
        self._loop = loop

    def call_soon(self, function: Callable[[], None]) -> None:
        """Call a function in the loop of the simulator; do not wait for it."""
        self._loop.call_soon_threadsafe(function)

    def do(self, function: Callable[[SimulatedController], T]) -> T:
        """Return what `function` returns for the controller."""

        async def call() -> T:
            return function(self.simulator.controller)

        return self.run(call())

    def run(self, asked: Awaitable[T]) -> T:
        """Return the result of a coroutine in the loop of the simulator."""

        async def awaited() -> T:
            return await asked

        return asyncio.run_coroutine_threadsafe(awaited(), self._loop).result(scaled(20))

    def options(self, **changes: Any) -> dict[str, Any]:
        """Return the options of the driver for this controller."""
        ports = self.simulator.ports
        return {
            "host": self.simulator.host,
            "rtde_port": ports.rtde,
            "dashboard_port": ports.dashboard,
            "script_port": ports.script,
            "robotiq_port": ports.robotiq,
            "watchdog_s": PATIENT_S,
            "silence_s": PATIENT_S,
            **changes,
        }


@contextmanager
def running_controller(controller: SimulatedController) -> Iterator[RunningController]:
    """Run a controller until the end of the context."""
    simulator = Simulator(
        controller, HOST, Ports(*(next_free_port() for _ in range(4))), max_wait_s=MAX_WAIT_S
    )
    running: list[RunningController] = []
    started, ended = threading.Event(), asyncio.Event()

    async def run() -> None:
        async with simulator:
            running.append(RunningController(simulator, asyncio.get_running_loop()))
            started.set()
            await ended.wait()

    thread = threading.Thread(target=asyncio.run, args=(run(),), name="ur-controller")
    thread.start()
    try:
        assert started.wait(scaled(10)), "the simulated controller has not started"
        yield running[0]
    finally:
        if running:
            running[0].call_soon(ended.set)
        thread.join()
