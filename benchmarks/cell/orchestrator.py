"""The orchestrator as a service: a broker, the orchestrator and a performer that moves Tasks in batches.

    python -m benchmarks.cell.orchestrator [--instances 2000] [--seconds 10] [--rounds 1000] [--postgres]

Broker and orchestrator are processes of their own with durable stores; this process is the performer: it
subscribes to Tasks and completes them with batch updates. Prints the figures with their aims. CPU time is
that of the orchestrator, which other load on the machine changes little; wall times hold only on an idle
machine.
"""

import argparse
import asyncio
import random
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import orjson
import psutil

from benchmarks.cell.token_engine import ENDS, LOOP, flow, path
from benchmarks.free_ports import free_ports
from benchmarks.steal_time import report_steal_time
from handover.broker import BrokerClient
from handover.settings import Settings
from tests.kit import processes
from tests.kit.postgres import postgres_server

IN_FLIGHT = 100
STARTS = 300
CONCURRENT_STARTS = 16
THINK_S = 4.0
"""Upper limit of the time that a performer takes for a Task while the latency is measured."""
IDLE_S = 10.0
MAX_BATCH = 100
START_TIMEOUT_S = 600.0
KEY = "key-of-the-benchmark"
VARIABLE = (
    '<extensionElements><handover:process><handover:parameter name="stop"/></handover:process>'
    "</extensionElements>"
)


def bpmn(name: str, content: str) -> bytes:
    """Return the BPMN file of the process `name` with the parameter `stop`."""
    return (
        '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="urn:benchmark" '
        'xmlns:handover="urn:handover:bpmn">'
        f'<process id="{name}" isExecutable="true">{VARIABLE}{content}</process></definitions>'
    ).encode()


def work(name: str) -> str:
    """Return an activity for a robot."""
    return (
        f'<userTask id="{name}"><extensionElements><handover:task definition="{name}">'
        '<handover:involves resource="Device:robot-1"/></handover:task></extensionElements></userTask>'
    )


LOOP_FILE = bpmn(
    "loop",
    f"{ENDS}{LOOP}{work('a')}" + path("start", "in", "a", "out", "in") + flow("out", "end", "a.stop"),
)


def sequence(name: str) -> bytes:
    """Return a process of five activities."""
    names = [f"t{number}" for number in range(5)]
    return bpmn(name, ENDS + "".join(map(work, names)) + path("start", *names, "end"))


SEQUENCE_FILE = sequence("sequence")


class Service:
    """A service as a process of its own."""

    def __init__(self, module: str, url: str, environment: dict[str, str], folder: Path) -> None:
        self.url = url
        self._module = module
        self._environment = environment
        self._log = folder / f"{module}.log"
        self._folder = folder
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> float:
        """Start it; return the seconds until it is ready."""
        started = time.perf_counter()
        command = processes.module_command(self._module)
        self.process = processes.spawn(command, self._environment, self._log, self._folder)
        processes.wait_ready(
            self.process, f"{self.url}/readyz", lambda: self._log.read_text(errors="replace"), START_TIMEOUT_S
        )
        return time.perf_counter() - started

    def stop(self) -> None:
        """Stop it in good order."""
        if self.process is not None and self.process.poll() is None:
            processes.stop(self.process, START_TIMEOUT_S)

    def cpu_s(self) -> float:
        """Return the CPU time that it has used."""
        assert self.process is not None
        times = psutil.Process(self.process.pid).cpu_times()
        return float(times.user + times.system)

    def resident(self) -> int:
        """Return its resident memory in bytes."""
        assert self.process is not None
        return int(psutil.Process(self.process.pid).memory_info().rss)


@dataclass
class Measured:
    """CPU and wall time of a part of the benchmark; valid after its context."""

    service: Service
    cpu_s: float = 0.0
    wall_s: float = 0.0

    @contextmanager
    def measure(self) -> Iterator["Measured"]:
        """Measure while the context lasts."""
        cpu, wall = self.service.cpu_s(), time.perf_counter()
        yield self
        self.cpu_s, self.wall_s = self.service.cpu_s() - cpu, time.perf_counter() - wall


