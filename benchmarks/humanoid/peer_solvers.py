"""Peers of the solvers and of the cycle, in an environment of their own (requirements/bench.lock).

`benchmarks.humanoid.whole_body_peers` starts this file, writes one JSON line for each request, and reads one
for each answer. It imports nothing of the product. A cascade solves one quadratic program for each level,
with the levels above as equalities, as OpenSoT does; only the calls of the solver are timed, not what
prepares them.
"""

import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

Array = Any
EQUALITY = 1e-12


@dataclass(frozen=True)
class Program:
    """The quadratic program of a level: H, g, equalities a x = b, and low <= c x <= high."""

    level: int
    h: Array
    g: Array
    a: Array
    b: Array
    c: Array
    low: Array
    high: Array


Solve = Callable[[Program], tuple[Array, float]]
"""Returns x and the CPU time in s."""


def proxqp() -> Solve:
    """Return dense ProxQP, which keeps a program for each level and starts from its last solution."""
    from proxsuite import proxqp as prox  # noqa: PLC0415 - may be missing

    solvers: dict[tuple[int, int, int], Any] = {}

    def solve(program: Program) -> Any:
        key = (program.level, len(program.b), len(program.low))
        qp = solvers.get(key)
        if qp is None:
            qp = solvers[key] = prox.dense.QP(len(program.g), len(program.b), len(program.low))
            qp.settings.eps_abs, qp.settings.max_iter = 1e-8, 500
            qp.settings.initial_guess = prox.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
            qp.init(program.h, program.g, program.a, program.b, program.c, program.low, program.high)
            qp.solve()
        began = time.thread_time()
        qp.update(program.h, program.g, program.a, program.b, program.c, program.low, program.high)
        qp.solve()
        used = time.thread_time() - began
        if qp.results.info.status != prox.QPSolverOutput.PROXQP_SOLVED:
            raise ArithmeticError(str(qp.results.info.status))
        return np.array(qp.results.x), used

    return solve


def quadprog() -> Solve:
    """Return quadprog, the method of Goldfarb and Idnani as in eiquadprog."""
    from quadprog import solve_qp  # noqa: PLC0415 - may be missing

    def solve(program: Program) -> Any:
        rows = np.asfortranarray(np.vstack([program.a, program.c, -program.c]).T)
        values = np.concatenate([program.b, program.low, -program.high])
        began = time.thread_time()
        solution = solve_qp(program.h, -program.g, rows, values, len(program.b))[0]
        return solution, time.thread_time() - began

    return solve


def qpoases() -> Solve:
    """Return qpOASES by casadi, timed by casadi itself without the conversions from Python."""
    import casadi  # noqa: PLC0415 - may be missing

    solvers: dict[tuple[int, int], Any] = {}

    def solve(program: Program) -> Any:
        rows, count, n = np.vstack([program.a, program.c]), len(program.b) + len(program.low), len(program.g)
        made = solvers.get((program.level, count))
        if made is None:
            shape = {"h": casadi.Sparsity.dense(n, n), "a": casadi.Sparsity.dense(count, n)}
            options = {"printLevel": "none", "error_on_fail": True, "sparse": False, "record_time": True}
            made = solvers[program.level, count] = casadi.conic("level", "qpoases", shape, options)
        solver = made(
            h=program.h,
            g=program.g,
            a=rows,
            lba=np.concatenate([program.b, program.low]),
            uba=np.concatenate([program.b, program.high]),
        )
        return np.array(solver["x"]).ravel(), float(made.stats()["t_proc_solver"])

    return solve


MAKERS: dict[str, Callable[[], Solve]] = {"proxqp": proxqp, "quadprog": quadprog, "qpOASES": qpoases}


def cascade(solve: Solve, problem: dict[str, Any]) -> tuple[float, list[float]]:
    """Return the CPU time in s of all levels, and the norms of their residuals."""
    matrix, lower, upper = problem["matrix"], problem["lower"], problem["upper"]
    equal = upper - lower <= EQUALITY
    a, b = matrix[equal], lower[equal]
    c, low, high = np.ascontiguousarray(matrix[~equal]), lower[~equal], upper[~equal]
    used, x = 0.0, np.zeros(matrix.shape[1])
    for level, (jacobian, target) in enumerate(problem["levels"]):
        h = jacobian.T @ jacobian + problem["epsilon"] * np.eye(len(x))
        x, spent = solve(Program(level, h, -jacobian.T @ target, a, b, c, low, high))
        used += spent
        a, b = np.vstack([a, jacobian]), np.concatenate([b, jacobian @ x])
    return used, [float(np.linalg.norm(j @ x - t)) for j, t in problem["levels"]]


