"""Which motion engine controls a humanoid: both have the same stack, and the same step."""

from collections.abc import Callable, Mapping
from typing import Final, Literal, Protocol

from handover_humanoid.engines.projection_engine import ProjectionEngine
from handover_humanoid.engines.stack_engine import StackEngine, Step
from handover_humanoid.model.kinematics import Array, Kinematics
from handover_humanoid.solvers.problem import Solver
from handover_humanoid.tasks.base import Stack

EngineName = Literal["stack", "projections"]


class MotionEngine(Protocol):
    """Makes motion of a stack of tasks."""

    stack: Stack

    def step(self, q: Array, dt_s: float) -> Step:
        """Return the next configuration after `dt_s`."""
        ...


MakeEngine = Callable[[Kinematics, Stack], MotionEngine]


def engine_maker(name: EngineName, solver: Solver | None = None) -> MakeEngine:
    """Return what makes engines of this name; only `stack` uses the solver."""
    makers: Mapping[EngineName, MakeEngine] = {
        "stack": lambda kinematics, stack: StackEngine(kinematics, stack, solver),
        "projections": ProjectionEngine,
    }
    return makers[name]


DEFAULT_ENGINE: Final[EngineName] = "stack"
