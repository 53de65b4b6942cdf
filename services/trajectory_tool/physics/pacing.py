"""The clock of a simulation: waiting simulates, and then keeps the given pace to the wall clock.

At a pace of 1 a simulated second takes a second, at 2 half of it. Without a pace the simulation runs only
while a caller waits, as fast as it can: then it does not depend on the wall clock, and the same commands give
the same result.
"""

import time

from services.trajectory_tool.drivers import Clock
from services.trajectory_tool.metrics import SIMULATED_SECONDS, SIMULATION_CPU_SECONDS
from services.trajectory_tool.physics.simulation import Simulation
from services.trajectory_tool.physics.world_model import STEP_S

MAX_LAG_S = 0.1
"""A simulation that is slower than its pace by more than this does not catch up."""


class PacedSimulation:
    """A simulation that runs at `pace` simulated seconds in a second, or freely for None.

    All methods are called in one thread, that of the control cycles.
    """

    def __init__(self, simulation: Simulation, pace: float | None) -> None:
        self.simulation = simulation
        self.clock = Clock(lambda: simulation.time_s, self.wait_s)
        self._pace = pace
        self.resync()

    @property
    def is_paced(self) -> bool:
        """Return whether the simulation keeps a pace, so that it runs between motions as well."""
        return self._pace is not None

    def wait_s(self, seconds: float) -> None:
        """Simulate a time, and wait as long as it takes at the pace."""
        simulation = self.simulation
        until_s = simulation.time_s + max(seconds, 0.0) - STEP_S / 2
        self._simulate(until_s)
        if self._pace is not None:
            ahead_s = (simulation.time_s - self._began_s) / self._pace - (time.monotonic() - self._began_at)
            if ahead_s > 0:
                time.sleep(ahead_s)
            elif ahead_s < -MAX_LAG_S:
                self.resync()

    def _simulate(self, until_s: float) -> None:
        simulation = self.simulation
        began, began_s = time.thread_time(), simulation.time_s
        while simulation.time_s < until_s:
            simulation.step()
        SIMULATION_CPU_SECONDS.inc(time.thread_time() - began)
        SIMULATED_SECONDS.inc(max(simulation.time_s - began_s, 0.0))

    def catch_up(self) -> None:
        """Simulate the time since the last motion; what is more than `MAX_LAG_S` is left out."""
        if self._pace is None:
            return
        behind_s = (time.monotonic() - self._began_at) * self._pace - (self.simulation.time_s - self._began_s)
        if behind_s > MAX_LAG_S * self._pace:
            self.resync()
        elif behind_s > STEP_S:
            self._simulate(self.simulation.time_s + behind_s)

    def resync(self) -> None:
        """Keep the pace from now on, after the simulation has jumped ahead or fell behind."""
        self._began_s, self._began_at = self.simulation.time_s, time.monotonic()
