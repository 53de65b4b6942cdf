"""Random moves with changes of pace, pauses and resumption; every sample of 1 ms is compared with the limits.

    python -m benchmarks.robots.random_moves [--moves 10000] [--robots ur10 ur5e panda] [--seed 1]

A move is a straight line or a curve through random waypoints, at a random speed. In half of them, the pace
falls and rises again. Each is paused once or twice at a random time; at rest, the robot continues with
a new motion to the target. Compared are the position, the velocity, the acceleration and the jerk of each
joint: those of the setpoints, and those of the differences of consecutive setpoints.
"""

import argparse
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks.steal_time import report_steal_time
from handover_robots.model.joint_trajectory import Array
from handover_robots.model.planned_course import PlannedCourse
from handover_robots.model.trajectory import Course, Limits
from handover_robots.planning import retiming, timing
from handover_robots.planning.arm import Arm
from handover_robots.robots import ROBOTS

ROBOT_NAMES = ("ur10", "ur5e", "panda")
EVERY_S = 0.001
LINE_SHARE, CURVE_SHARE = 0.3, 0.4
"""The fractions of planned lines and of curves; the others are lines of the tool without planning."""
RESUME_WITHIN = 1e-3
"""At this distance of a joint to the target (rad), a paused move is over."""
LIMIT_TOLERANCE = 1e-4
"""Of a limit: the tolerance of the execution of a change of pace."""


@dataclass
class Result:
    """What was found: the highest value of each quantity as a fraction of its limit."""

    moves: int = 0
    pauses: int = 0
    samples: int = 0
    exceeded: Counter[str] = field(default_factory=Counter)
    peaks: dict[str, float] = field(default_factory=dict)
    stops_s: list[float] = field(default_factory=list)

    def compare(self, ratios: dict[str, float], samples: int) -> bool:
        """Add a motion; return whether it exceeded a limit."""
        self.samples += samples
        over = [name for name, ratio in ratios.items() if ratio > 1 + LIMIT_TOLERANCE]
        self.exceeded.update(over)
        for name, ratio in ratios.items():
            self.peaks[name] = max(self.peaks.get(name, 0.0), ratio)
        return bool(over)


