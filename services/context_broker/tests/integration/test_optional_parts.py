"""A broker without federation or snapshots: their packages are not loaded and their operations answer 422."""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from handover_broker.app import operations_of
from handover_broker.settings import BrokerSettings

from .conftest import BrokerProcess

ENTITY = {
    "id": "urn:ngsi-ld:Room:1",
    "type": "Room",
    "temperature": {"type": "Property", "value": 21, "observedAt": "2026-01-01T00:00:00Z"},
}
OFF = {"HANDOVER_BROKER_FEDERATION": "false", "HANDOVER_BROKER_SNAPSHOTS": "false"}
LOADED = """
import sys
from pathlib import Path
from handover_broker.app import create_broker
from handover_broker.settings import BrokerSettings
create_broker(BrokerSettings(data_dir=Path(sys.argv[1]), broker_federation=False, broker_snapshots=False))
print(*sorted(sys.modules))
"""


@pytest.mark.nightly
def test_packages_of_switched_off_parts_are_not_imported(tmp_path: Path) -> None:
    command = [sys.executable, "-c", LOADED, str(tmp_path)]
    loaded = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert "handover_broker.extensions.federation" in loaded
    parts = ("handover_broker.federation", "handover_broker.snapshots")
    assert [one for one in loaded if one.startswith(parts)] == []


def test_a_switched_off_part_lists_the_same_operations(tmp_path: Path) -> None:
    def listed(**settings: bool) -> set[tuple[str, str, str, str]]:
        operations = operations_of(BrokerSettings(data_dir=tmp_path, **settings))  # type: ignore[arg-type]
        return {(one.method, one.path, one.name, one.clause) for one in operations}

    assert listed(broker_federation=False, broker_snapshots=False) == listed()


@pytest.fixture
def limited(tmp_path: Path) -> Iterator[BrokerProcess]:
    broker = BrokerProcess(tmp_path, extra=OFF).start()
    yield broker
    broker.stop()


def require_unsupported(response: httpx.Response, setting: str) -> None:
    assert response.status_code == 422, response.text
    problem = json.loads(response.content)
    assert problem["type"].endswith("/OperationNotSupported")
    assert setting in problem["detail"]


def test_operations_of_switched_off_parts_are_not_supported(limited: BrokerProcess) -> None:
    registration = {
        "type": "ContextSourceRegistration",
        "information": [{"entities": [{"type": "Room"}]}],
        "endpoint": "http://127.0.0.1:1",
    }
    snapshot = {"snapshotQueries": [{"type": "Query", "entities": [{"type": "Room"}]}]}
    with limited.client() as client:
        assert client.post("/entities", json=ENTITY).status_code == 201
        federation = "HANDOVER_BROKER_FEDERATION=true"
        require_unsupported(client.post("/csourceRegistrations", json=registration), federation)
        require_unsupported(client.get("/csourceRegistrations", params={"type": "Room"}), federation)
        require_unsupported(client.get("/csourceSubscriptions"), federation)
        require_unsupported(client.get("/entityMaps", params={"type": "Room"}), federation)
        mapped = {"type": "Room", "entityMap": "true"}
        require_unsupported(client.get("/entities", params=mapped), federation)
        snapshots = "HANDOVER_BROKER_SNAPSHOTS=true"
        require_unsupported(client.post("/snapshots", json=snapshot), snapshots)
        inside = {"NGSILD-Snapshot": "urn:ngsi-ld:Snapshot:1"}
        require_unsupported(client.get("/entities", params={"type": "Room"}, headers=inside), snapshots)


@pytest.mark.nightly
def test_a_broker_without_optional_parts_serves_its_own_entities(limited: BrokerProcess) -> None:
    with limited.client() as client:
        assert client.post("/entities", json=ENTITY).status_code == 201
        assert [one["id"] for one in client.get("/entities", params={"type": "Room"}).json()] == [
            ENTITY["id"]
        ]
        assert client.get("/types").json()["typeList"] == ["Room"]
        past = {"type": "Room", "timerel": "after", "timeAt": "2025-01-01T00:00:00Z"}
        assert [one["id"] for one in client.get("/temporal/entities", params=past).json()] == [ENTITY["id"]]
        change = {"temperature": {"type": "Property", "value": 22}}
        assert client.patch(f"/entities/{ENTITY['id']}/attrs", json=change).status_code == 204
        limited.kill()
        limited.start()
        assert client.get(f"/entities/{ENTITY['id']}").json()["temperature"]["value"] == 22


@pytest.mark.nightly
def test_stored_documents_of_a_switched_off_part_are_kept_with_a_warning(tmp_path: Path) -> None:
    registration = {
        "id": "urn:ngsi-ld:ContextSourceRegistration:1",
        "type": "ContextSourceRegistration",
        "information": [{"entities": [{"type": "Room"}]}],
        "endpoint": "http://127.0.0.1:1",
    }
    path = f"/csourceRegistrations/{registration['id']}"
    broker = BrokerProcess(tmp_path).start()
    with broker.client() as client:
        assert client.post("/csourceRegistrations", json=registration).status_code == 201
    broker.stop()
    broker.extra = OFF
    broker.start()
    assert "stored documents are ignored" in broker.log()
    broker.stop()
    broker.extra = {}
    broker.start()
    with broker.client() as client:
        assert client.get(path).status_code == 200
    broker.stop()
