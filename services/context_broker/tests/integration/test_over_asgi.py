"""The broker over ASGI (`HANDOVER_BROKER_HTTP=asgi`) answers as it does with its own protocol."""

from typing import Any

import httpx
import pytest

from services.context_broker.tests.integration.acts import create, patch, subscribe

ENTITY = "urn:ngsi-ld:Lamp:demo:1"


@pytest.mark.nightly
@pytest.mark.parametrize("http", ["asgi", "direct"])
def test_requests_are_answered_alike_on_both_ways(
    own_broker: Any, subscriber: Any, eventually: Any, http: str
) -> None:
    own_broker.extra["HANDOVER_BROKER_HTTP"] = http
    own_broker.start()
    with own_broker.client() as client:
        subscribe(client, "Lamp", subscriber.url)
        create(client, "Lamp", state={"type": "Property", "value": "off"})
        patch(client, ENTITY, state={"type": "Property", "value": "on"})
        eventually(lambda: any(one["state"]["value"] == "on" for one in subscriber.entities()))
        found = client.get(f"/entities/{ENTITY}")
        assert (found.status_code, found.json()["state"]["value"]) == (200, "on")
        assert client.head(f"/entities/{ENTITY}").headers["content-length"] == found.headers["content-length"]
        missing = client.get("/entities/urn:ngsi-ld:Lamp:2")
        assert (missing.status_code, missing.headers["content-type"]) == (404, "application/json")
        assert (
            client.post("/entities", content=b"{", headers={"Content-Type": "application/json"}).status_code
            == 400
        )
        long = {
            "id": "urn:ngsi-ld:Lamp:3",
            "type": "Lamp",
            "text": {"type": "Property", "value": "x" * 500_000},
        }
        assert client.post("/entities", json=long).status_code == 201
        assert client.get("/entities/urn:ngsi-ld:Lamp:3").json()["text"]["value"] == "x" * 500_000
        foreign = client.get("/types", headers={"Origin": "https://elsewhere.example"})
        assert foreign.status_code == 403
    assert httpx.get(f"{own_broker.url}/readyz", trust_env=False, timeout=120).is_success
