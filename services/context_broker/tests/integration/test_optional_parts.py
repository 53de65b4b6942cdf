"""A broker without federation or snapshots: their package is not loaded and their operations answer 422."""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from handover_broker.app import operations_of
from handover_broker.extensions.federation import FEDERATION
from handover_broker.extensions.plugins import PLUGINS
from handover_broker.extensions.snapshots import SNAPSHOTS
from handover_broker.settings import BrokerSettings
from tests.kit.waiting import wait_for

from .conftest import BrokerProcess, Subscriber

ENTITY = {
    "id": "urn:ngsi-ld:Room:1",
    "type": "Room",
    "temperature": {"type": "Property", "value": 21, "observedAt": "2026-01-01T00:00:00Z"},
}
REGISTRATION = {
    "id": "urn:ngsi-ld:ContextSourceRegistration:1",
    "type": "ContextSourceRegistration",
    "information": [{"entities": [{"type": "Room"}]}],
    "endpoint": "http://127.0.0.1:1",
}
SNAPSHOT = {"snapshotQueries": [{"type": "Query", "entities": [{"type": "Room"}]}]}
INSIDE = {"NGSILD-Snapshot": "urn:ngsi-ld:Snapshot:1"}
OFF = {"HANDOVER_BROKER_FEDERATION": "false", "HANDOVER_BROKER_SNAPSHOTS": "false"}
LOADED = """
import sys
from pathlib import Path
from handover_broker.app import create_broker
from handover_broker.settings import BrokerSettings
create_broker(BrokerSettings(data_dir=Path(sys.argv[1]), broker_federation=False, broker_snapshots=False))
print(*sorted(sys.modules))
"""


@pytest.fixture
def without_plugin(tmp_path: Path) -> dict[str, str]:
    """Return the environment of a process in which `handover_federation` is not installed."""
    folder = tmp_path / "path"
    information = folder / "handover_federation-0.1.0.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: handover-federation\nVersion: 0.1.0\n"
    )
    (information / "entry_points.txt").touch()
    (folder / "handover_federation.py").write_text('raise SystemExit("handover_federation was imported")')
    return {"PYTHONPATH": str(folder)}


@pytest.fixture
def alone(without_plugin: dict[str, str], tmp_path: Path) -> Iterator[BrokerProcess]:
    """A broker that runs where its plugin is not installed."""
    (tmp_path / "data").mkdir()
    broker = BrokerProcess(tmp_path / "data", extra=without_plugin, is_forked=False).start()
    yield broker
    broker.stop()


@pytest.mark.nightly
def test_packages_of_switched_off_parts_are_not_imported(tmp_path: Path) -> None:
    command = [sys.executable, "-c", LOADED, str(tmp_path)]
    loaded = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert "handover_broker.extensions.federation" in loaded
    assert [name for name in loaded if name.startswith("handover_federation")] == []


def test_the_package_of_the_plugin_is_loaded_by_its_entry_points() -> None:
    assert PLUGINS.names() == ["federation", "snapshots"]
    assert FEDERATION.factory(is_wanted=True).__module__.startswith("handover_federation.")
    assert SNAPSHOTS.factory(is_wanted=True).__module__.startswith("handover_federation.")


def test_a_broker_without_its_plugin_serves_entities_queries_and_subscriptions(
    alone: BrokerProcess, subscriber: Subscriber
) -> None:
    path = f"/entities/{ENTITY['id']}"
    subscription = {
        "type": "Subscription",
        "entities": [{"type": "Room"}],
        "notification": {"endpoint": {"uri": subscriber.url}},
    }
    with alone.client() as client:
        assert client.post("/subscriptions", json=subscription).status_code == 201
        assert client.post("/entities", json=ENTITY).status_code == 201
        wait_for(lambda: subscriber.received, why="no notification of the new entity")
        assert client.get(path).json()["temperature"]["value"] == 21
        change = {"temperature": {"type": "Property", "value": 22}}
        assert client.patch(f"{path}/attrs", json=change).status_code == 204
        wait_for(lambda: len(subscriber.received) == 2, why="no notification of the change")
        assert subscriber.received[1]["data"][0]["temperature"]["value"] == 22
        warm = client.get("/entities", params={"type": "Room", "q": "temperature>21"}).json()
        assert [room["id"] for room in warm] == [ENTITY["id"]]
        past = {"type": "Room", "timerel": "after", "timeAt": "2025-01-01T00:00:00Z"}
        assert len(client.get("/temporal/entities", params=past).json()) == 1
        assert client.post("/entityOperations/delete", json=[ENTITY["id"]]).status_code == 204
        assert client.get(path).status_code == 404


