"""The cost of the limiter in a control cycle, beside the query of distances, in a cell with obstacles.

    python -m benchmarks.robots.limits [--robots ur10 ur5e panda] [--cycles 2000]

Every setpoint passes the limiter: setpoints of a planned motion (`limit`), and commanded velocities (`step`).
The cost is measured with the guard against collisions and without it; the second is beside the query. The
query itself, whether a configuration is free, is printed too. Times are CPU times of the thread.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np

from benchmarks.robots.motion import SCALES, cell
from benchmarks.steal_time import report_steal_time
from handover_robots.limits.guards import CollisionGuard, Guard
from handover_robots.limits.limiter import JointLimiter
from handover_robots.model.robot_model import RobotModel
from handover_robots.model.trajectory import Course, Setpoint
from handover_robots.planning.arm import Arm
from handover_robots.planning.collision import Collisions
from handover_robots.robots import ROBOTS

CYCLE_S = 0.002
AIM_US = 50.0
TURN_RAD = 0.4


def costs_us(work: Callable[[int], object], cycles: int) -> list[float]:
    """Return the CPU time of each cycle in µs."""
    times = []
    for cycle in range(cycles):
        began_ns = time.thread_time_ns()
        work(cycle)
        times.append((time.thread_time_ns() - began_ns) / 1000)
    return times


def shown(costs: list[float]) -> str:
    """Return the median, the 99th percentile, and the median as a ratio of the aim."""
    median, tail = np.median(costs), np.percentile(costs, 99)
    return f"p50 {median:6.1f} us, p99 {tail:6.1f} us ({median / AIM_US:.2f} of the aim of {AIM_US:.0f} us)"


def limiter_of(model: RobotModel, guards: list[Guard]) -> JointLimiter:
    """Return a limiter at rest at home."""
    limiter = JointLimiter(model.limits, [(joint.lower, joint.upper) for joint in model.joints], guards)
    limiter.start(model.home, 0.0)
    return limiter


def motion_of(model: RobotModel) -> list[Setpoint]:
    """Return the setpoints of a turn of the first joint and back."""
    away = (model.home[0] + TURN_RAD, *model.home[1:])
    setpoints: list[Setpoint] = []
    for start, target in ((model.home, away), (away, model.home)):
        course = Course(start, target, model.limits, model.limits, began_s=0.0)
        count = int(course.remaining_s(0.0) / CYCLE_S) + 2
        setpoints += [course.at(number * CYCLE_S) for number in range(count)]
    return setpoints


def measure(model: RobotModel, scale: float, cycles: int) -> None:
    """Print the costs of one robot."""
    world = cell(scale, 1)
    motion = motion_of(model)
    velocities = [tuple(0.1 * np.sin(0.01 * cycle + np.arange(len(model.home)))) for cycle in range(cycles)]
    print(f"{model.name} among {len(world.obstacles)} obstacles")
    for name, guards in (
        ("beside the query", []),
        ("with collisions", [CollisionGuard(model, lambda: world)]),
    ):
        planned = limiter_of(model, list(guards))
        costs = costs_us(
            lambda cycle, used=planned: used.limit(motion[cycle % len(motion)], cycle * CYCLE_S),  # type: ignore[misc]
            cycles,
        )
        print(f"  planned setpoint, {name}: {shown(costs)}")
        jogged = limiter_of(model, list(guards))
        last = [Setpoint.at_rest(model.home)]

        def step(cycle: int, used: JointLimiter = jogged, last: list[Setpoint] = last) -> None:
            last[0] = used.step(velocities[cycle], cycle * CYCLE_S)
            used.limit(last[0], cycle * CYCLE_S)

        print(f"  commanded velocity, {name}: {shown(costs_us(step, cycles))}")
    collisions = Collisions(Arm(model), world)
    places = [np.array(setpoint.positions) for setpoint in motion]
    query = costs_us(lambda cycle: collisions.is_free(places[cycle % len(places)]), cycles)
    print(f"  the query alone: p50 {np.median(query):.1f} us, p99 {np.percentile(query, 99):.1f} us")


def main() -> None:
    """Print the measurements of each robot."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.robots.limits", description=__doc__)
    parser.add_argument("--robots", nargs="+", default=list(SCALES), choices=list(SCALES))
    parser.add_argument("--cycles", type=int, default=2000)
    options = parser.parse_args()
    with report_steal_time():
        for name in options.robots:
            measure(ROBOTS.load(name), SCALES[name], options.cycles)


if __name__ == "__main__":
    main()
