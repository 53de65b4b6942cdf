"""Motion planning among the 30 obstacles of a bin-picking cell, beside the defaults of OMPL in Python.

    python -m benchmarks.robots.motion [--problems 1000] [--peers 100] [--robots ur10 ur5e panda] [--seed 1]

A problem is a pair of poses, from one bin or fixture to another, that both have a free position of the arm. A
plan is the whole way from a pose to a trajectory: inverse kinematics, path, timing, and check. Each plan is
verified every millisecond. Times are CPU times of the thread, with the time of the clock beside them.
"""

import argparse
import dataclasses
import math
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import pairwise
from typing import Any

import numpy as np
from ompl import base, geometric

from benchmarks.robots.jerk_reference import optimal_duration_s
from benchmarks.steal_time import report_steal_time
from handover.errors import HandoverError
from handover_robots.limits.guards import TorqueGuard
from handover_robots.model.obstacles import Box, Cylinder, Obstacle, World
from handover_robots.model.poses import Pose, pointing_down
from handover_robots.model.trajectory import duration_s
from handover_robots.planning import timing, tracked_distances
from handover_robots.planning.arm import Arm
from handover_robots.planning.collision import Collisions
from handover_robots.planning.inverse import Inverse
from handover_robots.planning.planner import Options, Planner
from handover_robots.planning.torques import Torques
from handover_robots.planning.tracked_distances import TrackedDistances
from handover_robots.robots import ROBOTS

SCALES = {"ur10": 1.0, "ur5e": 0.7, "panda": 0.6}
"""The size of the cell for the reach of each robot."""

REFERENCES = 40
"""The plans of each kind whose duration is compared with the optimum of their path."""
OMPL_TIMEOUT_S = 5.0
PINK_STEPS, PINK_STEP_S, PINK_TOLERANCE = 200, 0.1, 1e-4
EVERY_S, CYCLE_S = 0.001, 0.002
DISTANCE_TOLERANCE_M = 1e-5
"""The distances of coal for the same pair differ by that much."""
HORIZON_M = 0.1
"""The distances below this one are computed exactly for what depends on them."""


def bin_walls(name: str, x: float, y: float, size: float, height: float) -> Iterator[Obstacle]:
    """Yield the bottom and the four walls of a bin."""
    wall, half = 0.012, size / 2
    yield box(name, (size, size, wall), (x, y, wall / 2))
    for side in (-half, half):
        yield box(name, (size, wall, height), (x, y + side, height / 2))
        yield box(name, (wall, size, height), (x + side, y, height / 2))


def box(
    name: str, size: tuple[float, float, float], at: tuple[float, float, float], yaw: float = 0
) -> Obstacle:
    """Return a box."""
    return Obstacle(name, Box(size), Pose(at, (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))))


def cell(scale: float, seed: int) -> World:
    """Return a cell with 30 obstacles: bins, posts, a camera, a fence, and crates at random places."""
    random = np.random.default_rng(seed)
    s = scale
    obstacles = [box("table", (2.4 * s, 2.4 * s, 0.05), (0.0, 0.0, -0.045))]
    for number, (x, y) in enumerate(((-0.55, -0.55), (-0.55, 0.45), (0.55, -0.5)), 1):
        obstacles += bin_walls(f"bin-{number}", x * s, y * s, 0.4 * s, 0.12 * s)
    obstacles.append(box("fixture", (0.3 * s, 0.25 * s, 0.05), (0.6 * s, 0.45 * s, 0.025)))
    for number, (x, y) in enumerate(((-0.95, -0.1), (0.9, 0.05), (-0.2, 0.85), (0.2, -0.9))):
        post = Pose((x * s, y * s, 0.5 * s), (0.0, 0.0, 0.0, 1.0))
        obstacles.append(Obstacle(f"post-{number}", Cylinder(0.03, s), post))
    obstacles.append(box("camera", (0.1, 0.1, 0.06), (-0.55 * s, -0.55 * s, 1.05 * s)))
    obstacles.append(box("camera-arm", (0.05, 0.5 * s, 0.05), (-0.55 * s, -0.8 * s, 1.1 * s)))
    obstacles.append(box("fence", (0.03, 2.4 * s, 1.2 * s), (1.15 * s, 0.0, 0.6 * s)))
    obstacles.append(box("shelf", (0.5 * s, 0.2 * s, 0.03), (0.1 * s, 1.0 * s, 0.7 * s)))
    while len(obstacles) < 30:
        angle, radius = random.uniform(-math.pi, math.pi), random.uniform(0.5, 0.95) * s
        width, depth, height = random.uniform(0.05, 0.15, 2) @ np.eye(2, 3) * s + (
            0,
            0,
            random.uniform(0.05, 0.3) * s,
        )
        at = (radius * math.cos(angle), radius * math.sin(angle), height / 2)
        obstacles.append(box(f"crate-{len(obstacles)}", (width, depth, height), at, random.uniform(0, 3)))
    return World(tuple(obstacles))


