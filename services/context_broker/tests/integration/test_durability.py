"""Acknowledged changes survive power failures and full disks, with their pending notifications."""

import re
import resource
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.kit.small_disk import SmallDisk, small_disk

Eventually = Callable[..., Any]


in_a_file = pytest.mark.parametrize("own_broker", ["sqlite"], indirect=True)
on_both = pytest.mark.parametrize("own_broker", ["sqlite", "postgresql"], indirect=True)


def subscribe(http: httpx.Client, name: str, url: str, **members: Any) -> str:
    subscription_id = f"urn:ngsi-ld:Subscription:demo:{name}"
    body = {
        "id": subscription_id,
        "type": "Subscription",
        "entities": [{"type": "Waiting"}],
        "notification": {"endpoint": {"uri": url, "accept": "application/json"}},
        **members,
    }
    assert http.post("/subscriptions", json=body).status_code == 201
    return subscription_id


def numbers(subscriber: Any) -> list[int]:
    """Return what a subscriber received, without immediate repetitions."""
    received = [entity["n"]["value"] for entity in subscriber.entities()]
    return [number for place, number in enumerate(received) if place == 0 or received[place - 1] != number]


@pytest.mark.nightly
@pytest.mark.slow
@on_both
def test_notifications_pending_at_a_power_failure_are_sent_after_it(
    own_broker: Any, new_subscriber: Callable[..., Any], eventually: Eventually
) -> None:
    subscriber = new_subscriber()
    subscriber.status = 503
    own_broker.start()
    with own_broker.client() as http:
        subscription = subscribe(http, "waiting", subscriber.url)
        throttled = subscribe(http, "throttled", subscriber.url, throttling=0.2)
        gone = subscribe(http, "gone", subscriber.url)
        for number in range(300):  # more than memory holds for one subscriber
            entity = {"id": f"urn:ngsi-ld:Waiting:demo:{number}", "type": "Waiting", "n": number}
            assert http.post("/entities", json=entity).status_code == 201
        assert http.delete(f"/subscriptions/{gone}").status_code == 204
    own_broker.kill()
    subscriber.status = 200
    own_broker.start()
    with own_broker.client() as http:

        def received(one: str) -> list[int]:
            return [entity["n"]["value"] for entity in subscriber.entities(one)]

        eventually(lambda: len(received(subscription)) >= 300)
        assert received(subscription) == list(range(300))
        eventually(lambda: set(received(throttled)) == set(range(300)))
        assert received(gone) == []
        path = f"/subscriptions/{subscription}"
        eventually(lambda: http.get(path).json()["notification"].get("timesSent", 0) >= 300)
    own_broker.stop()
    before = len(subscriber.received)
    own_broker.start()
    with own_broker.client() as http:
        assert http.get(path).json()["notification"]["timesSent"] >= 300
        entity = {"id": "urn:ngsi-ld:Waiting:demo:last", "type": "Waiting", "n": 300}
        assert http.post("/entities", json=entity).status_code == 201
        eventually(lambda: 300 in received(subscription))
    assert subscriber.received[before]["data"][0]["n"]["value"] == 300, "what was delivered is not sent again"


@pytest.mark.nightly
@pytest.mark.slow
@on_both
def test_power_cuts_while_notifying_lose_no_notification_and_keep_the_order(
    own_broker: Any, subscriber: Any, eventually: Eventually
) -> None:
    own_broker.start()
    with own_broker.client() as http:
        subscribe(http, "cuts", subscriber.url)
    number = 0
    for _ in range(3):
        with own_broker.client() as http:
            for _ in range(60):
                number += 1
                entity = {"id": f"urn:ngsi-ld:Waiting:demo:{number}", "type": "Waiting", "n": number}
                assert http.post("/entities", json=entity).status_code == 201
        own_broker.kill()
        own_broker.start()
    eventually(lambda: set(numbers(subscriber)) == set(range(1, number + 1)))
    first_received = list(dict.fromkeys(numbers(subscriber)))
    assert first_received == sorted(first_received)


