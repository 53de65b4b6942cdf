"""Invalid input and failures: each is reported, counted and survived."""

import asyncio
import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from handover_ros.graph.joining import JoinSettings, join
from handover_ros.types.type_store import TypeStore
from tests.kit.waiting import scaled

pytestmark = pytest.mark.slow

ROBOT = "urn:ngsi-ld:Device:demo:r1"

MAPPING = """
ros_to_ngsild:
  level: {topic: /level, type: std_msgs/Float64, entity: Device:r1, attributes: {level: data}}
  every: {topic: /every, type: std_msgs/Int32, entity: Device:r2, attributes: {n: data}, buffer: {keep: 5}}
  words: {topic: /words, type: std_msgs/String, entity: Device:r1, attributes: {words: data}}
  charges: {topic: "/{robot}/charge", type: std_msgs/Float64, entity: "Device:{robot}", attributes: {c: data}}
  task: {topic: /done, type: std_msgs/String, entity: "Task:{data}", create: false, attributes: {s: data}}
  raw:
    topic: /raw
    type: std_msgs/UInt8MultiArray
    entity: Device:r1
    large_arrays: true
    attributes: {raw: data}
ngsild_to_ros:
  small: {entity: Device:r3, topic: /small, type: std_msgs/Int8, fields: {data: number}}
"""


BUSY_S = 60.0
PUBLISH_INTERVAL_S = 0.1


def prop(value: Any) -> dict[str, Any]:
    return {"type": "Property", "value": value}


