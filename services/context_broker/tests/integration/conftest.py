"""Fixtures: a broker as a process, and a subscriber as an HTTP server."""

import itertools
import json
import re
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.runtime.python_processes import module_command
from tests.kit import processes
from tests.kit.context_sources import ScriptedSource
from tests.kit.databases import DATABASE
from tests.kit.ports import next_free_port
from tests.kit.waiting import scaled, wait_for

JSON = {"Content-Type": "application/json"}
LOG_LINE = re.compile(r"\S+ \[(info|warning|error)\s*\] ")


@dataclass
class BrokerProcess:
    """The broker on a port and a data directory of its own; `kill` ends it without notice."""

    data_dir: Path
    port: int = field(default_factory=next_free_port)
    extra: dict[str, str] = field(default_factory=dict)
    process: processes.Process | None = None
    log_dir: Path | None = None
    """Where its log goes, if not into the data directory."""
    is_forked: bool = True
    """Start it by the fork server; otherwise as `python -m`, which takes longer."""

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def api(self) -> str:
        return f"{self.url}/ngsi-ld/v1"

    def log(self) -> str:
        return ((self.log_dir or self.data_dir) / "log").read_text(errors="replace")

    def spawn(self) -> processes.Process:
        environment = processes.clean_environment()
        environment |= {"HANDOVER_BROKER_PORT": str(self.port), "HANDOVER_DATA_DIR": str(self.data_dir)}
        module, log = "handover_broker", (self.log_dir or self.data_dir) / "log"
        if self.is_forked:
            return processes.spawn_module(module, environment | self.extra, log, self.data_dir)
        command = module_command(module)
        return processes.spawn(command, environment | self.extra, log, self.data_dir)

    def start(self) -> "BrokerProcess":
        self.process = self.spawn()
        processes.wait_ready(self.process, f"{self.url}/readyz", self.log)
        return self

    def start_unready(self) -> httpx.Response:
        """Start a broker that will not be ready, and return its first answer to /readyz."""
        process = self.process = self.spawn()
        return wait_for(
            lambda: processes.answer(process, f"{self.url}/readyz", self.log),
            why="the broker does not answer",
        )

    def refused_start(self) -> str:
        """Start a broker that refuses to, and return why: one line, the last, after lines of its log only."""
        file = (self.log_dir or self.data_dir) / "log"
        said = len(self.log()) if file.exists() else 0
        process = self.spawn()
        try:
            assert process.wait(scaled(60)) == 2, self.log()[said:]
        finally:
            process.kill()
        *logged, reason = self.log()[said:].strip().splitlines()
        assert reason.startswith("context-broker: "), reason
        assert [line for line in logged if not LOG_LINE.match(line)] == []
        return reason

    def kill(self) -> None:
        assert self.process is not None
        processes.kill(self.process)
        self.process = None

    def stop(self) -> None:
        if self.process is None:
            return
        try:
            processes.stop(self.process)
        finally:
            self.process = None

    def client(self) -> httpx.Client:
        return httpx.Client(base_url=self.api, timeout=120, trust_env=False)

    def metric(self, name: str) -> float:
        text = httpx.get(f"{self.url}/metrics", trust_env=False, timeout=120).text
        return sum(
            float(value) for value in re.findall(rf"^{name}(?:{{[^}}]*}})? (\S+)$", text, re.MULTILINE)
        )


