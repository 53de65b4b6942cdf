"""Outgoing connections: the outbound policy, redirects and size limits."""

import functools
import gzip
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import orjson
import pytest

from handover_accounts.set_up import set_up
from handover_accounts.settings import AccountsSettings
from services.context_broker.tests.integration.acts import Eventually, create, subscribe
from services.context_broker.tests.integration.conftest import BrokerProcess
from tests.kit import processes
from tests.kit.context_sources import put, register
from tests.kit.ports import next_free_port
from tests.kit.waiting import wait_for

SETTING = "HANDOVER_OUTBOUND_ALLOW"
BEYOND_LOOPBACK = {"HANDOVER_HOST": "127.1", "HANDOVER_TLS_PROXY_URL": "https://cell.example"}
"""Listens on 127.0.0.1 by a name that is no loopback address as it is written, so it counts as any other."""
CLIENT = "cli"
CONTEXT = orjson.dumps({"@context": {"speed": "https://a.example/speed"}})
Page = tuple[int, dict[str, str], bytes]


@functools.cache
def bomb() -> bytes:
    """Return 200 MB of zeros, packed: made when a test needs it, not when each worker collects the tests."""
    return gzip.compress(bytes(200 * 1024 * 1024))


class Pages:
    """A server of given pages by path; records its requests."""

    def __init__(self) -> None:
        self.pages: dict[str, Page] = {}
        self.asked: list[str] = []
        pages = self

        class Handler(BaseHTTPRequestHandler):
            def answer(self) -> None:
                self.rfile.read(int(self.headers.get("Content-Length", 0)))
                path = self.path.partition("?")[0]
                pages.asked.append(path)
                status, headers, body = pages.pages.get(path, (404, {}, b""))
                self.send_response(status)
                for name, value in {"Content-Length": str(len(body)), **headers}.items():
                    self.send_header(name, value)
                self.end_headers()
                self.wfile.write(body)

            do_GET = do_POST = do_PATCH = answer  # noqa: N815 - http.server's names

            def log_message(self, *_: Any) -> None:
                pass

        class Server(ThreadingHTTPServer):
            daemon_threads = True

            def handle_error(self, *_: Any) -> None:
                pass  # the broker closed the connection

        self._server = Server(("127.0.0.1", 0), Handler)
        self.port = self._server.server_address[1]
        self.url = f"http://127.0.0.1:{self.port}"
        threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True).start()

    def redirects(self, path: str, to: str, status: int = 302) -> None:
        self.pages[path] = status, {"Location": to}, b""

    def stop(self) -> None:
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture
def pages() -> Iterator[Pages]:
    made = Pages()
    yield made
    made.stop()


