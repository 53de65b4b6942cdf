"""Rules in both directions between a real graph and a real broker."""

import math
from typing import Any

import httpx
import pytest

from handover_ros.graph.qos import LATCHED, SENSOR_DATA, Qos
from ros_fiware_bridge.tests.integration.conftest import Shop
from tests.kit.waiting import scaled

pytestmark = pytest.mark.slow

ROBOT = "urn:ngsi-ld:Device:demo:r1"


@pytest.fixture(scope="module")
def at_work(shared_shop: Shop) -> Shop:
    return shared_shop


def joints(angle: float) -> dict[str, Any]:
    stamp = {"frame_id": "r1", "stamp": {"sec": 1_770_000_000, "nanosec": 0}}
    return {"header": stamp, "name": ["wrist", "elbow"], "position": [0.0, angle]}


@pytest.mark.nightly
async def test_a_message_is_written_to_the_broker(shop: Any) -> None:
    publisher = await shop.publisher("/joint_states", "sensor_msgs/msg/JointState")
    publisher.publish(joints(math.pi / 2))
    await shop.becomes(ROBOT, "elbow", 90)
    entity = await shop.broker.retrieve(ROBOT)
    assert entity["type"] == "Device"
    assert entity["elbow"]["observedAt"].startswith("2026-02-02T02:40:00")
    assert entity["names"]["value"] == ["wrist", "elbow"]
    seen = await shop.until(lambda: (rule := shop.rule("joints"))["forwarded"] == 1 and rule)
    assert (seen["received"], seen["errors"]) == (1, 0)
    assert seen["lastValue"]["elbow"] == 90
    assert seen["publishers"] == 1


async def test_changes_within_the_dead_band_are_not_written(shop: Any) -> None:
    publisher = await shop.publisher("/level", "std_msgs/msg/Float64")
    for level in (1.0, 1.2, 1.5, 1.6, 1.7, 3.0):
        publisher.publish({"data": level})
    await shop.becomes(ROBOT, "level", 3)

    def all_counted() -> bool:
        # A message that arrives while a request is in flight may be replaced by the newest.
        seen = shop.rule("level")
        return bool(seen["received"] == 6 and seen["forwarded"] + seen["conflated"] == 3)

    await shop.until(all_counted)
    assert shop.rule("level")["dropped"] == 0


async def test_a_status_is_written_with_its_value_and_a_change_of_it_counts(shop: Any) -> None:
    publisher = await shop.publisher("/human/p_1/heart_rate", "handover_human_msgs/msg/HeartRate")
    person = "urn:ngsi-ld:HumanState:demo:p-1"

    async def becomes(status: str) -> Any:
        async def is_there() -> Any:
            found = [one for one in await shop.broker.query(type="HumanState") if one["id"] == person]
            return found and found[0]["heartRate"]["status"]["value"] == status and found[0]["heartRate"]

        return await shop.until(is_there, why=f"the status never became {status}")

    info = {"subject": "p-1", "source": "strap", "quality": 0.9, "validity": 1}
    publisher.publish({"rate_bpm": 92.0, "info": info})
    rate = await becomes("valid")
    assert (rate["value"], rate["quality"]["value"], rate["unitCode"]) == (92, 0.9, "BPM")
    assert rate["observedBy"]["object"] == "urn:ngsi-ld:Device:demo:strap"
    publisher.publish({"rate_bpm": 92.5, "info": {**info, "quality": 0.8}})  # within both dead bands
    publisher.publish({"rate_bpm": 92.5, "info": {**info, "validity": 2}})
    assert (await becomes("stale"))["value"] == 92.5
    await shop.until(lambda: (rule := shop.rule("body"))["received"] == 3 and rule["forwarded"] == 2)


async def test_the_rate_is_limited_and_the_last_value_is_written(shop: Any) -> None:
    publisher = await shop.publisher("/paced", "std_msgs/msg/Int32")
    for number in range(20):
        publisher.publish({"data": number})
    await shop.becomes("urn:ngsi-ld:Device:demo:paced-1", "number", 19)
    assert shop.rule("paced")["forwarded"] <= 4


async def test_a_rule_that_the_broker_refuses_does_not_affect_the_others(shop: Any) -> None:
    await shop.until(lambda: "the broker refuses the subscription" in (shop.rule("wrong")["lastError"] or ""))
    names = {one["id"].rsplit(":", 1)[-1] for one in await shop.broker.subscriptions()}
    assert names > {"ros-bridge-rule-speed", "ros-bridge-rule-valve-to-ros"}
    assert "ros-bridge-rule-wrong" not in names


async def test_a_rule_without_qos_uses_the_qos_of_the_publisher(shop: Any) -> None:
    sensor = await shop.robot.publisher("/sensor", "std_msgs/msg/Float64", SENSOR_DATA)
    latched = await shop.robot.publisher("/latched", "std_msgs/msg/Float64", LATCHED)
    latched.publish({"data": 4.5})

    async def is_read() -> bool:
        sensor.publish({"data": 2.5})
        return bool(await shop.value(ROBOT, "sensor") == 2.5 and await shop.value(ROBOT, "latched") == 4.5)

    await shop.until(is_read, 60.0)
    assert shop.rule("sensor")["qos"].startswith("best_effort, volatile")
    assert shop.rule("latched")["qos"].startswith("reliable, transient_local")


