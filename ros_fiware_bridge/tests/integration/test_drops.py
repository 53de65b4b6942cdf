"""Dropped messages are counted by cause and raise Alerts; conflated messages do not."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from typing import Any

import httpx
import pytest

from handover_ros.graph.qos import History, Qos
from ros_fiware_bridge.tests.integration.conftest import Shop
from tests.kit.cell import new_cell
from tests.kit.ports import next_free_port
from tests.kit.ros_domains import ros_domain

pytestmark = pytest.mark.slow

MAPPING = """
ros_to_ngsild:
  every:
    {topic: /every, type: std_msgs/Int32, entity: Device:every, attributes: {n: data}, buffer: {keep: 1000}}
  few:
    topic: /few
    type: std_msgs/Int32
    entity: Device:few
    attributes: {n: data}
    qos: {depth: 1}
    buffer: {keep: 1000}
  slow: {topic: /slow, type: std_msgs/Int32, entity: Device:slow, attributes: {n: data}, buffer: {keep: 5}}
  newest: {topic: /slow, type: std_msgs/Int32, entity: Device:newest, attributes: {n: data}}
"""
ALL = Qos(history=History.KEEP_ALL)
DELAY_S = 0.25


class Slow:
    """A TCP proxy that delays every request of the bridge to the broker."""

    def __init__(self, target: int) -> None:
        self.port = next_free_port()
        self.delay_s = 0.0
        self._target = target

    @asynccontextmanager
    async def opened(self) -> AsyncIterator[None]:
        server = await asyncio.start_server(self._carry, "127.0.0.1", self.port)
        try:
            yield
        finally:
            server.close()

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there, back = await asyncio.open_connection("127.0.0.1", self._target)

        async def pump(source: asyncio.StreamReader, sink: asyncio.StreamWriter, slow: bool) -> None:
            try:
                while data := await source.read(65536):
                    if slow:
                        await asyncio.sleep(self.delay_s)
                    sink.write(data)
                    await sink.drain()
            except ConnectionError:
                pass
            finally:
                sink.close()

        await asyncio.gather(pump(reader, back, True), pump(there, writer, False))


@pytest.fixture(scope="module")
def at_work(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shop]:
    with new_cell(tmp_path_factory.mktemp("cell")) as cell:
        made = Shop(cell, ros_domain())
        cell.start("context_broker", within_s=90.0)
        yield made


@pytest.fixture
async def slow(shop: Shop) -> AsyncIterator[Slow]:
    """The proxy between the bridge and the broker."""
    network = Slow(shop.cell.ports["context_broker"])
    async with network.opened():
        await asyncio.to_thread(shop.begin, MAPPING, HANDOVER_BROKER_URL=f"http://127.0.0.1:{network.port}")
        yield network
        await asyncio.to_thread(shop.cell.kill, "ros_fiware_bridge")


async def alert(shop: Shop, key: str) -> str:
    found = [one for one in await shop.broker.query(type="Alert") if key in one["id"]]
    return str(found[0]["description"]["value"]) if found else ""


def metric(shop: Shop, name: str, rule: str, cause: str) -> float:
    text = httpx.get(f"{shop.cell.url('ros_fiware_bridge')}/metrics", timeout=120).text
    wanted = f'{name}{{cause="{cause}",rule="{rule}"}} '
    return sum(float(line.removeprefix(wanted)) for line in text.splitlines() if line.startswith(wanted))


async def rule_becomes(shop: Shop, rule: str, **wanted: Any) -> dict[str, Any]:
    def found() -> Any:
        seen = shop.rule(rule)
        return all(seen[name] == value for name, value in wanted.items()) and seen

    view: dict[str, Any] = await shop.until(lambda: asyncio.to_thread(found), 60.0, f"{rule}: {wanted}")
    return view


@pytest.mark.nightly
async def test_a_reader_has_the_depth_of_the_buffer(shop: Shop, slow: Slow) -> None:
    every = await shop.publisher("/every", "std_msgs/msg/Int32", ALL)
    for number in range(900):
        every.publish({"data": number})
    seen = await rule_becomes(shop, "every", forwarded=900)
    assert (seen["received"], seen["dropped"], seen["droppedByCause"]) == (900, 0, {})


@pytest.mark.nightly
async def test_a_reader_overflow_is_counted_and_raises_an_alert(shop: Shop, slow: Slow) -> None:
    few = await shop.publisher("/few", "std_msgs/msg/Int32", ALL)
    for number in range(200):
        few.publish({"data": number})

    def accounted() -> Any:
        seen = shop.rule("few")
        return seen["forwarded"] + seen["dropped"] == 200 and seen

    seen = await shop.until(lambda: asyncio.to_thread(accounted), 60.0)
    assert seen["droppedByCause"]["reader_overflow"] > 0
    assert seen["forwarded"] == seen["received"]
    assert metric(shop, "handover_bridge_messages_dropped_total", "few", "reader_overflow") == seen["dropped"]

    async def alerted() -> bool:
        return f"few: {seen['dropped']} messages came faster" in await alert(
            shop, "dropped-reader_overflow-few"
        )

    await shop.until(alerted, 60.0)


@pytest.mark.nightly
async def test_a_slow_broker_raises_an_alert_for_drops_and_none_for_conflation(
    shop: Shop, slow: Slow
) -> None:
    sent = 150
    publisher = await shop.publisher("/slow", "std_msgs/msg/Int32", ALL)
    await shop.until(lambda: shop.rule("slow")["publishers"] and shop.rule("newest")["publishers"], 60.0)
    slow.delay_s = DELAY_S
    for number in range(sent):
        publisher.publish({"data": number})
        await asyncio.sleep(0.01)

    def accounted() -> bool:
        slow, newest = shop.rule("slow"), shop.rule("newest")
        return bool(
            slow["forwarded"] + slow["dropped"] == sent and newest["forwarded"] + newest["conflated"] == sent
        )

    await shop.until(lambda: asyncio.to_thread(accounted), 60.0)
    dropped = shop.rule("slow")["droppedByCause"]
    assert set(dropped) <= {"broker_slow", "reader_overflow"}
    assert dropped["broker_slow"] > 0
    assert (
        metric(shop, "handover_bridge_messages_dropped_total", "slow", "broker_slow")
        == dropped["broker_slow"]
    )

    async def alerted() -> bool:
        return "because the broker accepts them too slowly" in await alert(shop, "dropped-broker_slow-slow")

    await shop.until(alerted, 60.0)
    assert shop.rule("newest")["droppedByCause"] == {}
    assert not await alert(shop, "newest")
    assert await shop.value("urn:ngsi-ld:Device:demo:newest", "n") == sent - 1


@pytest.mark.nightly
async def test_forwarded_counts_only_accepted_updates(shop: Shop, slow: Slow) -> None:
    every = await shop.publisher("/every", "std_msgs/msg/Int32", ALL)
    shop.cell.kill("context_broker")
    try:
        for number in range(20):
            every.publish({"data": number})
        await rule_becomes(shop, "every", received=20)
        assert shop.rule("every")["forwarded"] == 0
    finally:
        await asyncio.to_thread(shop.cell.start, "context_broker", within_s=90.0)
    await rule_becomes(shop, "every", forwarded=20, dropped=0)
