"""Several brokers on one PostgreSQL: of one mind, none overwrites another, one notifies, and any may die."""

import itertools
import os
import random
import signal
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest

from .conftest import BrokerProcess
from .several import Brokers, settings

pytestmark = pytest.mark.slow

Eventually = Callable[..., Any]
SERVING = "SELECT pid FROM pg_stat_activity WHERE application_name = 'handover context broker'"
"""The server's processes that work for brokers."""


END_ALL = """
    SELECT pg_terminate_backend(pid) FROM pg_stat_activity
    WHERE datname = current_database() AND pid <> pg_backend_pid()
"""
"""Ends all connections of brokers to their database."""


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory, new_database: Callable[[], str]) -> Iterator[Brokers]:
    """Brokers for all tests that leave them as they are; each uses types of its own."""
    made = Brokers(tmp_path_factory.mktemp("several"), new_database())
    yield made
    made.stop()


@pytest.fixture
def brokers(tmp_path: Path, new_database: Callable[[], str]) -> Iterator[Brokers]:
    """Brokers for one test, which may do with them what it likes."""
    made = Brokers(tmp_path, new_database())
    yield made
    made.stop()


@pytest.fixture
def two(shared: Brokers) -> Iterator[list[httpx.Client]]:
    """A client of each of two shared brokers."""
    yield from clients_of(shared)


@pytest.fixture
def own_two(brokers: Brokers) -> Iterator[list[httpx.Client]]:
    """A client of each of two brokers of the test's own."""
    yield from clients_of(brokers)


def clients_of(brokers: Brokers) -> Iterator[list[httpx.Client]]:
    with ThreadPoolExecutor(2) as pool:
        one, other = pool.map(brokers.started, (0, 1))
    with one.client() as first, other.client() as second:
        yield [first, second]


def entity(name: str, kind: str = "Part", **attributes: Any) -> dict[str, Any]:
    return {"id": f"urn:ngsi-ld:{kind}:demo:{name}", "type": kind, **attributes}


def wish(name: str, url: str, kind: str = "Part", **members: Any) -> dict[str, Any]:
    return {
        "id": f"urn:ngsi-ld:Subscription:demo:{name}",
        "type": "Subscription",
        "entities": [{"type": kind}],
        "notification": {"endpoint": {"uri": url, "accept": "application/json"}},
        **members,
    }


def told(subscriber: Any) -> list[int]:
    return [one["n"]["value"] for one in subscriber.entities()]


def ids(answer: httpx.Response) -> list[str]:
    return [one["id"] for one in answer.json()]


def test_what_one_broker_has_the_other_has_too(
    two: list[httpx.Client], shared: Brokers, subscriber: Any, eventually: Eventually
) -> None:
    one, other = two
    mine = {"NGSILD-Tenant": "mine"}
    first = entity("1", "Seen", n=1)
    assert one.post("/entities", json=first).status_code == 201
    assert one.post("/entities", json=first, headers=mine).status_code == 201
    assert one.post("/subscriptions", json=wish("Seen", subscriber.url, "Seen")).status_code == 201
    eventually(lambda: other.get(f"/entities/{first['id']}").status_code == 200)
    eventually(lambda: other.get(f"/entities/{first['id']}", headers=mine).status_code == 200)
    eventually(lambda: len(other.get("/subscriptions").json()) == 1)
    assert other.patch(f"/entities/{first['id']}/attrs", json={"n": 2}).status_code == 204
    keyed = {"options": "keyValues"}
    eventually(lambda: one.get(f"/entities/{first['id']}", params=keyed).json()["n"] == 2)
    eventually(lambda: told(subscriber) == [2])
    path = "/subscriptions/urn:ngsi-ld:Subscription:demo:Seen"
    for http in two:
        eventually(lambda http=http: http.get(path).json()["notification"].get("timesSent") == 1)
    assert other.patch(path, json={"isActive": False}).status_code == 204
    eventually(lambda: one.get(path).json()["status"] == "paused")
    assert one.delete(path).status_code == 204
    eventually(lambda: other.get(path).status_code == 404)
    assert other.delete(f"/entities/{first['id']}").status_code == 204
    eventually(lambda: one.get(f"/entities/{first['id']}").status_code == 404)
    third = shared.started(2)
    with third.client() as http:
        assert http.get("/entities", params={"type": "Seen"}).json() == []
        assert len(http.get("/entities", params={"type": "Seen"}, headers=mine).json()) == 1


