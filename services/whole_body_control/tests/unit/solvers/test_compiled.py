"""The compiled cascade gives the results of its reference in NumPy, also where rounding errors decide."""

import builtins
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from handover.errors import UsageError
from handover_humanoid.solvers import cascade
from handover_humanoid.solvers.cascade import Cascade
from handover_humanoid.solvers.compiled import Compiled, fastest_solver
from handover_humanoid.solvers.problem import Problem, Solution, Unsolvable

pytest.importorskip("numba", reason="the compiled solver needs numba, which has no wheel for this platform")

N = 12
EPSILONS = st.sampled_from([1e-6, 1e-2])
SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def compiled() -> Compiled:
    """Compile once: up to 20 s of one core where no earlier run has left its cache."""
    return Compiled()


def random_problem(
    seed: int, bound: float, epsilon: float, *, is_deficient: bool = False, contacts: int = 0
) -> Problem:
    """Return three levels under bounds of the joints, three mixed ones, and equalities at zero."""
    rng = np.random.default_rng(seed)
    levels = []
    for rows in (3, 4, N):
        jacobian = rng.normal(size=(rows, N))
        if is_deficient:
            jacobian[-1] = jacobian[0] + jacobian[1]
        levels.append((jacobian, rng.normal(size=rows)))
    matrix = np.vstack([np.eye(N), rng.normal(size=(3 + contacts, N))])
    upper = bound * rng.uniform(0.5, 1.5, size=len(matrix))
    upper[N + 3 :] = 0.0
    return Problem(levels, matrix, -upper, upper, epsilon)


def compare(compiled: Compiled, problem: Problem) -> tuple[Solution, Solution]:
    """Solve with both; both obey the bounds, and leave the same residuals.

    Where a level leaves nothing but its rounding errors (1e-8), daqp may see no way and keep a worse
    residual: 48 of 18,000 problems of `random_problem`. The first level that differs must be the better one.
    """
    ours, reference = compiled.solve(problem), Cascade().solve(problem)
    differences = np.subtract(ours.residuals, reference.residuals)
    different = np.flatnonzero(np.abs(differences) > 5e-6)
    if len(different):
        assert -1e-3 < differences[different[0]] < 0
    else:
        assert ours.residuals == pytest.approx(reference.residuals, abs=5e-6)
    assert ours.slack == pytest.approx(reference.slack, abs=1e-4)
    for solution in (ours, reference):
        reached = problem.matrix @ solution.velocity
        assert (reached <= problem.upper + solution.slack + 1e-6).all()
        assert (reached >= problem.lower - solution.slack - 1e-6).all()
    return ours, reference


@given(
    seed=SEEDS,
    bound=st.sampled_from([0.1, 0.5, 10.0]),
    epsilon=EPSILONS,
    kind=st.tuples(st.booleans(), st.integers(0, 5)),
)
def test_the_residuals_are_those_of_the_reference(
    compiled: Compiled, seed: int, bound: float, epsilon: float, kind: tuple[bool, int]
) -> None:
    is_deficient, contacts = kind
    problem = random_problem(seed, bound, epsilon, is_deficient=is_deficient, contacts=contacts)
    ours, _ = compare(compiled, problem)
    assert not ours.is_relaxed


@given(seed=SEEDS, epsilon=EPSILONS)
def test_repeated_rows_of_bounds_change_nothing(compiled: Compiled, seed: int, epsilon: float) -> None:
    problem = random_problem(seed, 0.1, epsilon)
    twice = Problem(
        problem.levels,
        np.vstack([problem.matrix, -2.0 * problem.matrix]),
        np.concatenate([problem.lower, -2.0 * problem.upper]),
        np.concatenate([problem.upper, -2.0 * problem.lower]),
        epsilon,
    )
    ours, _ = compare(compiled, twice)
    assert ours.residuals == pytest.approx(compiled.solve(problem).residuals, abs=1e-4)


@given(seed=SEEDS, share=st.floats(0.01, 1.0))
def test_bounds_that_zero_violates_are_obeyed(compiled: Compiled, seed: int, share: float) -> None:
    """A joint beyond its limit returns, while contacts move with their own velocity."""
    rng = np.random.default_rng(seed)
    problem = random_problem(seed, 1.0, 1e-6, contacts=3)
    inside = rng.uniform(0.5, 2.0, size=N)
    reached = problem.matrix @ inside
    width = share * np.ones(len(reached))
    width[N + 3 :] = 0.0
    shifted = Problem(problem.levels, problem.matrix, reached - width, reached + width, problem.epsilon)
    ours, _ = compare(compiled, shifted)
    assert (ours.slack < 1e-5).all()


