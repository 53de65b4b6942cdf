"""Recordings: only with consent and key, encrypted, closed after a crash, and deleted."""

import base64
import hashlib
import io
import os
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.broker import BrokerClient
from handover.database import connect
from handover.subscriptions.notifications import KEY_HEADER
from handover_body.exchange.mcap import read_stream
from handover_body.formats.json_messages import Marker
from handover_body.model.features import Feature, FeatureName
from handover_body.model.signals import Samples, SignalKind
from handover_body.recording.archive import JOURNAL, SUFFIX
from handover_body.settings import HumanStateSettings
from handover_body.storage.store import RecordingRow, Store
from services.human_state.tests.integration.conftest import Running, add_person, consent
from tests.kit.cell import Cell
from tests.kit.waiting import until

pyxdf = pytest.importorskip("pyxdf", reason="the extra [human-state] is not installed")
pytest.importorskip("mcap", reason="the extra [human-state] is not installed")

KEY = base64.b64encode(os.urandom(32)).decode()
AINO = "/people/aino/recordings"
ALLOWED = ("live", "history", "broker", "recording")


async def start(rest: httpx.AsyncClient, label: str = "lift") -> dict[str, Any]:
    answer = await rest.post(AINO, json={"label": label, "startedBy": "Eero"})
    assert answer.status_code == 201, answer.text
    made: dict[str, Any] = answer.json()
    return made


async def one(rest: httpx.AsyncClient, identifier: str) -> dict[str, Any]:
    found: list[dict[str, Any]] = (await rest.get(AINO)).raise_for_status().json()
    return next(each for each in found if each["id"] == identifier)


async def ended(rest: httpx.AsyncClient, identifier: str) -> dict[str, Any] | None:
    found = await one(rest, identifier)
    return found if found["state"] == "ended" else None


async def has_heart_rate(rest: httpx.AsyncClient) -> bool:
    values = (await rest.get("/people/aino/state")).raise_for_status().json()["values"]
    return any(each["name"] == "heartRate" for each in values)


async def notify_of_tasks(rest: httpx.AsyncClient, broker: BrokerClient, folder: Path) -> None:
    """Change a Task of the person who is recorded, and one of another; notify twice, as brokers may."""
    subscription = "urn:ngsi-ld:Subscription:demo:human-state-tasks"

    async def is_subscribed() -> bool:
        return subscription in {each["id"] for each in await broker.subscriptions()}

    await until(is_subscribed)
    tasks = [
        {
            "id": f"urn:ngsi-ld:Task:demo:of-{person}",
            "type": "Task",
            "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:lift"},
            "status": {"type": "Property", "value": "completed"},
            "outputParameters": {"type": "Property", "value": {"by": "gesture", "gesture": "Thumbs up"}},
            "name": {"type": "Property", "value": "Lift"},
            "involves": {"type": "Relationship", "object": f"urn:ngsi-ld:Person:demo:{person}"},
        }
        for person in ("aino", "eero")
    ]
    await broker.upsert(tasks)
    headers = {KEY_HEADER: (folder / "human-state.notification-key").read_text()}
    for _ in range(2):
        answer = await rest.post("/notifications", json={"data": tasks}, headers=headers)
        assert answer.status_code == 204, answer.text
    assert (await rest.post("/notifications", json={"data": tasks})).status_code == 403


def assert_digest(answer: httpx.Response) -> None:
    """Check that an answer names the SHA-256 of its content (RFC 9530)."""
    digest = base64.b64encode(hashlib.sha256(answer.content).digest()).decode()
    assert answer.headers["repr-digest"] == f"sha-256=:{digest}:"


