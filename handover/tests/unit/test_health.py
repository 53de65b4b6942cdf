"""Health: what a container's health check says of a service that is well, of one that is not, and of none."""

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from handover.health import main

ANSWERS = {
    "/readyz": (200, b'{"status": "ready"}'),
    "/ill": (503, b'{"status": "not ready", "broker": "does not answer"}'),
    "/glove": (200, b'{"connected": true, "holding": false}'),
    "/text": (200, b"well enough"),
}


class Service(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        status, body = ANSWERS[self.path]
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        pass


@pytest.fixture(scope="module")
def service() -> Iterator[str]:
    server = HTTPServer(("127.0.0.1", 0), Service)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


def test_a_ready_service_is_well(service: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([f"{service}/readyz"]) == 0
    assert capsys.readouterr().err == ""


def test_the_reason_is_printed_if_a_service_is_not_ready(
    service: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([f"{service}/ill"]) == 1
    assert "503" in (said := capsys.readouterr().err)
    assert "broker" in said


@pytest.mark.parametrize(
    ("path", "name", "code"),
    [("/glove", "connected", 0), ("/glove", "holding", 1), ("/glove", "left", 1), ("/text", "connected", 1)],
)
def test_what_must_be_true_must_be_said(service: str, path: str, name: str, code: int) -> None:
    assert main([f"{service}{path}", name]) == code


def test_nobody_there_is_not_well(free_port: object, capsys: pytest.CaptureFixture[str]) -> None:
    assert callable(free_port)
    assert main([f"http://127.0.0.1:{free_port()}/readyz"]) == 1
    assert "does not answer" in capsys.readouterr().err


def test_what_is_no_address_is_not_well(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["54200"]) == 1
    assert "54200" in capsys.readouterr().err


def test_without_an_address_it_says_how_it_is_used(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert "usage" in capsys.readouterr().err
