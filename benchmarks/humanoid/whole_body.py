"""The stack of tasks on COMAN: solvers on recorded problems, a whole cycle, and the pattern generator.

    python -m benchmarks.humanoid.whole_body [--problems 1400] [--seed 1] [--rounds 5]

The problems are those of a robot that juggles and of one that walks with its hands held, each recorded by the
same seeded motion: targets jump, also beyond reach and beyond what the limits allow. Times are CPU times of
one thread. In each round one solver after the other solves all problems in their order, so that a warm start
begins with the problem before, and code and memory are as warm as in a control cycle; of each problem the
least time of all rounds counts. A solver is compared with the cascade in NumPy: at each level the residual,
where both have kept the bounds.
"""

import argparse
import time
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pinocchio as pin

from benchmarks.steal_time import report_steal_time
from handover_humanoid.engines.stack_engine import StackEngine
from handover_humanoid.model.kinematics import Array, Kinematics
from handover_humanoid.patterns.footsteps import Stance, StepLimits, Wish
from handover_humanoid.patterns.pendulum import Pendulum, PendulumState
from handover_humanoid.patterns.regions import Footprint
from handover_humanoid.patterns.walking import WalkingPattern
from handover_humanoid.patterns.zmp_control import ZmpControl
from handover_humanoid.robots import humanoid
from handover_humanoid.solvers.cascade import Cascade
from handover_humanoid.solvers.compiled import Compiled
from handover_humanoid.solvers.hierarchical import Hierarchical
from handover_humanoid.solvers.problem import EPSILON, Problem, Solution, Solver
from handover_humanoid.tasks.base import Constraint, Stack
from handover_humanoid.tasks.constraints import Contact, JointLimits
from handover_humanoid.tasks.self_collision import SelfCollision
from handover_humanoid.tasks.tasks import CentreOfMassTask, OrientationTask, PoseTask, posture

DT_S = 0.01
AGREES, NEARLY = 1e-6, 1e-3
"""daqp has no damping of its own in a hierarchy, so it is nearer to a singularity by this much."""
STEP_S, STEP_LENGTH_M, STEP_HEIGHT_M = 0.8, 0.06, 0.03
PLACES = (True,) * 3 + (False,) * 3


class Recorder:
    """Solves with the reference, and keeps every problem."""

    name = "recorder"

    def __init__(self) -> None:
        self.problems: list[Problem] = []
        self._solver = Cascade()

    def solve(self, problem: Problem) -> Solution:
        """Return the solution of the reference."""
        self.problems.append(_copy(problem))  # the engine uses its memory again
        return self._solver.solve(problem)


def _copy(problem: Problem) -> Problem:
    rows = np.vstack([jacobian for jacobian, _ in problem.levels])
    targets = np.concatenate([target for _, target in problem.levels])
    ends = np.cumsum([0, *(len(target) for _, target in problem.levels)])
    levels = [(rows[start:end], targets[start:end]) for start, end in pairwise(ends)]
    bounds = (problem.matrix.copy(), problem.lower.copy(), problem.upper.copy())
    return Problem(levels, *bounds, problem.epsilon, (rows, targets))