@contextmanager
def answering_503(port: int) -> Iterator[list[str]]:
    """An HTTP server in place of the broker that answers every request with 503."""
    asked: list[str] = []

    class Busy(BaseHTTPRequestHandler):
        def _answer(self) -> None:
            asked.append(self.path)
            self.rfile.read(int(self.headers.get("Content-Length", 0)))
            self.send_response(503)
            self.send_header("Content-Length", "0")
            self.end_headers()

        do_GET = do_POST = do_PATCH = do_DELETE = _answer  # noqa: N815 - as the library calls them

        def log_message(self, *_: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", port), Busy)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield asked
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.mark.nightly
async def test_a_broker_that_answers_503_for_a_minute_misses_only_what_the_mapping_allows(shop: Any) -> None:
    level = await shop.publisher("/level", "std_msgs/msg/Float64")
    every = await shop.publisher("/every", "std_msgs/msg/Int32")
    level.publish({"data": 1.0})
    await shop.becomes(ROBOT, "level", 1)
    await shop.until(lambda: shop.rule("level")["forwarded"] == 1)
    before = shop.rule("level")["received"]
    shop.cell.kill("context_broker")
    sent = 0
    with answering_503(shop.cell.ports["context_broker"]) as asked:
        busy_until_s = time.monotonic() + BUSY_S
        while time.monotonic() < busy_until_s:
            level.publish({"data": 2.0 + sent})
            every.publish({"data": sent})
            sent += 1
            await asyncio.sleep(PUBLISH_INTERVAL_S)
        assert not httpx.get(f"{shop.cell.url('ros_fiware_bridge')}/broker", timeout=120).json()["available"]
        await shop.until(lambda: shop.rule("level")["received"] == before + sent)
        assert shop.rule("level")["forwarded"] == 1, "the broker has accepted nothing since"
        assert 3 <= len(asked) < sent, "the bridge retries with backoff"
        assert httpx.get(f"{shop.cell.url('ros_fiware_bridge')}/readyz", timeout=120).status_code == 503
    shop.cell.start("context_broker")
    await shop.becomes(ROBOT, "level", 1 + sent)
    await shop.becomes("urn:ngsi-ld:Device:demo:r2", "n", sent - 1)
    shop.cell.wait_ready("ros_fiware_bridge")
    level = shop.rule("level")
    assert (level["dropped"], level["conflated"]) == (0, sent - 1), "of a level only the newest is kept"
    assert shop.rule("every")["droppedByCause"] == {"broker_away": sent - 5}, "the buffer keeps five"
    url = f"{shop.cell.url('context_broker')}/ngsi-ld/v1/temporal/entities/urn:ngsi-ld:Device:demo:r2"
    history = httpx.get(
        url, params={"timerel": "after", "timeAt": "2020-01-01T00:00:00Z", "lastN": "5"}, timeout=120
    )
    assert sorted(one["value"] for one in history.json()["n"]) == list(range(sent - 5, sent))

    async def alerted() -> bool:
        return any("were replaced" in str(one) for one in await shop.broker.query(type="Alert"))

    await shop.until(alerted, why="no Alert reports the drops")


async def test_nan_and_text_over_the_limit_are_reported_and_counted(shop: Any) -> None:
    level = await shop.publisher("/level", "std_msgs/msg/Float64")
    faults = shop.rule("level")["errors"]
    level.publish({"data": math.nan})
    await shop.until(lambda: shop.rule("level")["errors"] == faults + 1)
    assert shop.rule("level")["lastError"] == (
        "level: data is nan, which JSON cannot represent; set `nan` to the value to write instead"
    )
    level.publish({"data": 5.5})
    await shop.becomes(ROBOT, "level", 5.5)
    words = await shop.publisher("/words", "std_msgs/msg/String")
    words.publish({"data": "x" * 70_000})
    await shop.until(lambda: "text of 70000 characters" in (shop.rule("words")["lastError"] or ""))


@pytest.mark.nightly
async def test_a_message_of_50_megabytes_is_refused_and_the_next_one_accepted(shop: Any) -> None:
    asked = JoinSettings(
        node="big", domain_id=shop.domain, interfaces=("127.0.0.1",), max_message_bytes=100 * 2**20
    )
    big = await join(TypeStore(), asked)
    try:
        raw = await big.publisher("/raw", "std_msgs/msg/UInt8MultiArray")
        assert await raw.matched(scaled(10.0))
        raw.publish({"data": np.zeros(50 * 2**20, np.uint8)})
        await shop.until(lambda: shop.rule("raw")["unreadable"] == 1, 30.0)
        assert "16777216 are allowed" in shop.rule("raw")["lastUnreadable"]
        raw.publish({"data": b"ok"})
        await shop.becomes(ROBOT, "raw", [111, 107])
    finally:
        await big.close()


@pytest.mark.nightly
async def test_a_silent_topic_raises_an_alert_until_it_has_a_publisher(shop: Any) -> None:
    async def alert() -> dict[str, Any]:
        found = [one for one in await shop.broker.query(type="Alert") if "silent-words" in one["id"]]
        return found[0] if found else {}

    async def stands() -> bool:
        return bool(found := await alert()) and "validTo" not in found

    async def is_over() -> bool:
        return "validTo" in await alert()

    words = await shop.publisher("/words", "std_msgs/msg/String")
    words.publish({"data": "here"})
    await shop.becomes(ROBOT, "words", "here")
    await shop.until(lambda: shop.rule("words")["publishers"] == 1)
    await shop.next_check()
    await words.close()
    await shop.until(stands, 25.0, "no Alert reports the silence")
    assert "no node publishes /words any more" in (await alert())["description"]["value"]
    words = await shop.publisher("/words", "std_msgs/msg/String")
    await shop.until(is_over, 25.0, "the Alert is not cleared")
    await words.close()


@pytest.mark.nightly
async def test_disabling_a_rule_clears_the_alerts_of_its_silent_topics(shop: Any) -> None:
    async def alert() -> dict[str, Any]:
        found = [one for one in await shop.broker.query(type="Alert") if "amr_9" in one["id"]]
        return found[0] if found else {}

    async def stands() -> bool:
        return bool(found := await alert()) and "validTo" not in found

    async def is_over() -> bool:
        return "validTo" in await alert()

    charge = await shop.publisher("/amr_9/charge", "std_msgs/msg/Float64")
    await shop.until(lambda: shop.rule("charges")["publishers"] == 1)
    await shop.next_check()
    await charge.close()
    await shop.until(stands, 25.0, "no Alert reports the silence")
    assert shop.post("/rules/charges/disable").is_success
    await shop.until(is_over, 25.0, "the Alert is not cleared")
    assert shop.post("/rules/charges/enable").is_success


@pytest.mark.nightly
async def test_a_peer_with_another_definition_is_reported(shop: Any, tmp_path: Path) -> None:
    folder = tmp_path / "std_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Float64.msg").write_text("float64 data\nfloat64 more\n")
    asked = JoinSettings(node="other", domain_id=shop.domain, interfaces=("127.0.0.1",))
    other = await join(TypeStore([tmp_path]), asked)
    try:
        publisher = await other.publisher("/level", "std_msgs/msg/Float64")
        await publisher.matched(5.0)
        publisher.publish({"data": 77.0, "more": 1.0})
        url = f"{shop.cell.url('ros_fiware_bridge')}/graph"
        problems = await shop.until(lambda: httpx.get(url, timeout=120).json()["problems"])
        assert any("std_msgs/msg/Float64" in problem and "/other" in problem for problem in problems)
        level = await shop.publisher("/level", "std_msgs/msg/Float64")
        level.publish({"data": 6.5})
        await shop.becomes(ROBOT, "level", 6.5)
    finally:
        await other.close()


