"""Messages become entities and entities become messages, between a real graph and a real broker."""

import math
from typing import Any

import pytest

from ros_fiware_bridge.graph.qos import LATCHED, SENSOR_DATA
from tests.integration.ros_fiware_bridge.conftest import Shop

pytestmark = pytest.mark.slow

ROBOT = "urn:ngsi-ld:Device:demo:r1"


@pytest.fixture(scope="module")
def at_work(everyday: Shop) -> Shop:
    return everyday


def joints(angle: float) -> dict[str, Any]:
    stamp = {"frame_id": "r1", "stamp": {"sec": 1_770_000_000, "nanosec": 0}}
    return {"header": stamp, "name": ["wrist", "elbow"], "position": [0.0, angle]}


async def test_what_a_robot_says_is_in_the_broker(shop: Any) -> None:
    speaker = await shop.speaks("/joint_states", "sensor_msgs/msg/JointState")
    speaker.publish(joints(math.pi / 2))
    await shop.becomes(ROBOT, "elbow", 90)
    entity = await shop.broker.retrieve(ROBOT)
    assert entity["type"] == "Device"
    assert entity["elbow"]["observedAt"].startswith("2026-02-02T02:40:00")
    assert entity["names"]["value"] == ["wrist", "elbow"]
    seen = await shop.until(lambda: (rule := shop.rule("joints"))["told"] == 1 and rule)
    assert (seen["heard"], seen["faults"]) == (1, 0)
    assert seen["lastValue"]["elbow"] == 90
    assert seen["publishers"] == 1


async def test_a_dead_band_keeps_small_changes_from_the_broker(shop: Any) -> None:
    speaker = await shop.speaks("/level", "std_msgs/msg/Float64")
    for level in (1.0, 1.2, 1.5, 1.6, 1.7, 3.0):
        speaker.publish({"data": level})
    await shop.becomes(ROBOT, "level", 3)

    def all_counted() -> bool:
        # What comes while a request is under way may give way to the newest.
        seen = shop.rule("level")
        return bool(seen["heard"] == 6 and seen["told"] + seen["conflated"] == 3)

    await shop.until(all_counted)
    assert shop.rule("level")["dropped"] == 0


async def test_an_entity_is_written_so_often_at_most_and_the_last_word_is_told(shop: Any) -> None:
    speaker = await shop.speaks("/paced", "std_msgs/msg/Int32")
    for number in range(20):
        speaker.publish({"data": number})
    await shop.becomes("urn:ngsi-ld:Device:demo:paced-1", "number", 19)
    assert shop.rule("paced")["told"] <= 4


async def test_a_rule_that_the_broker_does_not_understand_says_so_and_hinders_no_other(shop: Any) -> None:
    await shop.until(lambda: "the broker does not let us listen" in (shop.rule("wrong")["lastError"] or ""))
    names = {one["id"].rsplit(":", 1)[-1] for one in await shop.broker.subscriptions()}
    assert names > {"ros-bridge-rule-speed", "ros-bridge-rule-valve-to-ros"}
    assert "ros-bridge-rule-wrong" not in names


async def test_a_rule_without_a_quality_of_service_reads_with_that_of_the_publisher(shop: Any) -> None:
    sensor = await shop.robot.publisher("/sensor", "std_msgs/msg/Float64", SENSOR_DATA)
    latched = await shop.robot.publisher("/latched", "std_msgs/msg/Float64", LATCHED)
    latched.publish({"data": 4.5})

    async def is_read() -> bool:
        sensor.publish({"data": 2.5})
        return bool(await shop.value(ROBOT, "sensor") == 2.5 and await shop.value(ROBOT, "latched") == 4.5)

    await shop.until(is_read, 60.0)
    assert shop.rule("sensor")["qos"].startswith("best_effort, volatile")
    assert shop.rule("latched")["qos"].startswith("reliable, transient_local")


async def test_one_rule_is_for_every_robot_whose_topic_fits(shop: Any) -> None:
    async def charges(robot: str, charge: float) -> None:
        speaker = await shop.speaks(f"/{robot}/charge", "std_msgs/msg/Float64")
        speaker.publish({"data": charge})
        await shop.becomes(f"urn:ngsi-ld:Device:demo:{robot}", "charge", charge, 60.0)

    await charges("amr_1", 0.75)
    await charges("amr_2", 0.5)
    await shop.until(lambda: shop.rule("fleet")["told"] == 2)
    seen = shop.rule("fleet")
    assert seen["topics"] == ["/amr_1/charge", "/amr_2/charge"]
    assert (seen["from"], seen["publishers"]) == ("/{robot}/charge", 2)


async def test_a_type_that_only_the_graph_knows_is_learnt(shop: Any) -> None:
    speaker = await shop.robot.publisher("/words", "std_msgs/msg/String", LATCHED)
    await shop.until(lambda: shop.rule("untyped")["type"] == "std_msgs/msg/String")
    assert await speaker.matched(10.0)
    speaker.publish({"data": "hello"})
    await shop.becomes(ROBOT, "words", "hello")


BELT = "urn:ngsi-ld:Device:demo:belt-1"


def belt(**values: Any) -> dict[str, Any]:
    return {
        "id": BELT,
        "type": "Device",
        **{name: {"type": "Property", "value": value} for name, value in values.items()},
    }


async def test_what_is_written_in_the_broker_is_heard_on_the_graph(shop: Any) -> None:
    _, heard = await shop.listens("/belt/speed", "std_msgs/msg/Float64")
    await shop.broker.upsert([belt(speed=36)])
    await shop.until(lambda: heard == [{"data": 10.0}])
    await shop.broker.update(BELT, {"speed": {"type": "Property", "value": "fast"}})
    await shop.until(lambda: shop.rule("speed")["faults"] == 1)
    assert "'fast' is no number" in shop.rule("speed")["lastError"]
    await shop.broker.update(BELT, {"speed": {"type": "Property", "value": 18}})
    await shop.until(lambda: heard == [{"data": 10.0}, {"data": 5.0}])


VALVE = "urn:ngsi-ld:Device:demo:valve-1"


async def test_nothing_goes_round(shop: Any) -> None:
    _, heard = await shop.listens("/valve", "std_msgs/msg/Float32")
    speaker = await shop.speaks("/valve", "std_msgs/msg/Float32")
    speaker.publish({"data": 0.25})
    await shop.becomes(VALVE, "opening", 0.25)
    await shop.broker.update(VALVE, {"opening": {"type": "Property", "value": 0.1}})
    await shop.until(lambda: len(heard) == 2)
    await shop.broker.update(VALVE, {"opening": {"type": "Property", "value": 0.5}})
    await shop.until(lambda: len(heard) == 3)
    speaker.publish({"data": 0.75})
    await shop.becomes(VALVE, "opening", 0.75)
    said = [round(message["data"], 3) for message in heard]
    assert said == [0.25, 0.1, 0.5, 0.75]
    assert shop.rule("valve-to-ros")["told"] == 2, "what came from the graph was sent back to it"
    assert shop.rule("valve-from-ros")["told"] <= 4


async def test_the_bridges_node_has_parameters_that_can_be_read(shop: Any) -> None:
    async def call(service: str, kind: str, request: dict[str, Any]) -> Any:
        return await shop.robot.call(
            f"/handover_bridge/{service}", f"rcl_interfaces/srv/{kind}", request, 30.0
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