@given(seed=SEEDS, gap=st.floats(0.01, 2.0))
def test_bounds_that_contradict_are_relaxed_by_the_same_slack(
    compiled: Compiled, seed: int, gap: float
) -> None:
    problem = random_problem(seed, 1.0, 1e-6)
    row = np.random.default_rng(seed).normal(size=(1, N))
    contradicting = Problem(
        problem.levels,
        np.vstack([problem.matrix, row, row]),
        np.concatenate([problem.lower, [-1.0, gap]]),
        np.concatenate([problem.upper, [0.0, gap + 1.0]]),
    )
    solution = compiled.solve(contradicting)
    assert solution.is_relaxed
    assert solution.slack == pytest.approx(Cascade().solve(contradicting).slack, abs=1e-4)
    assert solution.slack[-2:].sum() >= gap - 1e-4


@given(seed=SEEDS, bound=st.sampled_from([0.1, 10.0]))
def test_a_level_disturbs_none_above_it(compiled: Compiled, seed: int, bound: float) -> None:
    problem = random_problem(seed, bound, 1e-6)
    whole = compiled.solve(problem)
    for depth in range(1, len(problem.levels)):
        shorter = Problem(problem.levels[:depth], problem.matrix, problem.lower, problem.upper)
        assert compiled.solve(shorter).residuals == pytest.approx(whole.residuals[:depth], abs=1e-6)


@given(seed=SEEDS)
def test_memory_that_was_used_before_changes_nothing(compiled: Compiled, seed: int) -> None:
    problem = random_problem(seed, 0.1, 1e-6)
    first = compiled.solve(problem)
    compiled.solve(random_problem(seed + 1, 0.3, 1e-2, is_deficient=True))
    again = compiled.solve(problem)  # it starts from other active bounds
    assert again.residuals == pytest.approx(first.residuals, abs=1e-9)
    assert again.velocity == pytest.approx(first.velocity, abs=1e-6)


def test_problems_without_bounds_or_levels(compiled: Compiled) -> None:
    levels = [(np.eye(2), np.ones(2))]
    nothing = Problem(levels, np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    assert compiled.solve(nothing).velocity == pytest.approx(np.ones(2), abs=1e-5)
    assert compiled.solve(Problem([], np.eye(2), -np.ones(2), np.ones(2))).residuals == ()


def test_what_has_no_meaning_is_named(compiled: Compiled) -> None:
    problem = random_problem(1, 1.0, 1e-6)
    problem.levels[1][1][0] = np.nan
    with pytest.raises(Unsolvable, match="level 1"):
        compiled.solve(problem)
    problem = random_problem(1, 1.0, 1e-6)
    with pytest.raises(Unsolvable, match="level 0"):
        compiled.solve(Problem([(np.ones((1, N)), np.ones(3))], problem.matrix, problem.lower, problem.upper))
    problem.upper[3] = problem.lower[3] - 1.0
    with pytest.raises(Unsolvable, match="upper bound"):
        compiled.solve(problem)


def test_the_tolerances_are_those_of_the_reference() -> None:
    from handover_humanoid.solvers import kernels

    for name in ("RANK_TOLERANCE", "FEASIBLE", "EQUALITY", "PRIMAL_TOLERANCE"):
        assert getattr(kernels, name) == getattr(cascade, name)


def test_without_numba_daqp_serves_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    package = "handover_humanoid.solvers"
    monkeypatch.delitem(sys.modules, f"{package}.kernels", raising=False)
    monkeypatch.delattr(sys.modules[package], "kernels", raising=False)
    original = builtins.__import__

    def refuse(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "numba":
            raise ImportError("No module named 'numba'")
        return original(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(UsageError, match=r"handover-cell\[humanoid\]"):
        Compiled()
    with capture_logs() as logged:
        solver = fastest_solver()
    assert solver.name == "daqp, hierarchical"
    assert "numba" in logged[0]["reason"]