@pytest.mark.nightly
async def test_a_session_is_recorded_marked_downloaded_exported_and_deleted(
    running: Running, shared_cell: Cell, tmp_path: Path
) -> None:
    async with (
        running(health_recording_key=KEY, human_state_port=shared_cell.ports["human_state"]) as rest,
        BrokerClient(shared_cell.settings) as broker,
    ):
        person = await add_person(rest, "aino", *ALLOWED)
        made = await start(rest)
        assert made["state"] == "running"
        assert (await rest.get("/people/aino")).json()["recording"] == made["id"]
        again = await rest.post(AINO, json={"startedBy": "Eero"})
        assert again.json()["detailCode"] == "health.already_recording"
        this = f"{AINO}/{made['id']}"
        assert (await rest.get(f"{this}/file")).json()["detailCode"] == "health.still_recording"
        await until(lambda: has_heart_rate(rest))
        marked = await rest.post(f"{this}/markers", json={"name": "lift", "text": "the box"})
        assert marked.status_code == 204
        await notify_of_tasks(rest, broker, tmp_path)

        closed = (await rest.post(f"{this}/stop")).raise_for_status().json()
        assert (closed["state"], closed["endReason"]) == ("ended", "stopped")
        late = await rest.post(f"{this}/markers", json={"name": "late"})
        assert late.json()["detailCode"] == "health.not_recording"
        file = await rest.get(f"{this}/file")
        digest = hashlib.sha256(file.content).digest()
        assert (digest.hex(), len(file.content)) == (closed["sha256"], closed["size"])
        assert_digest(file)
        items = list(read_stream(io.BytesIO(file.content), "it"))
        assert len(items) == closed["messages"]
        assert [each.text for each in items if isinstance(each, Marker)] == [
            "the box",
            "Lift: completed by the gesture Thumbs up",
        ]
        assert {each.info.kind for each in items if isinstance(each, Samples)} == {SignalKind.HEART_RATE}
        rates = [each for each in items if isinstance(each, Feature) and each.name is FeatureName.HEART_RATE]
        assert rates
        stored = (tmp_path / "recordings" / f"{made['id']}{SUFFIX}").read_bytes()
        assert b"heartRate" not in stored
        assert person["pseudonym"].encode() not in stored

        exported = await rest.get(f"{this}/xdf")
        assert exported.headers["content-disposition"].endswith('.xdf"')
        assert_digest(exported)
        (tmp_path / "session.xdf").write_bytes(exported.content)
        streams, header = pyxdf.load_xdf(str(tmp_path / "session.xdf"))
        markers = next(each for each in streams if each["info"]["name"][0] == "markers")
        assert any("the box" in text for row in markers["time_series"] for text in row)
        assert any(len(each["time_stamps"]) for each in streams if each is not markers)
        assert header["info"]["version"] == ["1.0"]

        answer = (await rest.get(f"{this}/bundle")).raise_for_status()
        assert_digest(answer)
        bundle = answer.json()
        identifier = f"urn:ngsi-ld:PhysiologicalSession:demo:{made['id']}"
        assert bundle["identifier"]["value"] == identifier
        subjects = {each["resource"]["subject"]["identifier"]["value"] for each in bundle["entry"]}
        assert subjects == {person["pseudonym"]}

        async def entity() -> dict[str, Any] | None:
            found = await broker.query(type="PhysiologicalSession", id=identifier)
            return found[0] if found and "sha256" in found[0] else None

        published = await until(entity)
        assert published is not None
        assert published["sha256"]["value"] == closed["sha256"]
        assert published["refPerson"]["object"] == "urn:ngsi-ld:Person:demo:aino"

        assert (await rest.delete(this)).status_code == 204
        assert (await rest.get(AINO)).json() == []
        assert list((tmp_path / "recordings").iterdir()) == []

        async def is_gone() -> bool:
            return not await broker.query(type="PhysiologicalSession", id=identifier)

        await until(is_gone)
        records = (await rest.get("/audit", params={"limit": 100})).raise_for_status().json()
        path = "/people/{person}/recordings"
        assert {
            f"POST {path}",
            f"GET {path}/{{recording}}/file",
            f"GET {path}/{{recording}}/bundle",
            f"DELETE {path}/{{recording}}",
        } <= {each["action"] for each in records}


