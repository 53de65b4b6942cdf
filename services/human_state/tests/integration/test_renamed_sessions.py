"""A broker with sessions of an earlier version has the present names after the start of the service."""

from typing import Any

import httpx
import pytest

from handover.broker import BrokerClient
from handover_body.recording import session_entities
from handover_body.recording.session_entities import rename_attributes
from services.human_state.tests.integration.conftest import Running
from tests.kit.cell import Cell
from tests.kit.waiting import until

TYPE = "PhysiologicalSession"
VOCABULARY = "https://uri.etsi.org/ngsi-ld/default-context/"
OLD = [f"{VOCABULARY}start", f"{VOCABULARY}end"]
ENDED, RUNS, HALF_RENAMED, PRESENT = (f"urn:ngsi-ld:{TYPE}:other:{each}" for each in "abcd")


def date_time(day: int) -> dict[str, Any]:
    return {"type": "Property", "value": {"@type": "DateTime", "@value": f"2026-03-0{day}T09:00:00Z"}}


def person(name: str) -> dict[str, Any]:
    return {"type": "Relationship", "object": f"urn:ngsi-ld:Person:other:{name}"}


SESSIONS: list[dict[str, Any]] = [
    {"id": ENDED, "refPerson": person("a"), OLD[0]: date_time(1), OLD[1]: date_time(2)},
    {"id": RUNS, "refPerson": person("b"), OLD[0]: date_time(3)},
    {"id": HALF_RENAMED, "startedAt": date_time(4), OLD[0]: date_time(4), OLD[1]: date_time(5)},
    {"id": PRESENT, "startedAt": date_time(6)},
]
EXPECTED: dict[str, dict[str, Any]] = {
    ENDED: {"refPerson": person("a"), "startedAt": date_time(1), "endedAt": date_time(2)},
    RUNS: {"refPerson": person("b"), "startedAt": date_time(3)},
    HALF_RENAMED: {"startedAt": date_time(4), "endedAt": date_time(5)},
    PRESENT: {"startedAt": date_time(6)},
}


async def attributes(broker: BrokerClient) -> dict[str, dict[str, Any]]:
    return {
        entity["id"]: {name: value for name, value in entity.items() if name not in {"id", "type"}}
        for entity in await broker.query(type=TYPE, id_pattern=f"^urn:ngsi-ld:{TYPE}:other:")
    }


async def test_sessions_are_renamed_once_at_the_start(
    running: Running, shared_cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    logged: list[dict[str, Any]] = []
    monkeypatch.setattr(session_entities.log, "info", lambda event, **said: logged.append(said))
    shared_cell.run("context_broker")
    async with BrokerClient(shared_cell.settings) as broker:
        await broker.upsert([{"type": TYPE, **session} for session in SESSIONS])
        try:
            async with running():

                async def is_renamed() -> bool:
                    return bool(logged) and await attributes(broker) == EXPECTED

                await until(is_renamed)
            (line,) = logged
            assert (line["type"], line["entities"]) == (TYPE, 3)
            assert line["names"] == "start to startedAt, end to endedAt"
            assert await broker.query(type=TYPE, attrs=OLD) == []

            await rename_attributes(broker)
            assert len(logged) == 1, "nothing is left to rename"
            assert await attributes(broker) == EXPECTED
        finally:
            await broker.delete_batch([session["id"] for session in SESSIONS])


@pytest.mark.parametrize("answered_as", ["start", f"{VOCABULARY}start", "ngsi-ld:default-context/start"])
async def test_any_broker_is_asked_by_the_iri(shared_cell: Cell, answered_as: str) -> None:
    """A broker may answer with the short name, the IRI or a prefix; the IRI is what it is asked for."""
    requests: list[tuple[str, str, bytes]] = []

    def answer(request: httpx.Request) -> httpx.Response:
        requests.append((request.method, request.url.raw_path.decode(), request.content))
        if request.method == "GET":
            return httpx.Response(200, json=[{"id": RUNS, "type": TYPE, answered_as: date_time(3)}])
        return httpx.Response(204)

    async with BrokerClient(shared_cell.settings, transport=httpx.MockTransport(answer)) as broker:
        await rename_attributes(broker)
    (_, asked, _), (posted, to, body), (deleted, path, _) = requests
    assert "https:%2F%2Furi.etsi.org%2Fngsi-ld%2Fdefault-context%2Fstart" in asked
    assert (posted, to) == ("POST", f"/ngsi-ld/v1/entities/{RUNS}/attrs")
    assert b'"startedAt"' in body
    iri = "https%3A%2F%2Furi.etsi.org%2Fngsi-ld%2Fdefault-context%2Fstart"
    assert (deleted, path) == ("DELETE", f"/ngsi-ld/v1/entities/{RUNS}/attrs/{iri}")


async def test_what_a_broker_refuses_stays_and_does_not_stop_the_others(
    shared_cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    warned: list[dict[str, Any]] = []
    monkeypatch.setattr(session_entities.log, "warning", lambda event, **said: warned.append(said))
    deleted: list[str] = []

    def answer(request: httpx.Request) -> httpx.Response:
        if request.method == "GET":
            found = [{"id": each, "type": TYPE, OLD[0]: date_time(3)} for each in (ENDED, RUNS)]
            return httpx.Response(200, json=found)
        if request.method == "DELETE":
            if ENDED in request.url.path:
                return httpx.Response(400, json={"type": "about:blank", "title": "Bad request"})
            deleted.append(request.url.path)
        return httpx.Response(204)

    async with BrokerClient(shared_cell.settings, transport=httpx.MockTransport(answer)) as broker:
        await rename_attributes(broker)
    assert [each["entity"] for each in warned] == [ENDED]
    assert [RUNS in path for path in deleted] == [True]
