"""People who move robots by hand: from an input to the motion command, for one user and for many.

    python -m benchmarks.robots.control [--users 50] [--seconds 20] [--tools 2] [--send-hz 50]

The robots are kinematic UR10s at 125 Hz, in cells of one trajectory tool each; a tool is a process. They
stand 4.5 m apart, so they are not compared with each other. A user is a client that sends inputs over the
WebSocket, with the dead-man control held; inputs count from the time at which they are due. All processes
share the cores of this machine, the clients too, whose share is printed.

The tools record each control cycle: when it began, and the input that it used. An input counts once, from the
moment before it is sent to the begin of the first cycle that uses it; an input that a newer one replaced
before a cycle is not counted (the latest wins), but its share is printed. Checked in each cycle, not assumed:

- the velocity is the one that this user sent with this number: each user has a speed of their own, so that
  a command on another robot would be seen;
- the number never falls, and no newer input had arrived when the cycle began.

The limiter computes after the begin of a cycle; its cost is measured by `benchmarks.robots.limits`.
"""

import argparse
import asyncio
import contextlib
import csv
import os
import random
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import orjson
import psutil
from websockets.asyncio.client import connect

from benchmarks.free_ports import free_ports
from benchmarks.steal_time import report_steal_time

AIM_P50_MS, AIM_P99_MS = 15.0, 40.0
AIM_MANY_P99_MS = 100.0
GRID_M, GRID_COLUMNS = 4.5, 8
TURN_INPUTS = 50
"""A user moves one way for this many inputs, then back."""
SLOWEST_MPS, STEP_MPS = 0.02, 0.001
READY_TIMEOUT_S = 600.0
STARTED_AT_ONCE = 4
CLOCK_S = 0.001
"""How exactly the times of two processes agree; recorded times are rounded to 1 µs."""


@dataclass
class Tool:
    """A trajectory tool with `count` robots."""

    folder: Path
    port: int
    process: subprocess.Popen[bytes]
    count: int

    @property
    def url(self) -> str:
        """The address of the service."""
        return f"http://127.0.0.1:{self.port}"

    @property
    def robots(self) -> list["DrivenRobot"]:
        """The robots of its cell."""
        return [DrivenRobot(self, f"ur10-{number}") for number in range(1, self.count + 1)]


@dataclass(frozen=True)
class DrivenRobot:
    """One robot of a tool."""

    tool: Tool
    name: str

    @property
    def address(self) -> str:
        """The path of the robot."""
        return f"{self.tool.port}/robots/{self.name}"

    def rows(self) -> list[dict[str, str]]:
        """Return the control cycles that were recorded."""
        (file,) = (self.tool.folder / "control-recordings" / self.name).glob("*.csv")
        with file.open(encoding="utf-8") as opened:
            return list(csv.DictReader(opened))


@dataclass
class User:
    """One person at one robot; `speed_mps` is that of nobody else."""

    number: int
    sent_s: dict[int, float] = field(default_factory=dict)
    releases: int = 0
    stops: int = 0

    @property
    def speed_mps(self) -> float:
        """The speed of this user."""
        return round(SLOWEST_MPS + STEP_MPS * self.number, 6)

    def velocity_mps(self, sequence: int) -> float:
        """Return the velocity along x that this user sends with an input."""
        return self.speed_mps if sequence // TURN_INPUTS % 2 == 0 else -self.speed_mps

    async def drive(
        self, robot: DrivenRobot, seconds: float, every_s: float, all_ready: asyncio.Barrier
    ) -> None:
        """Hold the dead-man control and move to and fro; begin again after a stop."""
        state: dict[str, Any] = {}
        address = f"ws://127.0.0.1:{robot.address}/control?record=true"
        async with connect(address, proxy=None, compression=None) as socket:

            async def receive() -> None:
                async for text in socket:
                    state.update(orjson.loads(text))

            receiving = asyncio.create_task(receive())
            while not state:  # the tool is ready to move this robot
                await asyncio.sleep(0.01)
            await all_ready.wait()
            end_s = time.perf_counter() + seconds
            due_s = time.perf_counter() + every_s * random.random()  # users are not in step
            sequence, was_released = 0, True
            try:
                while time.perf_counter() < end_s:
                    sequence += 1
                    is_stopped = bool(state.get("needsRelease")) and not was_released
                    self.stops += is_stopped
                    held = sequence > 1 and not is_stopped
                    was_released = not held
                    settings = {
                        "seq": sequence,
                        "held": held,
                        "linear": [self.velocity_mps(sequence), 0.0, 0.0],
                    }
                    late_s = max(time.perf_counter() - due_s, 0.0)
                    self.sent_s[sequence] = time.time() - late_s
                    await socket.send(orjson.dumps(settings).decode())
                    due_s = max(due_s + every_s, time.perf_counter() - every_s)
                    await asyncio.sleep(max(due_s - time.perf_counter(), 0.0))
            finally:
                receiving.cancel()
                await asyncio.gather(receiving, return_exceptions=True)


