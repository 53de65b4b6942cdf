"""When the next cycle is due, and why one was late.

A cycle is late when it begins more than `LATE_S` after it was due. Its cause:

- `computing`: the cycle before used more CPU time than a period has;
- `preempted`: the cycle before took longer than a period, but did not have the processor for all of it;
- `woken late`: the cycle before was in time, and the operating system woke the process too late.

Cycles that cannot be made up for are counted as lost, and the schedule begins again from now.
"""

import time
from collections.abc import Callable

import numpy as np

from handover.messages import number_text
from handover_humanoid.model.kinematics import Array

LATE_S = 1e-3
CAUSES = ("computing", "preempted", "woken late")


class Timing:
    """The schedule of a cycle; the clocks are in ns, so that tests can replace them."""

    def __init__(
        self,
        period_s: float,
        clock: Callable[[], int] = time.monotonic_ns,
        cpu_clock: Callable[[], int] = time.thread_time_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if not 1e-4 <= period_s <= 1.0:
            raise ValueError(f"the period is {number_text(period_s)} s; a control cycle has 0.0001 s to 1 s")
        self._period_ns = round(period_s * 1e9)
        self._clock, self._cpu_clock, self._sleep = clock, cpu_clock, sleep
        self._due = clock()
        self._began, self._cpu_began = self._due, cpu_clock()
        self.cycles, self.late, self.lost = 0, 0, 0
        self.causes = np.zeros(len(CAUSES), dtype=np.int64)
        self.max_late_s, self.last_busy_s, self.max_busy_s = 0.0, 0.0, 0.0

    def wait(self) -> None:
        """Return when the next cycle is due, and count what is late."""
        ended = self._clock()
        busy, used = ended - self._began, self._cpu_clock() - self._cpu_began
        self.last_busy_s = busy / 1e9
        self.max_busy_s = max(self.max_busy_s, self.last_busy_s)
        self.cycles += 1
        self._due += self._period_ns
        ahead = self._due - ended
        if ahead > 0:
            self._sleep(ahead / 1e9)
        now = self._clock()
        late = now - self._due
        if late > LATE_S * 1e9:
            self.late += 1
            self.max_late_s = max(self.max_late_s, late / 1e9)
            self.causes[self._cause(ahead, used)] += 1
        if late > self._period_ns:
            lost = late // self._period_ns
            self.lost += lost
            self._due += lost * self._period_ns
        self._began, self._cpu_began = now, self._cpu_clock()

    def write_figures(self, figures: Array) -> None:
        """Write `FIGURES` as numbers."""
        figures[0], figures[1], figures[2] = self.cycles, self.late, self.lost
        figures[3 : 3 + len(CAUSES)] = self.causes
        figures[-3], figures[-2], figures[-1] = self.max_late_s, self.last_busy_s, self.max_busy_s

    def _cause(self, ahead: int, used: int) -> int:
        if used > self._period_ns:
            return 0
        return 1 if ahead <= 0 else 2


FIGURES = (
    "cycles",
    "late",
    "lost",
    "late: computing",
    "late: preempted",
    "late: woken late",
    "max_late_s",
    "last_busy_s",
    "max_busy_s",
)
