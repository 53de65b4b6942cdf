"""The control thread of a cell: it runs the control cycles of several robots, each at its time.

Work of a robot is a generator that yields the monotonic time at which it continues. A robot does one work
after the other. With a thread for each robot, the interpreter lock passes between them in every cycle, and
each wake-up costs as much as a cycle computes; here one wake-up serves all robots, whose cycles are due at
the same times (`CyclicRobot`). Work must not block: what takes long is done before it is submitted.
"""

import heapq
import itertools
import time
from collections import deque
from collections.abc import Generator
from concurrent.futures import Future
from dataclasses import dataclass
from threading import Condition, Thread
from typing import Any, TypeVar

from handover.runtime.control_cycle import runs_in_cycle

T = TypeVar("T")

Cycles = Generator[float, None, T]
"""Work in control cycles: it yields the time on the clock of the robot at which it continues."""

IDLE_S = 5.0
"""The thread ends after this time without work."""


@dataclass(slots=True)
class _CyclicWork:
    cycles: Cycles[Any]
    done: "Future[Any]"


class ControlThread:
    """One thread, which runs while there is work."""

    def __init__(self) -> None:
        self._changed = Condition()
        self._works: dict[str, deque[_CyclicWork]] = {}
        self._due: list[tuple[float, int, str]] = []
        """The next time of each robot with work, as a heap."""
        self._numbers = itertools.count()
        self._thread: Thread | None = None

    def submit(self, robot: str, cycles: Cycles[T]) -> "Future[T]":
        """Do work of a robot after its work before."""
        done: Future[T] = Future()
        with self._changed:
            works = self._works.setdefault(robot, deque())
            works.append(_CyclicWork(cycles, done))
            if len(works) == 1:
                self._schedule(robot, time.monotonic())
            if self._thread is None:
                self._thread = Thread(target=self._run, name="cell-control", daemon=True)
                self._thread.start()
            self._changed.notify_all()
        return done

    def drain(self, robot: str) -> None:
        """Wait for the end of all work of a robot."""
        with self._changed:
            self._changed.wait_for(lambda: not self._works.get(robot))

    @runs_in_cycle
    def _schedule(self, robot: str, due_s: float) -> None:
        heapq.heappush(self._due, (due_s, next(self._numbers), robot))

    @runs_in_cycle
    def _run(self) -> None:
        while (robot := self._next()) is not None:
            work = self._works[robot][0]
            try:
                due_s = next(work.cycles)
            except StopIteration as end:
                self._finish(robot)
                work.done.set_result(end.value)
            except BaseException as error:  # noqa: BLE001 - it belongs to who waits for the work
                self._finish(robot)
                work.done.set_exception(error)
            else:
                with self._changed:
                    self._schedule(robot, due_s)

    @runs_in_cycle
    def _next(self) -> str | None:
        """Wait until work is due, and return its robot; None when there was none for some time."""
        with self._changed:
            while True:
                if not self._due:
                    if not self._changed.wait(IDLE_S) and not self._due:
                        self._thread = None
                        return None
                elif (wait_s := self._due[0][0] - time.monotonic()) > 0:
                    self._changed.wait(wait_s)
                else:
                    return heapq.heappop(self._due)[2]

    @runs_in_cycle
    def _finish(self, robot: str) -> None:
        with self._changed:
            works = self._works[robot]
            works.popleft()
            if works:
                self._schedule(robot, time.monotonic())
            self._changed.notify_all()