@pytest.mark.nightly
@pytest.mark.slow
@on_both
def test_a_million_would_not_fill_the_memory_because_a_window_of_them_is_held(
    own_broker: Any, new_subscriber: Callable[..., Any], eventually: Eventually
) -> None:
    subscriber = new_subscriber()
    subscriber.go_on.clear()
    own_broker.start()
    with own_broker.client() as http:
        subscribe(http, "slow", subscriber.url)
        entities = [{"id": f"urn:ngsi-ld:Waiting:demo:{n}", "type": "Waiting", "n": n} for n in range(1500)]
        for start in range(0, 1500, 500):
            answer = http.post("/entityOperations/create", json=entities[start : start + 500])
            assert answer.status_code == 201
        assert own_broker.metric(r'handover_broker_notifications_pending\{state="memory"\}') <= 256
        subscriber.go_on.set()
        eventually(lambda: len(set(numbers(subscriber))) == 1500, within_s=40)
    assert list(dict.fromkeys(numbers(subscriber))) == list(range(1500))


@pytest.fixture
def full_disk(own_broker: Any) -> Callable[[bool], None]:
    """Make the disk full for the broker, and free space again, by a limit on the size of its files."""
    own_broker.start()
    unlimited = resource.RLIM_INFINITY

    def fill(full: bool) -> None:
        soft = 64 * 1024 if full else unlimited
        resource.prlimit(own_broker.process.pid, resource.RLIMIT_FSIZE, (soft, unlimited))

    return fill


@pytest.mark.nightly
@in_a_file
@pytest.mark.skipif(
    not hasattr(resource, "prlimit"), reason="only Linux can limit the files of another process"
)
def test_a_full_disk_refuses_writes_and_nothing_else(
    own_broker: Any, full_disk: Callable[[bool], None], subscriber: Any, eventually: Eventually
) -> None:
    with own_broker.client() as http:
        subscribe(http, "full", subscriber.url)
        first = {"id": "urn:ngsi-ld:Waiting:demo:first", "type": "Waiting", "n": 0}
        assert http.post("/entities", json=first).status_code == 201
        eventually(lambda: numbers(subscriber) == [0])
        path = f"/entities/{first['id']}"
        full_disk(True)
        refused = http.patch(f"{path}/attrs", json={"n": {"value": 1, "pad": "x" * 1_000_000}})
        assert refused.status_code == 507, refused.text
        assert "not stored" in refused.json()["detail"]
        pad = "x" * 1_000_000
        lost = {"id": "urn:ngsi-ld:Waiting:demo:lost", "type": "Waiting", "n": 9, "pad": pad}
        assert http.post("/entities", json=lost).status_code == 507
        batch = http.post("/entityOperations/upsert", json=[{**first, "n": 5, "pad": pad}, lost])
        assert batch.status_code == 207
        assert [one["error"]["status"] for one in batch.json()["errors"]] == [507, 507]
        wish = {
            "entities": [{"type": "X"}],
            "description": pad,
            "notification": {"endpoint": {"uri": "http://a/"}},
        }
        assert http.post("/subscriptions", json=wish).status_code == 507
        assert http.get(path, params={"options": "keyValues"}).json()["n"] == 0
        assert http.get(f"/entities/{lost['id']}").status_code == 404
        assert len(http.get("/subscriptions").json()) == 1
        full_disk(False)
        assert http.patch(f"{path}/attrs", json={"n": 2}).status_code == 204
        assert http.post("/entities", json=lost).status_code == 201
        eventually(lambda: numbers(subscriber)[-1] == 9)
    assert numbers(subscriber) == [0, 2, 9]
    own_broker.kill()
    own_broker.start()
    with own_broker.client() as http:
        assert http.get(path, params={"options": "keyValues"}).json()["n"] == 2
        assert http.get(f"/entities/{lost['id']}").status_code == 200


