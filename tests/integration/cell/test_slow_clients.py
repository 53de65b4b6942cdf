"""Clients that never finish what they begin: the others are served meanwhile, and the slow ones are ended."""

import resource
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress

import httpx
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from tests.kit.cell import Cell

pytestmark = pytest.mark.slow

Eventually = Callable[..., None]

HALF_SENT = 1_100
HALF_A_HEAD = b"POST /ngsi-ld/v1/entities HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Ty"
NO_BODY = (
    b"POST /%b HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\nContent-Length: 50000\r\n\r\n"
)
WRITTEN = {
    "context_broker": b"ngsi-ld/v1/entities",
    "task_orchestrator": b"processes",
    "gesture_controller": b"gloves/glove-1/complete",
    "webui": b"api/operator",
}
READ = {"context_broker": "/ngsi-ld/v1/types", "webui": "/api/events"}


@pytest.fixture
def crowd(cell: Cell) -> Iterator[Callable[..., list[socket.socket]]]:
    """Open connections to a service that send something and no more."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with ExitStack() as stack:

        def opened(service: str, count: int, sent: bytes) -> list[socket.socket]:
            resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, max(soft, 4 * HALF_SENT)), hard))
            made = []
            for _ in range(count):
                link = socket.create_connection(("127.0.0.1", cell.ports[service]), timeout=120)
                stack.callback(link.close)
                with suppress(OSError):  # it may be closed already
                    link.sendall(sent)
                made.append(link)
            return made

        yield opened
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.fixture
def usual_file_limit() -> Iterator[None]:
    """Let what is started have the usual soft limit of open files, 1024, and the hard one of this machine."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(1024, hard), hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def answers(cell: Cell, service: str) -> bool:
    """Whether a client that comes now is served."""
    return httpx.get(f"{cell.url(service)}{READ.get(service, '/healthz')}", timeout=120).is_success


def is_closed(link: socket.socket) -> bool:
    """Whether the server has closed a connection; what it said before is read."""
    link.settimeout(0)
    try:
        while link.recv(65536):
            pass
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def closed(cell: Cell, service: str) -> str:
    """The metrics of connections that the server has ended."""
    text = httpx.get(f"{cell.url(service)}/metrics", timeout=120).text
    return "\n".join(line for line in text.splitlines() if line.startswith("handover_http_connections"))


@pytest.mark.nightly
@pytest.mark.parametrize("sent", [HALF_A_HEAD, NO_BODY % WRITTEN["context_broker"]])
def test_eleven_hundred_half_sent_requests_do_not_make_the_broker_unreachable(
    cell: Cell,
    usual_file_limit: None,
    crowd: Callable[..., list[socket.socket]],
    eventually: Eventually,
    sent: bytes,
) -> None:
    cell.start("context_broker")
    links = crowd("context_broker", HALF_SENT, sent)
    assert answers(cell, "context_broker"), "meanwhile"
    eventually(lambda: sum(map(is_closed, links)) >= HALF_SENT - 100, 60)
    assert answers(cell, "context_broker"), "after"
    assert 'reason="too many unfinished"' in closed(cell, "context_broker")


