"""COMAN in MuJoCo: speed of the simulation, a long walk, pushes, and the lateness of the control cycle.

    python -m benchmarks.humanoid.whole_body_walking [--minutes 5] [--no-pushes] [--seconds 60]

The walk follows seeded wishes of 8 s: ahead, back, sideways, turning, and standing, with sensor noise. The
cycle (500 Hz, the stack of tasks in each fifth) runs in a process of its own with a real clock, once with
SCHED_FIFO and once without, beside a process that keeps one core busy; 600 s are ten minutes. Speeds are CPU
times of one thread.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from handover_humanoid.behaviours.simulated_walk import SimulatedWalk, WalkRecord
from handover_humanoid.behaviours.walking import WalkingController
from handover_humanoid.components.robot import JointCommand
from handover_humanoid.cycle.ports import PortReader, PortWriter
from handover_humanoid.cycle.wish import WISH
from handover_humanoid.model.kinematics import Array
from handover_humanoid.patterns.footsteps import Wish
from handover_humanoid.robots import humanoid
from handover_humanoid.simulation.body_model import build
from handover_humanoid.simulation.simulated_robot import QUIET, TYPICAL_NOISE, SimulatedRobot
from handover_humanoid.solvers.compiled import fastest_solver
from handover_humanoid.solvers.problem import Solver

COMAN = humanoid("coman")
MODEL = build(COMAN)
STILL = Wish(np.zeros(2))
WISH_S, PART_S = 8.0, 20.0
PUSHES = ((10.0, 0.0), (-10.0, 0.0), (0.0, 5.0), (0.0, -5.0))
DEPLOYMENT = """
folder: {folder}
fifo: {fifo}
components:
  robot: {{kind: mujoco, realtime: true}}
  walking: {{kind: walking, realtime: true}}