def poses(planner: Planner, scale: float, count: int, random: Any) -> list[tuple[Pose, Any]]:
    """Return poses in and over the bins and the fixture, each with a free position of the arm."""
    home, positions = np.array(planner.model.home), []
    places = ((-0.55, -0.55, 0.12), (-0.55, 0.45, 0.12), (0.55, -0.5, 0.12), (0.6, 0.45, 0.1))
    for _ in range(20 * count):
        x, y, spread = places[random.integers(len(places))]
        dx, dy = random.uniform(-spread, spread, 2)
        at = ((x + dx) * scale, (y + dy) * scale, random.uniform(0.06, 0.4) * scale)
        pose = pointing_down(at, random.uniform(-math.pi, math.pi))
        try:
            positions.append((pose, planner.goals(pose, home)[0]))
        except HandoverError:
            continue
        if len(positions) == count:
            break
    return positions


def shown(values_s: list[float]) -> str:
    """Return p50, p95 and the maximum in ms."""
    p50, p95 = np.quantile(values_s, [0.5, 0.95])
    return f"p50 {1000 * p50:.1f} ms, p95 {1000 * p95:.1f} ms, max {1000 * max(values_s):.0f} ms"


def cpu_s(work: Callable[[], Any], times: int = 1) -> float:
    """Return the CPU time of one call."""
    began = time.thread_time()
    for _ in range(times):
        work()
    return (time.thread_time() - began) / times


def measure_plans(planner: Planner, places: list[tuple[Pose, Any]]) -> None:
    """Plan from each pose to the next."""
    cpu, clock, violations, contacts, refused = [], [], 0, 0, 0
    ratios: dict[str, list[tuple[float, float]]] = {"lines": [], "curves": []}
    for (_, start), (target, _) in pairwise(places):
        began_cpu, began = time.thread_time(), time.perf_counter()
        try:
            plan = planner.to_pose(tuple(start.tolist()), target)
        except HandoverError:
            refused += 1
            continue
        cpu.append(time.thread_time() - began_cpu)
        clock.append(time.perf_counter() - began)
        violations += len(list(plan.trajectory.violations(planner.limits)))
        contacts += not all(
            planner.collisions.is_free(position) for position in plan.trajectory.positions(EVERY_S)
        )
        kind = ratios["lines" if len(plan.path) == 2 else "curves"]
        if len(kind) < REFERENCES:
            duration = plan.trajectory.duration_s
            optimal_s = optimal_duration_s(plan.trajectory, planner.limits)
            kind.append((duration / optimal_s, duration / without_jerk_s(planner, list(plan.path))))
    problems = len(places) - 1
    print(f"  plan: {shown(cpu)} CPU; {shown(clock)} on the clock")
    print(f"  success {100 * len(cpu) / problems:.1f} % of {problems}; refused {refused}")
    print(f"  exceeded limits {violations}, trajectories with a contact {contacts} (every 1 ms)")
    for what, pairs in ratios.items():
        if pairs:
            (jerk, toppra), (most, _) = np.mean(pairs, axis=0), np.max(pairs, axis=0)
            print(
                f"  duration of {len(pairs)} {what} over the optimum of their path with the limit of jerk: "
                f"mean {jerk:.3f}, max {most:.3f}; over toppra without a limit of jerk: mean {toppra:.3f}"
            )


def without_jerk_s(planner: Planner, path: list[Any]) -> float:
    """Return the duration of the fastest motion of toppra along the rounded path."""
    positions, spacing_s = timing.fastest(timing.BlendedLines(path, planner.limits), planner.limits)
    return (len(positions) - 1) * spacing_s


def measure_lines(planner: Planner, random: Any) -> None:
    """Compare straight lines in joint space with the time-optimal profile under the same limits of jerk."""
    ratios = []
    for _ in range(100):
        start, end = np.array(planner.model.home) + random.uniform(-0.5, 0.5, (2, planner.arm.n))
        optimal_s = duration_s(tuple(start), tuple(end), planner.limits)
        ratios.append(timing.line(start, end, planner.limits).duration_s / optimal_s)
    print(f"  line: duration over the optimum with the limit of jerk: mean {np.mean(ratios):.3f}")


