"""The ROS bridge: a robot on a graph, the bridge and the broker as processes, JointStates of 4 KB.

    python -m benchmarks.ros.ros_bridge [--seconds 10] [--rate 100] [--memory MINUTES]

Prints the latency from a message of the robot to the notification of a subscriber (ROS to NGSI-LD), and from
a write in the broker to the message on the graph (NGSI-LD to ROS), as p50 and p99 with the number of lost
messages. Prints also the share of a core and the growth of memory of the bridge at 1,000 messages a second to
a rule with a dead band. With `--memory` both directions run for so many minutes instead, and the resident
memory of bridge and broker is printed every minute.

The messages of the robot are encoded once and only their number changes; the subscriber only records times.
So neither uses the cores of the measured processes.
"""

import argparse
import asyncio
import os
import random
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, cast

import httpx
import orjson
import psutil

from benchmarks.free_ports import free_ports
from benchmarks.steal_time import report_steal_time
from handover.broker import BrokerClient
from handover.settings import Settings
from handover_ros.graph.joining import JoinSettings, join
from handover_ros.graph.qos import Qos
from handover_ros.types.type_store import TypeStore

LIMIT_P50_MS, LIMIT_P99_MS = 5.0, 25.0
LIMIT_CORE_SHARE = 0.5
JOINTS = 100
ROBOT = "urn:ngsi-ld:Device:demo:arm-1"
GOAL = "urn:ngsi-ld:Device:demo:goal-1"
MAPPING = """
ros_to_ngsild:
  joints:
    topic: /joint_states
    type: sensor_msgs/JointState
    entity: Device:arm-1
    qos: {depth: 1000}
    buffer: {keep: 1000}
    attributes: {number: "velocity[0]", jointPositions: position}
  banded:
    topic: /banded
    type: sensor_msgs/JointState
    entity: Device:arm-2
    attributes: {jointPositions: {field: position, dead_band: 0.5}}
ngsild_to_ros:
  goal: {entity: Device:goal-1, topic: /goal, type: std_msgs/Float64, fields: {data: goal}, every_value: true}
"""


def joint_state(number: int) -> dict[str, Any]:
    """Return a JointState of some 4 KB that carries its number."""
    return {
        "name": [f"joint_{joint:03}" for joint in range(JOINTS)],
        "position": [0.1] * JOINTS,
        "velocity": [float(number)] + [0.2] * (JOINTS - 1),
        "effort": [0.3] * JOINTS,
    }


class Bench:
    """The processes and the recorded times."""

    def __init__(self, folder: Path) -> None:
        self.domain = random.randint(1, 100)
        self.broker_port, self.bridge_port, self.own_port = free_ports(3)
        (folder / "mapping.yaml").write_text(MAPPING)
        self.environment = {
            **os.environ,
            "HANDOVER_DATA_DIR": str(folder),
            "HANDOVER_BROKER_PORT": str(self.broker_port),
            "HANDOVER_BROKER_URL": f"http://127.0.0.1:{self.broker_port}",
            "HANDOVER_OUTBOUND_ALLOW": "127.0.0.0/8",
            "HANDOVER_BRIDGE_PORT": str(self.bridge_port),
            "HANDOVER_ROS_MAPPING": str(folder / "mapping.yaml"),
            "HANDOVER_ROS_DOMAIN_ID": str(self.domain),
            "HANDOVER_ROS_INTERFACES": '["127.0.0.1"]',
            "HANDOVER_LOG_LEVEL": "warning",
        }
        self.seen_s: dict[int, float] = {}

    def start(self, module: str) -> "subprocess.Popen[bytes]":
        """Start a service."""
        return subprocess.Popen([sys.executable, "-m", module], env=self.environment)

    async def ready(self, port: int) -> None:
        """Wait until a service is ready."""
        async with httpx.AsyncClient(trust_env=False) as http:
            for _ in range(600):
                try:
                    if (await http.get(f"http://127.0.0.1:{port}/readyz")).is_success:
                        return
                except httpx.TransportError:
                    pass
                await asyncio.sleep(0.1)
        raise SystemExit(f"the service on port {port} is not ready")


class JointStates:
    """The messages of the robot: encoded once, so that publishing a thousand a second takes little time."""

    def __init__(self, store: TypeStore) -> None:
        mark = 987_654_321
        self._data = bytearray(store.encode("sensor_msgs/msg/JointState", joint_state(mark)))
        self._at = self._data.index(struct.pack("<d", mark))

    def encoded(self, number: int) -> bytes:
        """Return the JointState of that number."""
        struct.pack_into("<d", self._data, self._at, number)
        return bytes(self._data)


