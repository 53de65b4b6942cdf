"""`handover bridge` as a person types it."""

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest

from ros_fiware_bridge.graph.qos import SENSOR_DATA

pytestmark = pytest.mark.slow

Handover = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def handover(own_shop: Any) -> Handover:
    environment = {
        **own_shop.cell.environment,
        "HANDOVER_ROS_DOMAIN_ID": str(own_shop.domain),
        "HANDOVER_ROS_INTERFACES": '["127.0.0.1"]',
    }

    def command(*words: str) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(
            [sys.executable, "-m", "handover.cli", "bridge", *words],
            env=environment,
            cwd=own_shop.cell.data_dir,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=90,
        )

    return command


async def test_a_mapping_is_checked_and_its_mistakes_are_told_in_lines(
    own_shop: Any, handover: Handover
) -> None:
    good = handover("check", "battery")
    assert (good.returncode, good.stderr) == (0, "")
    assert "battery: /battery_state (sensor_msgs/msg/BatteryState;" in good.stdout
    file = own_shop.cell.data_dir / "cell.yaml"
    file.write_text(
        "ros_to_ngsild:\n  a:\n    topic: /x\n    type: std_msgs/Strin\n    entity: Device:d\n"
        "    attributes: {words: data}\n"
    )
    bad = handover("check", "cell.yaml")
    assert bad.returncode == 2
    assert bad.stdout == ""
    assert bad.stderr.startswith("handover: cell.yaml:4: ros_to_ngsild.a.type: ")
    assert "did you mean std_msgs/msg/String" in bad.stderr
    assert handover("check", "nowhere.yaml").returncode == 2


async def test_a_topic_that_exists_is_seen_and_gets_a_mapping_that_can_work(
    own_shop: Any, handover: Handover
) -> None:
    await own_shop.robot.publisher("/joint_states", "sensor_msgs/msg/JointState", SENSOR_DATA)
    scaffold = handover("scaffold", "/joint_states")
    assert scaffold.returncode == 0, scaffold.stderr
    assert "qos: sensor_data" in scaffold.stdout
    (own_shop.cell.data_dir / "cell.yaml").write_text(scaffold.stdout)
    live = handover("check", "cell.yaml", "--live")
    assert live.returncode == 0, live.stderr
    assert "nobody" not in live.stdout
    (own_shop.cell.data_dir / "cell.yaml").write_text(
        scaffold.stdout.replace("qos: sensor_data", "qos: default")
    )
    unheard = handover("check", "cell.yaml", "--live")
    assert (
        "/robot will not be heard: the reader wants reliable, the writer offers best_effort" in unheard.stdout
    )
    seen = handover("graph")
    assert "topic     /joint_states  sensor_msgs/msg/JointState" in seen.stdout
    assert "from /robot (best_effort, volatile" in seen.stdout
    assert "the broker cannot be asked" in seen.stdout
    missing = handover("scaffold", "/nothing", "--wait", "0.2")
    assert missing.returncode == 2
    assert "nobody publishes /nothing" in missing.stderr
