"""The entities of devices reach a real broker in batches, with each device as it was changed last."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import orjson

from handover.broker import BrokerClient
from handover.broker.latest_value_writer import LatestValueWriter
from handover_devices.model.description import DeviceDescription
from handover_devices.registry.device import Device
from handover_devices.registry.entities import device_id, specification_id
from handover_devices.settings import GatewaySettings
from handover_devices.storage.device_store import StoredDevice
from handover_devices.upkeep import MAX_BATCH_DEVICES, RegistryEntities
from services.device_gateway.tests.integration.conftest import broker_in_process
from tests.kit.waiting import scaled, until

UPSERT = "/entityOperations/upsert"
Fault = Callable[[httpx.Request], httpx.Response | None]


def pass_on(_: httpx.Request) -> None:
    """Let the broker answer."""


class FaultyLink(httpx.AsyncBaseTransport):
    """The way to a real broker; `fault` answers or raises in the place of it."""

    def __init__(self, broker: Any) -> None:
        self.fault: Fault = pass_on
        self.batches: list[int] = []
        """The number of entities in each upsert that the broker received."""
        self._transport = httpx.ASGITransport(broker)

    async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
        answer = self.fault(request)
        if answer is not None:
            return answer
        if request.url.path.endswith(UPSERT):
            self.batches.append(len(orjson.loads(request.content)))
        return await self._transport.handle_async_request(request)


class Registry:
    """The entities of a gateway, and what the broker has of them."""

    def __init__(self, folder: Path, broker: Any, writer: LatestValueWriter) -> None:
        self.settings = GatewaySettings.load(data_dir=folder)
        self.link = FaultyLink(broker)
        self.client = BrokerClient(self.settings, transport=self.link)
        self.entities = RegistryEntities(self.settings, self.client, writer)

    def write(self, name: str, **members: Any) -> None:
        description = DeviceDescription.model_validate({"kind": "sensor", **members})
        self.entities.write(Device(StoredDevice(name, description, None, 0, 0)))

    async def has(self, **titles: str) -> bool:
        """Return whether the broker has both entities of exactly these devices, with these titles."""
        devices = {one["id"] for one in await self.client.query(type="Device")}
        found = await self.client.query(type="ResourceSpecification")
        return devices == {device_id(self.settings, name) for name in titles} and {
            one["id"]: one["name"]["value"] for one in found
        } == {specification_id(self.settings, name): title for name, title in titles.items()}


@asynccontextmanager
async def registry(folder: Path) -> AsyncIterator[Registry]:
    async with broker_in_process(folder) as broker, LatestValueWriter() as writer:
        yield Registry(folder, broker, writer)


async def test_many_devices_are_written_in_few_requests_of_bounded_size(tmp_path: Path) -> None:
    names = [f"d-{number}" for number in range(2 * MAX_BATCH_DEVICES + 20)]
    async with registry(tmp_path) as gateway:
        for name in names:
            gateway.write(name, title=f"first {name}")
            gateway.write(name, title=f"second {name}")
        await until(lambda: gateway.has(**{name: f"second {name}" for name in names}))
        assert gateway.link.batches == [2 * MAX_BATCH_DEVICES, 2 * MAX_BATCH_DEVICES, 40]
        for name in names:
            gateway.entities.delete(name)
        await until(gateway.has)


async def test_what_changes_while_the_broker_is_away_is_written_as_it_is_last(tmp_path: Path) -> None:
    async with registry(tmp_path) as gateway:
        attempted = asyncio.Event()

        def away(request: httpx.Request) -> None:
            attempted.set()
            raise httpx.ConnectError("connection refused", request=request)

        gateway.write("kept", title="one")
        gateway.write("changed", title="one")
        gateway.write("deleted", title="one")
        await until(lambda: gateway.has(kept="one", changed="one", deleted="one"))
        gateway.link.fault = away
        gateway.write("changed", title="two")
        gateway.write("added", title="one")
        await asyncio.wait_for(attempted.wait(), scaled(30))
        gateway.write("changed", title="three")
        gateway.entities.delete("deleted")
        gateway.link.fault = pass_on
        await until(lambda: gateway.has(kept="one", changed="three", added="one"))


async def test_a_batch_that_the_broker_refuses_is_written_entity_by_entity(tmp_path: Path) -> None:
    async with registry(tmp_path) as gateway:

        def small_only(request: httpx.Request) -> httpx.Response | None:
            """A proxy before the broker, with a small limit; it refuses one entity even alone."""
            if not request.url.path.endswith(UPSERT):
                return None
            entities = orjson.loads(request.content)
            is_small = len(entities) == 1 and "x" * 80 not in request.content.decode()
            return None if is_small else httpx.Response(413, json={"title": "Payload too large"})

        gateway.link.fault = small_only
        for name, title in (("a", "one"), ("large", "x" * 80), ("b", "two")):
            gateway.write(name, title=title)

        async def is_written() -> bool:
            found = await gateway.client.query(type="ResourceSpecification")
            return {one["name"]["value"] for one in found} == {"one", "two"}

        await until(is_written)
