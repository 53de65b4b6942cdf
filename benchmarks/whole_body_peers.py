"""Our solvers and cycle beside proxqp, quadprog, qpOASES and placo, in one run.

    python -m benchmarks.whole_body_peers PYTHON_OF_THE_PEERS [--problems 1400] [--rounds 3]

The peers are installed in an environment of their own, which `make bench-whole-body` makes from
requirements/bench.lock, and run in a process of their own. Both processes take turns problem by problem, and
each counts the CPU time of its thread, the least of some rounds. eiquadprog publishes no Python module, so
quadprog, of the same method, stands for it.
"""

import argparse
import json
import subprocess
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from benchmarks.steal_time import report_steal_time
from benchmarks.whole_body import AGREES, DT_S, NEARLY, Robot, juggling, walking
from services.whole_body_control.engines.stack_engine import StackEngine
from services.whole_body_control.solvers.cascade import Cascade
from services.whole_body_control.solvers.compiled import Compiled
from services.whole_body_control.solvers.hierarchical import Hierarchical
from services.whole_body_control.solvers.problem import Problem, Solver

SCRIPT = Path(__file__).with_name("peer_solvers.py")
MOVES, CYCLES_PER_MOVE = 12, 25


class Peers:
    """The process of the peers."""

    def __init__(self, python: str) -> None:
        self._process = subprocess.Popen(
            [python, str(SCRIPT)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        self.about = self._read()

    def ask(self, **request: Any) -> Any:
        """Return the answer to a request."""
        if self._process.stdin is None:
            raise RuntimeError("the process of the peers has ended")
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        return self._read()

    def _read(self) -> Any:
        line = self._process.stdout.readline() if self._process.stdout else ""
        if not line:
            raise RuntimeError(f"the process of the peers ended with {self._process.wait()}")
        return json.loads(line)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.wait()


def store(problems: list[Problem], file: Path) -> None:
    """Write problems for the other process."""
    arrays: dict[str, Any] = {"count": len(problems), "epsilon": problems[0].epsilon}
    for number, problem in enumerate(problems):
        arrays[f"{number}.rows"] = np.vstack([jacobian for jacobian, _ in problem.levels])
        arrays[f"{number}.targets"] = np.concatenate([target for _, target in problem.levels])
        arrays[f"{number}.sizes"] = np.array([len(target) for _, target in problem.levels])
        for name in ("matrix", "lower", "upper"):
            arrays[f"{number}.{name}"] = getattr(problem, name)
    np.savez(file, **arrays)


def timed(solver: Solver, problem: Problem, rounds: int) -> float:
    """Return the least CPU time in s of some solutions."""
    least = np.inf
    for _ in range(rounds):
        began = time.thread_time()
        solver.solve(problem)
        least = min(least, time.thread_time() - began)
    return float(least)


def compare(name: str, problems: list[Problem], peers: Peers, rounds: int) -> None:
    """Print the times of all solvers for the same problems."""
    ours: list[Solver] = [Compiled(), Hierarchical()]
    reference = Cascade()
    times: dict[str, list[float]] = {solver.name: [] for solver in ours}
    times |= {peer: [] for peer in peers.about["solvers"]}
    failed = dict.fromkeys(peers.about["solvers"], 0)
    different = {peer: [0, 0] for peer in peers.about["solvers"]}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "problems.npz"
        store(problems, file)
        peers.ask(file=str(file))
    for number, problem in enumerate(problems):
        for solver in ours:
            times[solver.name].append(timed(solver, problem, rounds))
        residuals = reference.solve(problem).residuals
        for peer, found in peers.ask(problem=number, rounds=rounds).items():
            if found is None:
                failed[peer] += 1
                continue
            times[peer].append(found[0])
            worst = np.abs(np.subtract(found[1], residuals)).max()
            different[peer][0] += worst > AGREES
            different[peer][1] += worst > NEARLY
    print(f"{name}: {len(problems)} problems")
    medians = {each: 1e6 * float(np.median(values)) for each, values in times.items() if values}
    for each, values in times.items():
        if not values:
            print(f"  {each}: solved none")
            continue
        text = f"  {each}: p50 {medians[each]:.0f} us, p95 {1e6 * np.quantile(values, 0.95):.0f} us"
        if each in failed:
            count = len(values)
            text += (
                f"; {failed[each]} not solved; residuals as ours to {AGREES} in "
                f"{100 * (1 - different[each][0] / count):.1f} %, to {NEARLY} in "
                f"{100 * (1 - different[each][1] / count):.1f} %"
            )
        print(text)
    best = min((medians[peer], peer) for peer in peers.about["solvers"] if peer in medians)
    for solver in ours:
        print(f"  {solver.name}: {best[0] / medians[solver.name]:.1f} times faster than {best[1]} (aim 2.5)")


def compare_cycles(peers: Peers, seed: int) -> None:
    """Print the cycle of placo, which has one hard and one soft level, beside ours with five hard ones."""
    for solver in (Compiled(), Hierarchical()):
        robot = Robot(seed)
        feet = robot.keeps("l_sole") & robot.keeps("r_sole")
        hands = robot.hands[0] & robot.hands[1]
        stack = feet / robot.com / hands / robot.waist / robot.posture << robot.limits
        engine, targets, times = StackEngine(robot.kinematics, stack, solver), [], list[float]()
        for _ in range(MOVES):
            robot.move_hands(0.05)
            targets.append([task.target.translation.tolist() for task in robot.hands])
            for _ in range(CYCLES_PER_MOVE):
                began = time.thread_time()
                robot.q = engine.step(robot.q, DT_S).q
                times.append(time.thread_time() - began)
        print(f"cycle, {solver.name}, five levels: p50 {1e6 * np.median(times):.0f} us")
    humanoid = robot.kinematics.humanoid
    joints = dict(zip(humanoid.joint_names, humanoid.pose("hands_forward"), strict=True))
    with tempfile.TemporaryDirectory() as folder:
        urdf = Path(folder) / "robot.urdf"
        urdf.write_text(humanoid.urdf, encoding="utf-8")
        found = peers.ask(urdf=str(urdf), joints=joints, targets=targets)
    if "missing" in found:
        print(f"cycle, placo: {found['missing']}")
    else:
        print(f"cycle, placo, one hard and one soft level: p50 {1e6 * np.median(found['times']):.0f} us")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", maxsplit=1)[0])
    parser.add_argument("python", help="the interpreter of the environment of the peers")
    parser.add_argument("--problems", type=int, default=1400, help="of both applications together")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=3, help="of which the least time counts")
    chosen = parser.parse_args()
    with report_steal_time(), Peers(chosen.python) as peers:
        for name, reason in peers.about["missing"].items():
            print(f"{name} is not installed: {reason}")
        for name, record in (("juggling", juggling), ("walking", walking)):
            compare(name, record(chosen.seed, chosen.problems // 2), peers, chosen.rounds)
        compare_cycles(peers, chosen.seed)


if __name__ == "__main__":
    main()
