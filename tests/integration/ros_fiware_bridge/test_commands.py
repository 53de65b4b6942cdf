"""`handover bridge` as a person types it."""

import asyncio
import subprocess
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from handover.cli.main import main
from ros_fiware_bridge.graph.qos import SENSOR_DATA

pytestmark = pytest.mark.slow

LOOK = ("--wait", "2")
Handover = Callable[..., Awaitable[tuple[int, str, str]]]
"""Runs a command; gives its exit code, standard output and standard error."""


@pytest.fixture
def handover(own_shop: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Handover:
    """The command in a thread of this process: a new one each time would load the middleware anew."""
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


async def test_a_mapping_is_checked_and_its_mistakes_are_told_in_lines(
    own_shop: Any, handover: Handover
) -> None:
    code, said, wrong = await handover("check", "battery")
    assert (code, wrong) == (0, "")
    assert "battery: /battery_state (sensor_msgs/msg/BatteryState;" in said
    file = own_shop.cell.data_dir / "cell.yaml"
    file.write_text(
        "ros_to_ngsild:\n  a:\n    topic: /x\n    type: std_msgs/Strin\n    entity: Device:d\n"
        "    attributes: {words: data}\n"
    )
    code, said, wrong = await handover("check", "cell.yaml")
    assert (code, said) == (2, "")
    assert wrong.startswith("handover: cell.yaml:4: ros_to_ngsild.a.type: ")
    assert "did you mean std_msgs/msg/String" in wrong
    assert (await handover("check", "nowhere.yaml"))[0] == 2


def test_a_shell_gets_the_code_and_one_line(tmp_path: Path) -> None:
    typed = [sys.executable, "-m", "handover.cli", "bridge", "check", "nowhere.yaml"]
    ended = subprocess.run(
        typed, cwd=tmp_path, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=90
    )
    assert (ended.returncode, ended.stdout) == (2, "")
    assert len(ended.stderr.splitlines()) == 1


async def test_a_topic_that_exists_is_seen_and_gets_a_mapping_that_can_work(
    own_shop: Any, handover: Handover
) -> None:
    await own_shop.robot.publisher("/joint_states", "sensor_msgs/msg/JointState", SENSOR_DATA)
    code, scaffold, wrong = await handover("scaffold", "/joint_states", *LOOK)
    assert code == 0, wrong
    assert "qos: sensor_data" in scaffold
    file = own_shop.cell.data_dir / "cell.yaml"
    file.write_text(scaffold)
    code, live, wrong = await handover("check", "cell.yaml", "--live", *LOOK)
    assert code == 0, wrong
    assert "nobody" not in live
    file.write_text(scaffold.replace("qos: sensor_data", "qos: default"))
    _, unheard, _ = await handover("check", "cell.yaml", "--live", *LOOK)
    assert "/robot will not be heard: the reader wants reliable, the writer offers best_effort" in unheard
    _, seen, _ = await handover("graph", *LOOK)
    assert "topic     /joint_states  sensor_msgs/msg/JointState" in seen
    assert "from /robot (best_effort, volatile" in seen
    assert "the broker cannot be asked" in seen
    code, _, wrong = await handover("scaffold", "/nothing", "--wait", "0.2")
    assert code == 2
    assert "nobody publishes /nothing" in wrong