async def test_a_refused_update_is_reported_and_the_rule_continues(shop: Any) -> None:
    done = await shop.publisher("/done", "std_msgs/msg/String")
    done.publish({"data": "unknown-task"})
    await shop.until(lambda: shop.rule("task")["errors"] == 1)
    assert "urn:ngsi-ld:Task:demo:unknown-task" in shop.rule("task")["lastError"]
    done.publish({"data": ""})
    await shop.until(lambda: shop.rule("task")["errors"] == 2)
    assert "data is empty" in shop.rule("task")["lastError"]


async def test_a_value_out_of_range_is_reported(shop: Any) -> None:
    _, received = await shop.subscribe("/small", "std_msgs/msg/Int8")
    entity = {"id": "urn:ngsi-ld:Device:demo:r3", "type": "Device"}
    await shop.broker.upsert([{**entity, "number": prop(300)}])
    await shop.until(lambda: shop.rule("small")["errors"] == 1)
    assert "300 does not fit int8, whose range is -128 to 127" in shop.rule("small")["lastError"]
    await shop.broker.upsert([{**entity, "number": prop(100)}])
    await shop.until(lambda: received == [{"data": 100}])


FORGED = {"id": "urn:ngsi-ld:Device:demo:r3", "type": "Device", "number": {"type": "Property", "value": 9}}
STRANGE: list[Any] = [
    5,
    [],
    {"data": 5},
    {"data": [{"id": 5, "number": {}}]},
    {"data": [{**FORGED, "number": {"type": "Property"}}]},
    {"data": [{**FORGED, "number": {"type": "Property", "value": "urn:ngsi-ld:null"}}]},
    {"data": [{**FORGED, "id": "urn:ngsi-ld:Device:demo:another"}]},
    {"data": [{**FORGED, "type": "Person"}]},
]


async def test_a_forged_notification_publishes_nothing(shop: Any) -> None:
    forwarded = shop.rule("small")["forwarded"]
    (subscription,) = await shop.broker.subscriptions()
    endpoint = subscription["notification"]["endpoint"]
    uri, (pair,) = endpoint["uri"], endpoint["receiverInfo"]
    (file,) = shop.cell.data_dir.glob("ros-bridge.notification-key")
    keyed = {pair["key"]: file.read_text()}
    for strange in STRANGE:
        assert httpx.post(uri, json=strange, headers=keyed, timeout=120).status_code in {204, 400}
    assert httpx.post(uri, json={"data": [FORGED]}, timeout=120).status_code == 403
    assert httpx.post(uri, json={"data": [FORGED]}, headers=keyed, timeout=120).status_code == 204
    other_rule = httpx.post(f"{uri}-that-is-none", json={"data": [FORGED]}, headers=keyed, timeout=120)
    assert other_rule.status_code == 404
    assert shop.rule("small")["forwarded"] == forwarded
    await shop.broker.upsert([FORGED])
    assert httpx.post(uri, json={"data": [FORGED]}, headers=keyed, timeout=120).status_code == 204
    assert shop.rule("small")["forwarded"] > forwarded
