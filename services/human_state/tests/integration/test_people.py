"""Without consent nothing is processed or stored; with it, what was allowed, and until it ends."""

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.broker import BrokerClient
from services.human_state.tests.integration.conftest import HEART_RATE, Running, add_person, consent
from tests.kit.cell import Cell
from tests.kit.waiting import until


async def heart_rate(rest: httpx.AsyncClient, name: str = "aino") -> dict[str, Any] | None:
    answer = (await rest.get(f"/people/{name}/state")).raise_for_status().json()
    found: list[dict[str, Any]] = [one for one in answer["values"] if one["name"] == "heartRate"]
    return found[0] if found and found[0]["status"] == "valid" else None


async def stored(rest: httpx.AsyncClient, name: str = "aino") -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = (
        (await rest.get(f"/people/{name}/history/heartRate")).raise_for_status().json()
    )
    return found


@pytest.mark.nightly
async def test_a_person_is_sensed_with_consent_and_forgotten_without(
    running: Running, shared_cell: Cell
) -> None:
    async with running() as rest, BrokerClient(shared_cell.settings) as broker:
        (await rest.put("/people/aino", json={"age": 40})).raise_for_status()
        sensor = {"person": "aino", "driver": "simulated", "settings": HEART_RATE}
        made = (await rest.put("/sensors/strap-aino", json=sensor)).raise_for_status().json()
        assert not made["isMonitored"]
        assert (await rest.get("/people/aino/state")).status_code == 409
        (await rest.put("/people/aino/consent", json=consent())).raise_for_status()
        value = await until(lambda: heart_rate(rest))
        assert value is not None
        assert 40 < value["value"] < 110
        assert value["ageS"] < 4
        pseudonym = made["pseudonym"]
        identifier = f"urn:ngsi-ld:HumanState:demo:{pseudonym}"

        async def entity() -> dict[str, Any] | None:
            found = await broker.query(type="HumanState", id=identifier)
            return found[0] if found and "heartRate" in found[0] else None

        async def with_heart_rate() -> dict[str, Any] | None:
            found = await entity()
            return found if found is not None and "heartRate" in found else None

        published = await until(with_heart_rate)
        assert published is not None
        assert published["refPerson"]["object"] == "urn:ngsi-ld:Person:demo:aino"
        assert "aino" not in identifier
        rates = published["heartRate"]
        assert {one.get("datasetId") for one in rates} == {None, "urn:ngsi-ld:Dataset:strap-aino"}
        assert rates[0]["unitCode"] == "BPM"
        await until(lambda: stored(rest))

        withdrawn = await rest.delete("/people/aino/consent", params={"delete": "true"})
        assert withdrawn.json()["purposes"] == []
        assert (await rest.get("/people/aino/state")).status_code == 409
        assert await stored(rest) == []

        async def is_gone() -> bool:
            evolution = await broker.evolution("2020-01-01T00:00:00Z", type="HumanState", id=identifier)
            return await entity() is None and not evolution

        await until(is_gone)


@pytest.mark.nightly
async def test_only_what_was_allowed_is_stored_and_published(running: Running, shared_cell: Cell) -> None:
    async with running() as rest, BrokerClient(shared_cell.settings) as broker:
        made = await add_person(rest, "eero", "live")
        await until(lambda: heart_rate(rest, "eero"))
        await add_person(rest, "aino")
        await until(lambda: stored(rest, "aino"))
        assert await stored(rest, "eero") == []
        published = {one["id"] for one in await broker.query(type="HumanState")}
        assert not any(made["pseudonym"] in one for one in published)
        refused = await rest.put("/people/eero/robots/ur10-1")
        assert refused.status_code == 409
        assert refused.json()["detailCode"] == "health.no_limit_consent"


@pytest.mark.nightly
async def test_a_consent_ends_by_itself_and_has_an_end(running: Running) -> None:
    async with running() as rest:
        await add_person(rest, "aino", "live")
        ending = consent("live") | {"ends": (datetime.now(UTC) + timedelta(seconds=2)).isoformat()}
        (await rest.put("/people/aino/consent", json=ending)).raise_for_status()

        async def has_ended() -> bool:
            return not (await rest.get("/people/aino")).json()["isMonitored"]

        await until(has_ended)
        for hours in (-1.0, 24.0 * 400):
            assert (await rest.put("/people/aino/consent", json=consent(hours=hours))).status_code == 422
        only = await rest.put("/people/aino/consent", json=consent("broker"))
        assert only.json()["detailCode"] == "health.live_required"


