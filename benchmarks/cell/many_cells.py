"""Many cells on one broker: an orchestrator and a performer each, as processes of their own, without a page.

    python -m benchmarks.cell.many_cells [--cells 50] [--rates 0.1 0.2 0.5 1] [--seconds 30] [--broker URL]

Each cell starts processes of five Tasks at a rate that does not wait for their ends (an open load), at each
of the rates in turn. Prints how long a process takes, memory (PSS: shared pages count once) and CPU of a
cell and of the broker, and what gave way first: a process that takes longer than `--limit` at p99, one that
was refused, or one that had not ended. All processes share the cores of this machine.
"""

import argparse
import asyncio
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx
import psutil

from benchmarks.cell.orchestrator import SEQUENCE_FILE, Service
from benchmarks.free_ports import free_ports
from benchmarks.steal_time import report_steal_time
from tests.kit import processes

MIB = 1024 * 1024
REST_S = 20.0
"""How long the processes of a rate may take to end after the last was started."""
STARTED_TOGETHER = 4


class PerformedCell:
    """An orchestrator and its performer."""

    def __init__(self, name: str, folder: Path, broker_url: str) -> None:
        orchestrator, performer = free_ports(2)
        folder.mkdir()
        environment = {
            **processes.clean_environment(),
            "HANDOVER_FACTORY": name,
            "HANDOVER_DATA_DIR": str(folder),
            "HANDOVER_BROKER_URL": broker_url,
            "HANDOVER_ORCHESTRATOR_PORT": str(orchestrator),
            "HANDOVER_LOG_LEVEL": "warning",
            "PERFORMER_PORT": str(performer),
        }
        url = f"http://127.0.0.1:{orchestrator}"
        self.orchestrator = Service("handover_processes", url, environment, folder)
        self.performer = Service(
            "benchmarks.cell.cell_performer", f"http://127.0.0.1:{performer}", environment, folder
        )

    def start(self) -> None:
        """Start both, and deploy the process."""
        self.orchestrator.start()
        self.performer.start()
        answer = httpx.post(
            f"{self.orchestrator.url}/definitions",
            content=SEQUENCE_FILE,
            headers={"Content-Type": "application/xml"},
            timeout=60,
            trust_env=False,
        )
        answer.raise_for_status()

    def stop(self) -> None:
        """Stop both."""
        self.performer.stop()
        self.orchestrator.stop()


@dataclass
class Load:
    """What the processes of one rate have shown."""

    durations_s: list[float] = field(default_factory=list)
    refused: int = 0
    unfinished: int = 0

    async def run(self, cells: Sequence[PerformedCell], rate: float, seconds: float) -> None:
        """Start processes at `rate` per second in each cell for some seconds, and wait for their ends."""
        async with httpx.AsyncClient(trust_env=False, timeout=60) as http:
            await asyncio.gather(
                *(self._run(http, cell, number / len(cells) / rate, rate, seconds)
                  for number, cell in enumerate(cells))
            )  # fmt: skip

    async def _run(
        self, http: httpx.AsyncClient, cell: PerformedCell, delay_s: float, rate: float, seconds: float
    ) -> None:
        begun = time.monotonic() + delay_s
        starts = []
        for number in range(max(1, round(rate * seconds))):
            await asyncio.sleep(max(0.0, begun + number / rate - time.monotonic()))
            starts.append(asyncio.create_task(self._start(http, cell)))
        started = [start for start in await asyncio.gather(*starts) if start is not None]
        until = time.monotonic() + REST_S
        ended: dict[str, Any] = {}
        while len(ended) < len(started) and time.monotonic() < until:
            await asyncio.sleep(1)
            for process_id in set(started) - ended.keys():
                process = (await http.get(f"{cell.orchestrator.url}/processes/{process_id}")).json()
                if process["endedAt"]:
                    ended[process_id] = process
        self.unfinished += len(started) - len(ended)
        self.durations_s += [
            (
                datetime.fromisoformat(instance["endedAt"]) - datetime.fromisoformat(instance["startedAt"])
            ).total_seconds()
            for instance in ended.values()
        ]

    async def _start(self, http: httpx.AsyncClient, cell: PerformedCell) -> str | None:
        body = {"definition": "sequence", "parameters": {"stop": False}}
        try:
            answer = await http.post(f"{cell.orchestrator.url}/processes", json=body)
            answer.raise_for_status()
        except httpx.HTTPError:
            self.refused += 1
            return None
        return str(answer.json()["id"])

    def gave_way(self, limit_s: float) -> str | None:
        """Return what was too much; None if all was done in time."""
        if self.refused:
            return f"{self.refused} processes were refused"
        if self.unfinished:
            return f"{self.unfinished} processes had not ended {REST_S:.0f} s after the last was started"
        if (slowest := _quantile(self.durations_s, 0.99)) > limit_s:
            return f"a process took {slowest:.1f} s at p99"
        return None


