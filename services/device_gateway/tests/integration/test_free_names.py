"""Many devices that are registered at once take few requests to the broker."""

import asyncio
from pathlib import Path

import httpx
import pytest

from handover.broker import BrokerClient, BrokerUnavailable
from handover.errors import Problem
from handover.settings import Settings
from handover_devices.registry.free_names import FreeNames
from services.device_gateway.tests.integration.conftest import broker_in_process


def device(number: int) -> str:
    return f"urn:ngsi-ld:Device:demo:d{number}"


async def test_names_are_asked_for_together_and_a_taken_one_is_refused(tmp_path: Path) -> None:
    asked: list[str] = []
    async with broker_in_process(tmp_path) as broker:

        class Counting(httpx.ASGITransport):
            async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
                asked.append(f"{request.method} {request.url}")
                return await super().handle_async_request(request)

        async with BrokerClient(Settings.load(), transport=Counting(broker)) as client:
            taken = {"id": device(7), "type": "Device", "controlledProperty": _property(["x"])}
            await client.upsert_batch([{**taken, "performer": _property("trajectory-tool")}])
            asked.clear()
            names = FreeNames(client)
            answers = await asyncio.gather(
                *(names.require_free(device(number)) for number in range(120)), return_exceptions=True
            )
            assert len(asked) <= 4
    refused = [number for number, answer in enumerate(answers) if answer is not None]
    assert refused == [7]
    assert isinstance(answers[7], Problem)
    assert "trajectory-tool" in answers[7].detail
    async with BrokerClient(Settings.load(broker_url="http://127.0.0.1:1")) as away:
        with pytest.raises(BrokerUnavailable):
            await FreeNames(away).require_free(device(1))


def _property(value: object) -> dict[str, object]:
    return {"type": "Property", "value": value}