@dataclass
class ControlResult:
    """What the recordings of all robots show."""

    latencies_s: list[float] = field(default_factory=list)
    intervals_s: list[float] = field(default_factory=list)
    cycles: int = 0
    inputs: int = 0
    used: int = 0
    foreign: int = 0
    old: int = 0

    def add(self, user: User, rows: Sequence[dict[str, str]]) -> None:
        """Add the cycles of the robot of a user."""
        sequence, before_s = 0, 0.0
        arrivals = {int(row["seq"]): float(row["inputT"]) for row in rows}
        newer = dict(zip(sorted(arrivals), sorted(arrivals)[1:], strict=False))
        for row in rows:
            number, at_s = int(row["seq"]), float(row["t"])
            self.cycles += 1
            if 0 < at_s - before_s < 1.0:
                self.intervals_s.append(at_s - before_s)
            before_s = at_s
            sent = user.sent_s.get(number)
            is_own = sent is not None and abs(float(row["human_x"]) - user.velocity_mps(number)) < 1e-6
            self.foreign += not is_own
            arrived_s = arrivals.get(newer.get(number, -1), float("inf"))
            self.old += number < sequence or arrived_s < at_s - CLOCK_S
            if number > sequence and sent is not None:
                self.used += 1
                self.latencies_s.append(at_s - sent)
            sequence = max(sequence, number)
        self.inputs += len(user.sent_s)

    def show(self, aims: tuple[float | None, float]) -> bool:
        """Print the result; return whether every check holds."""
        latencies = sorted(self.latencies_s)
        if not latencies:
            print("  no robot moved")
            return False
        p50, p99 = 1000 * statistics.median(latencies), 1000 * latencies[len(latencies) * 99 // 100]
        for name, value, aim in (("p50", p50, aims[0]), ("p99", p99, aims[1])):
            ratio = "" if aim is None else f" ({value / aim:.2f} of the aim of {aim:.0f} ms)"
            print(f"  input to motion command, {name}: {value:.1f} ms{ratio}")
        print(
            f"  inputs {self.inputs}, used by a cycle {self.used}, the others replaced by a newer one or at "
            f"rest; cycles {self.cycles}, median {1 / statistics.median(self.intervals_s):.0f} Hz"
        )
        print(
            f"  cycles with a command of another user: {self.foreign}; "
            f"with an input that was not the newest: {self.old}"
        )
        return self.foreign == 0 and self.old == 0


@contextlib.contextmanager
def tools(robots: int, count: int) -> Iterator[list[Tool]]:
    """Run tools with so many robots in all as processes of this machine, and end them."""
    with tempfile.TemporaryDirectory() as name:
        *ports, broker = free_ports(count + 1)
        running: list[Tool] = []
        plain = {key: value for key, value in os.environ.items() if not key.startswith("HANDOVER_")}
        try:
            for number, port in enumerate(ports):
                folder = Path(name) / str(number)
                folder.mkdir()
                own = robots // count + (number < robots % count)
                environment = plain | {
                    "HANDOVER_DATA_DIR": str(folder),
                    "HANDOVER_TRAJECTORY_PORT": str(port),
                    "HANDOVER_BROKER_URL": f"http://127.0.0.1:{broker}",
                    "HANDOVER_LOG_LEVEL": "error",
                    "HANDOVER_CELL_FILE": str(_cell_file(folder, own)),
                }
                with (folder / "log").open("wb") as log:
                    process = subprocess.Popen(
                        [sys.executable, "-m", "handover_robots"],
                        env=environment,
                        stdout=log,
                        stderr=log,
                    )
                running.append(Tool(folder, port, process, own))
                if len(running) % STARTED_AT_ONCE == 0:
                    _wait_until_ready(running[-STARTED_AT_ONCE:])
            _wait_until_ready(running)
            yield running
        finally:
            for tool in running:
                tool.process.terminate()
            for tool in running:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    tool.process.wait(20)
                tool.process.kill()
                tool.process.wait()


def _cell_file(folder: Path, count: int) -> Path:
    places = (
        (GRID_M * (number % GRID_COLUMNS), GRID_M * (number // GRID_COLUMNS)) for number in range(count)
    )
    robots = {
        f"ur10-{number}": {"model": "ur10", "base": {"position": [x, y, 0.0]}}
        for number, (x, y) in enumerate(places, 1)
    }
    file = folder / "cell.yaml"
    file.write_bytes(
        orjson.dumps({"name": "hall", "robots": robots, "scene": {"name": "hall"}})
    )  # JSON is YAML
    return file


def _wait_until_ready(started: Sequence[Tool]) -> None:
    end_s = time.monotonic() + READY_TIMEOUT_S
    for tool in started:
        while True:
            with contextlib.suppress(httpx.TransportError):
                if httpx.get(f"{tool.url}/robots", trust_env=False).is_success:
                    break
            if tool.process.poll() is not None or time.monotonic() > end_s:
                raise SystemExit(
                    f"a trajectory tool did not start: {(tool.folder / 'log').read_text()[-2000:]}"
                )
            time.sleep(0.1)


async def measure(
    started: Sequence[Tool], seconds: float, every_s: float, aims: tuple[float | None, float]
) -> bool:
    """Let a user drive each robot; print the result and return whether every check holds."""
    robots = [robot for tool in started for robot in tool.robots]
    users = [User(number) for number in range(len(robots))]
    processes = [psutil.Process(tool.process.pid) for tool in started]
    all_ready = asyncio.Barrier(len(users) + 1)
    async with asyncio.TaskGroup() as group:
        for user, robot in zip(users, robots, strict=True):
            group.create_task(user.drive(robot, seconds, every_s, all_ready))
        await all_ready.wait()
        before_s = sum(sum(process.cpu_times()[:2]) for process in processes)
        own_s, began_s = time.process_time(), time.perf_counter()
    took_s = time.perf_counter() - began_s
    clients_s = time.process_time() - own_s
    used_s = sum(sum(process.cpu_times()[:2]) for process in processes) - before_s
    for robot in robots:
        await _until_free(robot)
    result = ControlResult()
    for user, robot in zip(users, robots, strict=True):
        result.add(user, await asyncio.to_thread(robot.rows))
    print(
        f"{len(users)} user(s) on {len(robots)} robot(s) of {len(started)} tool(s), {took_s:.0f} s, "
        f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}:"
    )
    holds = result.show(aims)
    cycle_us = 1e6 * used_s / max(result.cycles, 1)
    print(
        f"  CPU: {used_s / took_s:.2f} cores for the tools, {cycle_us:.0f} us for each cycle with its "
        f"share of inputs and states; {clients_s / took_s:.2f} cores for the clients; "
        f"stops because inputs came late: {sum(user.stops for user in users)}"
    )
    return holds


async def _until_free(robot: DrivenRobot) -> None:
    """Wait until the control has ended: the recording is complete then."""
    async with asyncio.timeout(60), httpx.AsyncClient(trust_env=False) as http:
        address = f"http://127.0.0.1:{robot.address}/control"
        while (await http.get(address, timeout=30)).json()["holder"] is not None:
            await asyncio.sleep(0.05)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--users", type=int, default=50, help="users and robots at the same time")
    parser.add_argument("--seconds", type=float, default=20.0, help="how long each user drives")
    parser.add_argument("--tools", type=int, default=2, help="trajectory tools that share the robots")
    parser.add_argument("--send-hz", type=float, default=50.0, help="inputs of a user in a second")
    asked = parser.parse_args()
    every_s = 1 / asked.send_hz
    print(f"load before: {os.getloadavg()[0]:.1f}")
    with report_steal_time():
        with tools(1, 1) as started:
            holds = asyncio.run(measure(started, asked.seconds, every_s, (AIM_P50_MS, AIM_P99_MS)))
        with tools(asked.users, asked.tools) as started:
            many = measure(started, asked.seconds, every_s, (None, AIM_MANY_P99_MS))
            holds = asyncio.run(many) and holds
    if not holds:
        raise SystemExit("a robot got a command that was not the newest one of its user")


if __name__ == "__main__":
    main()
