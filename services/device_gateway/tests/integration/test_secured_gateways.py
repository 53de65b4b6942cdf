"""Gateways with accounts and TLS: replicas that pass requests on, and an edge in another network."""

import json
import socket
import ssl
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.network.tls_trust import client_context
from handover.security.caller import Caller, CallerKind
from handover.security.permissions import Grant, Role
from handover.transport_security.local_authority import ServerFiles
from handover_accounts.settings import AccountsSettings
from handover_accounts.signing_keys import SigningKeys
from services.device_gateway.tests.integration.conftest import SENSOR
from tests.kit import processes
from tests.kit.cell import Cell, new_cell
from tests.kit.certificates import Certificates, wait_ready_over_tls
from tests.kit.other_broker.running import ready_path
from tests.kit.private_network import CENTRE, Namespace, other_machine
from tests.kit.waiting import wait_for
from webui.tests.integration.test_signing_in import set_up

pytestmark = pytest.mark.slow

NAME = "gateway.test"
"""The name in the certificates: replicas are reached by address, and verified by name."""
EDGE = "site-1"


class SecuredCell(Cell):
    """A cell with accounts, whose servers have a certificate."""

    files: ServerFiles

    def url(self, service: str) -> str:
        return super().url(service).replace("http:", "https:")

    def wait_ready(self, service: str, within_s: float = 90.0) -> None:
        path = ready_path(service)
        wait_ready_over_tls(self.url(service), self.files, lambda: self.log(service), within_s, path)

    def token(self, name: str, *grants: Grant) -> str:
        """Return an access token as accounts issues it."""
        data = Path(self.extra["HANDOVER_SECURITY_DIR"]).parent
        settings = AccountsSettings.load(data_dir=data)
        keys = SigningKeys(settings.signing_keys_file, settings.security_folder)
        return keys.signing_key().issue(
            Caller(CallerKind.USER, f"user-{name}", name.capitalize(), grants), valid_s=3600
        )

    def client(self, token: str | None = None, **headers: str) -> httpx.Client:
        """Return a client of the gateway of this cell."""
        given = headers if token is None else {"Authorization": f"Bearer {token}", **headers}
        trust = client_context(self.files.authority)
        return httpx.Client(
            base_url=self.url("device_gateway"), verify=trust, trust_env=False, timeout=120, headers=given
        )


@pytest.fixture
def new_secured(tmp_path: Path) -> Iterator[Callable[..., SecuredCell]]:
    """Make cells that share accounts, authority and broker; the first one runs accounts and the broker."""
    files = Certificates(tmp_path / "certificates").make(NAME, "localhost", "127.0.0.1", CENTRE)
    made: list[SecuredCell] = []
    with ExitStack() as stack:

        def secured(**extra: str) -> SecuredCell:
            folder = tmp_path / f"cell-{len(made)}"
            folder.mkdir()
            plain = stack.enter_context(new_cell(folder))
            cell = SecuredCell(plain.data_dir, plain.ports, processes=plain.processes)
            cell.files = files
            first = made[0] if made else cell
            for service in ("context_broker", "accounts"):
                cell.ports[service] = first.ports[service]
            cell.extra.update(
                HANDOVER_SECURITY_DIR=str(first.data_dir / "security"),
                HANDOVER_TLS_CERTIFICATE=str(files.certificate),
                HANDOVER_TLS_KEY=str(files.key),
                HANDOVER_DEVICE_TLS_CERTIFICATE=str(files.certificate),
                HANDOVER_DEVICE_TLS_KEY=str(files.key),
                HANDOVER_TLS_AUTHORITY=str(files.authority),
                HANDOVER_AUTHORITY_DIR=str(tmp_path / "certificates" / "authority"),
                HANDOVER_ALLOWED_HOSTS=NAME,
                **extra,
            )
            if not made:
                set_up(cell)
                cell.start("context_broker", "accounts")
            made.append(cell)
            return cell

        yield secured


def metric(cell: SecuredCell, name: str) -> float:
    with cell.client() as client:
        text = client.get("/metrics").text
    (line,) = [line for line in text.splitlines() if line.startswith(f"{name} ")]
    return float(line.rpartition(" ")[2])


