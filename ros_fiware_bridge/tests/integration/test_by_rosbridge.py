"""The bridge with the rosbridge adapter."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack

import pytest

from handover_ros.graph.joining import Adapter, JoinSettings, join
from handover_ros.types.type_store import TypeStore
from ros_fiware_bridge.tests.integration.conftest import Shop
from ros_fiware_bridge.tests.integration.graph.rosbridge_server import running
from tests.kit.cell import Cell

pytestmark = pytest.mark.slow

BELT = "urn:ngsi-ld:Device:demo:belt-1"
MAPPING = """
ros_to_ngsild:
  counted:
    topic: /counted
    type: std_msgs/UInt32
    entity: Device:counter
    attributes: {count: data}
    observed_at: received
ngsild_to_ros:
  belt:
    entity: Device:belt-1
    topic: /belt/speed
    type: std_msgs/Float64
    fields: {data: {attribute: speed, required: true}}
"""


@pytest.fixture
def at_work(cell: Cell) -> Shop:
    return Shop(cell, 0)


@pytest.fixture
async def shop(at_work: Shop) -> AsyncIterator[Shop]:
    async with AsyncExitStack() as on:
        server = await on.enter_async_context(running())
        settings = {"HANDOVER_ROS_ADAPTER": "rosbridge", "HANDOVER_ROSBRIDGE_URL": server.url}
        await asyncio.to_thread(at_work.begin, MAPPING, **settings)  # the server answers meanwhile
        await on.enter_async_context(at_work.opened())
        await at_work.robot.close()
        asked = JoinSettings(node="robot", rosbridge_url=server.url)
        at_work.robot = await join(TypeStore(), asked, Adapter.ROSBRIDGE)
        yield at_work


async def test_rules_work_in_both_directions(shop: Shop) -> None:
    sent = await shop.publisher("/counted", "std_msgs/msg/UInt32")
    sent.publish({"data": 7})
    await shop.becomes("urn:ngsi-ld:Device:demo:counter", "count", 7)
    _, received = await shop.subscribe("/belt/speed", "std_msgs/msg/Float64")
    speed = {"type": "Property", "value": 0.25}
    await shop.broker.create({"id": BELT, "type": "Device", "speed": speed})
    await shop.until(lambda: received == [{"data": 0.25}], why="the speed never came")