@pytest.fixture(name="small_disk")
def mounted_disk(tmp_path: Path) -> Iterator[Path]:
    with small_disk(tmp_path / "disk", 32) as disk:
        yield disk.folder


@pytest.mark.nightly
@pytest.mark.parametrize("ends", ["killed", "stopped"])
def test_a_broker_on_a_full_disk_starts_serves_reads_and_recovers_by_itself(
    small_disk: Path, ends: str, eventually: Eventually, broker_on: Callable[[Path], Any], subscriber: Any
) -> None:
    broker = broker_on(small_disk).start()
    subscriber.status = 503
    ever = {"timerel": "after", "timeAt": "1970-01-01T00:00:00Z", "timeproperty": "modifiedAt"}
    ids = [f"urn:ngsi-ld:Waiting:demo:{number}" for number in range(40)]
    with broker.client() as http:
        subscribe(http, "full", subscriber.url)
        for name in ids[:30]:
            entity = {"id": name, "type": "Waiting", "n": 0, "pad": "x" * 2000}
            assert http.post("/entities", json=entity).status_code == 201
        assert http.delete(f"/entities/{ids[0]}").status_code == 204
        assert (
            len(http.get("/temporal/entities", params={"type": "Waiting", "limit": 50, **ever}).json()) == 30
        )
        with closing(sqlite3.connect(small_disk / "broker.db", isolation_level=None)) as other:
            if ends == "killed":
                other.execute("BEGIN IMMEDIATE")  # so that the log alone has the rest
            for name in ids[30:]:
                assert http.post("/entities", json={"id": name, "type": "Waiting", "n": 1}).status_code == 201
            assert http.patch(f"/entities/{ids[1]}/attrs", json={"n": 2}).status_code == 204
            assert http.delete(f"/entities/{ids[2]}").status_code == 204
            broker.kill() if ends == "killed" else broker.stop()
    SmallDisk(small_disk).fill()
    answer = broker.start_unready()
    assert answer.status_code == 503
    assert str(small_disk) in answer.json()["storage"]
    assert " bytes free" in answer.json()["storage"]
    with broker.client() as http:
        found = http.get("/entities", params={"type": "Waiting", "limit": 100, "options": "keyValues"}).json()
        assert [one["id"] for one in found] == [ids[1], *ids[3:]]
        assert found[0]["n"] == 2
        for _ in range(3):
            refused = http.post("/entities", json={"id": "urn:ngsi-ld:Waiting:demo:more", "type": "Waiting"})
            assert refused.status_code == 507
            assert "not stored" in refused.json()["detail"]
        assert http.get("/entities/urn:ngsi-ld:Waiting:demo:more").status_code == 404
        past = http.get("/temporal/entities", params={"type": "Waiting", "limit": 50, **ever})
        assert past.status_code == (503 if ends == "killed" else 200)
        SmallDisk(small_disk).fill()
        SmallDisk(small_disk).free()
        eventually(lambda: httpx.get(f"{broker.url}/readyz", trust_env=False, timeout=120).is_success)
        entity = {"id": "urn:ngsi-ld:Waiting:demo:more", "type": "Waiting", "n": 3}
        assert http.post("/entities", json=entity).status_code == 201
        assert (
            len(http.get("/temporal/entities", params={"type": "Waiting", "limit": 50, **ever}).json()) == 41
        )
        subscriber.status = 200
        eventually(lambda: {one["id"] for one in subscriber.entities()} >= {*ids[30:], entity["id"]})
    broker.kill()
    broker.start()
    with broker.client() as http:
        found = http.get("/entities", params={"type": "Waiting", "limit": 100}).json()
        assert [one["id"] for one in found] == [ids[1], *ids[3:], entity["id"]]
    broker.stop()
    assert [row[0] for row in _rows(small_disk)] == ["ok"]


def _rows(folder: Path) -> list[Any]:
    assert not (folder / "broker.db-wal").exists()
    with closing(sqlite3.connect(folder / "broker.db")) as database:
        return database.execute("PRAGMA integrity_check").fetchall()