@pytest.mark.nightly
def test_a_replica_passes_requests_on_over_tls_and_the_audit_names_the_caller(
    new_secured: Callable[..., SecuredCell], new_database: Callable[[], str]
) -> None:
    url = new_database()
    cells = [new_secured(HANDOVER_DATABASE_URL=url, HANDOVER_INSTANCE=f"gateway-{name}") for name in "ab"]
    for cell in cells:
        cell.extra["HANDOVER_GATEWAY_URL"] = f"https://{NAME}:{cell.ports['device_gateway']}"
        cell.start("device_gateway", within_s=90)
    leader, follower = sorted(cells, key=lambda one: -metric(one, "handover_device_gateway_leads"))
    assert metric(follower, "handover_device_gateway_leads") == 0
    anna = leader.token("anna", Grant(Role.ENGINEER), Grant(Role.ADMIN))
    vera = leader.token("vera", Grant(Role.VIEWER))
    body = {"name": "hall-1", "description": SENSOR}
    with follower.client(anna) as client, follower.client(vera) as viewer, follower.client() as stranger:
        # 503 until the leader follows the revocations of accounts.
        wait_for(lambda: client.post("/devices", json=body).status_code in {201, 409})
        assert stranger.get("/devices").status_code == 401, "a replica gives no rights"
        assert viewer.get("/devices/hall-1").json()["name"] == "hall-1"
        assert viewer.delete("/devices/hall-1").status_code == 403
        forged = {"handover-replica": "1", "X-Forwarded-For": "203.0.113.9", "Forwarded": "for=203.0.113.9"}
        assert stranger.get("/devices", headers=forged).status_code in {401, 503}
        with leader.client(**forged) as pretender:
            assert pretender.get("/devices").status_code == 401, "who says to be a replica is a stranger"
        turn = {"name": "turn", "parameters": {"rad": 1}, "id": "m-1"}
        assert client.post("/devices/hall-1/commands", json=turn).status_code == 409, "the device is away"
        beep = {"name": "beep", "id": "b-1"}
        assert client.post("/devices/hall-1/commands", json=beep).status_code == 202
        found = client.get("/audit").raise_for_status().json()
    acts = {(one["action"], one["subject"], one["method"], one["outcome"]) for one in found}
    assert ("POST /devices", "user-anna", "user", "done") in acts
    assert ("POST /devices/{device}/commands", "user-anna", "user", "done") in acts
    assert ("DELETE /devices/{device}", "user-vera", "user", "refused") in acts
    assert {one["subject"] for one in found} <= {"user-anna", "user-vera"}, "nobody else, and no replica"
    assert sum(one["action"] == "POST /devices" and one["outcome"] == "done" for one in found) == 1

    leader.kill("device_gateway")
    with follower.client(anna) as client:
        wait_for(lambda: client.get("/devices/hall-1").is_success, 60)
        assert client.get("/devices/hall-1/commands/b-1").json()["id"] == "b-1"
        assert client.get("/audit/verification").json()["fault"] is None


@pytest.fixture
def namespace() -> Iterator[Namespace]:
    with other_machine() as made:
        yield made


class Meter:
    """A device at the edge, which counts what the edge has acknowledged and what it was asked to do."""

    def __init__(self, connection: ssl.SSLSocket, name: str, token: str) -> None:
        self.connection, self._lines = connection, connection.makefile("rb")
        self.acknowledged: set[int] = set()
        self.turned: list[float] = []
        self.sent = 0
        self._say(type="hello", version=1, device=name, token=token, boot="b1")
        self.greeting = json.loads(self._lines.readline())
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _say(self, **message: Any) -> None:
        self.connection.sendall(json.dumps(message).encode() + b"\n")

    def _read(self) -> None:
        with suppress(OSError, ValueError):
            for line in self._lines:
                message = json.loads(line)
                if message["type"] == "ack" and "seq" in message:
                    self.acknowledged.add(message["seq"])
                elif message["type"] == "command":
                    self.turned.append(message["parameters"]["rad"])
                    self._say(type="ack", id=message["id"], state="done")

    def send(self, count: int) -> None:
        """Send values, each with a time of its own, and wait until the edge has them."""
        for _ in range(count):
            self.sent += 1
            values = {"temperature": self.sent / 10}
            self._say(type="telemetry", seq=self.sent, t=time.time(), values=values)
        wait_for(lambda: len(self.acknowledged) == self.sent)

    def close(self) -> None:
        """Disconnect."""
        with suppress(OSError):
            self.connection.shutdown(socket.SHUT_RDWR)
        self._thread.join(60)
        self._lines.close()
        self.connection.close()


