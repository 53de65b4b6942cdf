"""The values of registered devices reach open pages, and are stale when the gateway does not answer."""

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import orjson
import pytest
from pydantic import TypeAdapter

from handover.broker import BrokerClient
from handover.database import connect
from handover.security.service_access import ServiceAccess
from handover_web.live.event_log import EventLog
from handover_web.live.live_state import LiveState, Viewer
from handover_web.live.viewers import Viewers
from handover_web.live.views import type_of_topic
from handover_web.settings import WebuiSettings
from handover_web.sources.broker_abilities import BrokerAbilities
from handover_web.sources.on_demand import SourceContext
from handover_web.sources.registered_devices import RegisteredDevices
from handover_web.sources.services import ServiceMonitor
from handover_web.sources.source import run_sources
from services.device_gateway.tests.integration.conftest import Bench
from tests.kit.waiting import until

pytestmark = pytest.mark.slow

TOPIC = "registeredDevice/urn:ngsi-ld:Device:demo:hall-20"


@asynccontextmanager
async def following(bench: Bench, folder: Path) -> AsyncIterator[tuple[LiveState, Viewers]]:
    """Follow the devices of the gateway as the page server does."""
    settings = WebuiSettings.load(gateway_url=bench.cell.url("device_gateway"), data_dir=folder)
    state, viewers = LiveState(), Viewers()
    async with httpx.AsyncClient(trust_env=False) as http, ServiceAccess(settings, "webui") as access:
        events = EventLog(connect(settings.database("webui")), state.publish_event)
        services = ServiceMonitor({}, http, BrokerAbilities(settings, BrokerClient(settings)), state, events)
        source = RegisteredDevices(SourceContext(settings, http, state, viewers, services, access))
        async with run_sources((source,)):
            yield state, viewers


async def open_page(state: LiveState, viewers: Viewers) -> Viewer:
    """Open a page that shows the devices."""
    viewer = state.add_viewer(lambda: None)
    await viewers.add(viewer)
    viewer.subscribe(["registeredDevices"])
    viewers.notify()
    return viewer


@pytest.mark.nightly
async def test_a_page_follows_the_devices_and_sees_when_their_values_are_old(
    new_bench: Callable[[], Bench], tmp_path: Path
) -> None:
    bench = new_bench()
    device = bench.connect("hall-20", bench.add("hall-20", placement={"location": "hall"}))
    device.ask(type="telemetry", values={"temperature": 21.5})
    async with following(bench, tmp_path) as (state, viewers):
        page = await open_page(state, viewers)

        def shown() -> dict[str, Any]:
            found: dict[str, Any] = state.value(TOPIC) or {}
            return found.get("values", {}).get("temperature", {})

        await until(lambda: shown().get("value") == 21.5)
        view = state.value(TOPIC)
        TypeAdapter(type_of_topic(TOPIC)).validate_json(orjson.dumps(view), strict=True)
        assert (view["location"], view["connected"], shown()["stale"]) == ("hall", True, False)
        assert [sensor["name"] for sensor in view["sensors"]] == ["temperature", "isOpen"]
        device.ask(type="telemetry", values={"temperature": 22})
        await until(lambda: shown().get("value") == 22)

        bench.cell.kill("device_gateway")
        await until(lambda: state.value("registeredDevices") == {"isCurrent": False})
        assert shown() == {**shown(), "value": 22.0, "stale": True}
        bench.cell.start("device_gateway")
        await until(lambda: state.value("registeredDevices") == {"isCurrent": True})

        new_bench().rest.delete("/devices/hall-20").raise_for_status()
        await until(lambda: state.value(TOPIC) is None)
        page.subscribe([])
        viewers.notify()
        await until(lambda: state.value("registeredDevices") is None)
        assert state.topics_of("registeredDevice") == []