@dataclass
class BatchPerformer:
    """Completes pending Tasks in batches; `think` returns the seconds that a Task takes."""

    broker: BrokerClient
    think: Callable[[], float] | None = lambda: 0.0
    """None: Tasks stay pending."""
    outputs: dict[str, Any] = field(default_factory=dict)
    completed: int = 0
    latencies_s: list[float] = field(default_factory=list)
    on_completed: Callable[[int], None] = lambda _: None
    _completed_at: dict[str, float] = field(default_factory=dict)
    _seen: set[str] = field(default_factory=set)
    _ready: asyncio.Queue[str] = field(default_factory=asyncio.Queue)

    def take(self, entities: list[dict[str, Any]]) -> None:
        """Accept the Tasks of a notification."""
        now = time.perf_counter()
        for entity in entities:
            task = str(entity["id"])
            if entity["status"]["value"] != "pending" or task in self._seen:
                continue
            self._seen.add(task)
            since = self._completed_at.pop(_process_of(task), None)
            if since is not None:
                self.latencies_s.append(now - since)
            if self.think is not None:
                asyncio.get_running_loop().call_later(self.think(), self._ready.put_nowait, task)

    async def work(self) -> None:
        """Complete Tasks for ever."""
        while True:
            batch = [await self._ready.get()]
            while len(batch) < MAX_BATCH and not self._ready.empty():
                batch.append(self._ready.get_nowait())
            at = datetime.now(UTC).isoformat().replace("+00:00", "Z")
            now = time.perf_counter()
            for task in batch:
                self._completed_at[_process_of(task)] = now
            await self.broker.upsert(
                [
                    {
                        "id": task,
                        "type": "Task",
                        "status": {"type": "Property", "value": "completed", "observedAt": at},
                        "outputParameters": {"type": "Property", "value": self.outputs, "observedAt": at},
                    }
                    for task in batch
                ]
            )
            self.completed += len(batch)
            self.on_completed(self.completed)

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer the notifications of a connection of the broker."""
        try:
            while True:
                head = (await reader.readuntil(b"\r\n\r\n")).lower()
                length = int(head.split(b"content-length:")[1].split(b"\r\n")[0])
                body = orjson.loads(await reader.readexactly(length))
                writer.write(b"HTTP/1.1 204 No Content\r\n\r\n")
                self.take(body["data"])
        except (asyncio.IncompleteReadError, asyncio.CancelledError, ConnectionError):
            writer.close()


def _process_of(task: str) -> str:
    return task.rsplit("-", 2)[0]


class Cell:
    """A broker, an orchestrator and the performer of this process."""

    def __init__(self, folder: Path, database_url: str | None) -> None:
        broker, orchestrator = free_ports(2)
        environment = {
            **processes.clean_environment(),
            "HANDOVER_DATA_DIR": str(folder),
            "HANDOVER_BROKER_PORT": str(broker),
            "HANDOVER_BROKER_URL": f"http://127.0.0.1:{broker}",
            "HANDOVER_ORCHESTRATOR_PORT": str(orchestrator),
            "HANDOVER_LOG_LEVEL": "warning",
            "HANDOVER_TASK_DEADLINE_S": "100000",
        }
        own = {**environment, "HANDOVER_DATABASE_URL": database_url} if database_url else environment
        self.broker = Service("handover_broker", environment["HANDOVER_BROKER_URL"], environment, folder)
        self.orchestrator = Service("handover_processes", f"http://127.0.0.1:{orchestrator}", own, folder)
        self.settings = Settings(broker_url=environment["HANDOVER_BROKER_URL"], data_dir=folder)
        self.folder = folder
        self.api = httpx.AsyncClient(base_url=self.orchestrator.url, trust_env=False, timeout=120)
        self.client = BrokerClient(self.settings, timeout_s=120)
        self.performer = BatchPerformer(self.client)

    async def open(self) -> list[Any]:
        """Start everything; return what must be kept while it runs."""
        self.broker.start()
        self.orchestrator.start()
        server = await asyncio.start_server(self.performer.serve, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        await self.client.ensure_subscription(
            {
                "id": self.settings.entity_id("Subscription", "benchmark"),
                "type": "Subscription",
                "entities": [{"type": "Task"}],
                "watchedAttributes": ["status"],
                "q": 'status=="pending"',
                "notification": {
                    "endpoint": {"uri": f"http://127.0.0.1:{port}/", "accept": "application/json"}
                },
            }
        )
        for xml in (LOOP_FILE, SEQUENCE_FILE):
            await self.deploy(xml)
        return [server, asyncio.create_task(self.performer.work())]

    async def close(self, kept: list[Any]) -> None:
        """Stop everything."""
        server, worker = kept
        worker.cancel()
        server.close()
        await self.api.aclose()
        await self.client.__aexit__()
        self.orchestrator.stop()
        self.broker.stop()

    async def deploy(self, xml: bytes) -> None:
        """Deploy a file."""
        answer = await self.api.post("/definitions", content=xml, headers={"Content-Type": "application/xml"})
        answer.raise_for_status()

    async def start_processes(self, definition: str, count: int) -> None:
        """Start processes, some at a time."""
        slots = asyncio.Semaphore(CONCURRENT_STARTS)

        async def start() -> None:
            async with slots:
                body = {"definition": definition, "parameters": {"stop": False}}
                (await self.api.post("/processes", json=body)).raise_for_status()

        await asyncio.gather(*(start() for _ in range(count)))

    async def until(self, condition: Callable[[], bool | Awaitable[bool]]) -> None:
        """Wait until a condition holds."""
        while True:
            holds = condition()
            if holds if isinstance(holds, bool) else await holds:
                return
            await asyncio.sleep(0.05)

    async def has_ended(self) -> bool:
        """Return whether no process runs."""
        running = await self.api.get("/processes", params={"status": "inProgress", "limit": 1})
        return not running.json()


def report(name: str, value: str, aim: str) -> None:
    """Print a figure with its aim."""
    print(f"{name:58} {value:34} aim: {aim}", flush=True)


async def measure_start(cell: Cell) -> None:
    """Print the cost of starting a process whose first Task no performer accepts."""
    cell.performer.think = None
    await cell.start_processes("sequence", CONCURRENT_STARTS)
    with Measured(cell.orchestrator).measure() as measured:
        await cell.start_processes("sequence", STARTS)
    report(
        "start of a process",
        f"{measured.cpu_s / STARTS * 1e3:.1f} ms CPU, {STARTS / measured.wall_s:.0f}/s wall",
        "5 ms CPU",
    )


async def measure_steps(cell: Cell, seconds: float, aim: int) -> None:
    """Print the durable steps a second with `IN_FLIGHT` processes whose Tasks are completed at once."""
    performer = cell.performer
    performer.think, performer.outputs = (lambda: 0.0), {"stop": False}
    await cell.start_processes("loop", IN_FLIGHT)
    await cell.until(lambda: performer.completed > IN_FLIGHT)
    before, broker_cpu = performer.completed, cell.broker.cpu_s()
    with Measured(cell.orchestrator).measure() as measured:
        await asyncio.sleep(seconds)
    steps = performer.completed - before
    report(
        "durable steps a second of CPU",
        f"{steps / measured.cpu_s:.0f}/s CPU, {steps / measured.wall_s:.0f}/s wall",
        f"{aim}/s",
    )
    broker_ms = (cell.broker.cpu_s() - broker_cpu) / steps * 1e3
    report(
        "CPU of a step",
        f"{measured.cpu_s / steps * 1e3:.2f} ms, broker {broker_ms:.2f} ms",
        f"{1000 / aim:.1f} ms",
    )


async def measure_latency(cell: Cell, seconds: float) -> None:
    """Print the time from a completed Task to the notification of the next one."""
    performer = cell.performer
    chance = random.Random(0)
    performer.think = lambda: chance.uniform(0.0, THINK_S)
    await asyncio.sleep(THINK_S)
    performer.latencies_s.clear()
    await asyncio.sleep(seconds)
    latencies_s = sorted(performer.latencies_s)
    p50, p99 = statistics.median(latencies_s), latencies_s[int(len(latencies_s) * 0.99)]
    report(
        f"completed Task to next Task, {len(latencies_s) / seconds:.0f}/s ({IN_FLIGHT} in flight)",
        f"p50 {p50 * 1e3:.0f} ms, p99 {p99 * 1e3:.0f} ms wall",
        "p50 15 ms, p99 50 ms",
    )


async def measure_loop(cell: Cell, rounds: int) -> None:
    """Print the CPU time of a step in the first and in the last rounds of a loop."""
    performer = cell.performer
    part = max(rounds // 10, 1)
    marks: list[tuple[int, float]] = []
    first = performer.completed

    def mark(completed: int) -> None:
        if completed - first in {1, part, rounds - part, rounds}:
            marks.append((completed - first, cell.orchestrator.cpu_s()))

    performer.think, performer.outputs, performer.on_completed = (lambda: 0.0), {"stop": False}, mark
    await cell.start_processes("loop", 1)
    await cell.until(lambda: performer.completed - first >= rounds)
    performer.on_completed = lambda _: None
    await end_all(cell)
    (n0, c0), (n1, c1), (n2, c2), (n3, c3) = marks[:4]
    report(
        f"CPU of a step alone, rounds {n0} to {n1} and {n2} to {n3}",
        f"{(c1 - c0) / (n1 - n0) * 1e3:.1f} ms and {(c3 - c2) / (n3 - n2) * 1e3:.1f} ms",
        "equal",
    )


async def measure_definitions(cell: Cell, count: int) -> None:
    """Print the time of a start-up with many definitions of which no process runs."""
    for number in range(count):
        await cell.deploy(sequence(f"definition-{number}"))
    cell.orchestrator.stop()
    wall = cell.orchestrator.start()
    report(
        f"start-up with {count} definitions",
        f"{cell.orchestrator.cpu_s():.1f} s CPU, {wall:.1f} s wall",
        "10 s with 1000 definitions",
    )


async def end_all(cell: Cell) -> None:
    """Let all loops end."""
    cell.performer.think, cell.performer.outputs = (lambda: 0.0), {"stop": True}
    await cell.until(cell.has_ended)


async def measure_many(cell: Cell, instances: int) -> None:
    """Print the memory, the idle CPU, the restart and the listing of many running processes."""
    cell.performer.think = None
    await cell.start_processes("sequence", STARTS)
    before = cell.orchestrator.resident()
    await cell.start_processes("sequence", instances)
    await asyncio.sleep(2)
    grown = (cell.orchestrator.resident() - before) / instances
    report(f"memory of a process, {instances} running", f"{grown / 1e3:.0f} kB", "20 kB")
    with Measured(cell.orchestrator).measure() as measured:
        await asyncio.sleep(IDLE_S)
    report("idle CPU", f"{measured.cpu_s / measured.wall_s:.1%} of a core", "3 %")
    times = []
    with Measured(cell.orchestrator).measure() as measured:
        for _ in range(10):
            started = time.perf_counter()
            (await cell.api.get("/processes", params={"limit": 1000})).raise_for_status()
            times.append(time.perf_counter() - started)
    report(
        "/processes?limit=1000",
        f"{measured.cpu_s * 100:.0f} ms CPU, median {statistics.median(times) * 1e3:.0f} ms wall",
        "100 ms",
    )
    cell.orchestrator.stop()
    wall = cell.orchestrator.start()
    report(
        "restart", f"{cell.orchestrator.cpu_s():.1f} s CPU, {wall:.1f} s wall", "10 s with 10000 processes"
    )


async def measure(arguments: argparse.Namespace, database_url: str | None) -> None:
    """Print all figures."""
    with tempfile.TemporaryDirectory(prefix="handover-benchmark-") as folder:
        cell = Cell(Path(folder), database_url)
        kept = await cell.open()
        try:
            await measure_start(cell)
            await measure_steps(cell, arguments.seconds, 150 if database_url else 250)
            await measure_latency(cell, arguments.seconds)
            cell.performer.think, cell.performer.outputs = (lambda: 0.0), {"stop": True}
            await asyncio.sleep(THINK_S + 1)
            await measure_many(cell, arguments.instances)
        finally:
            await cell.close(kept)
    with tempfile.TemporaryDirectory(prefix="handover-benchmark-") as folder:
        cell = Cell(Path(folder), None)
        kept = await cell.open()
        try:
            await measure_loop(cell, arguments.rounds)
            await measure_definitions(cell, arguments.definitions)
        finally:
            await cell.close(kept)


def main() -> None:
    """Measure the orchestrator and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--instances", type=int, default=2000, help="running processes")
    parser.add_argument("--seconds", type=float, default=10.0, help="duration of a measurement")
    parser.add_argument("--definitions", type=int, default=200, help="definitions at the start-up")
    parser.add_argument("--rounds", type=int, default=1000, help="rounds of the loop")
    parser.add_argument("--postgres", action="store_true", help="PostgreSQL instead of SQLite")
    arguments = parser.parse_args()
    print(f"load average at the start: {psutil.getloadavg()[0]:.1f} on {psutil.cpu_count()} CPUs")
    with report_steal_time(), postgres_server() if arguments.postgres else nullcontext() as server:
        asyncio.run(measure(arguments, server.new_database() if server is not None else None))


if __name__ == "__main__":
    sys.exit(main())
