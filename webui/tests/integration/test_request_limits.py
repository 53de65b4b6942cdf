"""Proxied requests that never end: services stay reachable, and nothing leaks."""

import re
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress

import httpx
import pytest

from tests.kit.cell import Cell
from tests.kit.waiting import Bound

pytestmark = pytest.mark.slow

UPLOADS = 80
HEAD = (
    b"POST %b HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/xml\r\nContent-Length: 900000\r\n\r\n"
)
THROUGH = b"/api/task-orchestrator/definitions"
MORE_THAN_IS_BUFFERED = b" " * 300_000


@pytest.fixture
def upload() -> Iterator[Callable[..., socket.socket]]:
    """Start an upload to a port."""
    with ExitStack() as stack:

        def start(port: int, path: bytes, sent: bytes) -> socket.socket:
            link = socket.create_connection(("127.0.0.1", port), timeout=120)
            stack.callback(link.close)
            link.sendall(HEAD % path + sent)
            return link

        yield start


@pytest.fixture
def page(cell: Cell) -> Iterator[httpx.Client]:
    """A client of the page's server."""
    with httpx.Client(base_url=cell.url("webui"), timeout=120) as client:
        yield client


def value_of(url: str, metric: str) -> float:
    text = httpx.get(f"{url}/metrics", timeout=120).text
    return sum(
        float(one) for one in re.findall(rf"^{re.escape(metric)}(?:\{{.*\}})? (\S+)$", text, re.MULTILINE)
    )


@pytest.mark.nightly
@pytest.mark.parametrize("sent", [b" ", MORE_THAN_IS_BUFFERED])
def test_eighty_slow_uploads_block_no_service(
    cell: Cell,
    page: httpx.Client,
    upload: Callable[..., socket.socket],
    eventually: Callable[..., None],
    sent: bytes,
) -> None:
    cell.start("context_broker", "task_orchestrator")
    cell.extra["HANDOVER_HTTP_BODY_TIMEOUT_S"] = "6"
    cell.extra["HANDOVER_HTTP_MIN_BODY_BYTES_PER_S"] = "100000"
    cell.start("webui")
    definitions = "/api/task-orchestrator/definitions"
    shipped = page.get(f"{definitions}/bin-picking/bpmn").content
    xml = {"Content-Type": "application/xml"}
    links = [upload(cell.ports["webui"], THROUGH, sent) for _ in range(UPLOADS)]
    said: dict[socket.socket, bytes] = {}
    bound = Bound(90)
    while len(said) < UPLOADS:
        bound.check(lambda: f"{len(said)} of {UPLOADS} uploads were ended")
        assert page.get(definitions).status_code == 200
        assert page.post(definitions, content=shipped, headers=xml).status_code == 200
        for link in links:
            if link not in said and (answer := trickled(link)) is not None:
                said[link] = answer
        time.sleep(0.2)
    statuses = {answer.split(b" ")[1] for answer in said.values() if answer}
    assert statuses <= {b"408", b"429"}
    assert b"408" in statuses
    eventually(lambda: value_of(cell.url("webui"), "handover_webui_proxied_requests_active") == 0, 60)
    unfinished = 'handover_http_connections{state="unfinished"}'
    eventually(lambda: unfinished_at(cell.url("task_orchestrator"), unfinished) <= 1, 60)
    assert "Traceback" not in cell.log("webui")
    assert "Traceback" not in cell.log("task_orchestrator")


def unfinished_at(url: str, series: str) -> float:
    text = httpx.get(f"{url}/metrics", timeout=120).text
    return next(float(line.split()[-1]) for line in text.splitlines() if line.startswith(series))


def trickled(link: socket.socket) -> bytes | None:
    """Send one more byte; return the response, b"" for a closed connection, None for neither."""
    link.settimeout(0)
    try:
        return link.recv(65536)
    except BlockingIOError:
        pass
    except OSError:
        return b""
    with suppress(OSError):
        link.sendall(b" ")
    return None


@pytest.mark.nightly
def test_aborted_uploads_log_no_error(
    cell: Cell, upload: Callable[..., socket.socket], eventually: Callable[..., None]
) -> None:
    cell.start("context_broker", "task_orchestrator", "webui")
    for port, path in ((cell.ports["webui"], THROUGH), (cell.ports["task_orchestrator"], b"/definitions")):
        for sent in (b"<bpmn", MORE_THAN_IS_BUFFERED):
            link = upload(port, path, sent)
            url = f"http://127.0.0.1:{port}"
            assert httpx.get(f"{url}/healthz", timeout=120).is_success, "what was sent has been read by now"
            link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            link.close()
    eventually(lambda: value_of(cell.url("webui"), "handover_webui_proxied_requests_active") == 0, 60)
    for service in ("webui", "task_orchestrator"):
        assert httpx.get(f"{cell.url(service)}/healthz", timeout=120).is_success
        assert "Traceback" not in cell.log(service)
        assert "request failed" not in cell.log(service)