@pytest.mark.nightly
def test_a_partition_between_edge_and_gateway_loses_nothing_and_delays_no_motion(
    namespace: Namespace, new_secured: Callable[..., SecuredCell]
) -> None:
    centre = new_secured(HANDOVER_DEVICE_HOST=CENTRE)
    centre.start("device_gateway")
    anna = centre.token("anna", Grant(Role.ENGINEER))
    with ExitStack() as stack:
        rest = stack.enter_context(centre.client(anna))
        token: list[str] = []

        def is_registered() -> bool:  # 503 until the gateway follows the revocations of accounts
            answer = rest.post("/devices", json={"name": EDGE, "template": "edge"})
            if answer.is_success:
                token.append(answer.json()["token"])
            return answer.is_success

        wait_for(is_registered)
        body = {"name": "hall-1", "description": {**SENSOR, "edge": EDGE}}
        device_token = rest.post("/devices", json=body).raise_for_status().json()["token"]
        edge = new_secured(
            HANDOVER_EDGE_UPSTREAM=f"{CENTRE}:{centre.ports['devices']}",
            HANDOVER_EDGE_NAME=EDGE,
            HANDOVER_EDGE_TOKEN=token[0],
        )
        command = namespace.within(sys.executable, "-m", "handover_devices")
        process = processes.spawn(command, edge.environment, edge.data_dir / "edge.log", edge.data_dir)
        stack.callback(processes.kill, process)
        trust = client_context(edge.files.authority)

        def at_edge() -> ssl.SSLSocket | None:
            with suppress(OSError):
                plain = namespace.connect(edge.ports["devices"])
                try:
                    return trust.wrap_socket(plain, server_hostname="localhost")
                except OSError:
                    plain.close()
            return None

        def device() -> dict[str, Any]:
            found: dict[str, Any] = rest.get("/devices/hall-1").raise_for_status().json()
            return found

        def order(rad: float) -> httpx.Response:
            return rest.post("/devices/hall-1/commands", json={"name": "turn", "parameters": {"rad": rad}})

        def stored() -> list[float]:
            query = {"type": "telemetry", "direction": "in", "limit": 1000}
            found = rest.get("/devices/hall-1/messages", params=query).raise_for_status().json()
            return sorted(one["message"]["values"]["temperature"] for one in found)

        def log() -> str:
            return (edge.data_dir / "edge.log").read_text(errors="replace")[-2000:]

        meters: list[Meter] = []

        def is_known_at_edge() -> bool:
            meter = Meter(wait_for(at_edge, 60, log), "hall-1", device_token)
            if meter.greeting["type"] == "ack":
                meters.append(meter)
            else:
                meter.close()  # the centre has not sent the device yet
            return bool(meters)

        wait_for(is_known_at_edge, 60, log)
        (meter,) = meters
        stack.callback(meter.close)
        meter.send(20)
        wait_for(lambda: device()["connected"] and len(stored()) == 20)
        wait_for(lambda: order(1.0).status_code == 202)
        wait_for(lambda: meter.turned == [1.0])

        namespace.part()
        meter.send(50)  # the edge acknowledges and keeps them
        wait_for(lambda: not device()["connected"], 60)
        refused = order(2.0)
        assert (refused.status_code, refused.json()["title"]) == (409, "Edge away")
        assert len(stored()) == 20

        namespace.join()
        wait_for(lambda: device()["connected"], 60, log)
        wait_for(lambda: len(stored()) >= meter.sent, 60)
        assert stored() == [number / 10 for number in range(1, meter.sent + 1)], "each value once"
        wait_for(lambda: order(3.0).status_code == 202)
        wait_for(lambda: meter.turned == [1.0, 3.0])  # the motion of the outage was never executed
