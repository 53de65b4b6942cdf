"""The commands of `handover bridge`."""

import asyncio
import subprocess
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from handover.command_line.main import main
from handover_ros.graph.qos import LATCHED, SENSOR_DATA
from ros_fiware_bridge.tests.integration.graph.test_genuine_cyclone import genuine
from tests.kit.waiting import scaled

pytestmark = pytest.mark.slow

LOOK = ("--wait", "2")
Handover = Callable[..., Awaitable[tuple[int, str, str]]]
"""Runs a command; gives its exit code, standard output and standard error."""


@pytest.fixture
def handover(own_shop: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Handover:
    """The command in a thread of this process: a new one each time would load the middleware again."""
    monkeypatch.chdir(own_shop.cell.data_dir)
    for name, value in own_shop.cell.environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("HANDOVER_ROS_DOMAIN_ID", str(own_shop.domain))
    monkeypatch.setenv("HANDOVER_ROS_INTERFACES", '["127.0.0.1"]')

    def typed(*words: str) -> int:
        monkeypatch.setattr(sys, "argv", ["handover", "bridge", *words])
        try:
            main()
        except SystemExit as end:
            return int(end.code or 0)
        return 0

    async def command(*words: str) -> tuple[int, str, str]:
        capsys.readouterr()
        code = await asyncio.to_thread(typed, *words)
        said = capsys.readouterr()
        return code, said.out, said.err

    return command


async def test_check_reports_each_error_with_its_line(own_shop: Any, handover: Handover) -> None:
    code, said, wrong = await handover("check", "battery")
    assert (code, wrong) == (0, "")
    assert "battery: /battery_state (sensor_msgs/msg/BatteryState;" in said
    file = own_shop.cell.data_dir / "cell.yaml"
    file.write_text(
        "ros_to_ngsild:\n  a:\n    topic: /x\n    type: std_msgs/Text\n    entity: Device:d\n"
        "    attributes: {words: data}\n"
    )
    code, said, wrong = await handover("check", "cell.yaml")
    assert (code, said) == (2, "")
    assert wrong.startswith("handover: cell.yaml:4: ros_to_ngsild.a.type: ")
    assert "there is no type std_msgs/msg/Text" in wrong
    assert (await handover("check", "nowhere.yaml"))[0] == 2


def test_a_failed_command_prints_one_line(tmp_path: Path) -> None:
    typed = [sys.executable, "-m", "handover_cell", "bridge", "check", "nowhere.yaml"]
    ended = subprocess.run(
        typed, cwd=tmp_path, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=scaled(90)
    )
    assert (ended.returncode, ended.stdout) == (2, "")
    assert len(ended.stderr.splitlines()) == 1


def test_logs_of_a_command_go_to_standard_error(tmp_path: Path) -> None:
    # Every logger of the bridge is a structlog logger; this one logs what the others may.
    script = (
        "import sys, structlog\nfrom handover.command_line.main import main\n"
        "from handover_ros.graph.cyclone.domain import log\n"
        "from handover_ros.types import type_store\n"
        "read = type_store.TypeStore.resolve\n"
        "def resolve(*given):\n    log.warning('a line of the log')\n    return read(*given)\n"
        "type_store.TypeStore.resolve = resolve\n"
        "sys.argv = ['handover', 'bridge', 'scaffold', '/joint_states', '--type', 'sensor_msgs/JointState']\n"
        "main()\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=scaled(90)
    )
    assert "a line of the log" in ended.stderr
    (rule,) = yaml.safe_load(ended.stdout)["ros_to_ngsild"].values()
    assert rule["type"] == "sensor_msgs/msg/JointState"


@pytest.mark.nightly
async def test_scaffold_writes_a_mapping_for_a_topic(own_shop: Any, handover: Handover) -> None:
    await own_shop.robot.publisher("/joint_states", "sensor_msgs/msg/JointState", SENSOR_DATA)
    code, scaffold, wrong = await handover("scaffold", "/joint_states", *LOOK)
    assert code == 0, wrong
    assert "qos: sensor_data" in scaffold
    file = own_shop.cell.data_dir / "cell.yaml"
    file.write_text(scaffold)
    code, live, wrong = await handover("check", "cell.yaml", "--live", *LOOK)
    assert code == 0, wrong
    assert "no node" not in live
    file.write_text(scaffold.replace("qos: sensor_data", "qos: default"))
    code, unmatched, _ = await handover("check", "cell.yaml", "--live", *LOOK)
    assert code == 1
    assert (
        "/robot will not be received: the reader wants reliable, the writer offers best_effort" in unmatched
    )
    _, seen, _ = await handover("graph", *LOOK)
    assert "topic     /joint_states  sensor_msgs/msg/JointState" in seen
    assert "from /robot (best_effort, volatile" in seen
    assert "the broker does not answer" in seen
    code, _, wrong = await handover("scaffold", "/nothing", "--wait", "0.2")
    assert code == 2
    assert "no node publishes /nothing" in wrong


CALLS = """
ngsild_to_ros:
  speed: {entity: Device:belt, topic: /speed, type: std_msgs/Float64, fields: {data: speed}}
services:
  trigger: {service: /trigger, type: std_srvs/Trigger, task: trigger, resource: Device:robot}
  other: {service: /other, type: std_srvs/Trigger, task: other, resource: Device:robot}
  absent: {service: /absent, type: std_srvs/Trigger, task: absent, resource: Device:robot}
actions:
  count: {action: /fibonacci, type: example_interfaces/Fibonacci, task: count, resource: Device:robot}
"""


@pytest.mark.nightly
async def test_check_live_reports_rules_that_cannot_work(own_shop: Any, handover: Handover) -> None:
    async def answer(_: dict[str, Any]) -> dict[str, Any]:
        return {}

    def ignore(_: Any) -> None:
        pass

    await own_shop.robot.serve("/other", "std_srvs/srv/SetBool", answer)
    await own_shop.robot.subscribe("/speed", "std_msgs/msg/Float64", ignore, LATCHED)
    (own_shop.cell.data_dir / "calls.yaml").write_text(CALLS)
    await own_shop.robot.publisher("/clock", "rosgraph_msgs/msg/Clock")
    with genuine(own_shop.domain, "0" * 64):
        code, live, wrong = await handover("check", "calls.yaml", "--live", *LOOK)
    assert code == 1, wrong
    assert "the graph runs on simulated time (/clock is published by /robot)" in live
    assert "trigger: /trigger: a node serves std_srvs/srv/Trigger with the type hash RIHS01_0000" in live
    assert "other: /other has the type std_srvs/srv/SetBool, not std_srvs/srv/Trigger" in live
    assert "absent: no node serves /absent now" in live
    assert "count: /fibonacci has the type test_msgs/action/Fibonacci, not example_interfaces" in live
    assert "speed: /robot will not receive messages: the reader wants transient_local" in live


@pytest.mark.nightly
async def test_graph_shows_the_configured_domain(
    own_shop: Any, handover: Handover, monkeypatch: pytest.MonkeyPatch
) -> None:
    await asyncio.to_thread(own_shop.begin, "")
    for name, value in own_shop.cell.environment.items():
        monkeypatch.setenv(name, value)
    _, seen, _ = await handover("graph", *LOOK)
    assert "node      /handover_bridge (cyclonedds) - the bridge" in seen
    assert "/robot" in seen
    other = own_shop.domain + 110  # no other test uses it
    monkeypatch.setenv("HANDOVER_ROS_DOMAIN_ID", str(other))
    _, seen, said = await handover("graph", *LOOK)
    assert "/robot" not in seen
    assert f"the running ROS bridge uses ROS domain {own_shop.domain}" in said
