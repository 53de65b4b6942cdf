"""Alerts on the page: they stand, somebody says that they know, they are over."""

from collections.abc import Callable
from typing import Any

import httpx
import pytest

from handover.alerts import alert_id, clear_alert, raise_alert
from handover.broker import BrokerClient
from handover.settings import Settings

pytestmark = pytest.mark.slow

GLOVE = "urn:ngsi-ld:Device:demo:glove-1"


async def test_an_alert_is_acknowledged_once_and_it_is_known_by_whom(
    cell: Any, look: Callable[[], Any], browser: httpx.Client
) -> None:
    cell.start("context_broker", "webui")
    viewer = look()
    settings = Settings.load(broker_url=cell.url("context_broker"))
    about = {
        "key": "glove-1 silent",
        "source": GLOVE,
        "category": "device",
        "description": "glove-1 is silent",
    }
    urn = alert_id(settings, "glove-1 silent")
    topic = f"alert/{urn}"
    async with BrokerClient(settings) as broker:
        await raise_alert(broker, settings, **about)
        viewer.read_until(lambda: topic in viewer.topics)
        assert viewer.topics[topic]["acknowledged"] is None
        assert viewer.topics[topic]["severity"] == "high"
        assert viewer.topics[topic]["source"] == GLOVE

        done = browser.post(f"/api/alerts/{urn}/acknowledge", json={"by": " Aino "})
        assert done.status_code == 200
        viewer.read_until(lambda: viewer.topics[topic]["acknowledged"])
        assert viewer.topics[topic]["acknowledged"]["by"] == "Aino"
        written = (await broker.retrieve(urn))["humanVerified"]
        assert written["value"] is True
        assert written["by"]["value"] == "Aino"
        assert written["observedAt"]

        twice = browser.post(f"/api/alerts/{urn}/acknowledge", json={"by": "Ville"})
        assert twice.status_code == 409
        assert "Aino" in twice.json()["detail"]
        unknown = browser.post(f"/api/alerts/{urn}-none/acknowledge", json={"by": "Ville"})
        assert unknown.status_code == 404
        assert browser.post(f"/api/alerts/{urn}/acknowledge", json={"by": " "}).status_code == 422

        await clear_alert(broker, settings, key="glove-1 silent")
        viewer.read_until(lambda: viewer.topics[topic]["validTo"])
        await raise_alert(broker, settings, **about)
        viewer.read_until(lambda: viewer.topics[topic]["validTo"] is None)
        assert viewer.topics[topic]["acknowledged"] is None
        moves = ["alert.raised", "alert.acknowledged", "alert.over", "alert.raised"]
        viewer.read_until(lambda: len(viewer.happened("alert.")) == len(moves))
        assert viewer.happened("alert.") == moves

        await broker.delete(urn)
        viewer.read_until(lambda: topic not in viewer.topics)

    cell.kill("context_broker")
    away = browser.post(f"/api/alerts/{urn}/acknowledge", json={"by": "Ville"})
    assert away.status_code == 503
