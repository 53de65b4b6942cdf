"""The null-space cascade in machine code by numba: the results of `cascade`, in a tenth of its time.

The first problem of a process waits for the compiler or, later, for its cache on the disk; `Compiled` solves
a small problem when it is made, so that no control cycle pays for this. Memory is allocated once for each
shape of problem; it keeps which bounds were active, for the next problem of this shape (a warm start).
Without numba `fastest_solver` answers with daqp, and says so.
"""

from types import ModuleType

import numpy as np

from handover.distribution import install_command
from handover.errors import UsageError
from handover.runtime.control_cycle import runs_in_cycle
from handover.telemetry import get_logger
from handover_humanoid.solvers.cascade import Cascade, needed_slack
from handover_humanoid.solvers.hierarchical import Hierarchical
from handover_humanoid.solvers.problem import (
    EPSILON,
    Problem,
    Solution,
    Solver,
    require_finite,
    require_shapes,
)

log = get_logger(__name__)


class _CompiledArrays:
    """The arrays of one shape of problem: `n` velocities, `m` bounds, and `counts` rows of the levels."""

    def __init__(self, n: int, m: int, counts: tuple[int, ...]) -> None:
        self.ends = np.cumsum([0, *counts])
        rows = int(self.ends[-1])
        longest = max(n, m, rows)
        self.rows, self.targets = np.empty((rows, n)), np.empty(rows)
        self.spans = [slice(*ends) for ends in zip(self.ends[:-1], self.ends[1:], strict=True)]
        self.squares, self.equal_rows = np.zeros((5, n, n)), np.zeros((m, n))
        self.reduced = np.zeros((n, rows))
        self.vectors, self.whole = np.zeros((15, longest)), np.zeros((6, longest), dtype=np.int64)
        self.guesses = np.zeros((len(counts), longest + 1), dtype=np.int64)
        self.no_slack = np.zeros(m)
        self.no_slack.flags.writeable = False


class Compiled:
    """The compiled cascade. Not thread-safe. Raises `UsageError` without numba."""

    name = "null-space cascade, compiled"

    def __init__(self) -> None:
        self._kernels = _kernels()
        self._reference = Cascade()
        self._memory: dict[tuple[int, int, tuple[int, ...]], _CompiledArrays] = {}
        self.fallbacks = 0
        """How many problems the reference had to solve since rounding errors led in a circle."""
        self._compile()

    @runs_in_cycle
    def solve(self, problem: Problem) -> Solution:
        """Return the velocities. Raises `Unsolvable`."""
        memory = self._fill(problem)
        velocity = np.zeros(problem.n)
        residuals = np.empty(len(problem.levels))
        matrix = np.ascontiguousarray(problem.matrix)
        lower, upper, slack, is_started = problem.lower, problem.upper, memory.no_slack, False
        while True:
            state = self._kernels.solve(
                memory.rows,
                memory.targets,
                memory.ends,
                matrix,
                lower,
                upper,
                problem.epsilon,
                velocity,
                is_started,
                residuals,
                memory.squares,
                memory.equal_rows,
                memory.reduced,
                memory.vectors,
                memory.whole,
                memory.guesses,
            )
            if state != self._kernels.ZERO_IS_OUTSIDE:
                break
            slack, velocity = needed_slack(problem)
            lower, upper, is_started = lower - slack, upper + slack, True
        if state == self._kernels.SOLVED:
            return Solution(velocity, tuple(residuals.tolist()), slack)
        memory.guesses[:] = 0
        require_finite(problem)
        self.fallbacks += 1
        return self._reference.solve(problem)

    def _fill(self, problem: Problem) -> _CompiledArrays:
        shape = require_shapes(problem)
        memory = self._memory.get(shape)
        if memory is None:
            memory = self._memory[shape] = _CompiledArrays(*shape)
        if problem.stacked is not None:
            np.copyto(memory.rows, problem.stacked[0])
            np.copyto(memory.targets, problem.stacked[1])
            return memory
        for span, (jacobian, target) in zip(memory.spans, problem.levels, strict=True):
            memory.rows[span] = jacobian
            memory.targets[span] = target
        return memory

    def _compile(self) -> None:
        """Solve a problem that needs every kernel."""
        rows = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        matrix, bounds = np.vstack([rows[:1], np.eye(3)]), np.array([0.0, 1.0, 1.0, 1.0])
        self.solve(Problem([(rows, np.full(2, 5.0))], matrix, -bounds, bounds, EPSILON))


def fastest_solver() -> Solver:
    """Return the compiled cascade; without numba daqp serves, and the log says so."""
    try:
        return Compiled()
    except UsageError as error:
        log.warning("daqp solves the stack of tasks", reason=str(error))
        return Hierarchical()


def _kernels() -> ModuleType:
    try:
        from handover_humanoid.solvers import kernels  # noqa: PLC0415 - numba is optional
    except ImportError as error:
        raise UsageError(
            f"the compiled solver needs numba ({error}); {install_command('humanoid')}"
        ) from None
    return kernels
