"""The perimeter: what every server of ours refuses, each as a process, asked over a socket."""

import json
import re
import select
import socket
from collections.abc import Iterable, Iterator
from contextlib import suppress
from http.client import HTTPConnection, HTTPResponse
from ipaddress import ip_address

import httpx
import pytest
from playwright.sync_api import Page, expect, sync_playwright
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from handover import services
from handover.extensions import Service
from handover_broker.app import operations_of
from handover_broker.settings import BrokerSettings
from tests.kit.cell import Cell, new_cell
from tests.kit.chromium import FLAGS, chromium
from tests.kit.other_broker import running
from tests.kit.paths import REPOSITORY
from tests.kit.skipping import OTHER_BROKER
from tests.kit.sockets import listening_sockets
from tests.kit.waiting import scaled

pytestmark = pytest.mark.slow

STARTED = (
    "context_broker",
    "task_orchestrator",
    "gesture_controller",
    "trajectory_tool",
    "study",
    "device_gateway",
    "alert_router",
    "accounts",
    "webui",
    "ros_fiware_bridge",
    "human_state",
    "assistive_devices",
    "whole_body_control",
)
SERVICES = tuple(one for one in STARTED if one != "context_broker" or not running.IS_OTHER)
"""Those that are ours: what another broker refuses is its own matter."""
WITHOUT_SCHEMA = {
    "webui": ("/notifications", "/api/task-orchestrator/processes", "/api/gesture-controller/gloves/g/pause"),
}
"""Routes that take a body and are not in the schema."""
WEBSOCKETS = {
    "gesture_controller": "/gloves/glove-1/live",
    "trajectory_tool": "/robots/ur10-1/joint_states",
    "webui": "/api/live",
    "human_state": "/limits",
    "whole_body_control": "/live",
}
READ = {
    "context_broker": "/ngsi-ld/v1/types",
    "task_orchestrator": "/processes",
    "gesture_controller": "/gloves",
    "trajectory_tool": "/robots",
    "study": "/sessions",
    "device_gateway": "/devices",
    "alert_router": "/routes",
    "accounts": "/users",
    "webui": "/api/events",
    "ros_fiware_bridge": "/rules",
    "human_state": "/people",
    "assistive_devices": "/machines",
    "whole_body_control": "/humanoids",
}
FOREIGN = {"Origin": "http://evil.example"}


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with new_cell(tmp_path_factory.mktemp("cell")) as made:
        made.extra["HANDOVER_BRIDGE_URL"] = "http://Bridge.cell:54100"
        made.extra["HANDOVER_ASSISTIVE_MACHINES"] = "bed"
        made.extra |= {"HANDOVER_HUMANOID_MODEL": "coman", "HANDOVER_HUMANOID_FIFO": "false"}
        made.start(*STARTED, within_s=90.0)
        yield made


@pytest.mark.nightly
def test_every_socket_is_on_loopback_and_documented(cell: Cell) -> None:
    """Of all processes and what they start; the ROS bridge joins a graph by datagrams."""
    ours = services.own_services()
    documented = {port for service in ours for port in ports_of(cell, service)}
    found = listening_sockets(cell.processes[name].pid for name in SERVICES)
    assert {one.port for one in found} >= {cell.ports[name] for name in (*SERVICES, "glove", "devices")}
    known = {one for one in found if one.protocol == "udp" and "handover_ros" in one.process}
    assert [one for one in found - known if not ip_address(one.address).is_loopback] == []
    assert [one for one in found - known if one.protocol != "tcp" or one.port not in documented] == []


def ports_of(cell: Cell, service: Service) -> set[int]:
    """Return the ports of a service in the cell, which is given the settings that the service documents."""
    fields = (service.port_field, *(field for _, field in service.also_listens))
    return {int(cell.environment[f"HANDOVER_{field.upper()}"]) for field in fields}


def asked(cell: Cell, service: str, method: str, path: str, **headers: str) -> HTTPResponse:
    """Send exactly these headers, with a body if there is a Content-Type."""
    connection = HTTPConnection("127.0.0.1", cell.ports[service], timeout=120)
    try:
        connection.putrequest(method, path, skip_host="host" in headers, skip_accept_encoding=True)
        body = b'{"x": 1}' if "content_type" in headers else b""
        for name, value in headers.items():
            connection.putheader(name.replace("_", "-"), value)
        if body:
            connection.putheader("content-length", str(len(body)))
        connection.endheaders(body)
        answer = connection.getresponse()
        answer.text = answer.read().decode()  # type: ignore[attr-defined]
        return answer
    finally:
        connection.close()


