"""Simulated physics: its headroom over real time, both simulated robots compared, and bin picking.

    python -m benchmarks.robots.physics [--parts 100] [--moves 20] [--seed 174]

A part counts as placed when it lies at a nest of the fixture in the simulation, whatever the tool believes. A
scan that finds no part to grip is followed by a stirred or refilled bin, as a person would do, and counts
neither way. Times are CPU times.
"""

import argparse
import asyncio
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.steal_time import report_steal_time
from handover.performer import TaskFailed
from handover_robots.cell.cell import RobotCell
from handover_robots.cell.cell_file import Base, CellPlan, RobotEntry
from handover_robots.model.poses import NO_TURN, Frame
from handover_robots.model.trajectory import Course, Setpoint
from handover_robots.physics.parts import Parts
from handover_robots.physics.robot import PhysicsRobot
from handover_robots.physics.robot_bodies import STEP_S
from handover_robots.physics.simulation import Simulation
from handover_robots.physics.world_model import build
from handover_robots.robots.ur10 import FOLDER, ROBOT
from handover_robots.scene.reading import load
from handover_robots.scene.scene import Scene
from handover_robots.settings import TrajectorySettings
from handover_robots.tasks import operations, parameters
from handover_robots.tasks.work import Work

MAX_SCANS_WITHOUT_PART = 5
NAME = "ur10-1"
FACING = (
    Frame(NO_TURN, (0.0, 0.0, 0.0)),
    Frame(((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)), (-1.3, 0.9, 0.0)),
)


class Freely:
    """Nobody pauses the work."""

    def may_go(self) -> bool:
        """Return True."""
        return True

    async def rest(self) -> None:
        """Return at once."""


def random_moves(count: int, random: Any) -> list[tuple[float, ...]]:
    """Return joint positions about home."""
    return [tuple((np.array(ROBOT.home) + random.uniform(-0.6, 0.6, 6)).tolist()) for _ in range(count)]


def measure_pace(scene: Scene, seed: int, arms: int) -> None:
    """Simulate a cell with a full bin while its arms move."""
    models = {f"ur10-{number + 1}": ROBOT.mounted(FACING[number]) for number in range(arms)}
    homes = dict.fromkeys(models, ROBOT.home)
    simulation = Simulation(build(models, scene, Parts.needed(scene)), homes)
    simulation.run(Parts(simulation, scene, seed).fill("bin-1"))
    target = (ROBOT.home[0] + 2.0, *ROBOT.home[1:])
    course = Course(ROBOT.home, target, ROBOT.limits, ROBOT.limits, simulation.time_s)
    steps, began = 0, time.thread_time()
    while steps < 2000:
        for arm in simulation.arms.values():
            arm.command(course.at(simulation.time_s))
        simulation.step()
        steps += 1
    cpu_s = time.thread_time() - began
    print(
        f"  {arms} arm{'s' * (arms > 1)}, {steps} steps of {1000 * STEP_S:.0f} ms at 500 Hz: "
        f"{1e6 * cpu_s / steps:.0f} µs CPU a step, {steps * STEP_S / cpu_s:.0f} times real time on one core"
    )


async def measure_drivers(scene: Scene, folder: Path) -> None:
    """Move two arms at once by their drivers, with all that a cycle of the tool does."""
    robots = {
        f"ur10-{number + 1}": RobotEntry(
            driver="physics", speed=1.0, base=Base(position=frame.position, yaw_deg=180 * number)
        )
        for number, frame in enumerate(FACING)
    }
    settings = TrajectorySettings(data_dir=folder, simulation_pace=0)
    plan = CellPlan(robots, scene.model_dump(mode="json"), FOLDER)
    async with RobotCell(settings, plan=plan) as cell:
        world = next(iter(cell.units.values())).robot.world  # type: ignore[attr-defined]
        targets = (tuple(turn + away for turn in ROBOT.home[:1]) + ROBOT.home[1:] for away in (0.5, 0.0) * 5)
        began, began_s = time.process_time(), world.simulation.time_s
        for target in targets:
            await asyncio.gather(*(unit.robot.move(target, 0.5, lambda: 1.0) for unit in cell.units.values()))
        cpu_s, simulated_s = time.process_time() - began, world.simulation.time_s - began_s
    print(
        f"  2 arms by their drivers, with limiter and collision check: "
        f"{1e6 * cpu_s / simulated_s * STEP_S:.0f} µs CPU a step, "
        f"{simulated_s / cpu_s:.1f} times real time on one core"
    )


