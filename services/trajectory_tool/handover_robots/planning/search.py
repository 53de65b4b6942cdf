"""RRT-Connect of OMPL in joint space with certified checks of its edges, and shortcuts of its path."""

import math
import time
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from ompl import base, geometric
from ompl import util as ompl_util

from handover_robots.planning.arm import Array
from handover_robots.planning.motions import Motions

RANGE_RAD = 1.2
"""The maximum length of an edge of the trees: the norm of the joint motions."""

SAMPLE_AROUND_RAD = math.pi
"""Joints are sampled at most this far beyond the start and the goals."""

SHORTCUT_ROUNDS = 40

ompl_util.setLogLevel(ompl_util.LogLevel.LOG_NONE)
ompl_util.RNG.setSeed(1)  # possible once in a process


class _Validity(base.StateValidityChecker):  # type: ignore[misc]
    def __init__(self, information: object, is_free: Callable[[Array], bool], size: int) -> None:
        super().__init__(information)
        self._is_free = is_free
        self._size = range(size)

    def isValid(self, state: object) -> bool:  # noqa: N802 - the name of OMPL
        return self._is_free(_joints(state, self._size))


class _Edges(base.MotionValidator):  # type: ignore[misc]
    def __init__(self, information: object, is_free: Callable[[Array, Array], bool], size: int) -> None:
        super().__init__(information)
        self._is_free = is_free
        self._size = range(size)

    def checkMotion(self, start: object, end: object) -> bool:  # noqa: N802 - the name of OMPL
        return self._is_free(_joints(start, self._size), _joints(end, self._size))


def search(
    motions: Motions,
    start: Array,
    goals: Sequence[Array],
    *,
    timeout_s: float,
    is_edge_allowed: Callable[[Array, Array], bool] | None = None,
) -> list[Array] | None:
    """Return a path of free lines from `start` to one of `goals`; None after `timeout_s` of computing.

    It is time of the processor, so that a busy machine finds the same paths, only later. All goals are free.
    `is_edge_allowed` is a further condition on lines, such as an orientation.
    """

    def is_free(begin: Array, end: Array) -> bool:
        return motions.is_free(begin, end) and (is_edge_allowed is None or is_edge_allowed(begin, end))

    for goal in goals:
        if is_free(start, goal):
            return [start, goal]
    arm, size = motions.collisions.arm, len(start)
    ends = np.array([start, *goals])
    low = np.maximum(arm.lower, ends.min(axis=0) - SAMPLE_AROUND_RAD)
    high = np.minimum(arm.upper, ends.max(axis=0) + SAMPLE_AROUND_RAD)
    space = base.RealVectorStateSpace(size)
    bounds = base.RealVectorBounds(size)
    for number in range(size):
        bounds.setLow(number, float(low[number]))
        bounds.setHigh(number, float(high[number]))
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    validity = _Validity(information, motions.is_state_free, size)
    edges = _Edges(information, is_free, size)
    information.setStateValidityChecker(validity)
    information.setMotionValidator(edges)
    information.setup()
    problem = base.ProblemDefinition(information)
    problem.addStartState(_state(space, start))
    targets = base.GoalStates(information)
    for goal in goals:
        targets.addState(_state(space, goal))
    problem.setGoal(targets)
    planner = geometric.RRTConnect(information)
    planner.setProblemDefinition(problem)
    planner.setRange(RANGE_RAD)
    planner.setup()
    ends_s = time.thread_time() + timeout_s
    planner.solve(base.PlannerTerminationCondition(lambda: time.thread_time() > ends_s))
    if not problem.hasExactSolution():
        return None
    solution = problem.getSolutionPath()
    path = [_joints(solution.getState(number), range(size)) for number in range(solution.getStateCount())]
    path[0], path[-1] = start, min(goals, key=lambda goal: float(np.abs(goal - path[-1]).max()))
    return path


def shorten(
    path: list[Array],
    cost: Callable[[Array, Array], float],
    is_free: Callable[[Array, Array], bool],
    *,
    seed: int = 1,
) -> list[Array]:
    """Return a path without detours: first between its points, then between random points on its lines.

    It never gets longer; the ends stay.
    """
    path = _skip(path, is_free)
    random = np.random.default_rng(seed)
    failures = 0
    for _ in range(SHORTCUT_ROUNDS):
        if len(path) < 3 or failures > 12:
            break
        lengths = np.array([cost(start, end) for start, end in pairwise(path)])
        place = np.concatenate([[0.0], np.cumsum(lengths)])
        first_at, second_at = np.sort(random.uniform(0.0, place[-1], 2))
        first, second = (int(np.searchsorted(place, at, side="right")) - 1 for at in (first_at, second_at))
        second = min(second, len(lengths) - 1)
        if first == second:
            continue
        start = _between(path, place, first, first_at)
        end = _between(path, place, second, second_at)
        before = second_at - first_at
        if cost(start, end) < 0.999 * before and is_free(start, end):
            path = _skip([*path[: first + 1], start, end, *path[second + 1 :]], is_free, around=first)
            failures = 0
        else:
            failures += 1
    return path


def _skip(
    path: list[Array], is_free: Callable[[Array, Array], bool], around: int | None = None
) -> list[Array]:
    """Return the path without points that a line can skip, the longest lines first."""
    low = 0 if around is None else max(around - 1, 0)
    result, here = path[: low + 1], low
    last = len(path) - 1 if around is None else min(around + 4, len(path) - 1)
    while here < last:
        there = next(
            (number for number in range(last, here + 1, -1) if is_free(path[here], path[number])), here + 1
        )
        result.append(path[there])
        here = there
    return result + path[last + 1 :]


def _between(path: list[Array], place: Array, line: int, at: float) -> Array:
    share = (at - place[line]) / max(place[line + 1] - place[line], 1e-12)
    return np.asarray(path[line] + share * (path[line + 1] - path[line]))


def _joints(state: object, size: Sequence[int]) -> Array:
    return np.array([state[number] for number in size])  # type: ignore[index]


def _state(space: object, joints: Array) -> object:
    state = space.allocState()  # type: ignore[attr-defined]
    for number, value in enumerate(joints.tolist()):
        state[number] = value
    return state
