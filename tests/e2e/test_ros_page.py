"""The ROS page of a cell with a ROS bridge: its rules, their counts, and how one is disabled."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import OpenPage
from tests.kit.cell import Cell, new_cell
from tests.kit.other_broker.running import context_link
from tests.kit.ros_domains import ros_domain

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(300)]

MAPPING = """
ros_to_ngsild:
  battery:
    topic: /battery_state
    type: sensor_msgs/BatteryState
    entity: Device:agv-1
    attributes: {batteryLevel: percentage}
ngsild_to_ros:
  belt:
    entity: Device:belt-1
    topic: /belt/speed
    type: std_msgs/Float64
    fields:
      data: {attribute: speed, convert: km/h -> m/s, required: true}
"""

BELT = {"id": "urn:ngsi-ld:Device:demo:belt-1", "type": "Device"}
OURS = {"Link": context_link()}


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[Cell]:
    mapping = tmp_path / "cell.yaml"
    mapping.write_text(MAPPING)
    with new_cell(tmp_path) as made:
        made.extra.update(
            {
                "HANDOVER_ROS_MAPPING": str(mapping),
                "HANDOVER_ROS_DOMAIN_ID": str(ros_domain()),
                "HANDOVER_ROS_INTERFACES": '["127.0.0.1"]',
            }
        )
        made.start("context_broker")
        made.start("ros_fiware_bridge", "webui")
        yield made


def test_rules_are_monitored_and_switched_off_and_on(
    cell: Cell, open_page: OpenPage, keep: Callable[[Page, str], Path], accessible: Callable[[Page], None]
) -> None:
    page = open_page("/admin/services")
    services = page.get_by_role("grid", name="Services")
    expect(services.get_by_role("row", name=re.compile("^ROS 2 bridge"))).to_contain_text("Running")
    page.get_by_role("link", name="Cell", exact=True).click()
    page.get_by_role("link", name="ROS").click()
    rules = page.get_by_role("grid", name="ROS 2")
    battery = rules.get_by_role("row", name=re.compile("^battery"))
    belt = rules.get_by_role("row", name=re.compile("^belt"))
    expect(battery).to_contain_text("No publisher")
    expect(belt).to_contain_text("Waiting for data")

    entities = f"{cell.url('context_broker')}/ngsi-ld/v1/entities"
    speed = {"speed": {"type": "Property", "value": 3.6}}
    httpx.post(entities, json={**BELT, **speed}, headers=OURS, timeout=120).raise_for_status()
    expect(belt).to_contain_text("Running")
    expect(belt).to_contain_text("data 1")
    fast = {"speed": {"type": "Property", "value": "fast"}}
    httpx.patch(f"{entities}/{BELT['id']}/attrs", json=fast, headers=OURS, timeout=120).raise_for_status()
    expect(belt).to_contain_text("fast")
    accessible(page)
    keep(page, "system-ros")

    belt.get_by_role("button", name="Switch off belt").click()
    expect(belt).to_contain_text("Off")
    belt.get_by_role("button", name="Switch on belt").click()
    expect(belt).not_to_contain_text("Off")

    for language, theme, tab in (("de", "dark", "ROS 2"), ("fi", "light", "ROS 2")):
        other = open_page("/cell/ros", language=language, theme=theme)
        expect(other.get_by_role("grid", name=tab)).to_contain_text("agv-1")
        accessible(other)
        keep(other, f"system-ros-{language}-{theme}")


def test_a_cell_without_a_bridge_has_no_ros_section(open_page: OpenPage, cell: Cell) -> None:
    cell.kill("webui")
    del cell.extra["HANDOVER_ROS_MAPPING"]
    cell.start("webui")
    page = open_page("/cell/ros")
    expect(page.get_by_text("There is no page “ROS”")).to_be_visible()
    page.get_by_role("link", name="Show what there is").click()
    expect(page.get_by_role("link", name="Robots")).to_be_visible()
    expect(page.get_by_role("link", name="ROS")).to_have_count(0)
    page.goto("/admin/services")
    services = page.get_by_role("grid", name="Services")
    expect(services.get_by_role("row", name=re.compile("^Context broker"))).to_be_visible()
    expect(services.get_by_role("row", name=re.compile("^ROS 2 bridge"))).to_have_count(0)
