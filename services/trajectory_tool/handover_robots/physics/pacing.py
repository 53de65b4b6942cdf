"""The stepping thread of a simulation: it steps the world, and runs the control cycles of all its robots.

Work of a robot is a generator that yields the simulated time at which it continues. Before each step, the
thread resumes the work that is due, in the order of the names of the robots; so what the robots command does
not depend on the scheduling of threads. A robot does one work after the other.

At a pace of 1 a simulated second takes a second, at 2 half of it; the simulation also runs while no robot
works. Without a pace it runs only while one works, as fast as it can: then it does not depend on the wall
clock, and the same commands give the same result.
"""

import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from threading import Condition, Thread
from typing import Any, TypeVar

from handover.messages import message
from handover.runtime.control_cycle import runs_in_cycle
from handover.telemetry import get_logger
from handover_robots.driver_base.control_thread import Cycles
from handover_robots.metrics import SIMULATED_SECONDS, SIMULATION_CPU_SECONDS
from handover_robots.model.faults import RobotFault
from handover_robots.physics.robot_bodies import STEP_S
from handover_robots.physics.simulation import Simulation

log = get_logger(__name__)

T = TypeVar("T")

MAX_LAG_S = 0.1
"""A simulation that is slower than its pace by more than this does not catch up."""

IDLE_EVERY_S = 0.03
"""How often the simulation catches up while no robot works."""


@dataclass(slots=True)
class _PacedWork:
    cycles: Cycles[Any]
    done: Future[Any]
    is_paced: bool
    due_s: float = 0.0


class PacedSimulation:
    """A simulation that runs at `pace` simulated seconds in a second, or freely for None.

    The thread runs while there is work, and between `start` and `stop`.
    """

    def __init__(self, simulation: Simulation, pace: float | None) -> None:
        self.simulation = simulation
        self._pace = pace
        self.on_step: Callable[[], None] = lambda: None
        """Called in the thread after each step for a robot that waits; it must not fail."""
        self._changed = Condition()
        self._works: dict[str, deque[_PacedWork]] = {}
        self._thread: Thread | None = None
        self._users = 0
        self._resync()

    def start(self) -> None:
        """Simulate from now on, also while no robot works."""
        with self._changed:
            self._users += 1
            self._require_thread()

    def stop(self) -> None:
        """Undo a `start`."""
        with self._changed:
            self._users -= 1
            self._changed.notify_all()

    def submit(self, robot: str, cycles: Cycles[T], *, is_paced: bool = True) -> "Future[T]":
        """Do work of a robot after its work before.

        While nothing but work without pace is done, the simulation is as fast as it can.
        """
        done: Future[T] = Future()
        with self._changed:
            self._works.setdefault(robot, deque()).append(_PacedWork(cycles, done, is_paced))
            self._require_thread()
            self._changed.notify_all()
        return done

    def drain(self, robot: str) -> None:
        """Wait for the end of all work of a robot."""
        with self._changed:
            self._changed.wait_for(lambda: not self._works.get(robot))

    def _require_thread(self) -> None:
        if self._thread is None:
            self._resync()
            self._thread = Thread(target=self._run, name="simulation", daemon=True)
            self._thread.start()

    def _run(self) -> None:
        try:
            self._work()
        except Exception as error:
            log.exception("simulation ended")
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        """End all work with a fault of the robot; the next work starts the simulation again."""
        why = message("robot.simulation_ended", "the simulation has ended: {reason}", reason=str(error))
        with self._changed:
            failed = [work for queue in self._works.values() for work in queue]
            self._works.clear()
            self._thread = None
            self._changed.notify_all()
        for work in failed:
            work.cycles.close()
            work.done.set_exception(RobotFault(why))

    def _work(self) -> None:
        while True:
            with self._changed:
                works = [(robot, queue[0]) for robot, queue in sorted(self._works.items()) if queue]
                if not works:
                    if not self._users:
                        self._thread = None
                        return
                    self._changed.wait(None if self._pace is None else IDLE_EVERY_S)
            if works:
                self._cycle(works)
            else:
                self._catch_up()

    @runs_in_cycle
    def _cycle(self, works: list[tuple[str, _PacedWork]]) -> None:
        """Resume the work that is due, and simulate a step if a robot waits for it."""
        now_s = self.simulation.time_s
        waiting = [
            work
            for robot, work in works
            if work.due_s > now_s + STEP_S / 2 or not self._has_ended(robot, work)
        ]
        if waiting:
            self._simulate(STEP_S)
            self.on_step()
            self._keep_pace(is_paced=any(work.is_paced for work in waiting))

    @runs_in_cycle
    def _has_ended(self, robot: str, work: _PacedWork) -> bool:
        """Resume work until it waits again; return whether it has ended."""
        try:
            work.due_s = next(work.cycles)
        except StopIteration as end:
            self._forget(robot)
            work.done.set_result(end.value)
        except BaseException as error:  # noqa: BLE001 - the caller of `submit` receives it
            self._forget(robot)
            work.done.set_exception(error)
        else:
            return False
        return True

    @runs_in_cycle
    def _forget(self, robot: str) -> None:
        with self._changed:
            self._works[robot].popleft()
            self._changed.notify_all()

    @runs_in_cycle
    def _simulate(self, seconds: float) -> None:
        began, began_s = time.thread_time(), self.simulation.time_s
        self.simulation.step_for(seconds)
        SIMULATION_CPU_SECONDS.inc(time.thread_time() - began)
        SIMULATED_SECONDS.inc(max(self.simulation.time_s - began_s, 0.0))

    def _keep_pace(self, *, is_paced: bool) -> None:
        """Wait as long as the simulated time takes at the pace."""
        if self._pace is None:
            return
        ahead_s = (self.simulation.time_s - self._began_s) / self._pace - (time.monotonic() - self._began_at)
        if not is_paced or ahead_s < -MAX_LAG_S:
            self._resync()
        elif ahead_s > 0:
            time.sleep(ahead_s)

    def _catch_up(self) -> None:
        """Simulate the time since the last work; what is more than `MAX_LAG_S` is left out."""
        if self._pace is None:
            return
        behind_s = (time.monotonic() - self._began_at) * self._pace - (self.simulation.time_s - self._began_s)
        if behind_s > MAX_LAG_S * self._pace:
            self._resync()
        elif behind_s > STEP_S:
            self._simulate(behind_s)

    def _resync(self) -> None:
        """Keep the pace from now on, after the simulation has jumped ahead or fell behind."""
        self._began_s, self._began_at = self.simulation.time_s, time.monotonic()