async def test_a_topic_pattern_applies_to_every_matching_robot(shop: Any) -> None:
    async def charges(robot: str, charge: float) -> None:
        publisher = await shop.publisher(f"/{robot}/charge", "std_msgs/msg/Float64")
        publisher.publish({"data": charge})
        await shop.becomes(f"urn:ngsi-ld:Device:demo:{robot}", "charge", charge, 60.0)

    await charges("amr_1", 0.75)
    await charges("amr_2", 0.5)
    await shop.until(lambda: shop.rule("fleet")["forwarded"] == 2)
    seen = shop.rule("fleet")
    assert seen["topics"] == ["/amr_1/charge", "/amr_2/charge"]
    assert (seen["from"], seen["publishers"]) == ("/{robot}/charge", 2)


async def test_a_rule_for_every_value_skips_none(shop: Any) -> None:
    _, received = await shop.subscribe("/count", "std_msgs/msg/Int32", Qos(depth=1000))
    counter = {"id": "urn:ngsi-ld:Device:demo:counter-1", "type": "Device"}
    for number in range(300):
        await shop.broker.upsert([{**counter, "count": {"type": "Property", "value": number}}])
    await shop.until(lambda: len(received) >= 300, 60.0)
    assert [message["data"] for message in received] == list(range(300))
    forged = {"data": [{**counter, "count": {"type": "Property", "value": 1000}}]}
    url = f"{shop.cell.url('ros_fiware_bridge')}/notifications/every"
    assert httpx.post(url, json=forged, timeout=120).status_code == 403


@pytest.mark.nightly
async def test_a_rule_for_every_value_publishes_a_value_that_was_not_notified(shop: Any) -> None:
    _, received = await shop.subscribe("/count", "std_msgs/msg/Int32", Qos(depth=1000))
    counter = {"id": "urn:ngsi-ld:Device:demo:counter-1", "type": "Device"}
    await shop.broker.upsert([{**counter, "count": {"type": "Property", "value": -1}}])
    await shop.until(lambda: received == [{"data": -1}])
    await shop.broker.delete_subscription("urn:ngsi-ld:Subscription:demo:ros-bridge-rule-every")
    await shop.broker.upsert([{**counter, "count": {"type": "Property", "value": -2}}])
    await shop.until(lambda: received == [{"data": -1}, {"data": -2}], 60.0)


async def test_the_type_of_a_topic_is_taken_from_the_graph(shop: Any) -> None:
    publisher = await shop.robot.publisher("/words", "std_msgs/msg/String", LATCHED)
    await shop.until(lambda: shop.rule("untyped")["type"] == "std_msgs/msg/String")
    assert await publisher.matched(scaled(10.0))
    publisher.publish({"data": "hello"})
    await shop.becomes(ROBOT, "words", "hello")


BELT = "urn:ngsi-ld:Device:demo:belt-1"


def belt(**values: Any) -> dict[str, Any]:
    return {
        "id": BELT,
        "type": "Device",
        **{name: {"type": "Property", "value": value} for name, value in values.items()},
    }


async def test_a_change_in_the_broker_is_published(shop: Any) -> None:
    _, received = await shop.subscribe("/belt/speed", "std_msgs/msg/Float64")
    await shop.broker.upsert([belt(speed=36)])
    await shop.until(lambda: received == [{"data": 10.0}])
    await shop.broker.update(BELT, {"speed": {"type": "Property", "value": "fast"}})
    await shop.until(lambda: shop.rule("speed")["errors"] == 1)
    assert "'fast' is not a number" in shop.rule("speed")["lastError"]
    await shop.broker.update(BELT, {"speed": {"type": "Property", "value": 18}})
    await shop.until(lambda: received == [{"data": 10.0}, {"data": 5.0}])


VALVE = "urn:ngsi-ld:Device:demo:valve-1"


async def test_a_value_is_not_sent_back_to_its_side(shop: Any) -> None:
    _, received = await shop.subscribe("/valve", "std_msgs/msg/Float32")
    publisher = await shop.publisher("/valve", "std_msgs/msg/Float32")
    publisher.publish({"data": 0.25})
    await shop.becomes(VALVE, "opening", 0.25)
    await shop.broker.update(VALVE, {"opening": {"type": "Property", "value": 0.1}})
    await shop.until(lambda: len(received) == 2)
    await shop.broker.update(VALVE, {"opening": {"type": "Property", "value": 0.5}})
    await shop.until(lambda: len(received) == 3)
    publisher.publish({"data": 0.75})
    await shop.becomes(VALVE, "opening", 0.75)
    await shop.until(lambda: len(received) == 4)
    sent = [round(message["data"], 3) for message in received]
    assert sent == [0.25, 0.1, 0.5, 0.75]
    assert shop.rule("valve-to-ros")["forwarded"] == 2, "what came from the graph was sent back to it"
    assert shop.rule("valve-from-ros")["forwarded"] <= 4


async def test_the_parameters_of_the_node_are_read_only(shop: Any) -> None:
    async def call(service: str, kind: str, request: dict[str, Any]) -> Any:
        return await shop.robot.call(
            f"/handover_bridge/{service}", f"rcl_interfaces/srv/{kind}", request, scaled(30.0)
        )

    listed = await call("list_parameters", "ListParameters", {"prefixes": ["rules"]})
    assert "rules.level.enabled" in listed["result"]["names"]
    assert "mapping" not in listed["result"]["names"]
    asked = {"names": ["rules.level.enabled", "mapping", "nothing"]}
    enabled, mapping, nothing = (await call("get_parameters", "GetParameters", asked))["values"]
    assert (enabled["type"], enabled["bool_value"]) == (1, True)
    assert mapping["string_value"].endswith("mapping.yaml")
    assert nothing["type"] == 0
    change = {"name": "rules.level.enabled", "value": {"type": 1, "bool_value": False}}
    (refused,) = (await call("set_parameters", "SetParameters", {"parameters": [change]}))["results"]
    assert not refused["successful"]
    assert shop.rule("level")["enabled"]
