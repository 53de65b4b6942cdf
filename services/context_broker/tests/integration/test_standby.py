"""One broker writes a PostgreSQL database; a second one waits for its lock and takes over."""

import itertools
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import psycopg
import pytest

from tests.kit.waiting import scaled

from .conftest import BrokerProcess
from .test_crashes import CUTS
from .writers import ALL_WAYS, Writer, compare, things_of

pytestmark = pytest.mark.slow

Eventually = Callable[..., Any]
WRITERS = 6
MAX_REPEATED = 64
"""More than a broker sends before the next commit, which deletes what was sent from the outbox."""

SERVER_PROCESSES = "SELECT pid FROM pg_stat_activity WHERE application_name = 'handover context broker'"
CLOSE_ALL_CONNECTIONS = """
    SELECT pg_terminate_backend(pid) FROM pg_stat_activity
    WHERE datname = current_database() AND pid <> pg_backend_pid()
"""
CLOSE_WRITER_CONNECTION = """
    SELECT pg_terminate_backend(pid) FROM pg_locks WHERE locktype = 'advisory' AND granted
    AND database = (SELECT oid FROM pg_database WHERE datname = current_database())
"""


class Pair:
    """Two brokers on one database, started as a test asks for them."""

    def __init__(self, folder: Path, url: str) -> None:
        self.url = url
        settings = {"HANDOVER_BROKER_DATABASE_URL": url}
        self._both = [BrokerProcess(folder / str(number), extra=settings) for number in range(2)]
        for broker in self._both:
            broker.data_dir.mkdir()

    def serving(self, number: int) -> BrokerProcess:
        """Return one of the brokers once it serves."""
        broker = self._both[number]
        return broker if broker.process else broker.start()

    def standby(self, number: int) -> BrokerProcess:
        """Return one of the brokers, started while the other one serves."""
        broker = self._both[number]
        answer = broker.start_unready()
        assert answer.status_code == 503, answer.text
        assert answer.json()["database"].startswith("standby: another broker writes postgresql://")
        return broker

    def query(self, statement: str) -> list[tuple[Any, ...]]:
        """Return what the database answers."""
        with psycopg.connect(
            self.url, autocommit=True, options="-c search_path=context_broker"
        ) as connection:
            return connection.execute(statement).fetchall()

    def stop(self) -> None:
        for broker in self._both:
            broker.stop()


@pytest.fixture
def pair(tmp_path: Path, new_database: Callable[[], str]) -> Iterator[Pair]:
    made = Pair(tmp_path, new_database())
    yield made
    made.stop()


def entity(name: str, kind: str = "Part", **attributes: Any) -> dict[str, Any]:
    return {"id": f"urn:ngsi-ld:{kind}:demo:{name}", "type": kind, **attributes}


def subscription(url: str, kind: str = "Part") -> dict[str, Any]:
    return {
        "id": "urn:ngsi-ld:Subscription:demo:s",
        "type": "Subscription",
        "entities": [{"type": kind}],
        "notification": {"format": "keyValues", "endpoint": {"uri": url, "accept": "application/json"}},
    }


def is_ready(broker: BrokerProcess) -> bool:
    return httpx.get(f"{broker.url}/readyz", trust_env=False, timeout=120).is_success


def notified(subscriber: Any) -> list[int]:
    return [one["n"] for one in subscriber.entities() if "n" in one]


@pytest.mark.nightly
def test_a_second_broker_is_a_standby_and_reports_it(pair: Pair) -> None:
    first = pair.serving(0)
    second = pair.standby(1)
    with second.client() as http:
        answer = http.get("/entities", params={"type": "Part"})
        assert answer.status_code == 503
        assert "this broker is a standby: another broker writes postgresql://" in answer.json()["detail"]
        assert http.post("/entities", json=entity("1")).status_code == 503
    assert [one.metric("handover_broker_standby") for one in (first, second)] == [0, 1]
    assert "standby: waiting for the lock of the database" in second.log()
    assert httpx.get(f"{second.url}/healthz", trust_env=False, timeout=120).is_success