def test_registrations_maps_and_snapshots_of_one_broker_are_known_to_the_other(
    two: list[httpx.Client], eventually: Callable[..., Any]
) -> None:
    one, other = two
    one.post("/entities", json=entity("shared", "Shared"))
    identities = [client.get("/info/sourceIdentity").json()["contextSourceAlias"] for client in two]
    assert identities[0] == identities[1]
    registration = {"endpoint": "http://127.0.0.1:9", "information": [{"entities": [{"type": "Shared2"}]}]}
    at = one.post("/csourceRegistrations", json=registration).headers["location"]
    at = at.removeprefix("/ngsi-ld/v1")
    eventually(lambda: other.get(at).status_code == 200)
    assert len(other.get("/csourceRegistrations", params={"type": "Shared2"}).json()) == 1
    assert other.delete(at).status_code == 204
    eventually(lambda: one.get(at).status_code == 404)
    made = one.get("/entityMaps", params={"type": "Shared"}).json()
    eventually(lambda: other.get(f"/entityMaps/{made['id']}").status_code == 200)
    query = {"type": "Query", "entities": [{"type": "Shared"}]}
    at = one.post("/snapshots", json={"snapshotQueries": [query]}).headers["location"]
    at = at.removeprefix("/ngsi-ld/v1")
    eventually(lambda: other.get(at).status_code == 200)
    eventually(lambda: other.get(at).json()["snapshotStatus"] == "success")
    inside = {"NGSILD-Snapshot": other.get(at).json()["id"]}
    found = other.get("/entities", params={"type": "Shared"}, headers=inside)
    assert len(found.json()) == 1
    assert other.delete(at).status_code == 204
    eventually(lambda: one.get("/entities", params={"type": "Shared"}, headers=inside).status_code == 404)


def test_no_update_is_lost_when_several_clients_write_one_entity_at_two_brokers(
    two: list[httpx.Client], shared: Brokers, eventually: Eventually
) -> None:
    parts = [entity(f"parts-{number}", "Shared") for number in range(3)]
    for one in parts:
        assert two[0].post("/entities", json=one).status_code == 201
    eventually(lambda: two[1].get(f"/entities/{parts[-1]['id']}").status_code == 200)

    def write(writer: int) -> int:
        dice = random.Random(writer)
        with shared.started(writer % 2).client() as http:
            for number in range(30):
                path = f"/entities/{dice.choice(parts)['id']}/attrs"
                answer = http.post(path, json={f"a{writer}x{number}": number})
                assert answer.status_code == 204, answer.text
        return 30

    with ThreadPoolExecutor(6) as pool:
        written = sum(pool.map(write, range(6)))

    def kept(http: httpx.Client) -> int:
        found = [http.get(f"/entities/{one['id']}", params={"options": "keyValues"}).json() for one in parts]
        return sum(len(one) - 2 for one in found)

    for http in two:
        eventually(lambda http=http: kept(http) == written, 5, "an update was lost")
    assert sum(shared.started(n).metric("handover_broker_commits_overtaken_total") for n in (0, 1)) > 0


def test_an_id_is_given_once_however_many_want_it(two: list[httpx.Client], shared: Brokers) -> None:
    def create(writer: int) -> list[int]:
        with shared.started(writer % 2).client() as http:
            return [
                http.post("/entities", json=entity(f"{n}", "Wanted", w=writer)).status_code for n in range(50)
            ]

    def create_many(writer: int) -> list[str]:
        batch = [entity(f"b{n}", "Wanted", w=writer) for n in range(60)]
        with shared.started(writer % 2).client() as http:
            answer = http.post("/entityOperations/create", json=batch)
            made: list[str] = answer.json() if answer.status_code == 201 else answer.json()["success"]
            return made

    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(create, range(4)))
        batches = list(pool.map(create_many, range(4)))
    for outcomes in zip(*answers, strict=True):
        assert sorted(outcomes) == [201, 409, 409, 409]
    made = Counter(itertools.chain.from_iterable(batches))
    assert len(made) == 60
    assert set(made.values()) == {1}