async def test_without_key_or_consent_nothing_is_recorded(running: Running, tmp_path: Path) -> None:
    async with running() as rest:
        await add_person(rest, "aino", *ALLOWED)
        refused = await rest.post(AINO, json={"startedBy": "Eero"})
        assert (refused.status_code, refused.json()["detailCode"]) == (409, "health.no_recording_key")
        assert "HANDOVER_HEALTH_RECORDING_KEY" in refused.json()["detail"]
        unknown = await rest.get(f"{AINO}/R-0123456789abcdef/file")
        assert unknown.json()["detailCode"] == "health.unknown_recording"
        assert (await rest.get(f"{AINO}/..%2f..%2fsecrets/file")).status_code in {404, 422}
        (await rest.put("/people/aino/consent", json=consent("live"))).raise_for_status()
        refused = await rest.post(AINO, json={"startedBy": "Eero"})
        assert refused.json()["detailCode"] == "health.no_recording_consent"
        assert not (tmp_path / "recordings").exists() or not list((tmp_path / "recordings").iterdir())


@pytest.mark.nightly
async def test_a_withdrawn_consent_ends_a_recording_and_deletes_what_was_asked(
    running: Running, tmp_path: Path
) -> None:
    async with running(health_recording_key=KEY) as rest:
        await add_person(rest, "aino", *ALLOWED)
        first = await start(rest)
        await until(lambda: has_heart_rate(rest))
        (await rest.put("/people/aino/consent", json=consent("live", "history"))).raise_for_status()
        assert (await rest.get("/people/aino")).json()["recording"] is None
        kept = await until(lambda: ended(rest, first["id"]))
        assert kept["endReason"] == "consent"
        (await rest.put("/people/aino/consent", json=consent(*ALLOWED))).raise_for_status()
        await start(rest, "second")
        await rest.delete("/people/aino/consent", params={"delete": "true"})
        assert (await rest.get(AINO)).json() == []
        assert list((tmp_path / "recordings").iterdir()) == []

        (await rest.put("/people/aino/consent", json=consent(*ALLOWED))).raise_for_status()
        await start(rest, "third")
        assert (await rest.delete("/people/aino")).status_code == 204
        assert list((tmp_path / "recordings").iterdir()) == []


@pytest.mark.nightly
async def test_the_next_start_closes_what_a_crash_has_left_and_deletes_what_is_old(
    running: Running, tmp_path: Path
) -> None:
    folder = tmp_path / "recordings"
    async with running(health_recording_key=KEY) as rest:
        await add_person(rest, "aino", *ALLOWED)
        made = await start(rest)
        journal = folder / f"{made['id']}{JOURNAL}"
        sizes = {journal.stat().st_size}

        def has_grown_three_times() -> bool:
            sizes.add(journal.stat().st_size)
            return len(sizes) > 3

        await until(has_grown_three_times)
        left = journal.read_bytes()[:-3]
    # what a killed service leaves: the row of a recording that runs, and a journal whose last chunk is cut
    store = Store(connect(HumanStateSettings.load(data_dir=tmp_path).database("human-state")))
    row = next(iter(store.recordings()))
    store.save_recording(RecordingRow(row.id, row.subject, row.label, row.started_us, row.started_by))
    (folder / f"{made['id']}{SUFFIX}").unlink()
    journal.write_bytes(left)
    (folder / f"R-{'0' * 16}{SUFFIX}").write_bytes(b"its deletion was interrupted")

    async with running() as rest:  # without the key it waits
        assert (await one(rest, made["id"]))["state"] == "interrupted"
        assert len(list(folder.iterdir())) == 1
    async with running(health_recording_key=KEY) as rest:
        closed = await until(lambda: ended(rest, made["id"]))
        assert closed["endReason"] == "interrupted"
        content = (await rest.get(f"{AINO}/{made['id']}/file")).raise_for_status().content
        assert hashlib.sha256(content).hexdigest() == closed["sha256"]
        assert len(list(read_stream(io.BytesIO(content), "it"))) == closed["messages"] > 0
    async with running(health_recording_key=KEY, health_recording_days=1e-6) as rest:

        async def is_deleted() -> bool:
            return (await rest.get(AINO)).json() == []

        await until(is_deleted)
        assert list(folder.iterdir()) == []
