"""The driver `ur` with the simulated controller at 500 Hz: command to joint motion, and pause to rest.

    python -m benchmarks.robots.universal_robots [--repetitions 100]

The controller is a process of its own in real time, and notes when the joints begin and cease to move. A
command is a new joint velocity for `servo`, which the control thread reads in its next cycle. A pause is a
pace of 0; its plan is the remaining time of the motion once the stop has begun. CPU times stand beside.
"""

import argparse
import asyncio
import multiprocessing
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import psutil

from benchmarks.free_ports import free_ports
from benchmarks.steal_time import report_steal_time
from handover_robots.driver_base.context import RobotContext
from handover_robots.robots.ur10 import ROBOT
from handover_robots.scene.reading import load
from handover_robots.settings import TrajectorySettings
from handover_ur.driver import UniversalRobot
from handover_ur.simulator.controller import SimulatedController
from handover_ur.simulator.simulator import Ports, Simulator

HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
HOST = "127.0.0.1"
MOVING_RAD_S = 1e-6
SPEED_RAD_S = 0.2
PAUSE_AFTER_S = 1.2
AIM_COMMAND_S, AIM_PAUSE_S = 0.004, 0.1


def run_controller(ports: Ports, events: Connection) -> None:
    """Run the controller until the other end closes; send when the joints begin and cease to move."""
    controller = SimulatedController(HOME)
    moving = False

    def watch() -> None:
        nonlocal moving
        now = max(map(abs, controller.velocities)) > MOVING_RAD_S
        if now != moving:
            moving = now
            events.send((now, time.monotonic()))

    controller.on_cycle.append(watch)

    async def serve() -> None:
        async with Simulator(controller, HOST, ports):
            while not events.poll():
                await asyncio.sleep(0.05)

    asyncio.run(serve())


async def next_event(events: Connection, *, begins: bool, after_s: float) -> float:
    """Return when the joints have begun, or ceased, to move."""
    async with asyncio.timeout(20):
        while True:
            while not events.poll():
                await asyncio.sleep(0.002)
            is_moving, at_s = events.recv()
            if is_moving == begins and at_s >= after_s:
                return float(at_s)


async def measure_commands(robot: UniversalRobot, events: Connection, repetitions: int) -> None:
    """Measure from a new velocity to the first motion of the joint."""
    still = (0.0,) * 6
    commanded = [still]
    done = [False]
    moving = asyncio.create_task(robot.servo(lambda: commanded[0], lambda: done[0], lambda: 1.0))
    await asyncio.sleep(1.0)
    latencies = []
    tool, exchange = psutil.Process(), psutil.Process(robot.exchange.pid)
    began_s, began_cpu = time.monotonic(), [sum(process.cpu_times()[:2]) for process in (tool, exchange)]
    for number in range(repetitions):
        sign = 1 if number % 2 else -1
        await asyncio.sleep(0.05 + 0.0007 * (number % 17))
        at_s = time.monotonic()
        commanded[0] = (sign * SPEED_RAD_S, *still[1:])
        latencies.append(await next_event(events, begins=True, after_s=at_s) - at_s)
        commanded[0] = still
        await next_event(events, begins=False, after_s=at_s)
    spent_s = time.monotonic() - began_s
    cpu = [
        100 * (sum(process.cpu_times()[:2]) - before) / spent_s
        for process, before in zip((tool, exchange), began_cpu, strict=True)
    ]
    done[0] = True
    await moving
    report = robot.exchange.report()
    print(
        f"command to joint motion: p50 {1000 * np.median(latencies):.2f} ms, "
        f"p99 {1000 * np.percentile(latencies, 99):.2f} ms of {repetitions} "
        f"({np.percentile(latencies, 99) / AIM_COMMAND_S:.2f} of the aim of {1000 * AIM_COMMAND_S:.0f} ms); "
        f"cycles missed by the exchange process: {report.skipped_cycles}; CPU: tool {cpu[0]:.0f} %, "
        f"exchange process {cpu[1]:.0f} %"
    )


async def measure_pauses(robot: UniversalRobot, events: Connection, repetitions: int) -> None:
    """Measure from a pause to rest, beside the planned stop."""
    late, stops = [], []
    for number in range(repetitions):
        target = (1.0 if number % 2 else -1.0, *HOME[1:])
        paused_at: list[float] = []
        planned: list[float] = []
        began_s = time.monotonic()

        def pace(
            began_s: float = began_s, paused: list[float] = paused_at, plan: list[float] = planned
        ) -> float:
            if time.monotonic() - began_s < PAUSE_AFTER_S:
                return 1.0
            if not paused:
                paused.append(time.monotonic())
            elif not plan:
                plan.append(robot.remaining_s() + time.monotonic() - paused[0])
            return 0.0

        if await robot.move(target, 0.5, pace) or not planned:
            continue
        rest_s = await next_event(events, begins=False, after_s=paused_at[0])
        stops.append(rest_s - paused_at[0])
        late.append(rest_s - paused_at[0] - planned[0])
    print(
        f"pause to rest: p50 {1000 * np.median(stops):.0f} ms; after the planned end: "
        f"p50 {1000 * np.median(late):.0f} ms, p99 {1000 * np.percentile(late, 99):.0f} ms of {len(late)} "
        f"({np.percentile(late, 99) / AIM_PAUSE_S:.2f} of the aim of {1000 * AIM_PAUSE_S:.0f} ms)"
    )


async def measure(repetitions: int) -> None:
    """Start a controller and a driver, and measure."""
    ports = Ports(*free_ports(4))
    context = multiprocessing.get_context("spawn")
    events, theirs = context.Pipe()
    controller = context.Process(target=run_controller, args=(ports, theirs))
    controller.start()
    try:
        with tempfile.TemporaryDirectory() as folder:
            robot = UniversalRobot.from_context(
                RobotContext(
                    settings=TrajectorySettings.load(data_dir=Path(folder)),
                    robot_id="ur10-1",
                    options={
                        "host": HOST,
                        "rtde_port": ports.rtde,
                        "script_port": ports.script,
                        "dashboard_port": ports.dashboard,
                        "watchdog_s": 2.0,
                    },
                    model=ROBOT,
                    scene=load(None, ROBOT),
                    limits=ROBOT.limits,
                    joints=HOME,
                    gripper_closed=False,
                    gripper_s=0.0,
                    is_between_fingers=lambda _: False,
                )
            )
            async with robot:
                while not robot.exchange.report().is_connected:
                    await asyncio.sleep(0.05)
                await measure_commands(robot, events, repetitions)
                await measure_pauses(robot, events, max(repetitions // 4, 4))
    finally:
        events.send("end")
        controller.join()


def main() -> None:
    """Print the measurements."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.robots.universal_robots", description=__doc__)
    parser.add_argument("--repetitions", type=int, default=100)
    options = parser.parse_args()
    with report_steal_time():
        asyncio.run(measure(options.repetitions))


if __name__ == "__main__":
    main()