class _Subscriber(asyncio.Protocol):
    """The subscriber: records the time of each number and responds."""

    def __init__(self, seen_s: dict[int, float]) -> None:
        self._seen_s = seen_s
        self._received = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)  # uvloop's is one in all but its class

    def data_received(self, data: bytes) -> None:
        self._received += data
        head, ended, rest = self._received.partition(b"\r\n\r\n")
        length = int(head.lower().partition(b"content-length:")[2].partition(b"\r\n")[0]) if ended else 0
        if not ended or len(rest) < length:
            return
        now_s = time.perf_counter()
        self._received = rest[length:]
        for entity in orjson.loads(rest[:length])["data"]:
            self._seen_s.setdefault(int(entity["number"]["value"]), now_s)
        self._transport.write(b"HTTP/1.1 204 No Content\r\n\r\n")


async def measure(seconds: float, rate_hz: float, memory_minutes: int) -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder))
        processes = [bench.start("handover_broker")]
        try:
            await bench.ready(bench.broker_port)
            processes.append(bench.start("handover_ros"))
            await bench.ready(bench.bridge_port)
            measured = [psutil.Process(process.pid) for process in processes]
            await _all(bench, measured, seconds, rate_hz, memory_minutes)
        finally:
            for process in reversed(processes):
                process.terminate()
                process.wait(timeout=10)


async def _all(
    bench: Bench, measured: list[psutil.Process], seconds: float, rate_hz: float, memory_minutes: int
) -> None:
    loop = asyncio.get_running_loop()
    server = await loop.create_server(lambda: _Subscriber(bench.seen_s), "127.0.0.1", bench.own_port)
    store = TypeStore()
    robot = await join(store, JoinSettings(node="robot", domain_id=bench.domain, interfaces=("127.0.0.1",)))
    url = f"http://127.0.0.1:{bench.broker_port}"
    async with BrokerClient(Settings.load(broker_url=url)) as broker:
        await broker.ensure_subscription(
            {
                "id": "urn:ngsi-ld:Subscription:demo:bench",
                "type": "Subscription",
                "entities": [{"type": "Device", "id": ROBOT}],
                "watchedAttributes": ["number"],
                "notification": {
                    "attributes": ["number"],
                    "endpoint": {
                        "uri": f"http://127.0.0.1:{bench.own_port}/",
                        "accept": "application/json",
                    },
                },
            }
        )
        if memory_minutes:
            await _memory(robot, store, broker, measured, minutes=memory_minutes, rate_hz=rate_hz)
        else:
            count = int(seconds * rate_hz)
            await _ros_to_ngsild(bench, robot, store, count, rate_hz)
            await _ngsild_to_ros(robot, broker, count, rate_hz)
            await _banded(robot, measured[1], seconds)
    await robot.close()
    server.close()


async def _ros_to_ngsild(bench: Bench, robot: Any, store: TypeStore, count: int, rate_hz: float) -> None:
    joint_states = JointStates(store)
    publisher = await robot.publisher("/joint_states", "sensor_msgs/msg/JointState", Qos(depth=1000))
    assert await publisher.matched(20)
    sent_s: dict[int, float] = {}

    async def publish(number: int) -> None:
        message = joint_states.encoded(number)
        sent_s[number] = time.perf_counter()
        publisher.publish_encoded(message)

    await _at_rate(publish, count, rate_hz)
    await _until(lambda: len(bench.seen_s) >= count)
    _print("ROS to NGSI-LD", sent_s, bench.seen_s, rate_hz)


async def _ngsild_to_ros(robot: Any, broker: BrokerClient, count: int, rate_hz: float) -> None:
    received_s: dict[int, float] = {}
    sent_s: dict[int, float] = {}

    def on_message(received: Any) -> None:
        received_s.setdefault(int(received.message["data"]), time.perf_counter())

    subscription = await robot.subscribe("/goal", "std_msgs/msg/Float64", on_message, Qos(depth=100))
    assert await subscription.matched(20)

    async def publish(number: int) -> None:
        sent_s[number] = time.perf_counter()
        attribute = {"type": "Property", "value": number}
        await broker.upsert([{"id": GOAL, "type": "Device", "goal": attribute}])

    await _at_rate(publish, count, rate_hz)
    await _until(lambda: len(received_s) >= count)
    _print("NGSI-LD to ROS", sent_s, received_s, rate_hz)