@pytest.mark.parametrize("service", SERVICES)
def test_a_rebound_name_reads_and_changes_nothing(cell: Cell, service: str) -> None:
    assert asked(cell, service, "GET", READ[service]).status == 200
    for host in ("evil.example", f"evil.example:{cell.ports[service]}", "127.0.0.1.evil.example", ""):
        for method in ("GET", "POST", "DELETE"):
            refused = asked(cell, service, method, READ[service], host=host)
            assert refused.status == 403, (host, method)
            assert "HANDOVER_ALLOWED_HOSTS" in refused.text  # type: ignore[attr-defined]
    for host in ("localhost", "[::1]:1", "127.0.0.1"):
        assert asked(cell, service, "GET", READ[service], host=host).status == 200


@pytest.mark.parametrize("service", SERVICES)
def test_a_page_of_another_site_reads_and_changes_nothing(cell: Cell, service: str) -> None:
    own = f"http://127.0.0.1:{cell.ports[service]}"
    assert asked(cell, service, "GET", READ[service], origin=own).status == 200
    for headers in ({"origin": "http://evil.example"}, {"origin": "null"}, {"sec_fetch_site": "cross-site"}):
        for method in ("GET", "POST", "OPTIONS"):
            assert asked(cell, service, method, READ[service], **headers).status == 403, (headers, method)


@pytest.mark.parametrize("service", SERVICES)
def test_a_request_needs_one_host(cell: Cell, service: str) -> None:
    port = cell.ports[service]
    for path in (READ[service], "/healthz"):
        for hosts in (b"", b"Host: 127.0.0.1\r\nHost: 127.0.0.1\r\n"):
            request = b"GET %b HTTP/1.1\r\n%bConnection: close\r\n\r\n" % (path.encode(), hosts)
            assert status_of(port, [request]) == 400, (path, hosts)
        assert status_of(port, [b"GET %b HTTP/1.0\r\n\r\n" % path.encode()]) == 200


def status_of(port: int, sent: Iterable[bytes]) -> int | None:
    """Send pieces until the server has answered or closed the connection; None if it has not answered."""
    with socket.create_connection(("127.0.0.1", port), timeout=scaled(120)) as link:
        with suppress(ConnectionError):
            for piece in sent:
                link.sendall(piece)
                if select.select([link], [], [], 0)[0]:
                    break
        answer = b""
        with suppress(ConnectionError):
            while piece := link.recv(65536):
                answer += piece
    return int(answer.split(maxsplit=2)[1]) if answer.startswith(b"HTTP/1.1 ") else None


