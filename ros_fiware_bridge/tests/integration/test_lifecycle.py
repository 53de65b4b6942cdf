"""Start and shutdown of the bridge: initial state, subscriptions, disabled rules."""

from typing import Any

import httpx
import pytest

from handover_ros.graph.qos import LATCHED

pytestmark = pytest.mark.slow

INWARD = """
ngsild_to_ros:
  speed: {entity: Device:belt-1, topic: /belt/speed, type: std_msgs/Float64, fields: {data: speed}}
  mode:
    entity: {type: Device, id_pattern: ".*belt.*"}
    topic: /modes/{id}
    type: std_msgs/String
    qos: latched
    fields: {data: mode}
"""
BELT = "urn:ngsi-ld:Device:demo:belt-1"


@pytest.mark.nightly
async def test_subscriptions_latched_topics_and_disabled_rules_survive_a_restart(own_shop: Any) -> None:
    shop = own_shop
    shop.cell.start("context_broker")
    values = {"mode": {"type": "Property", "value": "auto"}, "speed": {"type": "Property", "value": 1}}
    await shop.broker.create({"id": BELT, "type": "Device", **values})
    shop.begin(INWARD)
    await shop.until(lambda: shop.rule("mode")["forwarded"] == 1)
    _, received = await shop.subscribe("/modes/belt_1", "std_msgs/msg/String", LATCHED)
    await shop.until(lambda: received == [{"data": "auto"}])
    assert shop.rule("speed")["forwarded"] == 0, "what is not latched is not sent at the start"

    assert await _names(shop) == ["ros-bridge-rule-mode", "ros-bridge-rule-speed"]
    assert shop.post("/rules/speed/disable").json()["enabled"] is False
    await shop.until(lambda: _are(shop, ["ros-bridge-rule-mode"]))
    shop.cell.kill("ros_fiware_bridge")
    shop.begin(INWARD.replace("  mode:", "  kind:"))
    assert shop.rule("speed")["enabled"] is False, "a disabled rule stays disabled"
    assert await _names(shop) == ["ros-bridge-rule-kind"]
    assert shop.post("/rules/speed/enable").json()["enabled"] is True
    await shop.until(lambda: _are(shop, ["ros-bridge-rule-kind", "ros-bridge-rule-speed"]))
    refused = shop.post("/rules/sped/enable")
    assert (refused.status_code, refused.json()["title"]) == (404, "No such rule")
    records = httpx.get(f"{shop.cell.url('ros_fiware_bridge')}/audit", timeout=120).json()
    done = [one["text"] for one in reversed(records) if one["outcome"] == "done"]
    assert done == ["/rules/speed/disable", "/rules/speed/enable"]
    process = shop.cell.processes.pop("ros_fiware_bridge")
    process.terminate()
    process.wait(timeout=120)
    assert await _names(shop) == [], "an orderly shutdown deletes the subscriptions"


async def _names(shop: Any) -> list[str]:
    return sorted(one["id"].rsplit(":", 1)[-1] for one in await shop.broker.subscriptions())


async def _are(shop: Any, names: list[str]) -> bool:
    return await _names(shop) == names