def measure_ompl(planner: Planner, places: list[tuple[Pose, Any]], count: int) -> None:
    """Plan the same problems as the documentation of OMPL shows it: a validity check, else defaults."""
    arm = planner.arm
    cpu, solved = [], 0
    problems = list(pairwise(places))[:count]
    for (_, start), (target, _) in problems:
        space = base.RealVectorStateSpace(arm.n)
        bounds = base.RealVectorBounds(arm.n)
        for number in range(arm.n):
            bounds.setLow(number, float(arm.lower[number]))
            bounds.setHigh(number, float(arm.upper[number]))
        space.setBounds(bounds)

        class Validity(base.StateValidityChecker):  # type: ignore[misc]
            def isValid(self, state: Any) -> bool:  # noqa: N802
                return planner.collisions.is_free(np.array([state[i] for i in range(arm.n)]), 0.01)

        began = time.thread_time()
        goal = planner.goals(target, start)[0]
        setup = geometric.SimpleSetup(space)
        setup.setStateValidityChecker(Validity(setup.getSpaceInformation()))
        ends = [space.allocState() for _ in range(2)]
        for state, joints in zip(ends, (start, goal), strict=True):
            for number, value in enumerate(joints.tolist()):
                state[number] = value
        setup.setStartAndGoalStates(*ends)
        setup.setPlanner(geometric.RRTConnect(setup.getSpaceInformation()))
        setup.solve(OMPL_TIMEOUT_S)
        if setup.haveExactSolutionPath():
            setup.simplifySolution()
            solved += 1
        cpu.append(time.thread_time() - began)
    print(f"  OMPL's defaults, path only: {shown(cpu)} CPU; solved {100 * solved / len(problems):.1f} %")


def measure_inverse(name: str, random: Any) -> None:
    """Solve reachable poses from home."""
    model = ROBOTS.load(name)
    for kind, variant in (("closed form", model), ("numeric", dataclasses.replace(model, solutions=None))):
        if variant.solutions is None and kind == "closed form":
            continue
        arm = Arm(variant)
        inverse, home = Inverse(arm), np.array(model.home)
        low, high = np.maximum(arm.lower, -math.pi), np.minimum(arm.upper, math.pi)
        spent, solved, count = [], 0, 2000
        for joints in random.uniform(low, high, (count, arm.n)):
            pose = arm.tool_pose(joints)
            began = time.thread_time()
            solution = inverse.solve(pose, home)
            spent.append(time.thread_time() - began)
            solved += solution is not None
        print(
            f"  inverse kinematics, {arm.n} joints, {kind}: p50 {1000 * float(np.median(spent)):.3f} ms, "
            f"solved {100 * solved / count:.2f} %"
        )


def measure_pink(name: str, random: Any) -> None:
    """Solve reachable poses from home with pink, if it is installed: differential steps with a QP solver."""
    try:
        import pink  # noqa: PLC0415 - a peer, which is not a dependency
        from pink.tasks import FrameTask  # noqa: PLC0415
    except ImportError:
        print("  pink: not installed (pip install pin-pink daqp)")
        return
    model = ROBOTS.load(name)
    arm = Arm(model)
    home, tip = np.array(model.home), arm.pin_model.frames[arm.tip].name
    low, high = np.maximum(arm.lower, -math.pi), np.minimum(arm.upper, math.pi)
    spent, solved, count = [], 0, 200
    for joints in random.uniform(low, high, (count, arm.n)):
        target = arm.tool(joints)
        began = time.thread_time()
        task = FrameTask(tip, position_cost=1.0, orientation_cost=1.0)
        task.set_target(target)
        there = pink.Configuration(arm.pin_model, arm.pin_model.createData(), home)
        for _ in range(PINK_STEPS):
            if float(np.linalg.norm(task.compute_error(there))) < PINK_TOLERANCE:
                solved += 1
                break
            with suppress(pink.PinkError):
                there.integrate_inplace(pink.solve_ik(there, [task], PINK_STEP_S, solver="daqp"), PINK_STEP_S)
        spent.append(time.thread_time() - began)
    print(
        f"  pink, one start, {PINK_STEPS} steps: p50 {1000 * float(np.median(spent)):.2f} ms, "
        f"solved {100 * solved / count:.1f} %"
    )


def measure_torques(planner: Planner, places: list[tuple[Pose, Any]]) -> None:
    """Check the torques of plans, and of setpoints as the limiter does."""
    plans = []
    for (_, start), (target, _) in list(pairwise(places))[:30]:
        with suppress(HandoverError):
            plans.append(planner.to_pose(tuple(start.tolist()), target).trajectory)
    torques = Torques(planner.arm)
    per_plan = cpu_s(lambda: [torques.allowed_speed(plan) for plan in plans]) / len(plans)
    guard = TorqueGuard(planner.model, World)
    setpoints = [plans[0].at(time_s) for time_s in np.arange(0.0, plans[0].duration_s, 0.002).tolist()]
    guard.start(plans[0].start)
    per_setpoint = cpu_s(lambda: [guard.violation(setpoint) for setpoint in setpoints]) / len(setpoints)
    print(f"  torques: {1e3 * per_plan:.2f} ms a plan, {1e6 * per_setpoint:.1f} µs a setpoint of the limiter")