def measure_agreement(moves: int, random: Any) -> None:
    """Compare the servo in physics with the setpoints that the kinematic robot shows."""
    simulation = Simulation(build({NAME: ROBOT}, Scene(name="empty"), 1), {NAME: ROBOT.home})
    worst_m = worst_s = 0.0
    here = ROBOT.home
    for target in random_moves(moves, random):
        course = Course(here, target, ROBOT.limits, ROBOT.limits, simulation.time_s)
        while not course.is_over(simulation.time_s):
            setpoint = course.at(simulation.time_s)
            wanted, reached = ROBOT.tool_pose(setpoint.positions), ROBOT.tool_pose(simulation.arm.positions)
            worst_m = max(worst_m, wanted.distance_m(reached))
            worst_s = max(worst_s, lag_s(setpoint, simulation.arm.positions))
            simulation.arm.command(setpoint)
            simulation.step()
        simulation.arm.command(Setpoint.at_rest(target))
        here = target
    print(
        f"  {moves} random moves at full speed: the tool is at most {1000 * worst_m:.2f} mm "
        f"({1000 * worst_s:.2f} ms) from where the kinematic robot is"
    )


def lag_s(setpoint: Setpoint, positions: tuple[float, ...]) -> float:
    """Return by how much time the fastest joint is behind its setpoint."""
    fastest = max(range(6), key=lambda joint: abs(setpoint.velocities[joint]))
    if abs(setpoint.velocities[fastest]) < 0.2:
        return 0.0
    return abs((setpoint.positions[fastest] - positions[fastest]) / setpoint.velocities[fastest])


class Picking:
    """Bin picking by the operations of the tool, in physics as fast as possible."""

    def __init__(self, folder: Path, seed: int) -> None:
        settings = TrajectorySettings(
            data_dir=folder, robot="physics", simulation_pace=0, scan_seed=seed, robot_speed=1.0
        )
        self.cell = RobotCell(settings)
        self.unit = self.cell.only
        robot = self.unit.robot
        assert isinstance(robot, PhysicsRobot)
        self.simulation = robot.simulation
        self.parts: Parts = robot.vision.parts  # type: ignore[union-attr]
        self.placed = self.tried = 0
        self.reasons: Counter[str] = Counter()

    async def do(self, operation: str, **asked: Any) -> dict[str, Any]:
        """Execute an operation; raises `TaskFailed`."""
        performed = operations.operation_named(operation)
        read = parameters.read(performed.parameters, operation, asked)
        task = f"task-{operation}-{self.tried}"
        return await performed.perform(Work(task, operation, self.unit, Freely(), 1.0), read)

    async def run(self, count: int) -> None:
        """Pick and place `count` parts."""
        async with self.cell:
            print(f"  calibrateCamera: {await self.do('calibrateCamera')}")
            without = 0
            while self.tried < count and without < MAX_SCANS_WITHOUT_PART:
                part = await self.do("scan", bin="bin-1")
                if not part["found"]:
                    without += 1
                    continue
                without = 0
                self.tried += 1
                await self._pick_and_place(part)

    async def _pick_and_place(self, part: dict[str, Any]) -> None:
        try:
            await self.do("pick", part=part["part"], pose=part["pose"])
            held = self.simulation.gripped_part(NAME)
            await self.do("place", location="fixture-1")
        except TaskFailed as failure:
            self.reasons[str(getattr(failure.args[0], "code", failure))] += 1
            return
        if held is not None and held in self.parts.in_fixture("fixture-1"):
            self.placed += 1
        else:
            self.reasons["placed beside the nest"] += 1


def measure_picking(count: int, seed: int) -> None:
    """Pick from bins that are filled again and again."""
    with tempfile.TemporaryDirectory() as folder:
        picking = Picking(Path(folder), seed)
        began = time.process_time()
        asyncio.run(picking.run(count))
        cpu_s = time.process_time() - began
    simulated_s = picking.simulation.time_s
    print(
        f"  bin picking, seed {seed}: {picking.placed} of {picking.tried} parts placed; others: "
        f"{dict(picking.reasons) or 'none'}; {simulated_s / max(picking.tried, 1):.1f} s simulated and "
        f"{cpu_s / max(picking.tried, 1):.2f} s CPU a part"
    )


def main() -> None:
    """Print the measurements."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.robots.physics", description=__doc__)
    parser.add_argument("--parts", type=int, default=100)
    parser.add_argument("--moves", type=int, default=20)
    parser.add_argument("--seed", type=int, default=174)
    options = parser.parse_args()
    scene = load(FOLDER / "bin_picking_physics.yaml", ROBOT)
    with report_steal_time():
        print(f"{ROBOT.name} in simulated physics")
        for arms in (1, 2):
            measure_pace(scene, options.seed, arms)
        with tempfile.TemporaryDirectory() as folder:
            asyncio.run(measure_drivers(scene, Path(folder)))
        measure_agreement(options.moves, np.random.default_rng(options.seed))
        measure_picking(options.parts, options.seed)


if __name__ == "__main__":
    main()