class Moves:
    """Random moves of one robot."""

    def __init__(self, name: str, seed: int) -> None:
        model = ROBOTS.load(name)
        self.arm, self.limits = Arm(model), model.limits
        self.random = np.random.default_rng(seed)
        self.result = Result()
        self._low, self._high = np.maximum(self.arm.lower, -2.5), np.minimum(self.arm.upper, 2.5)

    def run(self, moves: int) -> Iterator[str]:
        """Yield a line for each motion that exceeds a limit."""
        for number in range(moves):
            self.result.moves += 1
            path = list(self.random.uniform(self._low, self._high, (self._points(), self.arm.n)))
            for _ in range(int(self.random.integers(1, 3))):
                here = yield from self._paused(number, path)
                if float(np.abs(here - path[-1]).max()) < RESUME_WITHIN:
                    break
                path = [here, path[-1]]
            else:
                yield from self._paused(number, path, is_last=True)

    def _points(self) -> int:
        return int(self.random.integers(3, 6)) if self.random.random() < CURVE_SHARE else 2

    def _paused(self, number: int, path: list[Array], *, is_last: bool = False) -> Iterator[str] | Any:
        """Move along `path`, with a pause except in the last motion; return where the joints rest."""
        speed = float(self.random.choice([1.0, self.random.uniform(0.2, 1.0)]))
        course, duration_s = self._course(path, speed)
        pause_s = np.inf if is_last else float(self.random.uniform(0.0, duration_s))
        change_s = (
            self.random.uniform(0.0, min(pause_s, duration_s)) if self.random.random() < 0.5 else np.inf
        )
        raise_s, pace = change_s + self.random.uniform(0.05, 0.6), float(self.random.uniform(0.1, 0.9))
        first_s, setpoints = min(pause_s, change_s, duration_s), []
        before_s = np.arange(0.0, first_s, EVERY_S)
        if isinstance(course, Course):
            before = [np.zeros((0, self.arm.n))] * 3
            now_s = 0.0
        else:  # Until the first change, the course is its trajectory: evaluate all times at once.
            before = [course.trajectory.derivative(before_s, order) for order in (0, 1, 2)]
            now_s = len(before_s) * EVERY_S
            course.at(float(before_s[-1]) if len(before_s) else 0.0)
        while True:
            allowed = 0.0 if now_s >= pause_s else pace if change_s <= now_s < raise_s else 1.0
            setpoints.append(course.at(now_s, pace=allowed))
            if course.is_over(now_s):
                break
            now_s += EVERY_S
        if pause_s < now_s:
            self.result.pauses += 1
            self.result.stops_s.append(now_s - pause_s)
        positions, velocities, accelerations = (
            np.concatenate([values, np.array([setpoint.derivatives[order] for setpoint in setpoints])])
            for order, values in enumerate(before)
        )
        ratios = self._ratios(positions, velocities, accelerations)
        if self.result.compare(ratios, len(positions)):
            yield (
                f"    move {number}: {type(course).__name__}, speed {speed:.3f}, pause at {pause_s:.3f} s, "
                f"pace {pace:.2f} from {change_s:.3f} to {raise_s:.3f} s, {ratios}, "
                f"path {[position.tolist() for position in path]}"
            )
        return positions[-1]

    def _course(self, path: list[Array], speed: float) -> tuple[Course | PlannedCourse, float]:
        limits = self.limits
        if len(path) > 2:
            curve = timing.along(timing.BlendedLines(path, limits), limits)
            trajectory = retiming.faster(curve, limits).slowed(speed)
            return PlannedCourse(trajectory, limits, 0.0), trajectory.duration_s
        if self.random.random() < LINE_SHARE / (1 - CURVE_SHARE):
            trajectory = timing.line(path[0], path[1], limits).slowed(speed)
            return PlannedCourse(trajectory, limits, 0.0), trajectory.duration_s
        start, target = (tuple(position.tolist()) for position in path)
        course = Course(start, target, limits.slowed(speed), limits, 0.0)
        return course, course.remaining_s(0.0)

    def _ratios(self, positions: Array, velocities: Array, accelerations: Array) -> dict[str, float]:
        """Return the highest value of each quantity as a fraction of its limit."""
        limits: Limits = self.limits
        fastest, strongest, jerk = (
            np.array(bound) for bound in (limits.velocity, limits.acceleration, limits.jerk)
        )
        middle, half = (self.arm.upper + self.arm.lower) / 2, (self.arm.upper - self.arm.lower) / 2
        steps = {
            "position": (positions - middle) / half,
            "velocity": velocities / fastest,
            "acceleration": accelerations / strongest,
            "velocity between samples": np.diff(positions, axis=0) / EVERY_S / fastest,
            "acceleration between samples": np.diff(velocities, axis=0) / EVERY_S / strongest,
            "jerk between samples": np.diff(accelerations, axis=0) / EVERY_S / jerk,
        }
        return {name: float(np.abs(values).max(initial=0.0)) for name, values in steps.items()}


def main() -> None:
    """Print the result of each robot. Exit with 1 when a limit was exceeded."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.robots.random_moves", description=__doc__)
    parser.add_argument("--moves", type=int, default=10_000)
    parser.add_argument("--robots", nargs="+", default=list(ROBOT_NAMES), choices=list(ROBOT_NAMES))
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    is_exceeded = False
    with report_steal_time():
        ends = np.linspace(0, options.moves, len(options.robots) + 1).astype(int)
        for name, (first, last) in zip(options.robots, pairwise(ends.tolist()), strict=True):
            began = time.thread_time()
            moves = Moves(name, options.seed)
            for line in moves.run(last - first):
                print(line, flush=True)
            result = moves.result
            is_exceeded = is_exceeded or bool(result.exceeded)
            print(
                f"{name}: {result.moves} random moves, {result.pauses} pauses, {result.samples} samples of "
                f"1 ms, seed {options.seed}: exceeded {dict(result.exceeded) or 'nothing'} "
                f"({time.thread_time() - began:.0f} s CPU)",
                flush=True,
            )
            print("  highest: " + ", ".join(f"{what} {peak:.5f}" for what, peak in result.peaks.items()))
            middle, high = np.quantile(result.stops_s, [0.5, 0.95])
            print(f"  pause to rest: p50 {middle:.3f} s, p95 {high:.3f} s, max {max(result.stops_s):.3f} s")
    raise SystemExit(int(is_exceeded))


if __name__ == "__main__":
    main()