def measure_checks(planner: Planner, random: Any) -> None:
    """Check configurations, and compute all distances."""
    arm = planner.arm
    low, high = np.maximum(arm.lower, -math.pi), np.minimum(arm.upper, math.pi)
    states = random.uniform(low, high, (3000, arm.n))
    collisions = Collisions(arm, planner.world)
    free = [joints for joints in states if collisions.is_free(joints, 0.01)]
    check = cpu_s(lambda: [collisions.is_free(joints, 0.01) for joints in free]) / len(free)
    some = free[:500]
    closest = cpu_s(lambda: [collisions.closest(joints) for joints in some]) / len(some)
    distances = cpu_s(lambda: [collisions.closest_index(joints) for joints in some]) / len(some)
    near = [cpu_s(lambda position=joints: collisions.within(position, HORIZON_M)) for joints in some]  # type: ignore[misc]
    count = np.mean([len(collisions.within(joints, HORIZON_M)) for joints in some])
    print(
        f"  {len(planner.world.obstacles)} obstacles, {collisions.pairs} pairs: free configuration "
        f"{1e6 * check:.1f} µs, smallest distance {1e6 * closest:.1f} µs, all distances "
        f"{1e6 * distances:.0f} µs; those below {HORIZON_M} m ({count:.0f} pairs) "
        f"p50 {1e6 * float(np.median(near)):.0f} µs, p95 {1e6 * float(np.quantile(near, 0.95)):.0f} µs"
    )


def measure_tracked(planner: Planner, random: Any) -> None:
    """Track all distances in cycles of 2 ms on straight lines between free configurations, at full speed.

    The bounds are compared with all distances, computed from scratch in each hundredth cycle.
    """
    collisions = Collisions(planner.arm, planner.world)
    low, high = np.maximum(planner.arm.lower, -math.pi), np.minimum(planner.arm.upper, math.pi)
    states = random.uniform(low, high, (300, planner.arm.n))
    free = [joints for joints in states if collisions.is_free(joints, 0.01)][:20]
    lines = [timing.line(start, end, planner.limits) for start, end in pairwise(free)]
    tracked = TrackedDistances(collisions)
    spent, wrong, cycles = [], 0, 0
    for joints in (joints for trajectory in lines for joints in trajectory.positions(CYCLE_S)):
        spent.append(cpu_s(lambda here=joints: tracked.update(here)))  # type: ignore[misc]
        cycles += 1
        if cycles % 100 == 0:
            exact = np.array([distance.distance_m for distance in collisions.distances(joints)])
            wrong += int((np.abs(exact - tracked.distances_m) > tracked.radii_m + DISTANCE_TOLERANCE_M).sum())
    p50, p95 = np.quantile(spent, [0.5, 0.95])
    print(
        f"  all {collisions.pairs} distances in each of {cycles} cycles at full speed, exact below "
        f"{tracked_distances.HORIZON_M} m, else to {100 * tracked_distances.SHARE:.0f} % of the rest: "
        f"p50 {1e6 * p50:.1f} µs, p95 {1e6 * p95:.1f} µs; {tracked.computed / cycles:.0f} computed a cycle; "
        f"outside of the bounds {wrong}"
    )


def main() -> None:
    """Print the measurements of each robot."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.robots.motion", description=__doc__)
    parser.add_argument("--problems", type=int, default=1000)
    parser.add_argument("--peers", type=int, default=100, help="the problems that OMPL's defaults plan")
    parser.add_argument("--robots", nargs="+", default=list(SCALES), choices=list(SCALES))
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    with report_steal_time():
        for name in options.robots:
            random = np.random.default_rng(options.seed)
            model, scale = ROBOTS.load(name), SCALES[name]
            planner = Planner(model, world=cell(scale, options.seed), options=Options())
            places = poses(planner, scale, options.problems + 1, random)
            print(
                f"{model.name} among {len(planner.world.obstacles)} obstacles, seed {options.seed}",
                flush=True,
            )
            measure_plans(planner, places)
            if options.peers:
                measure_ompl(planner, places, options.peers)
            measure_lines(planner, random)
            measure_inverse(name, random)
            measure_pink(name, random)
            measure_checks(planner, random)
            measure_tracked(planner, random)
            measure_torques(planner, places)


if __name__ == "__main__":
    main()
