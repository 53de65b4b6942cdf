"""From a packet of a sensor to the speed limit at a robot, while the same process analyses other people.

    python -m benchmarks.body.human_state_limits [--people 50] [--seconds 40] [--burners 0]

A real process of human state takes the ECG of `people`. Ten more people wear a pulse oximeter over UDP.
Their limit is linear in the heart rate, which rises by 1 bpm a packet: each packet completes a feature that
lowers the limit, and the fraction says which packet it was. The time ends where a reader of `/limits` has the
message, and where the server that stands for the limiter of the robot has it. `burners` are processes that
take CPU meanwhile.
"""

import argparse
import asyncio
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import numpy as np
import psutil
from websockets.asyncio.client import connect
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from benchmarks.free_ports import free_ports
from benchmarks.steal_time import report_steal_time

FREE_BPM, STRAINED_BPM, LEAST = 80.0, 200.0, 0.05
REST_BPM = 60.0
PACKET_S = 0.2
WEARERS = 10
MAX_WAIT_S = 120.0


def fraction_of(bpm: float) -> float:
    """Return the limit at a heart rate."""
    share = (bpm - FREE_BPM) / (STRAINED_BPM - FREE_BPM)
    return 1.0 - min(max(share, 0.0), 1.0) * (1.0 - LEAST)


@dataclass
class Wearer:
    """One person with an oximeter, and when which heart rate was sent."""

    name: str
    port: int
    source: str = ""
    bpm: float = REST_BPM
    fraction: float = 0.0
    pending: dict[str, list[tuple[float, float]]] = field(default_factory=lambda: {"reader": [], "robot": []})
    """By where the limit is awaited: when, and the fraction that the packet leads to."""

    def send(self, stick: socket.socket) -> None:
        """Send one datagram."""
        content = {
            "id": self.name,
            "ms": time.monotonic() * 1000,
            "ir": 50_000,
            "red": 48_000,
            "hr": self.bpm,
        }
        for waiting in self.pending.values():
            if self.bpm > FREE_BPM:
                waiting.append((time.perf_counter(), fraction_of(self.bpm)))
        stick.sendto(json.dumps(content).encode(), ("127.0.0.1", self.port))

    def received(self, where: str, fraction: float) -> list[float]:
        """Return how old the packets are that this limit answers, in s."""
        now, waiting = time.perf_counter(), self.pending[where]
        done = [now - sent for sent, wanted in waiting if fraction <= wanted + 1e-3]
        self.pending[where] = [waiting_for for waiting_for in waiting if fraction > waiting_for[1] + 1e-3]
        return done


class LimitBench:
    """The people, and the times that were measured."""

    def __init__(self, wearers: Sequence[Wearer]) -> None:
        self.wearers = {wearer.name: wearer for wearer in wearers}
        self.delays: dict[str, list[float]] = {"reader": [], "robot": []}
        self.missed = 0
        self._sequence: int | None = None

    def take(self, where: str, source: str, fraction: float) -> None:
        """Take a limit that arrived."""
        for wearer in self.wearers.values():
            if wearer.source == source:
                wearer.fraction = fraction
                self.delays[where] += wearer.received(where, fraction)

    async def read(self, url: str) -> None:
        """Read `/limits` until cancelled."""
        async with connect(f"{url}/limits", proxy=None, compression=None) as stream:
            async for text in stream:
                message = json.loads(text)
                if self._sequence is not None:
                    self.missed += message["sequence"] - self._sequence - 1
                self._sequence = message["sequence"]
                for limit in message["limits"]:
                    self.take("reader", limit["source"], limit["fraction"])

    async def be_robot(self, socket_: ServerConnection) -> None:
        """Take the reports for one robot as its limiter does."""
        try:
            async for text in socket_:
                report = json.loads(text)
                self.take("robot", report["source"], report["fraction"])
                await socket_.send('{"accepted": true}')
        except ConnectionClosed:
            return

    async def send(self, seconds: float) -> None:
        """Rise by 1 bpm a packet from rest to exertion; packets of different people are spread evenly."""
        began = time.perf_counter()
        stick = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        number = 0
        while (now := time.perf_counter() - began) < seconds:
            for place, wearer in enumerate(self.wearers.values()):
                due = (number + place / len(self.wearers)) * PACKET_S
                await asyncio.sleep(max(0.0, due - (time.perf_counter() - began)))
                wearer.send(stick)
                wearer.bpm = (
                    min(wearer.bpm + 1.0, STRAINED_BPM - 1) if self.is_ready and now > 0 else REST_BPM
                )
            number += 1
        stick.close()

    is_ready = False

    async def warm_up(self) -> None:
        """Send heart rates at rest until everybody has the full limit."""
        stick = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        began = time.perf_counter()
        while any(wearer.fraction < 0.999 for wearer in self.wearers.values()):
            if time.perf_counter() - began > MAX_WAIT_S:
                fractions = [wearer.fraction for wearer in self.wearers.values()]
                raise SystemExit(f"the limits did not rise in {MAX_WAIT_S:.0f} s: {fractions}")
            for wearer in self.wearers.values():
                wearer.send(stick)
                await asyncio.sleep(PACKET_S / len(self.wearers))
        stick.close()
        self.is_ready = True


