"""Context sources for tests: a scripted one for faults, and what registers real brokers with each other."""

import json
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

import httpx

REGISTRATION = "ContextSourceRegistration"


class ScriptedSource:
    """A context source that notes what it is asked and answers what `answers` says, by method and path.

    An answer is a status and a document (or bytes), or a function that makes these of the query.
    """

    def __init__(self) -> None:
        self.answers: dict[tuple[str, str], tuple[int, Any] | Callable[[dict[str, str]], Any]] = {}
        self.asked: list[tuple[str, str, dict[str, str], dict[str, str], Any]] = []
        self.go_on = threading.Event()
        self.go_on.set()
        source = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"
            disable_nagle_algorithm = True  # else the body waits 40 ms for word that the headers came

            def answer(self) -> None:
                body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
                parts = urlsplit(self.path)
                query = {name: values[0] for name, values in parse_qs(parts.query).items()}
                headers = {name.lower(): value for name, value in self.headers.items()}
                source.asked.append((self.command, parts.path, query, headers, json.loads(body or b"null")))
                source.go_on.wait(30)
                answer = source.answers.get((self.command, parts.path), (404, None))
                status, said = answer(query) if callable(answer) else answer
                text = said if isinstance(said, bytes) else json.dumps(said).encode()
                try:
                    self.send_response(status)
                    self.send_header("Content-Type", "application/json")
                    self.send_header("Content-Length", str(0 if status == 204 else len(text)))
                    self.end_headers()
                    if status != 204:
                        self.wfile.write(text)
                except OSError:
                    self.close_connection = True

            do_GET = do_POST = do_PATCH = do_PUT = do_DELETE = answer  # noqa: N815 - http.server's names

            def log_message(self, *_: Any) -> None:
                pass

        class Server(ThreadingHTTPServer):
            daemon_threads = True
            request_queue_size = 64

            def handle_error(self, *_: Any) -> None:
                pass

        self.server = Server(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}"
        self._thread = threading.Thread(target=self.server.serve_forever, args=(0.02,), daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self.go_on.set()
        self.server.shutdown()
        self.server.server_close()
        self._thread.join(5)


def register(
    client: httpx.Client,
    endpoint: str,
    entities: dict[str, str] | None = None,
    attributes: list[str] | None = None,
    *,
    mode: str = "inclusive",
    operations: list[str] | None = None,
    **more: Any,
) -> str:
    """Register a source; return the path of the registration."""
    information: dict[str, Any] = {}
    if entities is not None:
        information["entities"] = [entities]
    if attributes is not None:
        information["propertyNames"] = attributes
    answer = client.post(
        "/csourceRegistrations",
        json={
            "type": REGISTRATION,
            "mode": mode,
            "operations": operations or ["retrieveOps" if mode == "auxiliary" else "redirectionOps"],
            "information": [information],
            "endpoint": endpoint,
            **more,
        },
    )
    assert answer.status_code == 201, answer.text
    return answer.headers["location"].removeprefix("/ngsi-ld/v1")


def put(client: httpx.Client, entity_id: str, kind: str, **attributes: Any) -> str:
    """Create an entity in one broker alone; return its id."""
    document = {"id": entity_id, "type": kind, **attributes}
    answer = client.post("/entities", json=document, params={"local": "true"})
    assert answer.status_code == 201, answer.text
    return entity_id


def values(answer: httpx.Response) -> dict[str, Any]:
    """Return the values of an entity's Properties by name."""
    assert answer.status_code == 200, answer.text
    return {name: said["value"] for name, said in answer.json().items() if isinstance(said, dict)}
