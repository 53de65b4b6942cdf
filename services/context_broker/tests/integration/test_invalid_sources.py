"""Dead, slow and invalid sources: the other results arrive in time, with a warning."""

import itertools
import threading
from collections.abc import Iterator

import httpx
import psutil
import pytest

from services.context_broker.tests.integration.conftest import BrokerProcess
from tests.kit.context_sources import put, register
from tests.kit.ports import next_free_port
from tests.kit.rubbish_source import RubbishSource
from tests.kit.waiting import wait_for

HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\n"
OPERATIONS = [
    "redirectionOps", "createSubscription", "deleteSubscription", "retrieveTemporal", "queryTemporal",
    "createEntityMapQueryTemporal", "upsertBatch", "upsertTemporal",
]  # fmt: skip
PATIENCE_MS = 3000


def page(body: bytes, head: bytes = HEAD) -> bytes:
    return head + b"Content-Length: %d\r\n\r\n" % len(body) + body


RUBBISH: dict[str, tuple[bytes, ...]] = {
    "HTML": (page(b"<html>It works!</html>", b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\n"),),
    "broken JSON": (page(b'[{"id": "urn:x:1", "type"'),),
    "other JSON": (page(b'{"access_token": "abc", "data": {"data": []}}'),),
    "lists of lists": (page(b"[[[[]]]]"),),
    "no entities": (page(b'[{"id": 5, "type": null, "n": {"value": {"type": 7}}}, "x", null, 1e400]'),),
    "deep JSON": (page(b"[" * 100_000 + b"]" * 100_000),),
    "no UTF-8": (page(b'[{"id": "urn:x:\xff\xfe", "type": "T"}]'),),
    "500": (page(b"oops", b"HTTP/1.1 500 Internal Server Error\r\n"),),
    "a redirect": (b"HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1:1/\r\nContent-Length: 0\r\n\r\n",),
    "a redirect to itself": (b"HTTP/1.1 301 Moved\r\nLocation: /ngsi-ld/v1\r\nContent-Length: 0\r\n\r\n",),
    "no HTTP": (b"SSH-2.0-OpenSSH_9.6\r\n",),
    "nothing": (),
    "half a body": (HEAD + b"Content-Length: 1000\r\n\r\n[{",),
    "rubbish chunks": (HEAD + b"Transfer-Encoding: chunked\r\n\r\nZZ\r\n",),
    "odd headers": (b"HTTP/1.1 200 OK\r\nVia: ,,,;\xff\r\nLink: <<<>>>;;rel=\r\nContent-Range: x\r\n"
                    b"NGSILD-EntityMap: \xe9\r\nContent-Length: 3\r\n\r\n{[]",),
    "many headers": (page(b"[", HEAD + b"".join(b"X-%d: y\r\n" % number for number in range(5000))),),
}  # fmt: skip


@pytest.fixture(scope="module")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BrokerProcess]:
    """A broker of this module's own."""
    made = BrokerProcess(tmp_path_factory.mktemp("attacked")).start()
    yield made
    made.stop()


@pytest.fixture
def http(broker: BrokerProcess) -> Iterator[httpx.Client]:
    with broker.client() as client:
        yield client
        for one in client.get("/csourceRegistrations?idPattern=.*&limit=100").json():
            client.delete(f"/csourceRegistrations/{one['id']}")


@pytest.fixture
def rubbish() -> Iterator[RubbishSource]:
    made = RubbishSource()
    yield made
    made.stop()


def everything(http: httpx.Client, kind: str) -> dict[str, httpx.Response]:
    """Send every kind of query to a broker with one entity; return the responses."""
    one = f"urn:ngsi-ld:{kind}:1"
    past = {"timerel": "after", "timeAt": "2020-01-01T00:00:00Z", "timeproperty": "modifiedAt"}
    totals = {**past, "options": "aggregatedValues", "aggrMethods": "avg"}
    query = {"type": "Query", "entities": [{"type": kind}]}
    return {
        "retrieve": http.get(f"/entities/{one}"),
        "query": http.get("/entities", params={"type": kind}),
        "joined": http.get("/entities", params={"type": kind, "join": "inline"}),
        "posted": http.post("/entityOperations/query", json=query),
        "map": http.get("/entities", params={"type": kind, "entityMap": "true"}),
        "past": http.get(f"/temporal/entities/{one}", params=past),
        "pasts": http.get("/temporal/entities", params={"type": kind, **past}),
        "totals": http.get("/temporal/entities", params={"type": kind, **totals}),
        "past map": http.get("/temporal/entities", params={"type": kind, "entityMap": "true", **past}),
        "types": http.get("/types"),
        "detailed types": http.get("/types?details=true"),
        "type": http.get(f"/types/{kind}"),
        "attributes": http.get("/attributes"),
        "attribute": http.get("/attributes/n"),
    }


@pytest.mark.nightly
@pytest.mark.parametrize("said", RUBBISH)
def test_invalid_responses_cause_warnings_beside_the_other_results(
    http: httpx.Client, rubbish: RubbishSource, kind: str, said: str
) -> None:
    rubbish.says(*RUBBISH[said])
    one = put(http, f"urn:ngsi-ld:{kind}:1", kind, n=1)
    path = register(
        http, rubbish.url, {"type": kind}, operations=OPERATIONS, management={"timeout": PATIENCE_MS}
    )
    for name, answer in everything(http, kind).items():
        assert answer.status_code in {200, 201}, (name, answer.text)
        assert answer.headers["ngsild-warning"][:3] in {"111", "199", "299"}, (name, answer.text)
        assert one in answer.text or kind in answer.text or name in {"attributes", "attribute"}, name
    written = http.patch(f"/entities/{one}/attrs", json={"n": 2})
    assert written.status_code in {204, 207}, written.text
    assert http.get(f"/entities/{one}?local=true").json()["n"]["value"] == 2
    batch = http.post("/entityOperations/upsert", json=[{"id": one, "type": kind, "n": 3}])
    assert batch.status_code in {201, 204, 207}, batch.text
    assert http.get(f"/entities/{one}?local=true").json()["n"]["value"] == 3
    wish = {
        "type": "Subscription",
        "entities": [{"type": kind}],
        "notification": {"endpoint": {"uri": "http://127.0.0.1:9/"}},
    }
    made = http.post("/subscriptions", json=wish)
    assert made.status_code == 201, made.text
    assert http.delete(made.headers["location"].removeprefix("/ngsi-ld/v1")).status_code == 204
    returned = http.get(path).json()
    assert returned["timesSent"] >= returned["timesFailed"]


@pytest.mark.nightly
def test_dead_slow_and_endless_sources_cost_their_timeout_only(
    http: httpx.Client, broker: BrokerProcess, rubbish: RubbishSource, kind: str
) -> None:
    process = psutil.Process(broker.process.pid if broker.process else 0)
    put(http, f"urn:ngsi-ld:{kind}:1", kind, n=1)
    endless, good = RubbishSource(), RubbishSource()
    rubbish.says(HEAD, b"\r\n", *[b" "] * 100_000, pause_s=0.05)
    endless.answer = itertools.chain([HEAD, b"\r\n["], itertools.repeat(b" " * 65536))
    good.says(page(b'[{"id": "urn:ngsi-ld:good:1", "type": "%s", "n": 2}]' % kind.encode()))
    management = {"timeout": PATIENCE_MS, "cooldown": 60_000}
    for url in (f"http://127.0.0.1:{next_free_port()}", rubbish.url, endless.url, good.url):
        register(http, url, {"type": kind}, operations=["queryEntity"], management=management)
    first = http.get("/entities", params={"type": kind})
    assert {one["n"]["value"] for one in first.json()} == {1, 2}
    warnings = first.headers.get_list("ngsild-warning")
    assert len(", ".join(warnings).split('", ')) == 3, warnings
    before = good.sent
    for _ in range(20):
        again = http.get("/entities", params={"type": kind})
        assert {one["n"]["value"] for one in again.json()} == {1, 2}
    assert good.sent > before
    wait_for(lambda: rubbish.open == endless.open == 0, why="connections are left open")
    assert endless.sent < 200 * 1024 * 1024
    assert process.memory_info().rss < 400 * 1024 * 1024
    assert len(process.net_connections("tcp")) < 40
    for one in (endless, good):
        one.stop()


def test_many_requests_to_a_hanging_source_do_not_delay_others(
    http: httpx.Client, broker: BrokerProcess, rubbish: RubbishSource, kind: str
) -> None:
    rubbish.says(HEAD, closes=False)
    put(http, f"urn:ngsi-ld:{kind}:1", kind, n=1)
    put(http, f"urn:ngsi-ld:{kind}x:1", f"{kind}x", n=1)
    register(http, rubbish.url, {"type": kind}, management={"timeout": 60_000})
    answers: list[int] = []

    def ask() -> None:
        with broker.client() as client:
            answers.append(client.get("/entities", params={"type": kind}).status_code)

    threads = [threading.Thread(target=ask) for _ in range(8)]
    for thread in threads:
        thread.start()
    wait_for(lambda: rubbish.open > 0)
    assert http.get("/entities", params={"type": f"{kind}x"}).status_code == 200
    assert not answers, "the others had to wait for the source that hangs"
    rubbish.stop()
    for thread in threads:
        thread.join(120)
    assert answers == [200] * 8