async def _banded(robot: Any, bridge: psutil.Process, seconds: float) -> None:
    publisher = await robot.publisher("/banded", "sensor_msgs/msg/JointState", Qos(depth=1000))
    assert await publisher.matched(20)
    message = joint_state(0)

    async def publish(number: int) -> None:
        message["header"] = {"stamp": {"sec": number + 1, "nanosec": 0}}
        publisher.publish(message)

    await _at_rate(publish, 1000, 1000.0)
    before, memory, began_s = bridge.cpu_times(), bridge.memory_info().rss, time.perf_counter()
    await _at_rate(publish, int(1000 * seconds), 1000.0)
    took_s, after = time.perf_counter() - began_s, bridge.cpu_times()
    share = (after.user + after.system - before.user - before.system) / took_s
    grown_mb = (bridge.memory_info().rss - memory) / 2**20
    print(
        f"dead band, {1000 * seconds / took_s:.0f} messages a second: {share:.0%} of a core "
        f"({LIMIT_CORE_SHARE / share:.1f} times better than the limit), memory {grown_mb:+.1f} MB"
    )


async def _memory(
    robot: Any,
    store: TypeStore,
    broker: BrokerClient,
    measured: list[psutil.Process],
    *,
    minutes: int,
    rate_hz: float,
) -> None:
    joint_states = JointStates(store)
    publisher = await robot.publisher("/joint_states", "sensor_msgs/msg/JointState", Qos(depth=1000))
    received = 0

    def on_message(_: Any) -> None:
        nonlocal received
        received += 1

    subscription = await robot.subscribe("/goal", "std_msgs/msg/Float64", on_message, Qos(depth=100))
    assert await publisher.matched(20)
    assert await subscription.matched(20)

    async def publish(number: int) -> None:
        publisher.publish_encoded(joint_states.encoded(number))
        await broker.upsert([{"id": GOAL, "type": "Device", "goal": {"type": "Property", "value": number}}])

    memory_mb: list[list[float]] = []
    for minute in range(minutes):
        await _at_rate(publish, int(60 * rate_hz), rate_hz)
        memory_mb.append([process.memory_info().rss / 2**20 for process in measured])
        of_broker, of_bridge = memory_mb[-1]
        words = f"bridge {of_bridge:.1f} MB, broker {of_broker:.1f} MB"
        print(f"minute {minute + 1}: {words}, {received} received by the robot", flush=True)
    half = memory_mb[minutes // 2 :]
    if len(half) > 1:
        grown = [(last - first) / (len(half) - 1) for first, last in zip(half[0], half[-1], strict=True)]
        print(f"a minute of the second half: bridge {grown[1]:+.2f} MB, broker {grown[0]:+.2f} MB")


async def _at_rate(publish: Callable[[int], Awaitable[None]], count: int, rate_hz: float) -> None:
    start_s = time.perf_counter()
    for number in range(count):
        early_s = start_s + number / rate_hz - time.perf_counter()
        await asyncio.sleep(max(early_s, 0))
        await publish(number)


async def _until(done: Callable[[], bool], within_s: float = 10.0) -> None:
    deadline_s = time.perf_counter() + within_s
    while not done() and time.perf_counter() < deadline_s:
        await asyncio.sleep(0.05)


def _print(what: str, sent_s: dict[int, float], seen_s: dict[int, float], rate_hz: float) -> None:
    late_ms = sorted((seen_s[number] - at_s) * 1000 for number, at_s in sent_s.items() if number in seen_s)
    if not late_ms:
        print(f"{what}: nothing received")
        return
    p50, p99 = (late_ms[int(len(late_ms) * share)] for share in (0.5, 0.99))
    print(
        f"{what}, {rate_hz:.0f} Hz: p50 {p50:.2f} ms ({LIMIT_P50_MS / p50:.1f} times better than the limit), "
        f"p99 {p99:.2f} ms ({LIMIT_P99_MS / p99:.1f} times), "
        f"{len(sent_s) - len(late_ms)} of {len(sent_s)} lost"
    )


def main() -> None:
    """Measure as the command line says."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=100.0, help="messages a second, each way")
    parser.add_argument("--memory", type=int, default=0, metavar="MINUTES", help="watch its memory instead")
    asked = parser.parse_args()
    with report_steal_time():
        if sys.platform == "win32":
            asyncio.run(measure(asked.seconds, asked.rate, asked.memory))
        else:
            import uvloop  # noqa: PLC0415 - there is none for Windows

            uvloop.run(measure(asked.seconds, asked.rate, asked.memory))


if __name__ == "__main__":
    main()
