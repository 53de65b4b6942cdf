"""Solvers agree on random hierarchies, keep priorities and bounds, and relax what cannot hold."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_humanoid.solvers.cascade import Cascade
from handover_humanoid.solvers.hierarchical import Hierarchical
from handover_humanoid.solvers.problem import Problem, Solver, Unsolvable
from handover_humanoid.solvers.weighted import Weighted

N = 12
HIERARCHICAL: tuple[Solver, ...] = (Cascade(), Hierarchical())


def random_problem(seed: int, *, bound: float, is_deficient: bool = False) -> Problem:
    rng = np.random.default_rng(seed)
    levels = []
    for rows in (3, 4, N):
        jacobian = rng.normal(size=(rows, N))
        if is_deficient:
            jacobian[-1] = jacobian[0] + jacobian[1]
        levels.append((jacobian, rng.normal(size=rows)))
    matrix = np.vstack([np.eye(N), rng.normal(size=(3, N))])
    upper = bound * rng.uniform(0.5, 1.5, size=len(matrix))
    return Problem(levels, matrix, -upper, upper)


@given(seed=st.integers(0, 2**32 - 1), bound=st.sampled_from([0.1, 0.5, 10.0]), is_deficient=st.booleans())
@settings(deadline=None)
def test_cascade_and_daqp_reach_the_same_residuals(seed: int, bound: float, is_deficient: bool) -> None:
    problem = random_problem(seed, bound=bound, is_deficient=is_deficient)
    first, second = (solver.solve(problem) for solver in HIERARCHICAL)
    assert first.residuals == pytest.approx(second.residuals, abs=5e-3)
    for solution in (first, second):
        assert not solution.is_relaxed
        reached = problem.matrix @ solution.velocity
        assert (reached <= problem.upper + 1e-6).all()
        assert (reached >= problem.lower - 1e-6).all()


@given(seed=st.integers(0, 2**32 - 1), bound=st.sampled_from([0.1, 10.0]))
@settings(deadline=None)
def test_a_level_disturbs_none_above_it(seed: int, bound: float) -> None:
    problem = random_problem(seed, bound=bound)
    whole = Cascade().solve(problem)
    for depth in range(1, len(problem.levels)):
        shorter = Problem(problem.levels[:depth], problem.matrix, problem.lower, problem.upper)
        assert Cascade().solve(shorter).residuals == pytest.approx(whole.residuals[:depth], abs=1e-6)


@pytest.mark.parametrize("solver", HIERARCHICAL, ids=lambda solver: solver.name)
def test_bounds_that_contradict_are_relaxed_by_least_squares(solver: Solver) -> None:
    row = np.eye(1, 4)
    problem = Problem(
        [(np.eye(4)[1:], np.ones(3))],
        np.vstack([row, row]),
        np.array([-1.0, 3.0]),
        np.array([1.0, 5.0]),
    )
    solution = solver.solve(problem)
    assert solution.is_relaxed
    assert solution.slack == pytest.approx([1.0, 1.0], abs=1e-3)
    assert solution.velocity[1:] == pytest.approx(np.ones(3), abs=1e-3)


@pytest.mark.parametrize("solver", [*HIERARCHICAL, Weighted()], ids=lambda solver: solver.name)
def test_values_that_are_not_finite_are_named(solver: Solver) -> None:
    problem = random_problem(1, bound=1.0)
    problem.levels[1][1][0] = np.nan
    with pytest.raises(Unsolvable, match="level 1"):
        solver.solve(problem)


def test_near_a_singularity_velocities_stay_small_and_continuous() -> None:
    """A direction that vanishes gets no more velocity than the regularisation allows, and no jump."""
    velocities = []
    for sigma in np.geomspace(1e-1, 1e-9, 200):
        problem = Problem(
            [(np.diag([1.0, sigma]), np.array([0.0, 1e-3]))],
            np.eye(2),
            np.full(2, -100.0),
            np.full(2, 100.0),
        )
        velocities.append(Cascade().solve(problem).velocity[1])
    assert max(velocities) <= 1e-3 / (2 * 1e-6**0.5) + 1e-9
    assert np.abs(np.diff(velocities)).max() < 0.05


def test_weights_share_a_level() -> None:
    rows = np.eye(1)
    heavy, light = np.array([1.0]), np.array([0.0])
    weighted = np.vstack([3.0**0.5 * rows, rows])
    problem = Problem(
        [(weighted, np.concatenate([3.0**0.5 * heavy, light]))], np.eye(1), -np.ones(1), np.ones(1)
    )
    assert Cascade().solve(problem).velocity == pytest.approx([0.75], abs=1e-5)