def endless(begin: bytes, again: bytes) -> Iterator[bytes]:
    """Yield what never ends; a test that is not refused runs into its time limit."""
    yield begin
    while True:
        yield again * (65_536 // len(again))


ENDLESS = {
    "request line": (b"GET /", b"x"),
    "headers": (b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n", b"a: b\r\n"),
    "header": (b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nCookie: ", b"c"),
    "name": (b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n", b"n"),
    "handshake": (b"GET /api/live HTTP/1.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n", b"a: b\r\n"),
    "chunk extension": (b"POST /x HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\n1;", b"e"),
}
IN_A_BODY = frozenset({"chunk extension"})
"""The request may be answered before its body ends."""


@pytest.mark.nightly
def test_an_endless_head_is_refused_on_every_port(cell: Cell) -> None:
    """Of every socket that accepts connections; another client is served meanwhile."""
    found = listening_sockets(cell.processes[name].pid for name in SERVICES)
    ports = {one.port for one in found if one.protocol == "tcp"}
    assert ports >= {cell.ports[name] for name in (*SERVICES, "glove", "devices")}
    for port in sorted(ports):
        is_http = port in {cell.ports[name] for name in SERVICES}
        for name, (begin, again) in ENDLESS.items():
            status = status_of(port, endless(begin, again))
            if is_http and name not in IN_A_BODY:
                assert status == 431, (port, name)
            assert status is None or status >= 400, (port, name)
    for service in SERVICES:
        assert asked(cell, service, "GET", READ[service]).status == 200


@pytest.mark.parametrize("service", WEBSOCKETS)
def test_a_long_header_of_a_handshake_is_refused(cell: Cell, service: str) -> None:
    lines = ("Host: 127.0.0.1", "Upgrade: websocket", "Connection: Upgrade", f"Cookie: {'c' * 10_000}")
    request = "\r\n".join((f"GET {WEBSOCKETS[service]} HTTP/1.1", *lines, "", ""))
    assert status_of(cell.ports[service], [request.encode()]) == 431


@pytest.mark.parametrize("service", SERVICES)
def test_health_is_available_under_any_name(cell: Cell, service: str) -> None:
    for path in ("/healthz", "/readyz", "/metrics", "/context.jsonld"):
        assert asked(cell, service, "GET", path, host="cell-3.evil.example").status == 200, path


@pytest.mark.nightly
def test_the_docs_of_each_service_show_its_operations_without_another_host(cell: Cell) -> None:
    with sync_playwright() as playwright:
        flags = [*FLAGS, "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"]
        browser = playwright.chromium.launch(executable_path=chromium(), args=flags)
        for service in SERVICES:
            page = browser.new_page()
            own = (f"{cell.url(service)}/", "data:")
            requested, faults = watched(page)
            page.goto(f"{cell.url(service)}/docs")
            operations = page.locator(".opblock")
            expect(operations.first).to_be_visible(timeout=scaled(90) * 1000)
            document = httpx.get(f"{cell.url(service)}/openapi.json", timeout=120).json()
            described = sum(len(methods) for methods in document["paths"].values())
            expect(operations).to_have_count(described, timeout=scaled(90) * 1000)
            page.screenshot(path=REPOSITORY / "build" / "screenshots" / f"docs-{service}.png")
            assert [url for url in requested if not url.startswith(own)] == []
            assert faults == []
            page.close()
        browser.close()


def watched(page: Page) -> tuple[list[str], list[str]]:
    """Return the addresses that a page requests from now on, and what its console reports as an error."""
    requested: list[str] = []
    faults: list[str] = []
    page.on("request", lambda request: requested.append(request.url))
    page.on("console", lambda message: faults.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: faults.append(str(error)))
    return requested, faults


def test_a_service_answers_to_the_name_in_its_address(cell: Cell) -> None:
    """The origin check accepts it; without accounts only loopback names are local."""
    named = asked(cell, "ros_fiware_bridge", "GET", "/rules", host="bridge.cell:54100")
    assert named.status == 401
    assert asked(cell, "ros_fiware_bridge", "GET", "/healthz", host="bridge.cell:54100").status == 200
    assert asked(cell, "gesture_controller", "GET", "/gloves", host="bridge.cell").status == 403


@pytest.mark.nightly
@pytest.mark.parametrize("service", [one for one in SERVICES if one != "context_broker"])
def test_no_route_acts_on_plain_text_or_a_form(cell: Cell, service: str) -> None:
    schema = httpx.get(f"{cell.url(service)}/openapi.json", timeout=120).json()
    routes = [
        (method.upper(), re.sub(r"\{.*?\}", "x", path))
        for path, methods in schema["paths"].items()
        for method in methods
        if method != "get"
    ]
    routes += [("POST", path) for path in WITHOUT_SCHEMA.get(service, ())]
    assert routes, "every service has a route that changes something"
    for method, path in routes:
        for media_type in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data", "x"):
            refused = asked(cell, service, method, path, content_type=media_type)
            assert refused.status == 415, (method, path, media_type)
            assert json.loads(refused.text)["status"] == 415  # type: ignore[attr-defined]
        no_type = httpx.request(method, f"{cell.url(service)}{path}", content=b"x", timeout=120)
        assert no_type.status_code == 415, (method, path)


@pytest.mark.skipif(running.IS_OTHER, reason=OTHER_BROKER)
def test_no_operation_of_the_broker_acts_on_plain_text(cell: Cell, tmp_path: object) -> None:
    operations = operations_of(BrokerSettings(_env_file=None, data_dir=tmp_path))
    described = httpx.get(f"{cell.url('context_broker')}/openapi.json", timeout=120).json()["paths"]
    listed = {(one.method.lower(), f"/ngsi-ld/v1/{one.path}") for one in operations}
    assert listed <= {(method, path) for path, methods in described.items() for method in methods}
    with_body = [one for one in operations if one.method in {"POST", "PUT", "PATCH"}]
    assert len(with_body) > 10
    for one in with_body:
        path = "/ngsi-ld/v1/" + re.sub(r"\{.*?\}", "urn:ngsi-ld:X:1", one.path)
        for media_type in ("text/plain", "application/x-www-form-urlencoded"):
            answer = asked(cell, "context_broker", one.method, path, content_type=media_type)
            assert 400 <= answer.status < 500, (one.method, path)
    assert (
        json.loads(asked(cell, "context_broker", "GET", "/ngsi-ld/v1/entities?local=true&type=X").text) == []
    )  # type: ignore[attr-defined]


@pytest.mark.parametrize("service", WEBSOCKETS)
def test_a_websocket_opens_for_our_own_page_and_for_programs_only(cell: Cell, service: str) -> None:
    if service == "gesture_controller":
        httpx.put(f"{cell.url(service)}/gloves/glove-1", json={}, timeout=120).raise_for_status()
    url = f"ws://127.0.0.1:{cell.ports[service]}{WEBSOCKETS[service]}"
    for headers in (FOREIGN, {"Origin": "null"}, {"Host": "evil.example"}):
        with pytest.raises(InvalidStatus) as refused:
            connect(url, additional_headers=headers, proxy=None).__enter__()
        assert refused.value.response.status_code == 403
    own = None if service != "webui" else cell.url(service)
    with connect(url, origin=own, proxy=None) as link:
        assert link.recv(timeout=120)