"""


def measure_simulation(seconds: float) -> None:
    """Print how fast MuJoCo alone holds a standing pose."""
    start = WalkingController(COMAN).start
    robot, command = SimulatedRobot(COMAN, start, QUIET, 0, MODEL), JointCommand(COMAN)
    command.positions[:] = start[7:]
    began = time.thread_time()
    while robot.time_s < seconds:
        robot.write(command)
        robot.wait()
    print(f"simulation alone: {seconds / (time.thread_time() - began):.0f} times real time")


def wishes(seed: int) -> Iterator[Wish]:
    """Yield wishes; each sixth is to stand still."""
    random, number = np.random.default_rng(seed), 0
    while True:
        velocity = np.array([random.uniform(-0.05, 0.1), random.uniform(-0.03, 0.03)])
        yaw_rate = random.uniform(-0.15, 0.15)
        yield Wish(velocity, yaw_rate) if number % 6 else STILL
        number += 1


def measure_walk(solver: Solver, minutes: float, seed: int, *, is_straight: bool) -> None:
    """Print how a walk of some minutes was."""
    controller = WalkingController(COMAN, solver)
    walk = SimulatedWalk(controller, SimulatedRobot(COMAN, controller.start, TYPICAL_NOISE, seed, MODEL))
    wanted = wishes(seed)
    chosen = [next(wanted) for _ in range(int(60 * minutes / WISH_S) + 2)]
    ahead = Wish(np.array([0.08, 0.0]))
    began, records = time.thread_time(), list[WalkRecord]()
    while walk.robot.time_s < 60 * minutes and not (records and records[-1].has_fallen):
        records.append(walk.run(PART_S, lambda at: ahead if is_straight else chosen[int(at // WISH_S)]))
    used = time.thread_time() - began
    error: Array = np.concatenate(
        [np.linalg.norm(record.com - record.reference, axis=1) for record in records]
    )
    rooms = np.concatenate([record.room_m[record.is_single] for record in records])
    planned = min(float(record.planned_room_m.min()) for record in records)
    fell = f"FELL after {walk.robot.time_s:.0f} s" if records[-1].has_fallen else "no fall"
    drift = np.linalg.norm(walk.robot.true_configuration()[:2] - controller.estimator.q[:2])
    how = "ahead" if is_straight else "with seeded wishes"
    print(
        f"walk {how}, {walk.robot.time_s:.0f} s: {fell}; CoM error "
        f"RMS {1e3 * np.sqrt((error**2).mean()):.1f} mm, max {1e3 * error.max():.1f} mm; planned ZMP "
        f"{1e3 * planned:.1f} mm inside at least; measured pressure 10 mm inside in "
        f"{100 * (rooms >= 0.01).mean():.1f} % of {len(rooms)} samples in single support; odometry off by "
        f"{drift:.2f} m; {walk.robot.time_s / used:.1f} times real time with control",
        flush=True,
    )


def measure_pushes(solver: Solver) -> None:
    """Print which pushes are survived, standing and at eight moments of walking ahead."""
    for impulse in PUSHES:
        for speed, moments in ((0.0, (1.0,)), (0.05, tuple(3.0 + 0.2 * part for part in range(8)))):
            survived = 0
            for moment in moments:
                controller = WalkingController(COMAN, solver)
                walk = SimulatedWalk(
                    controller, SimulatedRobot(COMAN, controller.start, TYPICAL_NOISE, 1, MODEL)
                )
                wish = Wish(np.array([speed, 0.0]))
                walk.run(moment, lambda _, wish=wish: wish)  # type: ignore[misc]
                walk.robot.push(np.array([*impulse, 0.0]))
                survived += not walk.run(3.0, lambda _, wish=wish: wish).has_fallen  # type: ignore[misc]
            what = "walking" if speed else "standing"
            print(f"push of {impulse} N s, {what}: survived {survived} of {len(moments)}", flush=True)


def measure_cycle(seconds: float, *, fifo: bool) -> None:
    """Print how late the control cycle of a walking robot is, beside a busy core and whatever else runs."""
    with (
        tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as name,
        subprocess.Popen([sys.executable, "-c", "while True: pass"]) as busy,
    ):
        folder, file = Path(name), Path(name) / "deployment.yaml"
        file.write_text(DEPLOYMENT.format(folder=folder, fifo=str(fifo).lower()), encoding="utf-8")
        module = "handover_humanoid.control_process"
        with subprocess.Popen(
            [sys.executable, "-m", module, str(file)], stderr=subprocess.DEVNULL
        ) as process:
            try:
                report_cycle(folder, seconds, "with" if fifo else "without")
            finally:
                busy.kill()
                process.send_signal(signal.SIGTERM)


def report_cycle(folder: Path, seconds: float, how: str) -> None:
    """Let the robot walk for some time, and print the figures of its cycle."""
    while not (folder / "state").exists():
        time.sleep(0.1)
    time.sleep(1.0)
    wish, state = PortWriter(folder / "wish", WISH), PortReader(folder / "state")
    wanted = {"ahead_mps": 0.05, "speed_share": 1.0}
    ahead = np.array([wanted.get(name, 0.0) for name in WISH])
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        wish.write(ahead)
        time.sleep(0.02)
    state.read()
    names = (name for name in state.names if name.startswith(("cycles", "late", "lost", "max")))
    figures = ", ".join(f"{name} {state.value(name):.4g}" for name in names)
    share = 100 * state.value("late") / max(state.value("cycles"), 1.0)
    load = os.getloadavg()[0]
    print(
        f"cycle of 2 ms {how} SCHED_FIFO, load {load:.0f}: {share:.3f} % late by 1 ms (aim: 0.1); {figures}",
        flush=True,
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", maxsplit=1)[0])
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--no-pushes", action="store_true")
    parser.add_argument("--seconds", type=float, default=60.0, help="how long the cycle is timed; 0: not")
    chosen = parser.parse_args()
    measure_simulation(10.0)
    solver = fastest_solver()
    for fifo in (True, False) if chosen.seconds else ():
        measure_cycle(chosen.seconds, fifo=fifo)
    for is_straight in (True, False) if chosen.minutes else ():
        measure_walk(solver, chosen.minutes, chosen.seed, is_straight=is_straight)
    if not chosen.no_pushes:
        measure_pushes(solver)


if __name__ == "__main__":
    main()