def attempt(solve: Solve, problem: dict[str, Any]) -> tuple[float, list[float]] | None:
    """Return what `cascade` does, or None where the solver fails."""
    try:
        return cascade(solve, problem)
    except (ArithmeticError, ValueError, RuntimeError):
        return None


def read(file: Path) -> list[dict[str, Any]]:
    """Return the problems of a file of `benchmarks.humanoid.whole_body_peers`."""
    stored = np.load(file)
    problems = []
    for number in range(int(stored["count"])):
        levels, end = [], 0
        for size in stored[f"{number}.sizes"]:
            part = slice(end, end + int(size))
            levels.append((stored[f"{number}.rows"][part], stored[f"{number}.targets"][part]))
            end = part.stop
        parts = {name: stored[f"{number}.{name}"] for name in ("matrix", "lower", "upper")}
        problems.append({**parts, "levels": levels, "epsilon": float(stored["epsilon"])})
    return problems


def placo_cycles(urdf: str, joints: dict[str, float], targets: list[list[list[float]]]) -> list[float]:
    """Return the CPU times in s of cycles of placo: soles hard, all else soft, limits of the URDF."""
    import placo  # noqa: PLC0415 - may be missing

    robot = placo.RobotWrapper(urdf, placo.Flags.ignore_collisions)
    for name, value in joints.items():
        robot.set_joint(name, value)
    robot.update_kinematics()
    solver = placo.KinematicsSolver(robot)
    solver.dt = 0.01
    solver.enable_joint_limits(True)
    solver.enable_velocity_limits(True)
    for sole in ("l_sole", "r_sole"):
        solver.add_frame_task(sole, robot.get_T_world_frame(sole)).configure(sole, "hard", 1.0, 1.0)
    solver.add_com_task(robot.com_world()).configure("com", "soft", 1e3)
    hands = [
        solver.add_position_task(hand, robot.get_T_world_frame(hand)[:3, 3])
        for hand in ("LSoftHand", "RSoftHand")
    ]
    for hand in hands:
        hand.configure("hand", "soft", 1.0)
    # An axis that is aligned already makes placo's own task for it divide by zero.
    solver.add_orientation_task("Waist", np.eye(3)).configure("waist", "soft", 1e-1)
    posture = solver.add_joints_task()
    posture.set_joints(joints)
    posture.configure("posture", "soft", 1e-3)
    times = []
    for places in targets:
        for hand, place in zip(hands, places, strict=True):
            hand.target_world = np.array(place)
        for _ in range(25):
            began = time.thread_time()
            robot.update_kinematics()
            solver.solve(True)
            times.append(time.thread_time() - began)
    return times


def answers() -> Iterator[dict[str, Any]]:
    """Yield an answer for each request."""
    solvers: dict[str, Solve] = {}
    missing: dict[str, str] = {}
    for name, make in MAKERS.items():
        try:
            solvers[name] = make()
        except ImportError as error:
            missing[name] = str(error)
    yield {"solvers": list(solvers), "missing": missing}
    problems: list[dict[str, Any]] = []
    for line in sys.stdin:
        request = json.loads(line)
        if "file" in request:
            problems = read(Path(request["file"]))
            yield {"count": len(problems)}
        elif "solver" in request:
            yield {"found": [attempt(solvers[request["solver"]], problem) for problem in problems]}
        else:
            try:
                yield {"times": placo_cycles(request["urdf"], request["joints"], request["targets"])}
            except (ImportError, RuntimeError, ValueError) as error:
                yield {"missing": repr(error)}


if __name__ == "__main__":
    OUT = sys.stdout
    sys.stdout = sys.stderr  # qpOASES prints
    for answer in answers():
        print(json.dumps(answer), file=OUT, flush=True)
