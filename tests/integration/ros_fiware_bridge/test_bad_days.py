"""Bad input and bad days: each is named, counted and survived."""

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

from ros_fiware_bridge.graph.joining import JoinSettings, join
from ros_fiware_bridge.types.type_store import TypeStore

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
SAYS_EVERY_S = 0.1


def prop(value: Any) -> dict[str, Any]:
    return {"type": "Property", "value": value}


@contextmanager
def answering_503(port: int) -> Iterator[list[str]]:
    """Something that answers 503 to whatever is asked, in the place of the broker."""
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


async def test_a_broker_that_answers_503_for_a_minute_misses_only_what_a_rule_gives_up(shop: Any) -> None:
    level = await shop.speaks("/level", "std_msgs/msg/Float64")
    every = await shop.speaks("/every", "std_msgs/msg/Int32")
    level.publish({"data": 1.0})
    await shop.becomes(ROBOT, "level", 1)
    await shop.until(lambda: shop.rule("level")["told"] == 1)
    before = shop.rule("level")["heard"]
    shop.cell.kill("context_broker")
    said = 0
    with answering_503(shop.cell.ports["context_broker"]) as asked:
        busy_until_s = time.monotonic() + BUSY_S
        while time.monotonic() < busy_until_s:
            level.publish({"data": 2.0 + said})
            every.publish({"data": said})
            said += 1
            await asyncio.sleep(SAYS_EVERY_S)
        assert httpx.get(f"{shop.cell.url('ros_fiware_bridge')}/broker", timeout=120).json()["away"]
        await shop.until(lambda: shop.rule("level")["heard"] == before + said)
        assert shop.rule("level")["told"] == 1, "the broker has taken nothing since"
        assert 3 <= len(asked) < said, "it asks again, and less and less often"
        assert httpx.get(f"{shop.cell.url('ros_fiware_bridge')}/readyz").status_code == 503
    shop.cell.start("context_broker")
    await shop.becomes(ROBOT, "level", 1 + said)
    await shop.becomes("urn:ngsi-ld:Device:demo:r2", "n", said - 1)
    shop.cell.wait_ready("ros_fiware_bridge")
    level = shop.rule("level")
    assert (level["dropped"], level["conflated"]) == (0, said - 1), "of a level only the newest is wanted"
    assert shop.rule("every")["losses"] == {"broker_away": said - 5}, "five were to be kept"
    url = f"{shop.cell.url('context_broker')}/ngsi-ld/v1/temporal/entities/urn:ngsi-ld:Device:demo:r2"
    history = httpx.get(url, params={"timerel": "after", "timeAt": "2020-01-01T00:00:00Z", "lastN": "5"})
    assert sorted(one["value"] for one in history.json()["n"]) == list(range(said - 5, said))

    async def alerted() -> bool:
        return any("gave way" in str(one) for one in await shop.broker.query(type="Alert"))

    await shop.until(alerted, why="no Alert tells of the loss")


async def test_what_is_no_number_or_too_long_is_named_and_counted(shop: Any) -> None:
    level = await shop.speaks("/level", "std_msgs/msg/Float64")
    faults = shop.rule("level")["faults"]
    level.publish({"data": math.nan})
    await shop.until(lambda: shop.rule("level")["faults"] == faults + 1)
    assert shop.rule("level")["lastError"] == (
        "level: data is nan, which JSON cannot say; `nan` tells what to write instead"
    )
    level.publish({"data": 5.5})
    await shop.becomes(ROBOT, "level", 5.5)
    words = await shop.speaks("/words", "std_msgs/msg/String")
    words.publish({"data": "x" * 70_000})
    await shop.until(lambda: "text of 70000 characters" in (shop.rule("words")["lastError"] or ""))


async def test_a_message_of_50_megabytes_is_refused_and_nothing_else(shop: Any) -> None:
    asked = JoinSettings(node="big", domain_id=shop.domain, interfaces=("127.0.0.1",), most_bytes=100 * 2**20)
    big = await join(TypeStore(), asked)
    try:
        raw = await big.publisher("/raw", "std_msgs/msg/UInt8MultiArray")
        assert await raw.matched(10.0)
        raw.publish({"data": np.zeros(50 * 2**20, np.uint8)})
        await shop.until(lambda: shop.rule("raw")["unread"] == 1, 30.0)
        assert "16777216 are allowed" in shop.rule("raw")["lastUnread"]
        raw.publish({"data": b"ok"})
        await shop.becomes(ROBOT, "raw", [111, 107])
    finally:
        await big.close()