def _quantile(values: Sequence[float], share: float) -> float:
    return sorted(values)[min(len(values) - 1, int(share * len(values)))] if values else 0.0


def _pss_mib(service: Service) -> float:
    assert service.process is not None
    return float(psutil.Process(service.process.pid).memory_full_info().pss) / MIB


def _memory(what: str, services: Sequence[Service]) -> None:
    print(f"  {what:14} {statistics.median(map(_pss_mib, services)):7.1f} MiB")


async def measure(arguments: argparse.Namespace, folder: Path) -> None:
    """Start the cells, and load them at each rate until something gives way."""
    broker = None
    url = arguments.broker
    if url is None:
        port = free_ports(1)[0]
        url = f"http://127.0.0.1:{port}"
        environment = {
            **processes.clean_environment(),
            "HANDOVER_DATA_DIR": str(folder),
            "HANDOVER_BROKER_PORT": str(port),
            "HANDOVER_BROKER_URL": url,
            "HANDOVER_LOG_LEVEL": "warning",
        }
        broker = Service("handover_broker", url, environment, folder)
        broker.start()
    cells = [
        PerformedCell(f"cell-{number:02}", folder / f"cell-{number:02}", url)
        for number in range(arguments.cells)
    ]
    try:
        begun = time.perf_counter()
        for start in range(0, len(cells), STARTED_TOGETHER):
            some = cells[start : start + STARTED_TOGETHER]
            await asyncio.gather(*(asyncio.to_thread(cell.start) for cell in some))
        print(f"{len(cells)} cells ready after {time.perf_counter() - begun:.0f} s; memory of one (median):")
        _memory("orchestrator", [cell.orchestrator for cell in cells])
        _memory("performer", [cell.performer for cell in cells])
        if broker is not None:
            _memory("broker of all", [broker])
        services = {
            "orchestrator": [cell.orchestrator for cell in cells],
            "performer": [cell.performer for cell in cells],
            **({"broker": [broker]} if broker is not None else {}),
        }
        for rate in (0.0, *arguments.rates):
            if await _at_rate(rate, cells, services, arguments) is not None:
                break
    finally:
        for cell in cells:
            cell.stop()
        if broker is not None:
            broker.stop()


async def _at_rate(
    rate: float,
    cells: Sequence[PerformedCell],
    services: dict[str, list[Service]],
    arguments: argparse.Namespace,
) -> str | None:
    before = {name: sum(service.cpu_s() for service in some) for name, some in services.items()}
    psutil.cpu_percent()
    begun = time.perf_counter()
    load = Load()
    if rate:
        await load.run(cells, rate, arguments.seconds)
    else:
        await asyncio.sleep(arguments.seconds)
    passed_s = time.perf_counter() - begun
    used = {
        name: (sum(service.cpu_s() for service in some) - before[name]) / passed_s / len(some) * 100
        for name, some in services.items()
    }
    cpu = ", ".join(f"{name} {share:.1f} %" for name, share in used.items())
    title = f"{rate:g} processes/s per cell" if rate else "idle"
    times = (
        f"p50 {_quantile(load.durations_s, 0.5):.2f} s, p99 {_quantile(load.durations_s, 0.99):.2f} s; "
        if rate
        else ""
    )
    machine = psutil.cpu_percent()
    print(f"{title}: {times}CPU of one: {cpu}; of all cores of the machine {machine:.0f} %", flush=True)
    fault = load.gave_way(arguments.limit)
    if fault is not None:
        print(f"gave way first: {fault}, with {machine:.0f} % of all cores in use")
    return fault


def main() -> None:
    """Measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--cells", type=int, default=50)
    parser.add_argument(
        "--rates", type=float, nargs="+", default=[0.1, 0.2, 0.5, 1.0], help="per second and cell"
    )
    parser.add_argument("--seconds", type=float, default=30.0, help="duration of each rate")
    parser.add_argument("--limit", type=float, default=5.0, help="longest process in s that is good enough")
    parser.add_argument("--broker", help="the URL of another broker; without it, the embedded one is started")
    arguments = parser.parse_args()
    print(f"load average at the start: {psutil.getloadavg()[0]:.1f} on {psutil.cpu_count()} CPUs")
    with report_steal_time(), tempfile.TemporaryDirectory(prefix="handover-benchmark-") as folder:
        asyncio.run(measure(arguments, Path(folder)))


if __name__ == "__main__":
    sys.exit(main())
