"""The broker of a cell in tests: our own, or another one in its place (`HANDOVER_TEST_BROKER`).

- not set: our own
- `strict`: our own behind the strict broker, which speaks as Orion-LD 1.6.0; `strict -history` without a rule
- `http://…`: that broker. Each cell has a tenant of its own in it, which a proxy adds to each request.

Another broker loads our @context from this run. If it is on another machine, `HANDOVER_TEST_CONTEXT_URL` is
where it does so.
"""

import functools
import hashlib
import json
import os
import secrets
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Final

import httpx

from handover.settings import Settings
from handover_datamodels.contexts import handover_context
from tests.kit import processes
from tests.kit.other_broker.profiles import ORION_LD, PLAIN
from tests.kit.paths import REPOSITORY
from tests.kit.ports import next_free_port
from tests.kit.processes import Process
from tests.kit.waiting import wait_for

BROKER: Final = os.environ.get("HANDOVER_TEST_BROKER", "")
IS_OTHER: Final = bool(BROKER)
URL: Final = BROKER if BROKER.startswith(("http://", "https://")) else ""
PROFILE: Final = PLAIN.name if URL else BROKER.replace("strict", ORION_LD.name)
MODULE: Final = "tests.kit.other_broker.strict_broker"
FOLDER: Final = "strict-broker"
"""Folder of the strict broker in the data directory of its cell: its switches and what it stores."""
QUERY: Final = "/ngsi-ld/v1/entities?type=Device&limit=1"


@functools.cache
def context_url() -> str:
    """Return where the brokers of tests load our @context.

    Another broker may keep it for ever, so its content is part of the address.
    """
    if not IS_OTHER:
        return str(Settings.model_fields["context_url"].default)
    if given := os.environ.get("HANDOVER_TEST_CONTEXT_URL"):
        return given
    document = json.dumps(handover_context()).encode()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "application/ld+json")
            self.send_header("Content-Length", str(len(document)))
            self.end_headers()
            self.wfile.write(document)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return f"http://127.0.0.1:{server.server_port}/{hashlib.sha256(document).hexdigest()[:16]}/context.jsonld"


def context_link() -> str:
    """Return the Link header of requests with our @context."""
    return f'<{context_url()}>; rel="http://www.w3.org/ns/json-ld#context"; type="application/ld+json"'


def settings() -> dict[str, str]:
    """Return the settings that the services of a cell need for another broker."""
    return {"HANDOVER_CONTEXT_URL": context_url()} if IS_OTHER else {}


def ready_path(service: str) -> str:
    """Return the path that answers with success when a service of a cell is ready."""
    return QUERY if IS_OTHER and service == "context_broker" else "/readyz"


@contextmanager
def orion_like(environment: Mapping[str, str], folder: Path) -> Iterator[str]:
    """Run a broker that speaks as Orion-LD 1.6.0 beside the broker of a cell; yield its URL."""
    port = next_free_port()
    broker = OtherBroker(port, folder, ORION_LD.name, "")
    own = {**environment, "HANDOVER_DATA_DIR": str(folder / "broker")}
    process = broker.spawn(own, folder / "strict-broker.log")
    url = f"http://127.0.0.1:{port}"
    try:
        wait_for(lambda: _answers(f"{url}{QUERY}"), 60, "the broker does not answer")
        yield url
    finally:
        processes.stop(process)
        broker.stop()


def _answers(url: str) -> bool:
    try:
        return httpx.get(url, timeout=120, trust_env=False).is_success
    except httpx.TransportError:
        return False


class OtherBroker:
    """The broker of a cell: the strict broker at `port`, before our own one unless there is a `url`."""

    def __init__(self, port: int, data_dir: Path, profile: str = PROFILE, url: str = URL) -> None:
        self.folder = data_dir / FOLDER
        self._port, self._data_dir, self._profile, self._url = port, data_dir, profile, url
        self._tenant = f"cell_{secrets.token_hex(6)}" if url else ""
        self._behind_port = next_free_port()
        self._behind: Process | None = None

    def spawn(self, environment: Mapping[str, str], log: Path) -> Process:
        """Start both without waiting, with the environment of our broker; return the process at `port`."""
        self.folder.mkdir(exist_ok=True)
        scheme = "https" if "HANDOVER_TLS_CERTIFICATE" in environment else "http"
        front = {
            **environment,
            "PYTHONPATH": str(REPOSITORY),
            "STRICT_BROKER_PORT": str(self._port),
            "STRICT_BROKER_TARGET": self._url or f"{scheme}://127.0.0.1:{self._behind_port}",
            "STRICT_BROKER_PROFILE": self._profile,
            "STRICT_BROKER_TENANT": self._tenant,
            "STRICT_BROKER_FOLDER": str(self.folder),
        }
        if not self._url:
            behind = {**environment, "HANDOVER_BROKER_PORT": str(self._behind_port)}
            self._behind = processes.spawn_module("handover_broker", behind, log, self._data_dir)
        return processes.spawn_module(MODULE, front, log, self._data_dir)

    def kill(self) -> None:
        """Kill the broker behind, as a power cut would."""
        if self._behind is not None:
            processes.kill(self._behind)
            self._behind = None

    def stop(self) -> None:
        """End the broker behind in good order."""
        if self._behind is not None:
            processes.stop(self._behind)
            self._behind = None