def test_a_broker_without_its_plugin_refuses_what_needs_it_and_says_what_to_install(
    alone: BrokerProcess,
) -> None:
    with alone.client() as client:
        assert client.post("/entities", json=ENTITY).status_code == 201
        for missing in (
            client.post("/csourceRegistrations", json=REGISTRATION),
            client.get("/csourceSubscriptions"),
            client.get("/entityMaps", params={"type": "Room"}),
            client.get("/entities", params={"type": "Room", "options": "entityMap"}),
        ):
            require_unsupported(missing, "pip install --find-links dist handover-federation")
        for missing in (
            client.post("/snapshots", json=SNAPSHOT),
            client.get("/entities", params={"type": "Room"}, headers=INSIDE),
        ):
            require_unsupported(missing, "pip install --find-links dist handover-federation")


def test_what_the_plugin_has_stored_is_kept_without_it(
    without_plugin: dict[str, str], own_broker: BrokerProcess
) -> None:
    path = f"/csourceRegistrations/{REGISTRATION['id']}"
    own_broker.start()
    with own_broker.client() as client:
        assert client.post("/csourceRegistrations", json=REGISTRATION).status_code == 201
    own_broker.stop()
    own_broker.extra, own_broker.is_forked = without_plugin, False
    own_broker.start()
    assert "stored documents are ignored" in own_broker.log()
    own_broker.stop()
    own_broker.extra, own_broker.is_forked = {}, True
    own_broker.start()
    with own_broker.client() as client:
        assert client.get(path).status_code == 200


def test_a_plugin_that_cannot_be_imported_is_named_and_the_broker_does_not_start(
    without_plugin: dict[str, str], own_broker: BrokerProcess
) -> None:
    own_broker.extra, own_broker.is_forked = without_plugin, False
    entry_points = next(Path(without_plugin["PYTHONPATH"]).glob("*.dist-info")) / "entry_points.txt"
    with entry_points.open("a") as file:
        file.write("\n[handover.broker_plugins]\nfederation = no_such_module:Federation\n")
    reason = own_broker.refused_start()
    assert 'the broker plugin "federation" (no_such_module:Federation) cannot be loaded' in reason


@pytest.mark.parametrize("setting", ["HANDOVER_BROKER_FEDERATION", "HANDOVER_BROKER_SNAPSHOTS"])
def test_a_part_that_is_asked_for_and_not_installed_stops_the_start(
    without_plugin: dict[str, str], own_broker: BrokerProcess, setting: str
) -> None:
    own_broker.extra, own_broker.is_forked = {**without_plugin, setting: "true"}, False
    reason = own_broker.refused_start()
    assert f"{setting}=true needs a plugin that is not installed" in reason
    assert "pip install --find-links dist handover-federation" in reason


def test_a_switched_off_part_lists_the_same_operations(tmp_path: Path) -> None:
    def listed(**settings: bool) -> set[tuple[str, str, str, str]]:
        operations = operations_of(BrokerSettings(data_dir=tmp_path, **settings))  # type: ignore[arg-type]
        return {
            (operation.method, operation.path, operation.name, operation.clause) for operation in operations
        }

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
    with limited.client() as client:
        assert client.post("/entities", json=ENTITY).status_code == 201
        federation = "HANDOVER_BROKER_FEDERATION=true"
        require_unsupported(client.post("/csourceRegistrations", json=REGISTRATION), federation)
        require_unsupported(client.get("/csourceRegistrations", params={"type": "Room"}), federation)
        require_unsupported(client.get("/csourceSubscriptions"), federation)
        require_unsupported(client.get("/entityMaps", params={"type": "Room"}), federation)
        mapped = {"type": "Room", "entityMap": "true"}
        require_unsupported(client.get("/entities", params=mapped), federation)
        snapshots = "HANDOVER_BROKER_SNAPSHOTS=true"
        require_unsupported(client.post("/snapshots", json=SNAPSHOT), snapshots)
        require_unsupported(client.get("/entities", params={"type": "Room"}, headers=INSIDE), snapshots)


@pytest.mark.nightly
def test_a_broker_without_optional_parts_serves_its_own_entities(limited: BrokerProcess) -> None:
    with limited.client() as client:
        assert client.post("/entities", json=ENTITY).status_code == 201
        assert [room["id"] for room in client.get("/entities", params={"type": "Room"}).json()] == [
            ENTITY["id"]
        ]
        assert client.get("/types").json()["typeList"] == ["Room"]
        past = {"type": "Room", "timerel": "after", "timeAt": "2025-01-01T00:00:00Z"}
        assert [room["id"] for room in client.get("/temporal/entities", params=past).json()] == [ENTITY["id"]]
        change = {"temperature": {"type": "Property", "value": 22}}
        assert client.patch(f"/entities/{ENTITY['id']}/attrs", json=change).status_code == 204
        limited.kill()
        limited.start()
        assert client.get(f"/entities/{ENTITY['id']}").json()["temperature"]["value"] == 22


@pytest.mark.nightly
def test_stored_documents_of_a_switched_off_part_are_kept_with_a_warning(tmp_path: Path) -> None:
    path = f"/csourceRegistrations/{REGISTRATION['id']}"
    broker = BrokerProcess(tmp_path).start()
    with broker.client() as client:
        assert client.post("/csourceRegistrations", json=REGISTRATION).status_code == 201
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
