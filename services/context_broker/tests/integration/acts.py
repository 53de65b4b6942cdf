"""Requests of many tests: subscribe, create, change. A failure has the response of the broker."""

from collections.abc import Callable
from typing import Any

import httpx

Eventually = Callable[..., Any]
"""Waits until a function returns something, and returns it."""


def subscribe(http: httpx.Client, name: str, url: str, **members: Any) -> str:
    notification = members.pop("notification", {})
    endpoint = {"uri": url, **notification.pop("endpoint", {})}
    answer = http.post(
        "/subscriptions",
        json={
            "id": f"urn:ngsi-ld:Subscription:demo:{name}",
            "type": "Subscription",
            "entities": [{"type": name}],
            "notification": {**notification, "endpoint": endpoint},
            **members,
        },
    )
    assert answer.status_code == 201, answer.text
    return f"urn:ngsi-ld:Subscription:demo:{name}"


def create(http: httpx.Client, kind: str, name: str = "1", **attributes: Any) -> str:
    entity_id = f"urn:ngsi-ld:{kind}:demo:{name}"
    answer = http.post("/entities", json={"id": entity_id, "type": kind, **attributes})
    assert answer.status_code == 201, answer.text
    return entity_id


def patch(http: httpx.Client, entity_id: str, **attributes: Any) -> None:
    answer = http.patch(f"/entities/{entity_id}/attrs", json=attributes)
    assert answer.status_code == 204, answer.text