async def test_a_topic_on_which_nobody_speaks_any_more_is_an_alert_until_somebody_does(shop: Any) -> None:
    async def alert() -> dict[str, Any]:
        found = [one for one in await shop.broker.query(type="Alert") if "silent-words" in one["id"]]
        return found[0] if found else {}

    async def stands() -> bool:
        return bool(found := await alert()) and "validTo" not in found

    async def is_over() -> bool:
        return "validTo" in await alert()

    words = await shop.speaks("/words", "std_msgs/msg/String")
    words.publish({"data": "here"})
    await shop.becomes(ROBOT, "words", "here")
    await shop.until(lambda: shop.rule("words")["publishers"] == 1)
    await asyncio.sleep(1.5)  # the bridge looks round every second; there is nothing of it to be seen
    await words.close()
    await shop.until(stands, 25.0, "no Alert tells of the silence")
    assert "nobody speaks on /words any more" in (await alert())["description"]["value"]
    words = await shop.speaks("/words", "std_msgs/msg/String")
    await shop.until(is_over, 25.0, "the Alert is not cleared")
    await words.close()


async def test_switching_a_rule_off_ends_the_alerts_of_all_its_silent_robots(shop: Any) -> None:
    async def alert() -> dict[str, Any]:
        found = [one for one in await shop.broker.query(type="Alert") if "amr_9" in one["id"]]
        return found[0] if found else {}

    async def stands() -> bool:
        return bool(found := await alert()) and "validTo" not in found

    async def is_over() -> bool:
        return "validTo" in await alert()

    charge = await shop.speaks("/amr_9/charge", "std_msgs/msg/Float64")
    await shop.until(lambda: shop.rule("charges")["publishers"] == 1)
    await asyncio.sleep(1.5)  # the bridge looks round every second; there is nothing of it to be seen
    await charge.close()
    await shop.until(stands, 25.0, "no Alert tells of the silence")
    assert shop.post("/rules/charges/disable").is_success
    await shop.until(is_over, 25.0, "the Alert is not cleared")
    assert shop.post("/rules/charges/enable").is_success


async def test_a_peer_with_another_definition_is_named(shop: Any, tmp_path: Path) -> None:
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
        level = await shop.speaks("/level", "std_msgs/msg/Float64")
        level.publish({"data": 6.5})
        await shop.becomes(ROBOT, "level", 6.5)
    finally:
        await other.close()


async def test_what_the_broker_refuses_is_named_and_the_rule_goes_on(shop: Any) -> None:
    done = await shop.speaks("/done", "std_msgs/msg/String")
    done.publish({"data": "nobody-knows-it"})
    await shop.until(lambda: shop.rule("task")["faults"] == 1)
    assert "urn:ngsi-ld:Task:demo:nobody-knows-it" in shop.rule("task")["lastError"]
    done.publish({"data": ""})
    await shop.until(lambda: shop.rule("task")["faults"] == 2)
    assert "data is empty" in shop.rule("task")["lastError"]


async def test_a_bound_exceeded_is_named(shop: Any) -> None:
    _, heard = await shop.listens("/small", "std_msgs/msg/Int8")
    entity = {"id": "urn:ngsi-ld:Device:demo:r3", "type": "Device"}
    await shop.broker.upsert([{**entity, "number": prop(300)}])
    await shop.until(lambda: shop.rule("small")["faults"] == 1)
    assert "300 does not fit int8, which goes from -128 to 127" in shop.rule("small")["lastError"]
    await shop.broker.upsert([{**entity, "number": prop(100)}])
    await shop.until(lambda: heard == [{"data": 100}])


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


async def test_a_notification_moves_nothing_that_the_broker_does_not_say(shop: Any) -> None:
    told = shop.rule("small")["told"]
    (subscription,) = await shop.broker.subscriptions()
    endpoint = subscription["notification"]["endpoint"]
    uri, (pair,) = endpoint["uri"], endpoint["receiverInfo"]
    keyed = {pair["key"]: pair["value"]}
    for strange in STRANGE:
        assert httpx.post(uri, json=strange, headers=keyed).status_code in {204, 400}
    assert httpx.post(uri, json={"data": [FORGED]}).status_code == 403
    assert httpx.post(uri, json={"data": [FORGED]}, headers=keyed).status_code == 204
    other_rule = httpx.post(f"{uri}-that-is-none", json={"data": [FORGED]}, headers=keyed)
    assert other_rule.status_code == 404
    assert shop.rule("small")["told"] == told
    await shop.broker.upsert([FORGED])
    assert httpx.post(uri, json={"data": [FORGED]}, headers=keyed).status_code == 204
    assert shop.rule("small")["told"] > told
