"""A robot in another network, in network namespaces that the test creates and removes.

A veth pair without multicast connects two namespaces: one with the bridge, one with the robot.
"""

import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.kit.private_network import PATH, ip, require_ip

pytest.importorskip("cyclonedds")

pytestmark = pytest.mark.slow

PRUNED_AFTER_S = 35
"""By default Cyclone prunes an address that has never answered after 30 s."""


@dataclass
class Network:
    bridge: str
    robot: str
    robot_interface: str
    robot_address: str


@pytest.fixture(scope="module")
def network() -> Iterator[Network]:
    require_ip()
    mark = f"{os.getpid() % 100_000}"
    bridge, robot = f"hb{mark}", f"hr{mark}"
    with ExitStack() as made:
        try:
            for name in (bridge, robot):
                ip("netns", "add", name)
                made.callback(ip, "netns", "del", name)
            ip(
                "link",
                "add",
                f"vb{mark}",
                "netns",
                bridge,
                "type",
                "veth",
                "peer",
                f"vr{mark}",
                "netns",
                robot,
            )
        except subprocess.CalledProcessError as error:
            pytest.skip(f"this user may make no network namespaces (root may): {error.stderr.strip()}")
        for name, interface, address in (
            (bridge, f"vb{mark}", "10.231.7.1"),
            (robot, f"vr{mark}", "10.231.7.2"),
        ):
            ip("-n", name, "addr", "add", f"{address}/24", "dev", interface)
            ip("-n", name, "link", "set", interface, "multicast", "off", "up")
            ip("-n", name, "link", "set", "lo", "up")
        yield Network(bridge, robot, f"vr{mark}", "10.231.7.2")


class Node:
    """A `network_node.py` in a namespace, and its output."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._lines: queue.Queue[str] = queue.Queue()
        assert process.stdout is not None
        self._reader = threading.Thread(target=self._read, args=(process.stdout,), daemon=True)
        self._reader.start()

    def _read(self, lines: Any) -> None:
        for line in lines:
            self._lines.put(line.strip())

    def writes(self, line: str, within_s: float = 30.0) -> bool:
        try:
            return self._lines.get(timeout=within_s) == line
        except queue.Empty:
            return False


@contextmanager
def node(namespace: str, role: str, **settings: Any) -> Iterator[Node]:
    command = [
        "ip",
        "netns",
        "exec",
        namespace,
        sys.executable,
        str(Path(__file__).parent / "network_node.py"),
    ]
    with subprocess.Popen(
        [*command, role, json.dumps({"domain_id": 5, "node": role, **settings})],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PATH": PATH},
    ) as process:
        assert process.stdin is not None
        try:
            made = Node(process)
            assert made.writes("ready", 60.0), f"the node that should {role} does not start"
            yield made
        finally:
            process.stdin.close()
            try:
                process.wait(120)
            finally:
                process.kill()


@pytest.mark.nightly
def test_a_robot_out_of_multicast_range_is_found_by_its_address(network: Network) -> None:
    with (
        node(network.robot, "publish", interfaces=[network.robot_interface]),
        node(network.bridge, "subscribe", peers=[network.robot_address]) as bridge,
    ):
        assert bridge.writes("from the robot")


@pytest.mark.nightly
def test_a_robot_that_starts_long_after_the_bridge_is_found(network: Network) -> None:
    with node(network.bridge, "subscribe", peers=[network.robot_address]) as bridge:
        time.sleep(PRUNED_AFTER_S)
        with node(network.robot, "publish", interfaces=[network.robot_interface]):
            assert bridge.writes("from the robot", 60.0)


@pytest.mark.nightly
def test_nodes_of_one_machine_find_each_other_by_default(network: Network) -> None:
    with node(network.bridge, "publish"), node(network.bridge, "subscribe") as bridge:
        assert bridge.writes("from the robot")


@pytest.mark.nightly
def test_a_robot_out_of_multicast_range_is_not_found_without_its_address(network: Network) -> None:
    # Control: without it the other tests prove nothing.
    with (
        node(network.robot, "publish", interfaces=[network.robot_interface]),
        node(network.bridge, "subscribe") as bridge,
    ):
        assert not bridge.writes("from the robot", 8.0)