def test_a_newcomer_gets_in_when_the_server_is_full(
    cell: Cell, crowd: Callable[..., list[socket.socket]], eventually: Eventually
) -> None:
    cell.extra |= {
        "HANDOVER_HTTP_MAX_CONNECTIONS": "40",
        "HANDOVER_HTTP_MAX_UNFINISHED_PER_ADDRESS": "1000",
        "HANDOVER_HTTP_HEADER_TIMEOUT_S": "600",
    }
    cell.start("context_broker", "gesture_controller")
    for service in ("context_broker", "gesture_controller"):
        path = READ.get(service, "/healthz")
        idle = crowd(service, 60, f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
        assert answers(cell, service), "those that are idle give way"
        links = crowd(service, 60, HALF_A_HEAD)
        assert answers(cell, service), "those that have sent nothing complete give way"
        with httpx.Client(base_url=cell.url(service), timeout=120) as http:
            for _ in range(3):
                assert http.get(path).is_success
                crowd(service, 30, b"")
        assert 'reason="too many"' in closed(cell, service)
        assert any(map(is_closed, idle))
        assert any(map(is_closed, links))


def test_of_the_idle_connections_the_one_that_was_used_last_gives_way_last(
    cell: Cell, crowd: Callable[..., list[socket.socket]]
) -> None:
    cell.extra["HANDOVER_HTTP_MAX_CONNECTIONS"] = "40"
    cell.start("context_broker")
    get = b"GET /ngsi-ld/v1/types HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"

    def used(link: socket.socket) -> socket.socket:
        link.sendall(get)
        assert link.recv(65536).startswith(b"HTTP/1.1 200")
        return link

    first, *others = [used(link) for link in crowd("context_broker", 38, b"")]
    used(first)
    for _ in others[:30]:  # fewer than there are others: more connections may come to the broker meanwhile
        used(*crowd("context_broker", 1, b""))
    assert not is_closed(first)
    assert sum(map(is_closed, others)) > len(others) // 2


@pytest.mark.nightly
@pytest.mark.parametrize("service", WRITTEN)
def test_a_request_that_never_ends_is_ended(
    cell: Cell, crowd: Callable[..., list[socket.socket]], eventually: Eventually, service: str
) -> None:
    cell.extra |= {"HANDOVER_HTTP_HEADER_TIMEOUT_S": "1", "HANDOVER_HTTP_BODY_TIMEOUT_S": "1"}
    cell.start("context_broker", *({service} - {"context_broker"}))
    (silent,) = crowd(service, 1, b"")
    (half,) = crowd(service, 1, HALF_A_HEAD)
    (no_body,) = crowd(service, 1, NO_BODY % WRITTEN[service])
    (trickling,) = crowd(service, 1, NO_BODY % WRITTEN[service])
    stop_s = time.monotonic() + 60
    with suppress(OSError):
        while time.monotonic() < stop_s and not is_readable(trickling):
            trickling.sendall(b" ")
            time.sleep(0.1)
    eventually(lambda: is_closed(silent), 60)
    for slow in (half, no_body, trickling):
        slow.settimeout(60)
        said = b""
        with suppress(ConnectionResetError):
            while piece := slow.recv(65536):
                said += piece
        assert b" 408 " in said.split(b"\r\n")[0], said
    assert answers(cell, service)
    reported = closed(cell, service)
    assert 'reason="header timeout"' in reported
    assert 'reason="body timeout"' in reported
    assert "Traceback" not in cell.log(service)


def is_readable(link: socket.socket) -> bool:
    link.settimeout(0)
    try:
        link.recv(1, socket.MSG_PEEK)
    except BlockingIOError:
        return False
    finally:
        link.settimeout(60)
    return True


@pytest.mark.nightly
def test_a_body_that_comes_in_pieces_but_fast_enough_is_taken(cell: Cell) -> None:
    cell.extra |= {"HANDOVER_HTTP_BODY_TIMEOUT_S": "1", "HANDOVER_HTTP_MIN_BODY_BYTES_PER_S": "100"}
    cell.start("context_broker")
    body = b'{"id": "urn:ngsi-ld:X:slow", "type": "X", "a": {"type": "Property", "value": "%b"}}' % (
        b"x" * 3000
    )
    head = NO_BODY.replace(b"50000", b"%d" % len(body)) % WRITTEN["context_broker"]
    with socket.create_connection(("127.0.0.1", cell.ports["context_broker"]), timeout=120) as link:
        link.sendall(head)
        for start in range(0, len(body), 200):
            link.sendall(body[start : start + 200])
            time.sleep(0.2)
        assert b" 201 " in link.recv(65536)


@pytest.mark.nightly
def test_a_connection_that_is_used_stays(cell: Cell) -> None:
    cell.extra |= {
        "HANDOVER_HTTP_HEADER_TIMEOUT_S": "2",
        "HANDOVER_HTTP_BODY_TIMEOUT_S": "2",
        "HANDOVER_HTTP_MAX_UNFINISHED_PER_ADDRESS": "1",
    }
    cell.start("context_broker", "gesture_controller")
    for service in ("context_broker", "gesture_controller"):
        with ExitStack() as stack:
            never = httpx.Limits(keepalive_expiry=None)  # else the client closes after 5 s without a request
            clients = [
                stack.enter_context(httpx.Client(base_url=cell.url(service), timeout=120, limits=never))
                for _ in range(20)
            ]
            ports = set()
            for _ in range(3):
                for client in clients:
                    answer = client.get(READ.get(service, "/gloves"))
                    assert answer.is_success
                    stream = answer.extensions["network_stream"]
                    ports.add(stream.get_extra_info("client_addr"))
                time.sleep(4)  # longer than any request may take to come
            assert len(ports) == len(clients), "each has kept its connection"


def test_there_are_only_so_many_websockets(cell: Cell) -> None:
    cell.extra["HANDOVER_HTTP_MAX_WEBSOCKETS"] = "3"
    cell.start("context_broker", "trajectory_tool")
    url = f"ws://127.0.0.1:{cell.ports['trajectory_tool']}/robots/ur10-1/joint_states"
    with ExitStack() as stack:
        for _ in range(3):
            assert stack.enter_context(connect(url, proxy=None)).recv(timeout=120)
        with pytest.raises(InvalidStatus) as refused:
            connect(url, proxy=None).__enter__()
        assert refused.value.response.status_code == 503
    assert answers(cell, "trajectory_tool")