@pytest.mark.nightly
def test_a_standby_serves_everything_acknowledged_when_the_first_broker_is_killed(
    pair: Pair, subscriber: Any, eventually: Eventually
) -> None:
    first = pair.serving(0)
    mine = {"NGSILD-Tenant": "mine"}
    with first.client() as http:
        assert http.post("/subscriptions", json=subscription(subscriber.url)).status_code == 201
        second = pair.standby(1)  # what is written from here on is not in its memory
        for number in range(100):
            assert http.post("/entities", json=entity(str(number), n=number)).status_code == 201
        assert http.post("/entities", json=entity("only", n=1), headers=mine).status_code == 201
        assert http.patch(f"/entities/{entity('1')['id']}/attrs", json={"n": 1001}).status_code == 204
        assert http.delete(f"/entities/{entity('2')['id']}").status_code == 204
        alias = http.get("/info/sourceIdentity").json()["contextSourceAlias"]
        ids = [one["id"] for one in http.get("/entities", params={"type": "Part", "limit": 200}).json()]
    first.kill()
    eventually(lambda: is_ready(second), why="the standby does not take over")
    assert second.metric("handover_broker_standby") == 0
    with second.client() as http:
        found = http.get("/entities", params={"type": "Part", "limit": 200, "options": "keyValues"}).json()
        assert [one["id"] for one in found] == ids
        assert {one["n"] for one in found} == {*range(100), 1001} - {1, 2}
        assert len(http.get("/entities", params={"type": "Part"}, headers=mine).json()) == 1
        assert len(http.get("/subscriptions").json()) == 1
        assert len(http.get(f"/temporal/entities/{ids[1]}").json()["n"]) == 2
        assert http.get("/info/sourceIdentity").json()["contextSourceAlias"] == alias
        assert http.post("/entities", json=entity("after", n=5000)).status_code == 201
    wanted = {*range(100), 1001, 5000}
    eventually(lambda: wanted <= set(notified(subscriber)), why="some notifications were lost")