@pytest.mark.nightly
def test_a_full_disk_refuses_writes_until_there_is_space(
    small_disk: Path, eventually: Eventually, broker_on: Callable[[Path], Any]
) -> None:
    broker = broker_on(small_disk).start()
    created = []
    with broker.client() as http:
        SmallDisk(small_disk).fill()
        for number in range(200):  # the log has space of its own, and takes some of them
            entity = {"id": f"urn:ngsi-ld:Waiting:demo:{number}", "type": "Waiting", "pad": "x" * 100_000}
            answer = http.post("/entities", json=entity)
            if answer.status_code != 201:
                break
            created.append(entity["id"])
        assert answer.status_code == 507
        assert created
        refused = httpx.get(f"{broker.url}/readyz", trust_env=False, timeout=120)
        assert refused.status_code == 503
        assert re.search(rf"{small_disk} \(\d+ bytes free\)", refused.json()["storage"])
        SmallDisk(small_disk).free()
        eventually(lambda: httpx.get(f"{broker.url}/readyz", trust_env=False, timeout=120).is_success)
        assert http.post("/entities", json=entity).status_code == 201
        created.append(entity["id"])
    broker.kill()
    broker.start()
    with broker.client() as http:
        asked = {"type": "Waiting", "limit": 1000, "pick": "id"}
        assert [one["id"] for one in http.get("/entities", params=asked).json()] == created


@pytest.mark.nightly
@in_a_file
def test_writes_continue_while_another_process_locks_the_tables(
    own_broker: Any, subscriber: Any, eventually: Eventually
) -> None:
    """A copy being made, or a tool left open: the log takes what is written meanwhile."""
    own_broker.start()
    with own_broker.client() as http:
        subscribe(http, "held", subscriber.url)
        with closing(sqlite3.connect(own_broker.data_dir / "broker.db", isolation_level=None)) as other:
            other.execute("BEGIN IMMEDIATE")
            for number in range(50):
                entity = {"id": f"urn:ngsi-ld:Waiting:demo:{number}", "type": "Waiting", "n": number}
                assert http.post("/entities", json=entity).status_code == 201
            own_broker.kill()
            other.execute("ROLLBACK")
    own_broker.start()
    with own_broker.client() as http:
        found = http.get("/entities", params={"type": "Waiting", "limit": 100, "options": "keyValues"}).json()
        assert [one["n"] for one in found] == list(range(50))
        ever = {"type": "Waiting", "limit": 100, "timerel": "after", "timeAt": "1970-01-01T00:00:00Z"}
        ever["timeproperty"] = "modifiedAt"
        assert len(http.get("/temporal/entities", params=ever).json()) == 50
    eventually(lambda: sorted(set(numbers(subscriber))) == list(range(50)))


@in_a_file
def test_a_damaged_log_is_refused_in_one_line(own_broker: Any) -> None:
    own_broker.start()
    with (
        own_broker.client() as http,
        closing(sqlite3.connect(own_broker.data_dir / "broker.db", isolation_level=None)) as other,
    ):
        other.execute("BEGIN IMMEDIATE")
        for number in range(3):
            entity = {"id": f"urn:ngsi-ld:Waiting:demo:{number}", "type": "Waiting", "pad": "x" * 5000}
            assert http.post("/entities", json=entity).status_code == 201
        own_broker.kill()
        other.execute("ROLLBACK")
    file = own_broker.data_dir / "broker.log-1"
    content = file.read_bytes()
    at = content.rindex(b"Waiting:demo:1")
    file.write_bytes(content[:at] + b"?" + content[at + 1 :])
    last = own_broker.refused_start()
    assert "damaged data: " in last
    assert "broker.log-1" in last
    assert "restore the data directory" in last


