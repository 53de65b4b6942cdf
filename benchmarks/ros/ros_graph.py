"""The ROS graph over DDS: two processes on loopback, JointStates of 4 KB.

    python -m benchmarks.ros.ros_graph [--rate 100 1000] [--seconds 10] [--depth 100]

Prints for each rate the number of received messages, the time from publish to callback (p50 and p99), the
share of a core of the listener and of the publisher, and the growth of the listener's resident memory. The
listener either ignores messages, like a rule with a rate limit, or reads one field of each, like a rule with
a dead band.
"""

import argparse
import asyncio
import random
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import psutil

from handover_ros.graph.joining import JoinSettings, join
from handover_ros.graph.qos import Qos
from handover_ros.types.type_store import TypeStore

JOINTS = 100
TOPIC, TYPE = "/joint_states", "sensor_msgs/msg/JointState"


def settings(node: str, domain_id: int) -> JoinSettings:
    """Return how a node joins: on loopback, where nobody else is."""
    return JoinSettings(node=node, domain_id=domain_id, interfaces=("127.0.0.1",))


async def send(domain_id: int, rate_hz: float, count: int, depth: int) -> None:
    """Publish `count` messages and print the share of a core and the rate that it took."""
    graph = await join(TypeStore(), settings("robot", domain_id))
    publisher = await graph.publisher(TOPIC, TYPE, Qos(depth=depth))
    assert await publisher.matched(20)
    await asyncio.sleep(0.5)
    message: dict[str, Any] = {
        "name": [f"joint_{number}" for number in range(JOINTS)],
        "position": [0.1] * JOINTS,
        "velocity": [0.2] * JOINTS,
        "effort": [0.3] * JOINTS,
    }
    used_s = psutil.Process().cpu_times()
    start_s = time.perf_counter()
    for number in range(count):
        # Pauses shorter than a millisecond are not kept by the loop; a late message is sent at once.
        early_s = start_s + number / rate_hz - time.perf_counter()
        if early_s > 0:
            await asyncio.sleep(early_s)
        message["header"] = {"stamp": {"sec": number, "nanosec": 0}, "frame_id": "base"}
        publisher.publish(message)
    took_s = time.perf_counter() - start_s
    now_s = psutil.Process().cpu_times()
    share = (now_s.user + now_s.system - used_s.user - used_s.system) / took_s
    await asyncio.sleep(1)
    print(f"{share:.3f} {count / took_s:.0f}", flush=True)
    await graph.close()


async def listen(rate_hz: float, seconds: float, depth: int, look: Callable[[Any], Any]) -> str:
    """Listen to a sender of so many messages a second; return what was seen."""
    domain_id = random.randint(1, 100)
    graph = await join(TypeStore(), settings("bridge", domain_id))
    late_ms: list[float] = []

    def on_message(received: Any) -> None:
        look(received)
        late_ms.append((time.time() - received.sent_at_s) * 1000)

    subscription = await graph.subscribe(TOPIC, TYPE, on_message, Qos(depth=depth))
    count = int(rate_hz * seconds)
    arguments = ["--send", str(domain_id), str(rate_hz), str(count), str(depth)]
    sender = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.ros.ros_graph", *arguments], stdout=subprocess.PIPE, text=True
    )
    while not late_ms:
        await asyncio.sleep(0.01)
        assert sender.poll() is None
    process = psutil.Process()
    before, memory = process.cpu_times(), process.memory_info().rss
    start_s = time.perf_counter()
    while len(late_ms) + subscription.dropped < count and time.perf_counter() - start_s < seconds + 5:
        await asyncio.sleep(0.2)
    took_s = time.perf_counter() - start_s
    after = process.cpu_times()
    share = (after.user + after.system - before.user - before.system) / took_s
    grown_mb = (process.memory_info().rss - memory) / 2**20
    output, _ = await asyncio.to_thread(sender.communicate)
    sender_share, sent_hz = output.split()
    await graph.close()
    late_ms.sort()
    p50, p99 = (late_ms[int(len(late_ms) * share)] for share in (0.5, 0.99))
    return (
        f"{len(late_ms):>6} of {count:<6} p50 {p50:6.2f} ms  p99 {p99:6.2f} ms  listener {share:5.0%} of "
        f"a core  publisher {float(sender_share):5.0%} at {sent_hz} Hz  memory {grown_mb:+.1f} MB"
    )


def main() -> None:
    """Measure, or send for a listener that measures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rate", type=float, nargs="+", default=[100.0, 1000.0], help="messages a second")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--depth", type=int, default=100)
    parser.add_argument("--send", nargs=4, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.send:
        domain_id, rate_hz, count, depth = asked.send
        asyncio.run(send(int(domain_id), float(rate_hz), int(count), int(depth)))
        return
    looks: dict[str, Callable[[Any], Any]] = {
        "unread": lambda _: None,
        "one field read": lambda received: received.message["position"][3],
    }
    for rate_hz in asked.rate:
        for name, look in looks.items():
            line = asyncio.run(listen(rate_hz, asked.seconds, asked.depth, look))
            print(f"{rate_hz:>6.0f} Hz, {name:<15}{line}", flush=True)


if __name__ == "__main__":
    main()