@pytest.mark.nightly
async def test_a_restart_keeps_persons_and_continues(running: Running) -> None:
    async with running() as rest:
        made = await add_person(rest)
    async with running() as rest:
        await until(lambda: heart_rate(rest))
        again = (await rest.get("/people/aino")).json()
        assert again["pseudonym"] == made["pseudonym"]
        assert (await rest.delete("/people/aino")).status_code == 204
        assert (await rest.get("/people")).json() == []
    async with running() as rest:
        assert (await rest.get("/people/aino")).status_code == 404


@pytest.mark.nightly
async def test_who_looked_and_changed_is_recorded(running: Running) -> None:
    async with running() as rest:
        await add_person(rest)
        await until(lambda: heart_rate(rest))
        records = (await rest.get("/audit", params={"limit": 100})).raise_for_status().json()
        actions = {one["action"] for one in records}
        assert {
            "PUT /people/{person}",
            "PUT /people/{person}/consent",
            "PUT /sensors/{sensor}",
            "GET /people/{person}/state",
        } <= actions


async def test_bad_input_is_named(running: Running, tmp_path: Path) -> None:
    async with running() as rest:
        assert (await rest.get("/people/nobody")).json()["detailCode"] == "health.unknown_person"
        assert (await rest.delete("/sensors/none")).json()["detailCode"] == "health.unknown_sensor"
        both = await rest.put("/people/aino", json={"restBpm": 60})
        assert "restBpm and maximumBpm" in both.json()["detail"]
        near = await rest.put("/people/aino", json={"restBpm": 100, "maximumBpm": 110})
        assert "measure again" in near.json()["detail"]
        await add_person(rest)
        unknown = await rest.put("/sensors/x", json={"person": "aino", "driver": "telepathy"})
        assert (unknown.status_code, "telepathy" in unknown.text) == (422, True)
        bad = await rest.put(
            "/sensors/x", json={"person": "aino", "driver": "simulated", "settings": {"speed": 1}}
        )
        assert "speed" in bad.json()["detail"]
        rest_needed = await rest.post("/people/aino/baseline/rest", json={})
        assert "sit still" in rest_needed.json()["detail"]
        file = tmp_path / "slow.csv"
        file.write_text("time [s],ecg [mV],eda [Ohm]\n" + "".join(f"{at / 11},1,1\n" for at in range(99)))
        replayed = {"person": "aino", "driver": "recording", "settings": {"path": str(file), "loop": True}}
        (await rest.put("/sensors/file-aino", json=replayed)).raise_for_status()

        async def left_out() -> dict[str, str] | None:
            sensors = (await rest.get("/people/aino")).json()["sensors"]
            listed = next(one["leftOut"] for one in sensors if one["name"] == "file-aino")
            codes = {one["name"]: one["reasonCode"] for one in listed}
            return codes if len(codes) > 1 else None

        assert await until(left_out) == {
            "eda": "health.channel.unit_unknown",
            "ecg (recorded, ecg)": "health.signal.not_analysed",
        }


@pytest.mark.nightly
async def test_a_sensor_of_another_person_moves_with_nothing_of_its_values(running: Running) -> None:
    async with running() as rest:
        await add_person(rest, "aino")
        await until(lambda: heart_rate(rest, "aino"))
        await add_person(rest, "eero", "live")
        moved = {"person": "eero", "driver": "simulated", "settings": HEART_RATE}
        (await rest.put("/sensors/strap-aino", json=moved)).raise_for_status()
        assert (await rest.get("/people/aino")).json()["sensors"] == []
        assert await heart_rate(rest, "aino") is None


async def test_the_secrets_of_a_sensor_are_never_shown(running: Running) -> None:
    settings = {
        "base_url": "https://vendor.example",
        "token_url": "https://vendor.example/token",
        "client_id": "us",
        "client_secret": "most-secret",
        "device_id": "patch-1",
    }
    sensor = {"person": "aino", "driver": "vivalink", "settings": settings}
    async with running() as rest:
        (await rest.put("/people/aino", json={"age": 40})).raise_for_status()
        made = (await rest.put("/sensors/patch-aino", json=sensor)).raise_for_status()
        assert "most-secret" not in made.text
        shown = made.json()["sensors"][0]["settings"]
        assert shown["client_secret"] == "*" * 10
        changed = {**sensor, "settings": {**shown, "client_id": "clinic"}}
        (await rest.put("/sensors/patch-aino", json=changed)).raise_for_status()
        answer = await rest.get("/people/aino")
        assert "most-secret" not in answer.text
        assert answer.json()["sensors"][0]["settings"]["client_id"] == "clinic"
