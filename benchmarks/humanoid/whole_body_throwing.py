"""COMAN throws a ball in MuJoCo: landing errors of each hand at 0.8 m, with sensor noise, and solver times.

    python -m benchmarks.humanoid.whole_body_throwing [--throws 100] [--seed 1]

Targets lie at 0.8 m and a height of 0.5 m in random directions. Each hand begins with its rehearsal in
simulation, without noise, or with --unpractised without. CoSiMA
shows its throws in Figures 6c and 6d, without a table of errors to compare with.
"""

import argparse
import time

import numpy as np

from handover_humanoid.behaviours.rehearsal import rehearse
from handover_humanoid.behaviours.simulated_throw import SimulatedThrow
from handover_humanoid.behaviours.throwing import Practice
from handover_humanoid.model.kinematics import Array, Kinematics
from handover_humanoid.patterns.throwing import OutOfReach, ThrowPlanner
from handover_humanoid.robots import humanoid
from handover_humanoid.simulation.ball import build_with_ball
from handover_humanoid.simulation.simulated_robot import TYPICAL_NOISE
from handover_humanoid.solvers.compiled import fastest_solver

COMAN = humanoid("coman")
DISTANCE_M, HEIGHT_M, SPREAD_RAD = 0.8, 0.5, 0.25
FIRST = 5
"""The first throws are listed; they count."""


def target(random: np.random.Generator) -> Array:
    """Return a place at the distance, in a random direction."""
    direction = random.uniform(-SPREAD_RAD, SPREAD_RAD)
    return np.array([DISTANCE_M * np.cos(direction), DISTANCE_M * np.sin(direction), HEIGHT_M])


def measure_hand(hand: str, count: int, seed: int, *, is_rehearsed: bool) -> None:
    """Print the landing errors of one hand."""
    random, practice = np.random.default_rng(seed), Practice()
    if is_rehearsed:
        began = time.thread_time()
        rehearse(practice, COMAN, [hand], np.array([DISTANCE_M, 0.0, HEIGHT_M]), fastest_solver())
        print(f"{hand}: rehearsal took {time.thread_time() - began:.1f} s CPU")
    game = SimulatedThrow(COMAN, build_with_ball(COMAN), fastest_solver(), TYPICAL_NOISE, seed)
    base = game.controller.start[:2]
    planner = ThrowPlanner(Kinematics(COMAN), game.controller.start, COMAN.grips[hand])
    missed: list[float] = []
    planning_s: list[float] = []
    refused = 0
    began_s = game.robot.time_s
    while len(missed) < count:
        wanted = target(random)
        began = time.thread_time()
        try:
            throw = planner.plan(practice.aim(hand, base, wanted))
        except OutOfReach:
            refused += 1
            continue
        planning_s.append(time.thread_time() - began)
        record = game.throw(throw)
        practice.learn(hand, base, throw.landing, record.predicted)
        missed.append(float(np.linalg.norm(record.landed - wanted)))
    misses_mm = 1e3 * np.array(missed)
    print(f"{hand}: {count} throws to {DISTANCE_M} m, {game.robot.time_s - began_s:.0f} s simulated")
    print(
        f"  landing error: median {np.median(misses_mm):.0f} mm, 95 % {np.percentile(misses_mm, 95):.0f} mm, "
        f"largest {misses_mm.max():.0f} mm (aims: 20 and 50); "
        f"the first {FIRST}: {misses_mm[:FIRST].round()} mm"
    )
    print(f"  planning: median {1e3 * np.median(planning_s):.0f} ms CPU; {refused} targets out of reach")


def main() -> None:
    """Measure both hands."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--throws", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--unpractised", action="store_true", help="without a rehearsal")
    options = parser.parse_args()
    for hand in COMAN.grips:
        measure_hand(hand, options.throws, options.seed, is_rehearsed=not options.unpractised)


if __name__ == "__main__":
    main()
