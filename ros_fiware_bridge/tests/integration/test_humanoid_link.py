"""A node of a ROS graph walks a humanoid by stamped wishes, and sees its state, by the clock of the robot."""

import asyncio
import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover_ros.graph.joining import Adapter, installed
from handover_ros.graph.qos import SENSOR_DATA
from ros_fiware_bridge.tests.integration.conftest import Shop
from ros_fiware_bridge.tests.integration.graph.conftest import running_script
from tests.kit.cell import new_cell
from tests.kit.ros_domains import ros_domain
from tests.kit.skipping import NO_ROS
from tests.kit.waiting import until, wait_for

pytestmark = pytest.mark.slow

SERVICE, WITHIN_S = "whole_body_control", 120.0
WISH, STATUS, ODOMETRY, JOINTS = (
    f"/coman_1/{name}" for name in ("wish", "status", "odometry", "joint_states")
)
TWIST = "geometry_msgs/msg/TwistStamped"


class Graph(Shop):
    """A broker, a bridge and a humanoid whose state is shown on the graph."""

    def begin_humanoid(self, folder: Path) -> None:
        """Start all of them, and wait until the robot stands."""
        self.begin(
            "",
            HANDOVER_ROS_MAPPING="joint-states",
            HANDOVER_HUMANOID_PORTS_DIR=str(folder),
            HANDOVER_HUMANOID_FIFO="false",
            HANDOVER_HUMANOID_ROS_LINK="true",
        )
        self.cell.run(SERVICE)
        wait_for(lambda: self.document()["fault"] is None, WITHIN_S, "the control cycle runs")

    def document(self) -> dict[str, Any]:
        """Return the live document."""
        found: dict[str, Any] = httpx.get(f"{self.cell.url(SERVICE)}/state", timeout=WITHIN_S).json()
        return found


@pytest.fixture(scope="module")
def at_work(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    """A graph with a humanoid that stands."""
    with new_cell(tmp_path_factory.mktemp("cell")) as cell:
        made, folder = Graph(cell, ros_domain()), cell.data_dir / "ports"
        try:
            made.begin_humanoid(folder)
            yield made
        finally:
            cell.stop()
            with suppress(OSError, ValueError):
                pid = int((folder / "control.pid").read_text())
                if str(folder).encode() in Path(f"/proc/{pid}/cmdline").read_bytes():
                    os.kill(pid, signal.SIGKILL)


def wish(stamp: Any, ahead_mps: float) -> dict[str, Any]:
    return {"header": {"stamp": stamp}, "twist": {"linear": {"x": ahead_mps}}}


def value_of(status: dict[str, Any], key: str) -> str:
    (part,) = status["status"]
    return {each["key"]: each["value"] for each in part["values"]}[key]


@pytest.mark.nightly
async def test_wishes_with_the_time_of_the_robot_walk_it_and_late_ones_do_not(shop: Graph) -> None:
    _, odometry = await shop.subscribe(ODOMETRY, "nav_msgs/msg/Odometry", SENSOR_DATA)
    _, status = await shop.subscribe(STATUS, "diagnostic_msgs/msg/DiagnosticArray")
    publisher = await shop.publisher(WISH, TWIST)
    await shop.until(lambda: odometry and status, WITHIN_S, "no state")

    async def send(ahead_mps: float, late_s: int = 0) -> None:
        stamp = odometry[-1]["header"]["stamp"]
        publisher.publish(wish({**stamp, "sec": stamp["sec"] - late_s}, ahead_mps))
        await asyncio.sleep(0.04)

    async def walks() -> bool:
        if value_of(status[-1], "needs_release") == "true":  # messages were late on a slow machine
            await send(0.0)
        for _ in range(3):
            await send(0.08)
        return (
            float(odometry[-1]["twist"]["twist"]["linear"]["x"]) >= 0 and shop.document()["phase"] == "single"
        )

    start = odometry[-1]["pose"]["pose"]["position"]["x"]
    await send(0.0)
    await until(walks, WITHIN_S, why="it does not walk")
    delay_s = float(value_of(status[-1], "wish_delay_s"))
    assert -0.05 <= delay_s <= 0.3

    async def is_ahead() -> bool:
        await walks()
        return bool(odometry[-1]["pose"]["pose"]["position"]["x"] > start + 0.03)

    await until(is_ahead, WITHIN_S, why="it does not come ahead")
    await shop.until(lambda: shop.document()["phase"] == "standing", WITHIN_S, "silence does not stop it")

    async def is_refused() -> bool:
        await send(0.08, late_s=5)
        return "by the clock of the robot" in status[-1]["status"][0]["message"]

    await until(is_refused, WITHIN_S, why="a late wish is not refused")
    assert float(value_of(status[-1], "wish_delay_s")) > 4.0
    assert shop.document()["phase"] == "standing"


@pytest.mark.skipif(Adapter.RCLPY not in installed(), reason=NO_ROS)
async def test_a_genuine_ros_node_walks_it(at_work: Graph) -> None:
    before = at_work.document()["base"][0]
    with running_script("genuine_steering.py", str(at_work.domain), WISH, JOINTS):
        wait_for(lambda: at_work.document()["phase"] == "single", WITHIN_S, "it does not walk")
        wait_for(lambda: at_work.document()["base"][0] > before + 0.03, WITHIN_S, "it does not come ahead")
    wait_for(lambda: at_work.document()["phase"] == "standing", WITHIN_S, "the end does not stop it")