@pytest.fixture(scope="module")
def accounts(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """Accounts, which a broker beyond loopback needs; the settings of that broker."""
    folder, port = tmp_path_factory.mktemp("accounts"), next_free_port()
    set_up(AccountsSettings.load(data_dir=folder), ["context-broker", CLIENT])
    environment = processes.clean_environment() | {
        "HANDOVER_DATA_DIR": str(folder),
        "HANDOVER_ACCOUNTS_PORT": str(port),
    }
    process = processes.spawn_module("handover_accounts", environment, folder / "log", folder)
    processes.wait_ready(process, f"http://127.0.0.1:{port}/readyz", (folder / "log").read_text, 60)
    yield {
        **BEYOND_LOOPBACK,
        "HANDOVER_ACCOUNTS_URL": f"http://127.0.0.1:{port}",
        "HANDOVER_SECURITY_DIR": str(folder / "security"),
    }
    processes.stop(process)


@contextmanager
def client_of(broker: BrokerProcess) -> Iterator[httpx.Client]:
    """Yield a client with the token of a service, once the broker knows the revocations."""
    token = Path(broker.extra["HANDOVER_SECURITY_DIR"], "service-tokens", CLIENT).read_text().strip()
    with broker.client() as client:
        client.headers["Authorization"] = f"Bearer {token}"
        wait_for(lambda: client.delete("/subscriptions/urn:x:none").status_code == 404)
        yield client


@pytest.fixture(scope="module")
def strict(tmp_path_factory: pytest.TempPathFactory, accounts: dict[str, str]) -> Iterator[httpx.Client]:
    """A client of a broker that listens beyond loopback, with nothing allowed."""
    broker = BrokerProcess(tmp_path_factory.mktemp("strict"), extra=dict(accounts)).start()
    with client_of(broker) as client:
        yield client
    broker.stop()


def link(url: str) -> dict[str, str]:
    return {"Link": f'<{url}>; rel="http://www.w3.org/ns/json-ld#context"; type="application/ld+json"'}


def fetched(http: httpx.Client, url: str) -> httpx.Response:
    """Have the broker fetch the @context at a URL."""
    return http.get("/entities", params={"type": "T"}, headers=link(url))


def subscription(uri: str) -> dict[str, Any]:
    return {
        "type": "Subscription",
        "entities": [{"type": "T"}],
        "notification": {"endpoint": {"uri": uri}},
    }


@pytest.mark.nightly
@pytest.mark.parametrize(
    "host", ["127.0.0.1", "localhost", "10.0.0.1", "[64:ff9b::7f00:1]", "169.254.169.254"]
)
def test_a_refused_address_is_a_bad_request(strict: httpx.Client, host: str) -> None:
    uri = f"http://{host}:9/"
    registration = {
        "type": "ContextSourceRegistration",
        "information": [{"entities": [{"type": "T"}]}],
        "endpoint": uri,
    }
    query = {"type": "Query", "entities": [{"type": "T"}]}
    snapshot = {"type": "Snapshot", "snapshotQueries": [query], "endpoint": uri}
    for path, document in (
        ("/subscriptions", subscription(uri)),
        ("/subscriptions", subscription(f"mqtt://{host}/topic")),
        ("/csourceSubscriptions", subscription(uri)),
        ("/csourceRegistrations", registration),
        ("/snapshots", snapshot),
    ):
        answer = strict.post(path, json=document)
        assert (answer.status_code, SETTING in answer.text) == (400, True), (path, answer.text)


def test_no_context_is_fetched_from_a_refused_address(strict: httpx.Client, pages: Pages) -> None:
    pages.pages["/c.jsonld"] = 200, {}, CONTEXT
    answer = fetched(strict, f"{pages.url}/c.jsonld")
    assert (answer.status_code, SETTING in answer.text) == (504, True), answer.text
    assert pages.asked == []


@pytest.mark.nightly
def test_the_setting_allows_hosts_until_it_changes(
    tmp_path: Path, pages: Pages, subscriber: Any, eventually: Eventually, accounts: dict[str, str]
) -> None:
    broker = BrokerProcess(tmp_path, extra={**accounts, SETTING: "scada.example,127.0.0.1"}).start()
    pages.pages["/c.jsonld"] = 200, {}, CONTEXT
    try:
        with client_of(broker) as http:
            assert fetched(http, f"{pages.url}/c.jsonld").status_code == 200
            path = f"/subscriptions/{subscribe(http, 'Open', subscriber.url)}"
            registered = register(http, pages.url, {"type": "There"})
            create(http, "Open", n=1)
            eventually(lambda: subscriber.received)
            put(http, "urn:x:there", "There", n=1)
            http.get("/entities/urn:x:there")
            assert "/ngsi-ld/v1/entities/urn:x:there" in pages.asked
        broker.stop()
        broker.extra = dict(accounts)
        broker.start()
        before = len(pages.asked)
        with client_of(broker) as http:
            create(http, "Open", "2", n=2)
            eventually(lambda: http.get(path).json()["notification"].get("timesFailed", 0) >= 1)
            assert SETTING in broker.log()
            assert len(subscriber.received) == 1
            answer = http.get("/entities/urn:x:there")
            assert answer.status_code == 200
            assert answer.headers["ngsild-warning"].startswith("199")
            assert http.get(registered).json()["status"] == "failed"
            assert http.patch("/entities/urn:x:there/attrs", json={"n": 2}).status_code == 207
        assert len(pages.asked) == before
    finally:
        broker.stop()


def test_each_redirect_of_a_context_is_checked(http: httpx.Client, pages: Pages) -> None:
    pages.pages["/end.jsonld"] = 200, {}, CONTEXT
    pages.redirects("/good.jsonld", "/next.jsonld", 301)
    pages.redirects("/next.jsonld", f"{pages.url}/end.jsonld", 307)
    assert fetched(http, f"{pages.url}/good.jsonld").status_code == 200
    for number, (to, why) in enumerate(
        (
            ("http://169.254.169.254/latest/meta-data", SETTING),
            (f"http://me:secret@127.0.0.1:{pages.port}/end.jsonld", "credentials"),
            ("file:///etc/passwd", "not an http or https URL"),
            ("http://[", "not an http or https URL"),
        )
    ):
        pages.redirects(f"/bad{number}.jsonld", to)
        answer = fetched(http, f"{pages.url}/bad{number}.jsonld")
        assert (answer.status_code, why in answer.text, "redirects" in answer.text) == (504, True, True), to
        assert "secret" not in answer.text
    pages.redirects("/round.jsonld", "/round.jsonld")
    answer = fetched(http, f"{pages.url}/round.jsonld")
    assert (answer.status_code, "more than 5 times" in answer.text) == (504, True)
    assert pages.asked.count("/round.jsonld") == 6
    assert pages.asked.count("/end.jsonld") == 1


@pytest.mark.parametrize("who", ["me:secret@", "me@", ":secret@"])
def test_no_context_is_fetched_with_credentials(http: httpx.Client, pages: Pages, who: str) -> None:
    answer = fetched(http, f"http://{who}127.0.0.1:{pages.port}/c.jsonld")
    assert (answer.status_code, "credentials" in answer.text) == (400, True), answer.text
    assert "secret" not in answer.text
    assert pages.asked == []


def test_redirects_of_notifications_are_not_followed(
    http: httpx.Client, pages: Pages, subscriber: Any, kind: str, eventually: Eventually
) -> None:
    pages.redirects("/notify", subscriber.url, 307)
    path = f"/subscriptions/{subscribe(http, kind, f'{pages.url}/notify')}"
    create(http, kind, n=1)
    eventually(lambda: http.get(path).json()["notification"].get("timesFailed", 0) >= 1)
    assert subscriber.received == []


@pytest.mark.nightly
def test_a_compression_bomb_is_not_inflated(
    http: httpx.Client, shared_broker: BrokerProcess, pages: Pages, kind: str
) -> None:
    packed = {"Content-Encoding": "gzip", "Content-Type": "application/json"}
    entity_id = put(http, f"urn:ngsi-ld:{kind}:1", kind, n=1)
    register(http, pages.url, {"type": kind}, operations=["queryEntity"])
    pages.pages["/packed.jsonld"] = 200, packed, gzip.compress(CONTEXT)
    pages.pages["/ngsi-ld/v1/entities"] = 200, packed, gzip.compress(b"[]")
    assert fetched(http, f"{pages.url}/packed.jsonld").status_code == 200
    whole = http.get("/entities", params={"type": kind})
    assert (whole.status_code, "ngsild-warning" in whole.headers) == (200, False)
    before = _peak_bytes(shared_broker)
    pages.pages["/bomb.jsonld"] = 200, packed, bomb()
    answer = fetched(http, f"{pages.url}/bomb.jsonld")
    assert (answer.status_code, "inflates to more than" in answer.text) == (504, True), answer.text
    pages.pages["/odd.jsonld"] = 200, {"Content-Encoding": "br"}, b"x"
    assert "Content-Encoding br" in fetched(http, f"{pages.url}/odd.jsonld").text
    assert _peak_bytes(shared_broker) - before < 32 * 1024 * 1024
    pages.pages["/ngsi-ld/v1/entities"] = 200, packed, bomb()
    rest = http.get("/entities", params={"type": kind})
    assert [one["id"] for one in rest.json()] == [entity_id]
    assert rest.headers["ngsild-warning"].startswith("111")
    assert _peak_bytes(shared_broker) - before < 128 * 1024 * 1024, "32 MiB are read of a source's answer"


def _peak_bytes(broker: BrokerProcess) -> int:
    """Return the peak memory of the broker."""
    assert broker.process is not None
    status = Path(f"/proc/{broker.process.pid}/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) * 1024
