"""Requests that write and read temporal evolutions, for tests."""

from typing import Any

import httpx

PAST = "/temporal/entities"


def at(minute: int) -> str:
    return f"2026-01-01T{minute // 60:02}:{minute % 60:02}:00Z"


def readings(values: list[Any], first: int = 0, **more: Any) -> list[dict[str, Any]]:
    return [
        {"type": "Property", "value": value, "observedAt": at(first + minute), **more}
        for minute, value in enumerate(values)
    ]


def a_car(http: httpx.Client, entity_id: str) -> str:
    """Create a car with a history only: five speeds, two headings of a second sensor."""
    body = {
        "id": entity_id,
        "type": "Car",
        "speed": readings([10, 20, 30, 40, 50]),
        "heading": [*readings([1, 2]), *readings([8, 9], datasetId="urn:x:gps")],
    }
    answer = http.post(PAST, json=body)
    assert answer.status_code == 201, answer.text
    assert answer.headers["location"] == f"/ngsi-ld/v1{PAST}/{entity_id}"
    return entity_id


def read_evolution(http: httpx.Client, entity_id: str, **parameters: Any) -> dict[str, Any]:
    answer = http.get(f"{PAST}/{entity_id}", params=parameters)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def values(change_data: dict[str, Any], name: str = "speed") -> list[Any]:
    return [one["value"] for one in change_data.get(name, [])]


def fault(answer: httpx.Response) -> tuple[int, str]:
    return answer.status_code, answer.json()["type"].rpartition("/")[2]
