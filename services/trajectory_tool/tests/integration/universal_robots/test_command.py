"""`handover robot simulate-ur` as a process: it serves a driver, and its input moves the arm."""

import asyncio
import sys
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from handover.command_line.main import app
from handover.errors import UsageError
from handover_robots.driver_base.context import RobotContext
from handover_ur.driver import UniversalRobot
from tests.kit.ports import next_free_port
from tests.kit.ur_controllers import HOST
from tests.kit.waiting import scaled, until

pytestmark = pytest.mark.slow

NAMES = ("rtde", "dashboard", "script", "robotiq")


async def test_the_command_serves_a_driver_and_lines_of_input_are_acts_at_the_arm(
    context: RobotContext,
) -> None:
    ports = {name: next_free_port() for name in NAMES}
    options = [word for name, port in ports.items() for word in (f"--{name}-port", str(port))]
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "handover_cell", "robot", "simulate-ur", "--host", HOST, *options,
        stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
    )  # fmt: skip
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        async with asyncio.timeout(scaled(20)):
            started = await process.stdout.readline()
        assert started.decode().startswith(f"simulated controller on {HOST}: RTDE {ports['rtde']}")
        complete = replace(
            context, options={"host": HOST, **{f"{name}_port": port for name, port in ports.items()}}
        )
        async with UniversalRobot.from_context(complete) as robot:
            await until(lambda: robot.exchange.report().is_connected)
            process.stdin.write(b"push 0.25 0 0 0 0 0\n")
            async with asyncio.timeout(scaled(20)):
                answer = (await process.stdout.readline()).decode()
            assert answer.startswith("RUNNING NORMAL 0.2500")
            await until(lambda: abs(robot.state().positions[0] - 0.25) < 1e-6)
            efforts = robot.state().efforts
            assert efforts is not None
            assert len(efforts) == 6
            process.stdin.write(b"force 0 0 x\nforce 0 30 40\n")
            await until(lambda: robot.wrist_force_n() == 50.0)
    finally:
        process.kill()
        await process.wait()


@pytest.mark.parametrize("joints", ["0,1,2", "0,1,2,3,4,up"])
def test_joints_that_are_no_six_numbers_are_refused(joints: str) -> None:
    with pytest.raises(UsageError, match="six positions in rad"):
        CliRunner().invoke(app, ["robot", "simulate-ur", "--joints", joints], catch_exceptions=False)


def test_a_port_that_is_taken_is_named_with_the_way_out() -> None:
    with pytest.raises(UsageError, match=r"cannot listen on 203\.0\.113\.1: .* choose another --host"):
        CliRunner().invoke(app, ["robot", "simulate-ur", "--host", "203.0.113.1"], catch_exceptions=False)