DATABASES = ("sqlite", "postgresql")
ON_BOTH = {
    "test_batches",
    "test_entities",
    "test_queries",
    "test_subscriptions",
    "test_temporal_changes",
    "test_temporal_queries",
}
"""Modules whose tests run on both databases; the others run on one, unless a test is parametrized."""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run the tests of `ON_BOTH` on both databases."""
    if metafunc.module.__name__.rpartition(".")[2] in ON_BOTH and "shared_broker" in metafunc.fixturenames:
        metafunc.parametrize("shared_broker", DATABASES, indirect=True, scope="module")


def on(request: pytest.FixtureRequest) -> dict[str, str]:
    """Return the settings for the database of a test: its parameter, or the default."""
    if getattr(request, "param", DATABASE) == "sqlite":
        return {}
    return {"HANDOVER_BROKER_DATABASE_URL": request.getfixturevalue("new_database")()}


@pytest.fixture(scope="module")
def shared_broker(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[BrokerProcess]:
    """A broker for all tests of a module; each uses ids and types of its own."""
    broker = BrokerProcess(tmp_path_factory.mktemp("broker"), extra=on(request)).start()
    yield broker
    broker.stop()


@pytest.fixture
def http(shared_broker: BrokerProcess) -> Iterator[httpx.Client]:
    """A client of the shared broker."""
    with shared_broker.client() as client:
        yield client


@pytest.fixture
def own_broker(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[BrokerProcess]:
    """A broker for one test, which may kill it and start it again; not started yet."""
    broker = BrokerProcess(tmp_path, extra=on(request))
    yield broker
    broker.stop()


@pytest.fixture
def broker_on() -> Iterator[Callable[[Path], BrokerProcess]]:
    """Return a broker in a given folder; not started yet."""
    made: list[BrokerProcess] = []

    def on_folder(folder: Path) -> BrokerProcess:
        made.append(BrokerProcess(folder, log_dir=folder.parent))
        return made[-1]

    yield on_folder
    for broker in made:
        broker.stop()


class Subscriber:
    """A subscriber that records notifications, and answers with a configured status."""

    def __init__(self, port: int = 0) -> None:
        self.received: list[dict[str, Any]] = []
        self.headers: list[dict[str, str]] = []
        self.status = 200
        self.refuses: Callable[[Any], bool] | None = None
        self.go_on = threading.Event()
        self.go_on.set()
        subscriber = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"
            disable_nagle_algorithm = True  # else a body waits 40 ms for word that the headers came

            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                subscriber.go_on.wait(60)
                status = subscriber.status
                if subscriber.refuses is not None and subscriber.refuses(json.loads(body)):
                    status = 500
                if status < 300:
                    subscriber.headers.append({name.lower(): value for name, value in self.headers.items()})
                    subscriber.received.append(json.loads(body))
                try:
                    self.send_response(status)
                    self.send_header("Content-Length", "0")
                    self.end_headers()
                except OSError:
                    self.close_connection = True  # the broker had no patience left

            def do_GET(self) -> None:
                body = json.dumps(subscriber.document).encode()
                self.send_response(200 if subscriber.document is not None else 404)
                self.send_header("Content-Type", "application/ld+json")
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: Any) -> None:
                pass

        class Server(ThreadingHTTPServer):
            daemon_threads = True
            request_queue_size = 64

            def handle_error(self, *_: Any) -> None:
                pass  # a broker that was killed leaves its connections behind

        self.document: Any = None
        self.server = Server(("127.0.0.1", port), Handler)
        self.port = self.server.server_address[1]
        self.url = f"http://127.0.0.1:{self.port}/notify"
        self._thread = threading.Thread(target=self.server.serve_forever, args=(0.02,), daemon=True)
        self._thread.start()

    def entities(self, subscription: str | None = None) -> list[dict[str, Any]]:
        return [
            entity
            for one in list(self.received)
            if subscription in {None, one["subscriptionId"]}
            for entity in one["data"]
        ]

    def stop(self) -> None:
        self.go_on.set()
        self.server.shutdown()
        self.server.server_close()
        self._thread.join(120)


@pytest.fixture
def subscriber() -> Iterator[Subscriber]:
    """A subscriber that answers 200."""
    made = Subscriber()
    yield made
    made.stop()


@pytest.fixture
def new_subscriber() -> Iterator[Callable[..., Subscriber]]:
    """Make subscribers, on a given port if need be."""
    made: list[Subscriber] = []

    def make(port: int = 0) -> Subscriber:
        made.append(Subscriber(port))
        return made[-1]

    yield make
    for one in made:
        one.stop()


@pytest.fixture(scope="session")
def brokers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[BrokerProcess]]:
    """Three brokers that can be registered with each other."""
    made = [BrokerProcess(tmp_path_factory.mktemp(name)) for name in ("near", "far", "third")]
    for one in made:
        one.extra = {"HANDOVER_BROKER_SOURCE_TIMEOUT_S": "15"}
        one.start()
    yield made
    for one in made:
        one.stop()


@pytest.fixture
def near(brokers: list[BrokerProcess]) -> Iterator[httpx.Client]:
    """A client of the first broker, whose registrations go when the test ends."""
    with brokers[0].client() as client:
        yield client
        for one in client.get("/csourceRegistrations?idPattern=.*&limit=100").json():
            client.delete(f"/csourceRegistrations/{one['id']}")


@pytest.fixture
def far(brokers: list[BrokerProcess]) -> Iterator[httpx.Client]:
    """A client of the second broker, which may be registered with the first."""
    with brokers[1].client() as client:
        yield client


@pytest.fixture
def source() -> Iterator[ScriptedSource]:
    """A context source with configured responses."""
    made = ScriptedSource()
    yield made
    made.stop()


@pytest.fixture
def kind() -> str:
    """A type of entities that no other test has."""
    return f"Kind{next(_kinds)}"


_kinds = itertools.count(1)


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A certificate of 127.0.0.1 that vouches for itself, and its key."""
    program = shutil.which("openssl")
    if program is None:
        pytest.skip("openssl is not installed; apt-get install openssl")
    folder = tmp_path_factory.mktemp("tls")
    made, key = folder / "certificate.pem", folder / "key.pem"
    subject = ["-subj", "/CN=127.0.0.1", "-addext", "subjectAltName=IP:127.0.0.1"]
    words = [
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:prime256v1",
        "-nodes",
        "-days",
        "2",
    ]
    subprocess.run(
        [program, *words, *subject, "-keyout", str(key), "-out", str(made)], check=True, capture_output=True
    )
    return made, key
