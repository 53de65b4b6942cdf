"""A condition that keeps a rule from working raises an Alert while it lasts."""

from typing import Any

import pytest

from handover_ros.graph.qos import SENSOR_DATA

pytestmark = pytest.mark.slow

MAPPING = """
ros_to_ngsild:
  level: {topic: /level, type: std_msgs/Float64, qos: default, entity: Device:r1, attributes: {level: data}}
  count: {topic: /count, type: std_msgs/Int32, entity: Device:r1, attributes: {count: data}}
services:
  light:
    service: /lamp/on
    type: std_srvs/SetBool
    when: {entity: Device:lamp, attribute: wanted}
    request: {data: wanted}
    success: success
    message: message
    timeout_s: 1
"""
LAMP = "urn:ngsi-ld:Device:demo:lamp"


async def alerts(shop: Any, words: str, *, active: bool = True) -> list[dict[str, Any]]:
    found = await shop.broker.query(type="Alert")
    return [one for one in found if words in one["description"]["value"] and ("validTo" not in one) is active]


async def want(shop: Any, wanted: bool) -> None:
    value = {"type": "Property", "value": wanted}
    await shop.broker.upsert([{"id": LAMP, "type": "Device", "wanted": value}])


@pytest.mark.nightly
async def test_a_failed_call_for_a_changed_attribute_raises_an_alert_until_one_succeeds(shop: Any) -> None:
    await want(shop, True)
    words = f'the rule "light" could not call the graph: {LAMP}: '
    await shop.until(lambda: alerts(shop, f"{words}no node serves /lamp/on"), 60.0)

    async def no(_: dict[str, Any]) -> dict[str, Any]:
        return {"success": False, "message": "the lamp is broken"}

    async def yes(_: dict[str, Any]) -> dict[str, Any]:
        return {"success": True}

    broken = await shop.robot.serve("/lamp/on", "std_srvs/srv/SetBool", no)
    await want(shop, False)
    await shop.until(lambda: alerts(shop, f"{words}/lamp/on did not succeed: the lamp is broken"), 60.0)
    await broken.close()
    await shop.robot.serve("/lamp/on", "std_srvs/srv/SetBool", yes)
    await want(shop, True)
    await shop.until(lambda: alerts(shop, words, active=False), 60.0)


@pytest.mark.nightly
async def test_incompatible_qos_raises_an_alert_while_it_lasts(shop: Any) -> None:
    publisher = await shop.robot.publisher("/level", "std_msgs/msg/Float64", SENSOR_DATA)
    words = "/level: /robot publishes it with best_effort"
    await shop.until(lambda: alerts(shop, words), 60.0)
    await publisher.close()
    await shop.until(lambda: alerts(shop, words, active=False), 60.0)


@pytest.mark.nightly
async def test_another_type_on_the_topic_raises_an_alert(shop: Any) -> None:
    await shop.robot.publisher("/count", "std_msgs/msg/String")
    await shop.until(lambda: alerts(shop, "/count: /robot publishes std_msgs/msg/String, we use"), 60.0)