@in_a_file
def test_a_bit_that_flips_in_an_entity_is_refused_in_one_line(own_broker: Any) -> None:
    own_broker.start()
    with own_broker.client() as http:
        entity = {"id": "urn:ngsi-ld:Waiting:demo:1", "type": "Waiting", "speed": 1234567}
        assert http.post("/entities", json=entity).status_code == 201
    own_broker.stop()
    file = own_broker.data_dir / "broker.db"
    content = bytearray(file.read_bytes())
    at = content.index(b"1234567")
    while at >= 0:  # in the entity and in its past
        content[at] ^= 1
        at = content.find(b"1234567")
    file.write_bytes(content)
    last = own_broker.refused_start()
    assert "broker.db: an entity is not as it was written; restore the data directory" in last


@in_a_file
def test_a_value_of_the_past_that_is_damaged_is_not_served(own_broker: Any) -> None:
    own_broker.start()
    ever = {"timerel": "after", "timeAt": "1970-01-01T00:00:00Z", "timeproperty": "modifiedAt"}
    with own_broker.client() as http:
        entity = {"id": "urn:ngsi-ld:Waiting:demo:1", "type": "Waiting", "speed": 1234567}
        assert http.post("/entities", json=entity).status_code == 201
        assert http.patch(f"/entities/{entity['id']}/attrs", json={"speed": 1}).status_code == 204
    own_broker.stop()
    file = own_broker.data_dir / "broker.db"
    content = bytearray(file.read_bytes())
    content[content.index(b"1234567")] ^= 1
    file.write_bytes(content)
    own_broker.start()
    with own_broker.client() as http:
        assert http.get(f"/entities/{entity['id']}").status_code == 200
        answer = http.get(f"/temporal/entities/{entity['id']}", params=ever)
        assert answer.status_code == 503, answer.text
        assert "the history of entity 1 is not as it was written" in answer.json()["detail"]


@pytest.mark.nightly
@in_a_file
@pytest.mark.parametrize("others", ["stopped", "killed", "none"])
def test_a_database_that_was_stopped_in_order_can_be_restored_alone(
    own_broker: Any, tmp_path: Path, others: str
) -> None:
    """Beside the log of a broker that was killed it is refused: that log has changes that are in no table."""
    own_broker.start()
    entity = {"id": "urn:ngsi-ld:Waiting:demo:kept", "type": "Waiting", "n": 1}
    with own_broker.client() as http:
        assert http.post("/entities", json=entity).status_code == 201
    own_broker.stop()
    file = own_broker.data_dir / "broker.db"
    kept = file.read_bytes()
    own_broker.start()
    with own_broker.client() as http:
        assert http.patch(f"/entities/{entity['id']}/attrs", json={"n": 2}).status_code == 204
        own_broker.kill() if others == "killed" else own_broker.stop()
    for left in own_broker.data_dir.glob("broker.db*" if others != "none" else "broker.*"):
        left.unlink()
    file.write_bytes(kept)
    if others == "killed":
        last = own_broker.refused_start()
        assert "broker.log-1 holds changes of this database, later" in last
        assert "if broker.db itself was restored, move broker.log-1 and broker.log-2 away" in last
        for log in own_broker.data_dir.glob("broker.log-*"):
            log.rename(log.with_suffix(".away"))
    own_broker.start()
    with own_broker.client() as http:
        assert http.get(f"/entities/{entity['id']}", params={"options": "keyValues"}).json()["n"] == 1


@pytest.mark.nightly
@in_a_file
def test_a_second_broker_on_the_same_file_is_refused_in_one_line(own_broker: Any) -> None:
    own_broker.start()
    last = type(own_broker)(own_broker.data_dir).refused_start()
    assert "another broker runs on" in last
    assert "HANDOVER_DATA_DIR" in last


@in_a_file
def test_an_invalid_database_file_is_refused_in_one_line(own_broker: Any) -> None:
    (own_broker.data_dir / "broker.db").write_bytes(b"shopping list: bolts, nuts" * 100)
    assert "broker.db: file is not a database; restore" in own_broker.refused_start()