@pytest.mark.nightly
def test_brokers_that_are_killed_in_turn_lose_nothing_and_repeat_little(
    pair: Pair, subscriber: Any, eventually: Eventually
) -> None:
    """Kill the broker that serves, again and again, while all kinds of things are written."""
    serving = pair.serving(0)
    with serving.client() as http:
        assert http.post("/subscriptions", json=subscription(subscriber.url, "Load")).status_code == 201
    writers = [Writer(serving, number) for number in range(WRITERS)]
    for cut in range(CUTS // 2):
        serving, other = pair.serving(cut % 2), pair.standby(1 - cut % 2)
        writers = [Writer(serving, writer.number, writer) for writer in writers]
        goal = sum(writer.count for writer in writers) + 100 + 20 * (cut % 3)
        before = len(subscriber.received)
        for writer in writers:
            writer.start()
        work_until(goal, writers, eventually)
        serving.kill()
        for writer in writers:
            writer.join(scaled(30))
            assert not writer.is_alive()
            assert writer.failures == []
        eventually(lambda other=other: is_ready(other), why="the standby does not take over")
        with other.client() as http:
            for writer in writers:
                compare(http, writer)
            found = http.get("/entities", params={"type": "Load", "limit": 1000}).json()
        assert {one["id"] for one in found} == things_of(writers)
        promised = {
            (thing, number)
            for writer in writers
            for thing, sent in writer.notified.items()
            for number in sent
        }
        eventually(lambda promised=promised: promised <= received(subscriber), 60, "some were not notified")
        repeated = [one["id"] for one in subscriber.received[before:]]
        assert len(repeated) - len(set(repeated)) <= MAX_REPEATED
    assert {way for writer in writers for way in writer.ways} <= ALL_WAYS


def work_until(goal: int, writers: list[Writer], eventually: Eventually) -> None:
    eventually(lambda: sum(one.count for one in writers) >= goal, 60, "the writers are stuck")


def received(subscriber: Any) -> set[tuple[str, int]]:
    return {(one["id"], one["n"]) for one in subscriber.entities() if "n" in one}


@pytest.mark.nightly
def test_a_broker_that_lost_the_lock_becomes_a_standby_and_loads_the_database_again(
    pair: Pair, eventually: Eventually
) -> None:
    first = pair.serving(0)
    with first.client() as http:
        assert http.post("/entities", json=entity("1", n=1)).status_code == 201
    second = pair.standby(1)
    eventually(
        lambda: pair.query("SELECT 1 FROM pg_locks WHERE locktype = 'advisory' AND NOT granted"),
        why="the standby does not wait",
    )
    pair.query(CLOSE_WRITER_CONNECTION)
    eventually(lambda: is_ready(second), why="the standby does not take over")
    eventually(lambda: first.metric("handover_broker_standby") == 1, why="the first one does not stand by")
    with first.client() as http:
        assert http.get("/entities", params={"type": "Part"}).status_code == 503
    with second.client() as http:
        assert http.patch(f"/entities/{entity('1')['id']}/attrs", json={"n": 2}).status_code == 204
    second.kill()
    eventually(lambda: is_ready(first), why="the first one does not take over again")
    with first.client() as http:
        found = http.get("/entities", params={"type": "Part", "options": "keyValues"}).json()
        assert [one["n"] for one in found] == [2]
        assert http.post("/entities", json=entity("2", n=1)).status_code == 201


@pytest.mark.nightly
def test_a_standby_stops_on_sigterm(pair: Pair) -> None:
    pair.serving(0)
    process = pair.standby(1).process
    assert process is not None
    process.terminate()
    process.wait(scaled(20))


@pytest.mark.nightly
def test_when_the_database_crashes_under_load_nothing_acknowledged_is_lost(
    pair: Pair, subscriber: Any, eventually: Eventually
) -> None:
    broker = pair.serving(0)
    with broker.client() as http:
        assert http.post("/subscriptions", json=subscription(subscriber.url)).status_code == 201
    acknowledged: list[int] = []
    is_over = threading.Event()

    def write(writer: int) -> None:
        with broker.client() as http:
            for number in itertools.count(writer, 4):
                answer = http.post("/entities", json=entity(str(number), n=number))
                assert answer.status_code in {201, 503}, answer.text
                if answer.status_code == 201:
                    acknowledged.append(number)
                if is_over.is_set():
                    return

    with ThreadPoolExecutor(4) as pool:
        work = [pool.submit(write, number) for number in range(4)]
        try:
            for crash in range(3):
                before = len(acknowledged)
                eventually(lambda before=before: len(acknowledged) > before + 60, 60, "nothing is stored")
                if crash < 2:  # the server ends all its processes, and recovers
                    os.kill(pair.query(SERVER_PROCESSES)[0][0], signal.SIGKILL)
        finally:
            is_over.set()
        for one in work:
            one.result(30)
    wanted = set(acknowledged)
    ((stored,),) = pair.query("SELECT count(*) FROM entities")
    with broker.client() as http:
        counted = http.get("/entities", params={"type": "Part", "limit": "1", "count": "true"})
        assert int(counted.headers["ngsild-results-count"]) == stored
        for number in wanted:
            assert http.get(f"/entities/urn:ngsi-ld:Part:demo:{number}").status_code == 200, number
    eventually(lambda: wanted <= set(notified(subscriber)), why="some notifications were lost")


def test_connections_that_end_while_they_are_idle_are_replaced(pair: Pair, eventually: Eventually) -> None:
    broker = pair.serving(0)
    with broker.client() as http:
        for number in range(2):
            pair.query(CLOSE_ALL_CONNECTIONS)
            assert http.post("/entities", json=entity(str(number), n=0)).status_code == 201
            pair.query(CLOSE_ALL_CONNECTIONS)
            path = f"/entities/{entity(str(number))['id']}"
            assert http.patch(f"{path}/attrs", json={"n": 1}).status_code == 204
            assert http.get(f"/temporal{path}").status_code == 200
            assert len(http.get("/entities", params={"type": "Part"}).json()) == number + 1
            eventually(lambda: is_ready(broker))


def test_a_database_out_of_reach_is_refused_in_one_line(tmp_path: Path) -> None:
    url = "postgresql://somebody:secret@127.0.0.1:9/nothing"
    broker = BrokerProcess(tmp_path, extra={"HANDOVER_BROKER_DATABASE_URL": url})
    assert "HANDOVER_BROKER_DATABASE_URL" in broker.refused_start()
    assert "secret" not in broker.log()


@pytest.mark.nightly
def test_tables_of_another_format_are_refused_and_left_as_they_are(pair: Pair) -> None:
    broker = pair.serving(0)
    with broker.client() as http:
        assert http.post("/entities", json=entity("1")).status_code == 201
        pair.query("UPDATE format SET version = version + 1 RETURNING 1")
        pair.query(CLOSE_ALL_CONNECTIONS)
        answers = [http.delete(f"/entities/{entity('1')['id']}") for _ in range(2)]
    assert [one.status_code for one in answers] == [507, 507]
    assert "newer release" in answers[1].json()["detail"]
    broker.stop()
    assert "use the version that wrote them" in broker.refused_start()
    assert pair.query("SELECT count(*) FROM entities") == [(1,)]


def test_tables_of_before_the_first_release_are_refused_and_left_as_they_are(pair: Pair) -> None:
    with psycopg.connect(pair.url, autocommit=True) as connection:
        connection.execute("CREATE SCHEMA context_broker")
        connection.execute("CREATE TABLE context_broker.schema_version (version BIGINT)")
        connection.execute("INSERT INTO context_broker.schema_version VALUES (4)")
    (broker, _) = pair._both
    assert "of a version before the first release" in broker.refused_start()
    tables = "SELECT tablename FROM pg_tables WHERE schemaname = 'context_broker'"
    assert pair.query(tables) == [("schema_version",)]
