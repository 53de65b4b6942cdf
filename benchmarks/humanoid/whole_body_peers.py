"""Our solvers and cycle beside proxqp, quadprog, qpOASES and placo, in one run.

    python -m benchmarks.humanoid.whole_body_peers PYTHON_OF_THE_PEERS [--problems 1400] [--rounds 3]

The peers are installed in an environment of their own, which `make bench-whole-body` makes from
requirements/bench.lock, and run in a process of their own. In each round one solver after the other solves
all problems in their order, as `benchmarks.humanoid.whole_body` explains; the CPU time of a thread counts,
and of each problem the least of all rounds. eiquadprog publishes no Python module, so quadprog, of the same
method, stands for it.
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

from benchmarks.humanoid.whole_body import AGREES, DT_S, NEARLY, Robot, juggling, timed, walking
from benchmarks.steal_time import report_steal_time
from handover_humanoid.engines.stack_engine import StackEngine
from handover_humanoid.solvers.cascade import Cascade
from handover_humanoid.solvers.compiled import Compiled
from handover_humanoid.solvers.hierarchical import Hierarchical
from handover_humanoid.solvers.problem import Problem, Solver

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


def compare(name: str, problems: list[Problem], peers: Peers, rounds: int) -> None:
    """Print the times of all solvers for the same problems."""
    ours: list[Solver] = [Compiled(), Hierarchical()]
    reference = Cascade()
    names = [solver.name for solver in ours]
    least = {name: np.full(len(problems), np.inf) for name in (*names, *peers.about["solvers"])}
    apart = {peer: np.full(len(problems), np.nan) for peer in peers.about["solvers"]}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "problems.npz"
        store(problems, file)
        peers.ask(file=str(file))
    residuals = [reference.solve(problem).residuals for problem in problems]
    for _ in range(rounds):
        for solver, times_of in zip(ours, timed(ours, problems, 1), strict=True):
            least[solver.name] = np.minimum(least[solver.name], times_of)
        for peer in peers.about["solvers"]:
            for number, solution in enumerate(peers.ask(solver=peer)["found"]):
                if solution is not None:
                    least[peer][number] = min(least[peer][number], solution[0])
                    apart[peer][number] = np.abs(np.subtract(solution[1], residuals[number])).max()
    print(f"{name}: {len(problems)} problems")
    times = {solver_name: values[np.isfinite(values)] for solver_name, values in least.items()}
    medians = {
        solver_name: 1e6 * float(np.median(values)) for solver_name, values in times.items() if len(values)
    }
    for solver_name, values in times.items():
        if not len(values):
            print(f"  {solver_name}: solved none")
            continue
        text = f"  {solver_name}: p50 {medians[solver_name]:.0f} us, "
        text += f"p95 {1e6 * np.quantile(values, 0.95):.0f} us"
        if solver_name in apart:
            deviations = apart[solver_name][np.isfinite(apart[solver_name])]
            text += (
                f"; {len(problems) - len(values)} not solved; residuals as ours to {AGREES} in "
                f"{100 * np.mean(deviations <= AGREES):.1f} %, to {NEARLY} in "
                f"{100 * np.mean(deviations <= NEARLY):.1f} %"
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
        answer = peers.ask(urdf=str(urdf), joints=joints, targets=targets)
    if "missing" in answer:
        print(f"cycle, placo: {answer['missing']}")
    else:
        print(f"cycle, placo, one hard and one soft level: p50 {1e6 * np.median(answer['times']):.0f} us")


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