def test_pages_are_in_one_order_at_both_brokers(
    two: list[httpx.Client], shared: Brokers, eventually: Eventually
) -> None:
    def create(writer: int) -> None:
        with shared.started(writer % 2).client() as http:
            for number in range(30):
                assert http.post("/entities", json=entity(f"{writer}-{number}", "Page")).status_code == 201

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(create, range(4)))
    asked = {"type": "Page", "limit": "200"}
    for http in two:
        eventually(lambda http=http: len(http.get("/entities", params=asked).json()) == 120)
    assert ids(two[0].get("/entities", params=asked)) == ids(two[1].get("/entities", params=asked))
    everything = {"limit": "200", "local": "true", "idPattern": ".*"}
    assert ids(two[0].get("/entities", params=everything | {"type": "Page"})) == ids(
        two[1].get("/entities", params=asked)
    )


def test_a_notification_is_sent_once_whoever_wrote(
    two: list[httpx.Client], subscriber: Any, eventually: Eventually
) -> None:
    assert two[0].post("/subscriptions", json=wish("Once", subscriber.url, "Once")).status_code == 201

    def write(writer: int) -> None:
        for number in range(30):
            made = entity(f"{writer}-{number}", "Once", n=100 * writer + number)
            assert two[writer].post("/entities", json=made).status_code == 201

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(write, (0, 1)))
    wanted = Counter(100 * writer + number for writer in (0, 1) for number in range(30))
    path = "/subscriptions/urn:ngsi-ld:Subscription:demo:Once"
    for http in two:
        eventually(lambda http=http: http.get(path).json()["notification"].get("timesSent") == 60)
    assert Counter(told(subscriber)) == wanted
    for writer in (0, 1):
        of_one = [n for n in told(subscriber) if n // 100 == writer]
        assert of_one == sorted(of_one)


def test_a_subscription_made_at_one_broker_counts_at_once_at_the_other(
    two: list[httpx.Client], subscriber: Any, eventually: Eventually
) -> None:
    for number in range(15):
        one, other = two if number % 2 else two[::-1]
        kind = f"Kind{number}"
        assert one.post("/subscriptions", json=wish(kind, subscriber.url, kind)).status_code == 201
        assert other.post("/entities", json=entity("x", kind, n=number)).status_code == 201
    eventually(lambda: sorted(told(subscriber)) == list(range(15)))


@pytest.mark.slow
def test_when_the_leader_is_killed_another_goes_on_with_what_is_owed(
    brokers: Brokers, subscriber: Any, eventually: Eventually
) -> None:
    with brokers.started(0).client() as http:
        assert http.post("/subscriptions", json=wish("s", subscriber.url)).status_code == 201
    brokers.started(1)
    number = 0
    for _ in range(2):
        leader = eventually(brokers.leader)
        for broker in (leader, brokers.started(0), brokers.started(1)):
            with broker.client() as http:
                for _ in range(25):
                    number += 1
                    made = entity(str(number), n=number)
                    assert http.post("/entities", json=made).status_code == 201
        leader.kill()
        wanted = set(range(1, number + 1))
        eventually(lambda wanted=wanted: set(told(subscriber)) == wanted, why="some were not told")
        brokers.started(0)
        brokers.started(1)
    assert len(told(subscriber)) <= number + 2 * 60, (
        "only what a killed leader had not struck out is repeated"
    )


@pytest.mark.slow
def test_when_the_database_crashes_under_load_nothing_acknowledged_is_lost(
    own_two: list[httpx.Client], brokers: Brokers, subscriber: Any, eventually: Eventually
) -> None:
    assert own_two[0].post("/subscriptions", json=wish("s", subscriber.url)).status_code == 201
    acknowledged: list[int] = []
    over = threading.Event()

    def write(writer: int) -> None:
        with brokers.started(writer % 2).client() as http:
            for number in itertools.count(writer, 4):
                answer = http.post("/entities", json=entity(str(number), n=number))
                assert answer.status_code in {201, 507}, answer.text
                if answer.status_code == 201:
                    acknowledged.append(number)
                if over.is_set():
                    return

    with ThreadPoolExecutor(4) as pool:
        work = [pool.submit(write, number) for number in range(4)]
        try:
            for crash in range(3):
                before = len(acknowledged)
                eventually(lambda before=before: len(acknowledged) > before + 60, why="nothing is stored")
                if crash < 2:
                    os.kill(brokers.asked(SERVING)[0][0], signal.SIGKILL)  # the server ends all, and recovers
        finally:
            over.set()
        for one in work:
            one.result(30)
    asked = {"type": "Part", "limit": "1", "count": "true"}
    wanted = set(acknowledged)
    for http in own_two:
        counted = brokers.asked("SELECT count(*) FROM entities")[0][0]
        eventually(
            lambda http=http, counted=counted: (
                int(http.get("/entities", params=asked).headers["ngsild-results-count"]) == counted
            ),
            why="a broker does not have what the database has",
        )
        for number in wanted:
            assert http.get(f"/entities/urn:ngsi-ld:Part:demo:{number}").status_code == 200, number
    eventually(lambda: wanted <= set(told(subscriber)), why="some were not told")


@pytest.mark.slow
def test_a_broker_that_was_away_for_too_long_loads_everything_anew(
    own_two: list[httpx.Client], brokers: Brokers, eventually: Eventually
) -> None:
    gone, stays = entity("gone", n=1), entity("stays", n=1)
    for one in (gone, stays):
        assert own_two[0].post("/entities", json=one).status_code == 201
    assert own_two[0].post("/subscriptions", json=wish("gone", "http://127.0.0.1:9/")).status_code == 201
    eventually(lambda: own_two[1].get(f"/entities/{stays['id']}").status_code == 200)
    eventually(lambda: len(own_two[1].get("/subscriptions").json()) == 1)
    away = brokers.started(1).process
    away.send_signal(signal.SIGSTOP)
    try:
        assert own_two[0].delete(f"/entities/{gone['id']}").status_code == 204
        assert own_two[0].patch(f"/entities/{stays['id']}/attrs", json={"n": 2}).status_code == 204
        assert own_two[0].post("/entities", json=entity("new", n=1)).status_code == 201
        assert own_two[0].delete("/subscriptions/urn:ngsi-ld:Subscription:demo:gone").status_code == 204
        brokers.asked("DELETE FROM changes WHERE number < (SELECT max(number) FROM changes) RETURNING 1")
    finally:
        away.send_signal(signal.SIGCONT)
    asked = {"type": "Part", "options": "keyValues"}
    wanted = [{**stays, "n": 2}, entity("new", n=1)]
    eventually(lambda: own_two[1].get("/entities", params=asked).json() == wanted)
    eventually(lambda: own_two[1].get("/subscriptions").json() == [])
    assert own_two[1].patch(f"/entities/{stays['id']}/attrs", json={"n": 3}).status_code == 204


def test_connections_that_died_while_nothing_was_to_do_are_not_noticed(
    two: list[httpx.Client], shared: Brokers, eventually: Eventually
) -> None:
    shared.asked(END_ALL)
    for number, http in enumerate(two):
        assert http.post("/entities", json=entity(str(number), "Idle", n=0)).status_code == 201
    shared.asked(END_ALL)
    for number, http in enumerate(two):
        path = f"/entities/{entity(str(number), 'Idle')['id']}"
        assert http.patch(f"{path}/attrs", json={"n": 1}).status_code == 204
        assert http.get(f"/temporal{path}").status_code == 200
        eventually(lambda http=http: len(http.get("/entities", params={"type": "Idle"}).json()) == 2)
        ready = f"{shared[number].url}/readyz"
        eventually(lambda ready=ready: httpx.get(ready, trust_env=False).status_code == 200)


def test_a_database_out_of_reach_is_refused_in_one_line(tmp_path: Path) -> None:
    broker = BrokerProcess(tmp_path, extra=settings("postgresql://somebody:secret@127.0.0.1:9/nothing"))
    process = broker.spawn()
    try:
        assert process.wait(120) == 2
    finally:
        process.kill()
    assert broker.log().strip().count("\n") == 0
    assert "HANDOVER_BROKER_DATABASE_URL" in broker.log()
    assert "secret" not in broker.log()


def test_an_older_broker_leaves_tables_of_a_newer_one_alone(
    own_two: list[httpx.Client], brokers: Brokers, eventually: Eventually
) -> None:
    first = entity("1")
    assert own_two[0].post("/entities", json=first).status_code == 201
    brokers.asked("UPDATE schema_version SET version = version + 1 RETURNING 1")
    brokers.asked(END_ALL)
    answers = [own_two[0].delete(f"/entities/{first['id']}") for _ in range(2)]
    assert [one.status_code for one in answers] == [507, 507]
    assert "newer release" in answers[1].json()["detail"]
    brokers.started(0).stop()
    process = brokers[0].spawn()
    try:
        assert process.wait(120) == 2
    finally:
        process.kill()
    assert "newer version of Handover" in brokers[0].log().strip().splitlines()[-1]
