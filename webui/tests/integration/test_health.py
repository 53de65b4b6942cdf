"""The live signals of a person through the page server, with human state behind it."""

import asyncio
from collections.abc import AsyncIterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import orjson
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from handover.http.origin_guard import OriginGuard, OriginPolicy
from handover_body.app import make_app as make_human_state
from handover_body.settings import HumanStateSettings
from handover_web.app import make_app
from handover_web.settings import WebuiSettings
from tests.kit.asgi_server import served
from tests.kit.ports import next_free_port


@pytest.fixture
async def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[WebuiSettings]:
    """The settings of a page server that runs."""
    monkeypatch.chdir(tmp_path)
    given = {
        "data_dir": tmp_path,
        "broker_url": f"http://127.0.0.1:{next_free_port()}",
        "webui_port": next_free_port(),
        "human_state_port": next_free_port(),
    }
    settings = WebuiSettings.load(**given)
    async with served(
        OriginGuard(make_app(settings), OriginPolicy.of(settings)),
        settings.webui_port,
    ):
        yield settings


@pytest.mark.nightly
async def test_a_page_gets_the_live_signals_of_a_person_who_consents(settings: WebuiSettings) -> None:
    page = f"127.0.0.1:{settings.webui_port}/api/human-state"
    live = f"ws://{page}/people/aino/live"
    async with connect(live, proxy=None) as socket:
        with pytest.raises(ConnectionClosed) as closed:
            await socket.recv()
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 4502
    body = {"data_dir": settings.data_dir, "broker_url": settings.broker_url}
    body_settings = HumanStateSettings.load(**body, human_state_port=settings.human_state_port)
    async with (
        served(make_human_state(body_settings), settings.human_state_port),
        httpx.AsyncClient(base_url=f"http://{page}", trust_env=False, timeout=120) as rest,
        connect(live, proxy=None) as socket,
        asyncio.timeout(120),
    ):
        assert orjson.loads(await socket.recv()) == {"state": None}
        ends = (datetime.now(UTC) + timedelta(hours=1)).isoformat()
        consent = {"purposes": ["live"], "ends": ends, "givenBy": "Aino"}
        sensor = {"person": "aino", "driver": "simulated", "settings": {"signals": ["heartRate", "ecg"]}}
        (await rest.put("/people/aino", json={"age": 40})).raise_for_status()
        (await rest.put("/people/aino/consent", json=consent)).raise_for_status()
        (await rest.put("/sensors/strap-1", json=sensor)).raise_for_status()
        waits_for = {"signals", "heartRate"}
        while waits_for:
            message = orjson.loads(await socket.recv())
            if any(one["kind"] == "ecg" for one in message.get("signals", ())):
                waits_for.discard("signals")
            if any(value["name"] == "heartRate" for value in (message.get("state") or {}).get("values", ())):
                waits_for.discard("heartRate")
        (await rest.delete("/people/aino/consent")).raise_for_status()
        while orjson.loads(await socket.recv()) != {"state": None}:
            pass