async def add(rest: httpx.AsyncClient, name: str, sensor: dict[str, Any]) -> str:
    """Add a person who consents, with a sensor; return the pseudonym."""
    ends = (datetime.now(UTC) + timedelta(hours=1)).isoformat()
    curve = {"restBpm": 55, "maximumBpm": 205, "freeBpm": FREE_BPM, "strainedBpm": STRAINED_BPM}
    made = await rest.put(f"/people/{name}", json={**curve, "leastFraction": LEAST})
    consent = {"purposes": ["live", "speedLimits"], "ends": ends, "givenBy": "bench"}
    (await rest.put(f"/people/{name}/consent", json=consent)).raise_for_status()
    (await rest.put(f"/sensors/s-{name}", json={"person": name, **sensor})).raise_for_status()
    return str(made.raise_for_status().json()["pseudonym"])


async def counts(rest: httpx.AsyncClient) -> dict[str, float]:
    """Return how many heart rates had which status."""
    text = (await rest.get("/metrics")).text
    delays = [
        line for line in text.splitlines()
        if line.startswith("handover_human_state_features_total") and 'feature="heartRate"' in line
    ]  # fmt: skip
    return {line.split('status="')[1].split('"')[0]: float(line.rsplit(" ", 1)[1]) for line in delays}


async def measure(options: argparse.Namespace, ports: dict[str, int], process: psutil.Process) -> None:
    """Set everybody up, measure, and print."""
    bench = LimitBench([Wearer(f"w{n}", port) for n, port in enumerate(free_ports(WEARERS))])
    base = f"127.0.0.1:{ports['human']}"
    async with (
        httpx.AsyncClient(base_url=f"http://{base}", timeout=120, trust_env=False) as rest,
        serve(bench.be_robot, "127.0.0.1", ports["robot"]),
    ):
        await ready(rest)
        ecg = {"signals": ["ecg"], "packet_s": 0.56}
        for n in range(options.people):
            await add(rest, f"p{n}", {"driver": "simulated", "settings": {**ecg, "seed": n}})
        for wearer in bench.wearers.values():
            settings = {"port": wearer.port, "device_id": wearer.name}
            pseudonym = await add(rest, wearer.name, {"driver": "max30100", "settings": settings})
            wearer.source = f"body-{pseudonym}"
            (await rest.put(f"/people/{wearer.name}/robots/r-{wearer.name}")).raise_for_status()
        reading = asyncio.create_task(bench.read(f"ws://{base}"))
        await bench.warm_up()
        for wearer in bench.wearers.values():
            wearer.pending = {"reader": [], "robot": []}
        bench.delays, bench.missed = {"reader": [], "robot": []}, 0
        before, cpu, began = await counts(rest), sum(process.cpu_times()[:2]), time.perf_counter()
        burners = [
            subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(options.burners)
        ]
        try:
            await bench.send(min(options.seconds, (STRAINED_BPM - REST_BPM) * PACKET_S))
        finally:
            for burner in burners:
                burner.kill()
                burner.wait()
        await asyncio.sleep(0.5)
        cores = (sum(process.cpu_times()[:2]) - cpu) / (time.perf_counter() - began)
        after = await counts(rest)
        reading.cancel()
        problems = await _problems(rest)
    print(f"{options.people} people with ECG, {WEARERS} with a robot; {options.burners} other busy processes")
    for where, title in (("reader", "reader of /limits"), ("robot", "limiter of the robot")):
        delays = 1000 * np.array(bench.delays[where])
        lost = sum(len(wearer.pending[where]) for wearer in bench.wearers.values())
        p50, p99 = np.percentile(delays, (50, 99))
        print(
            f"  from the packet to the {title:20}: p50 {p50:.1f} ms, p99 {p99:.1f} ms, "
            f"longest {delays.max():.1f} ms, of {len(delays)} packets; {lost} without an answer"
        )
    shown = {key: int(after[key] - before.get(key, 0)) for key in after}
    print(f"  heart rates by status: {shown}; messages missed {bench.missed}; {cores:.2f} cores")
    print(f"  memory {process.memory_info().rss / 2**20:.0f} MB; problems: {problems or 'none'}")


async def _problems(rest: httpx.AsyncClient) -> dict[str, int]:
    """Return the faults that the sensors show, with how many show each."""
    by_reason: dict[str, int] = {}
    for person in (await rest.get("/people")).raise_for_status().json():
        for sensor in person["sensors"]:
            if sensor["fault"] or sensor["problem"]:
                key = f"{sensor['fault']}: {sensor['problem']}"[:70]
                by_reason[key] = by_reason.get(key, 0) + 1
    return by_reason


async def ready(rest: httpx.AsyncClient) -> None:
    """Wait until human state answers."""
    began = time.perf_counter()
    while True:
        try:
            (await rest.get("/people")).raise_for_status()
        except httpx.HTTPError:
            if time.perf_counter() - began > MAX_WAIT_S:
                raise
            await asyncio.sleep(0.1)
        else:
            return


def main(arguments: Sequence[str] | None = None) -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--people", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=28)
    parser.add_argument("--burners", type=int, default=0, help="processes that take CPU meanwhile")
    options = parser.parse_args(arguments)
    human, robot, broker = free_ports(3)
    with tempfile.TemporaryDirectory() as folder, report_steal_time():
        env = {
            **{name: value for name, value in os.environ.items() if not name.startswith("HANDOVER_")},
            "HANDOVER_DATA_DIR": folder,
            "HANDOVER_BROKER_URL": f"http://127.0.0.1:{broker}",
            "HANDOVER_HUMAN_STATE_PORT": str(human),
            "HANDOVER_TRAJECTORY_PORT": str(robot),
            "HANDOVER_LOG_LEVEL": "error",
        }
        service = subprocess.Popen([sys.executable, "-m", "handover_body"], env=env)
        try:
            asyncio.run(measure(options, {"human": human, "robot": robot}, psutil.Process(service.pid)))
        finally:
            service.terminate()
            service.wait()
    print(f"  load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