class Robot:
    """COMAN in its standing pose."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        self.kinematics = Kinematics(humanoid("coman"))
        self.q = self.kinematics.standing("hands_forward")
        self.kinematics.update(self.q)
        self.com = CentreOfMassTask("com", self.kinematics.centre_of_mass())
        self.hands = [self.keeps(link, PLACES) for link in ("LSoftHand", "RSoftHand")]
        self.rest = [task.target.translation.copy() for task in self.hands]
        self.waist = OrientationTask("waist", "Waist")
        self.posture = posture(self.kinematics, "hands_forward")
        self.limits = JointLimits(self.kinematics)

    def keeps(self, link: str, axes: tuple[bool, ...] = (True,) * 6) -> PoseTask:
        """Return the task to keep the pose of a link."""
        return PoseTask(link, link, self.kinematics.pose(link).copy(), axes=axes)

    def move_hands(self, spread_m: float) -> None:
        """Give the hands new targets about their rest poses."""
        for task, rest in zip(self.hands, self.rest, strict=True):
            target = rest + self.random.normal(scale=spread_m, size=3)
            task.target = pin.SE3(task.target.rotation, target)


def juggling(seed: int, count: int) -> list[Problem]:
    """Record a robot on both feet whose hands are sent to new places, some beyond reach."""
    robot, recorder = Robot(seed), Recorder()
    feet = robot.keeps("l_sole") & robot.keeps("r_sole")
    hands = robot.hands[0] & robot.hands[1]
    stack = feet / robot.com / hands / robot.waist / robot.posture << robot.limits
    engine = StackEngine(robot.kinematics, stack, recorder, EPSILON)
    for cycle in range(count):
        if cycle % 25 == 0:
            robot.move_hands(0.12)
        robot.q = engine.step(robot.q, DT_S).q
    return recorder.problems


def walking(seed: int, count: int) -> list[Problem]:
    """Record steps ahead: the foot on the ground is a constraint, hands follow a person."""
    robot, recorder = Robot(seed), Recorder()
    start = robot.com.target.copy()
    support, swing, cycles = "l_sole", "r_sole", round(STEP_S / DT_S)
    ahead = 0.0
    for cycle in range(count):
        if cycle % cycles == 0:
            support, swing = swing, support
            robot.kinematics.update(robot.q)
            foot, held = robot.keeps(swing), Contact(support)
            lifted = robot.kinematics.pose(swing).copy()
            stack: Stack = (
                (robot.com & foot) / (robot.hands[0] & robot.hands[1]) / robot.waist / robot.posture
            )
            engine = StackEngine(robot.kinematics, stack << (held, robot.limits), recorder, EPSILON)
            robot.move_hands(0.05)
            landing = robot.kinematics.pose(support).translation[0] + STEP_LENGTH_M / 2
            length = landing - lifted.translation[0]
        phase = (cycle % cycles) / cycles
        ahead += STEP_LENGTH_M / 2 / cycles
        sideways = 0.04 * np.sin(np.pi * phase) * (1 if support == "l_sole" else -1)
        robot.com.target = start + np.array([ahead, sideways, 0.0])
        smooth = phase**3 * (10 - 15 * phase + 6 * phase**2)
        lift = np.array([smooth * length, 0.0, STEP_HEIGHT_M * np.sin(np.pi * phase)])
        foot.target = pin.SE3(lifted.rotation, lifted.translation + lift)
        robot.q = engine.step(robot.q, DT_S).q
    return recorder.problems


def timed(solvers: list[Solver], problems: list[Problem], rounds: int) -> Array:
    """Return the CPU time in s of each solver (rows) for each problem."""
    least = np.full((len(solvers), len(problems)), np.inf)
    for _ in range(rounds):
        for row, solver in enumerate(solvers):
            for number, problem in enumerate(problems):
                began = time.thread_time()
                solver.solve(problem)
                least[row, number] = min(least[row, number], time.thread_time() - began)
    return least


def disagreements(solver: Solver, problems: list[Problem]) -> Iterator[tuple[int, int, float]]:
    """Yield the number of a problem, its first level that differs, and ours minus the reference there."""
    reference = Cascade()
    for number, problem in enumerate(problems):
        differences = np.subtract(solver.solve(problem).residuals, reference.solve(problem).residuals)
        different = np.flatnonzero(np.abs(differences) > AGREES)
        if len(different):
            yield number, int(different[0]), float(differences[different[0]])


def report(name: str, problems: list[Problem], solvers: list[Solver], rounds: int) -> None:
    """Print the figures of one application."""
    rows = [len(target) for _, target in problems[0].levels]
    bounded = sum(_is_bounded(problem) for problem in problems)
    print(
        f"{name}: {len(problems)} problems, {problems[0].n} velocities, levels of {rows} rows, "
        f"{len(problems[0].lower)} bounds; bounds matter in {bounded}"
    )
    times = 1e6 * timed(solvers, problems, rounds)
    for solver, values in zip(solvers, times, strict=True):
        p50, p95, most = np.quantile(values, [0.5, 0.95, 1.0])
        deviations = list(disagreements(solver, problems))
        share = 100 * (1 - len(deviations) / len(problems))
        far = [deviation for deviation in deviations if abs(deviation[2]) > NEARLY]
        nearly = 100 * (1 - len(far) / len(problems))
        print(
            f"  {solver.name}: p50 {p50:.0f} us, p95 {p95:.0f} us, max {most:.0f} us; "
            f"residuals as the reference to {AGREES} in {share:.2f} %, to {NEARLY} in {nearly:.2f} %"
        )
        for number, level, difference in far[:5]:
            print(f"    problem {number}: level {level} differs by {difference:.2g}")


def _is_bounded(problem: Problem) -> bool:
    """Return whether the solution without bounds on joints would violate one."""
    wide = problem.upper - problem.lower > 0
    slack = np.where(wide, 1e6, 0.0)
    free = Problem(
        problem.levels, problem.matrix, problem.lower - slack, problem.upper + slack, problem.epsilon
    )
    reached = problem.matrix @ Cascade().solve(free).velocity
    return bool(((reached < problem.lower - 1e-6) | (reached > problem.upper + 1e-6)).any())


def measure_cycle(solvers: list[Solver]) -> None:
    """Print the time of a whole cycle: kinematics, tasks, solution, integration; with self-collision too."""
    for solver in solvers:
        for is_checked in (False, True):
            robot = Robot(seed=1)
            constraints: list[Constraint] = [robot.limits]
            if is_checked:
                constraints.append(SelfCollision(robot.kinematics))
            feet = robot.keeps("l_sole") & robot.keeps("r_sole")
            hands = robot.hands[0] & robot.hands[1]
            stack = feet / robot.com / hands / robot.waist / robot.posture << constraints
            engine, times, solutions = StackEngine(robot.kinematics, stack, solver), list[float](), []
            for cycle in range(300):
                if cycle % 25 == 0:
                    robot.move_hands(0.05)
                began = time.thread_time()
                step = engine.step(robot.q, DT_S)
                times.append(time.thread_time() - began)
                robot.q = step.q
                solutions.append(step.solve_s)
            what = " with self-collision" if is_checked else ""
            print(
                f"cycle{what}, {solver.name}: p50 {1e6 * np.median(times):.0f} us, "
                f"of which the solver {1e6 * np.median(solutions):.0f} us"
            )


def measure_patterns() -> None:
    """Print the time of a period of the pattern generator, and of its quadratic program alone."""
    sole = np.array([[0.13, 0.05], [0.13, -0.05], [-0.07, -0.05], [-0.07, 0.05]])
    limits = StepLimits(width_m=0.15, min_width_m=0.12, max_width_m=0.22, max_length_m=0.1)
    start = Stance(Footprint("left", 0.0, 0.075), Footprint("right", 0.0, -0.075))
    control, periods, plans = ZmpControl(Pendulum(0.515)), [], []
    pattern = WalkingPattern(control, limits, sole, start)
    region = start.region(sole)
    for _ in range(300):
        began = time.thread_time()
        pattern.step(Wish(np.array([0.08, 0.0])))
        between = time.thread_time()
        control.plan(PendulumState(np.zeros(2), np.zeros(2), np.zeros(2)), [region] * 16, np.zeros(2))
        periods.append(between - began)
        plans.append(time.thread_time() - between)
    print(f"pattern generator: p50 {1e6 * np.median(periods):.0f} us a period of 0.1 s", end=", ")
    print(f"{1e6 * np.median(plans):.0f} us for the plan of a robot that stands")


def main() -> None:
    """Record, solve, and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--problems", type=int, default=1400, help="of both applications together")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=5, help="of which the least time counts")
    chosen = parser.parse_args()
    began = time.process_time()
    compiled = Compiled()
    print(f"compiled cascade ready after {time.process_time() - began:.1f} s of CPU time")
    solvers: list[Solver] = [compiled, Hierarchical(), Cascade()]
    with report_steal_time():
        for name, record in (("juggling", juggling), ("walking", walking)):
            report(name, record(chosen.seed, chosen.problems // 2), solvers, chosen.rounds)
        measure_cycle(solvers)
        measure_patterns()
    print(f"solved by the reference instead of the compiled cascade: {compiled.fallbacks}")


if __name__ == "__main__":
    main()
