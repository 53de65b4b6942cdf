"""Two gateways on one PostgreSQL database behind HAProxy: one is killed, and devices and commands go on."""

import asyncio
import shutil
import socket
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.transport_security.local_authority import ServerFiles
from handover_devices.device_client import DeviceClient, Run, tls_context
from handover_devices.settings import GatewaySettings
from services.device_gateway.tests.integration.conftest import SENSOR, TcpDevice
from services.device_gateway.tests.integration.test_driving import driver
from services.device_gateway.tests.integration.test_mqtt import MqttDevice
from tests.kit.cell import Cell, new_cell
from tests.kit.certificates import Certificates
from tests.kit.mosquitto import Mosquitto
from tests.kit.ports import next_free_port
from tests.kit.waiting import until, wait_for

pytestmark = pytest.mark.slow

HAPROXY = """
defaults
    mode tcp
    timeout connect 2s
    timeout client 300s
    timeout server 300s
    retries 3
    option redispatch 1
listen devices
    bind 127.0.0.1:{devices}
    balance roundrobin
{device_servers}
listen rest
    bind 127.0.0.1:{rest}
    balance roundrobin
{rest_servers}
"""


class Pair:
    """Two replicas by name, and the balancer before them."""

    def __init__(self, cells: dict[str, Cell], devices: int, rest: int, authority: str) -> None:
        self.cells = cells
        self.authority = authority
        self.devices, self.rest_port = devices, rest
        self.rest = httpx.Client(
            base_url=f"http://127.0.0.1:{rest}",
            timeout=120,
            trust_env=False,
            headers={"Connection": "close"},  # so that HAProxy chooses for each request
        )

    def add(self, name: str, **description: Any) -> str:
        """Register a device and return its token."""
        body = {"name": name, "description": {**SENSOR, **description}}
        token: str = self.ask("POST", "/devices", json=body)["token"]
        return token

    def ask(self, method: str, path: str, **options: Any) -> Any:
        """Return the answer of any replica; ask again while none leads. What is asked has an id."""
        answers: list[Any] = []

        def is_answered() -> bool:
            with suppress(httpx.HTTPError):
                answers.append(self.rest.request(method, path, **options))
            return bool(answers) and answers[-1].status_code not in {502, 503}

        wait_for(is_answered, 60)
        return answers[-1].raise_for_status().json() if answers[-1].content else None

    def metric(self, replica: str, name: str) -> float:
        """Return a metric of a replica."""
        text = httpx.get(f"{self.cells[replica].url('device_gateway')}/metrics", trust_env=False).text
        (line,) = [line for line in text.splitlines() if line.startswith(f"{name} ")]
        return float(line.rpartition(" ")[2])

    def leader(self) -> str:
        """Return the name of the replica that leads."""
        (found,) = [
            name
            for name, cell in self.cells.items()
            if cell.runs("device_gateway") and self.metric(name, "handover_device_gateway_leads") == 1
        ]
        return found

    def other(self, replica: str) -> str:
        """Return the name of the other replica."""
        return next(name for name in self.cells if name != replica)

    def device(self, replica: str, name: str, token: str, boot: str = "b1", **hello: Any) -> TcpDevice:
        """Connect a device to a replica."""
        tls = tls_context(self.authority)
        return TcpDevice(self.cells[replica].ports["devices"], name, token, boot, tls=tls, **hello)

    def start(self, replica: str) -> None:
        """Start a replica; it is ready when it leads or is connected with the leader."""
        self.cells[replica].start("device_gateway", within_s=60)

    def kill(self, replica: str) -> None:
        """End a replica as a power cut would."""
        self.cells[replica].kill("device_gateway")

    def values(self, device: str) -> int:
        """Return how many values of a device are stored."""
        series = self.ask("GET", f"/devices/{device}/values", params={"begin": 0, "points": 5000})
        return sum(int(point["n"]) for one in series for point in one["points"])


@contextmanager
def balancer(folder: Path, pair: Pair) -> Iterator[None]:
    if shutil.which("haproxy") is None and not Path("/usr/sbin/haproxy").exists():
        pytest.skip("haproxy is not installed; apt-get install haproxy")

    def servers(port: str) -> str:
        return "\n".join(
            f"    server {name} 127.0.0.1:{cell.ports[port]} check inter 200ms fall 1 rise 1"
            for name, cell in pair.cells.items()
        )

    file = folder / "haproxy.cfg"
    file.write_text(
        HAPROXY.format(
            devices=pair.devices,
            rest=pair.rest_port,
            device_servers=servers("devices"),
            rest_servers=servers("device_gateway"),
        )
    )
    with (folder / "haproxy.log").open("wb") as log:
        process = subprocess.Popen(
            [shutil.which("haproxy") or "/usr/sbin/haproxy", "-db", "-f", str(file)], stdout=log, stderr=log
        )
        try:
            yield
        finally:
            process.terminate()
            process.wait(30)


@pytest.fixture
def certificates(tmp_path: Path) -> ServerFiles:
    """Of the port for devices, of both replicas."""
    return Certificates(tmp_path / "certificates").make("devices.test", "127.0.0.1")


@pytest.fixture
def mosquitto(tmp_path: Path, certificates: ServerFiles) -> Iterator[Mosquitto]:
    folder = tmp_path / "mosquitto"
    folder.mkdir()
    files = (certificates.certificate, certificates.key)
    made = Mosquitto(folder, next_free_port(), next_free_port(), files)
    made.start()
    made.listen()
    yield made
    made.close()


@pytest.fixture
def pair(
    tmp_path: Path, new_database: Any, certificates: ServerFiles, mosquitto: Mosquitto
) -> Iterator[Pair]:
    url = new_database()
    with ExitStack() as stack:
        cells = {}
        for name in ("a", "b"):
            (tmp_path / name).mkdir()
            cell = cells[name] = stack.enter_context(new_cell(tmp_path / name))
            cell.extra.update(
                HANDOVER_DATABASE_URL=url,
                HANDOVER_INSTANCE=f"gateway-{name}",
                HANDOVER_DEVICE_TLS_CERTIFICATE=str(certificates.certificate),
                HANDOVER_DEVICE_TLS_KEY=str(certificates.key),
                HANDOVER_TLS_AUTHORITY=str(certificates.authority),
                HANDOVER_DEVICE_MQTT_URL=f"mqtt://127.0.0.1:{mosquitto.port}",
            )
        cells["b"].ports["context_broker"] = cells["a"].ports["context_broker"]
        cells["a"].start("context_broker")
        made = Pair(cells, next_free_port(), next_free_port(), str(certificates.authority))
        for name in cells:
            made.start(name)
        with balancer(tmp_path, made):
            wait_for(lambda: made.ask("GET", "/devices") == [])
            yield made


class Sensor:
    """A device that sends values and beeps; it counts both."""

    def __init__(self, pair: Pair, name: str) -> None:
        self.name = name
        self.sent = 0
        self.beeps: Counter[int] = Counter()
        tls = tls_context(pair.authority)
        self.client = DeviceClient("127.0.0.1", pair.devices, name, pair.add(name), tls=tls)

        @self.client.command("beep")
        def beep(parameters: dict[str, Any], _: Run) -> None:
            self.beeps[parameters["n"]] += 1

        self.client.start()

    def send(self) -> None:
        """Send a value; its time is unique."""
        self.client.send({"temperature": self.sent % 50}, time.time())
        self.sent += 1


@pytest.fixture
def sensors(pair: Pair) -> Iterator[list[Sensor]]:
    made = [Sensor(pair, f"hall-{number}") for number in range(6)]
    yield made
    for sensor in made:
        sensor.client.stop()


@pytest.mark.nightly
def test_devices_and_commands_survive_the_death_of_each_replica(pair: Pair, sensors: list[Sensor]) -> None:
    pushing = pair.add("pusher")
    pushed = 0
    is_over = threading.Event()

    def push() -> None:
        nonlocal pushed
        while not is_over.wait(0.05):
            message = {"type": "telemetry", "t": time.time(), "values": {"temperature": 20.5}}
            header = {"Authorization": f"Bearer {pushing}"}
            pair.ask("POST", "/ingest/pusher", json=message, headers=header)
            pushed += 1
            for sensor in sensors:
                sensor.send()

    connected = "handover_devices_connected"
    first = pair.leader()
    wait_for(lambda: pair.metric(first, connected) == 6)
    assert pair.metric(pair.other(first), connected) == 3, "the balancer has spread the devices"
    assert pair.metric(first, "handover_device_replicas") == 1
    pushes = threading.Thread(target=push)
    pushes.start()
    ordered: list[tuple[str, str]] = []

    def order() -> None:
        """Order a command of each device, through any replica."""
        for sensor in sensors:
            n = len(ordered)
            body = {"name": "beep", "parameters": {"n": n}, "id": f"c-{n}", "timeoutS": 600}
            pair.ask("POST", f"/devices/{sensor.name}/commands", json=body)
            ordered.append((sensor.name, f"c-{n}"))

    try:
        order()
        pair.kill(pair.other(first))
        order()
        wait_for(lambda: pair.metric(first, connected) >= 6, 60)
        order()
        pair.start(pair.other(first))
        for sensor in sensors[:3]:  # some return to the replica that came back
            sensor.client._break_off()
        wait_for(lambda: pair.metric(pair.other(first), connected) >= 1, 60)
        order()
        pair.kill(first)
        order()
        wait_for(lambda: pair.metric(pair.other(first), "handover_device_gateway_leads") == 1)
        wait_for(lambda: pair.metric(pair.other(first), connected) >= 6, 60)
        order()
    finally:
        is_over.set()
        pushes.join(120)

    def states() -> set[str]:
        return {pair.ask("GET", f"/devices/{device}/commands/{one}")["state"] for device, one in ordered}

    wait_for(lambda: states() == {"done"}, 60)
    wait_for(lambda: all(sensor.client.waiting() == 0 for sensor in sensors), 60)
    executed: Counter[int] = sum((sensor.beeps for sensor in sensors), Counter())
    assert executed == Counter(range(len(ordered))), "each command is executed once"
    for sensor in sensors:
        assert pair.values(sensor.name) == sensor.sent, "every acknowledged value is stored once"
    assert pair.values("pusher") == pushed
    latest = pair.ask("GET", "/devices/hall-0")["values"]["temperature"]["value"]
    assert latest == (sensors[0].sent - 1) % 50, "the leader knows the latest value of every device"


@pytest.mark.nightly
def test_what_is_registered_or_revoked_counts_at_every_replica(pair: Pair) -> None:
    leader = pair.leader()
    follower = pair.other(leader)
    token = pair.add("meter-1")
    with pair.device(follower, "meter-1", token) as device:
        assert device.greeting is not None
        assert device.greeting["type"] == "ack"
        wait_for(lambda: pair.ask("GET", "/devices/meter-1")["connected"])
        order = {"name": "turn", "parameters": {"rad": 0.5}, "id": "m-1"}
        assert pair.ask("POST", "/devices/meter-1/commands", json=order)["state"] == "sent"
        command = device.receive()
        assert command is not None
        assert (command["name"], command["id"]) == ("turn", "m-1"), "a motion reaches the other replica"
        device.say(type="ack", id="m-1", state="done", result={"rad": 0.5})
        wait_for(lambda: pair.ask("GET", "/devices/meter-1/commands/m-1")["state"] == "done")
        with pair.device(leader, "meter-1", token, boot="b2") as other:
            assert other.greeting is not None
            ended = device.receive()
            assert ended is not None
            assert ended["code"] == "replaced", "of two connections of a device the younger one counts"
            pair.ask("DELETE", "/devices/meter-1/token")
            revoked = other.receive()
            assert revoked is not None
            assert revoked["code"] == "tokenRevoked"
    with pair.device(follower, "meter-1", token) as late:
        assert late.greeting is not None
        assert late.greeting["code"] == "wrongToken"


class Rover:
    """A robot that is driven: what it has received."""

    def __init__(self, device: TcpDevice) -> None:
        self.drives: list[dict[str, Any]] = []
        self._device = device
        self._thread = threading.Thread(target=self._read, args=(device,), daemon=True)
        self._thread.start()

    def _read(self, device: TcpDevice) -> None:
        with suppress(OSError):
            while (message := device.receive()) is not None:
                if message["type"] == "drive":
                    self.drives.append(message)

    def stop(self) -> None:
        """Disconnect; the thread that reads ends."""
        self._device.socket.shutdown(socket.SHUT_RDWR)
        self._thread.join(60)

    def moves(self) -> bool:
        """Return whether the last message lets it move."""
        return bool(self.drives) and self.drives[-1]["held"]


class Through:
    """A client of one replica, for `driver`."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell


@pytest.mark.nightly
async def test_driving_and_mqtt_continue_with_the_next_leader(pair: Pair, mosquitto: Mosquitto) -> None:
    leader = pair.leader()
    follower = pair.other(leader)
    tokens = {"meter-1": pair.add("meter-1"), "rover-1": pair.add("rover-1", kind="mobileRobot")}
    settings = GatewaySettings.load(device_mqtt_url=f"mqtt://127.0.0.1:{mosquitto.port}")
    meter = MqttDevice(mosquitto, settings, "meter-1", tokens["meter-1"])
    meter.say(type="hello", version=1, boot="b1")
    meter.say(type="telemetry", seq=1, t=time.time(), values={"temperature": 1})
    await until(lambda: {"type": "ack", "seq": 1} in meter.received("ack"))
    with pair.device(follower, "rover-1", tokens["rover-1"], drives=True) as device:
        rover = Rover(device)
        await until(lambda: pair.ask("GET", "/devices/rover-1")["connected"])
        async with driver(Through(pair.cells[follower]), "rover-1") as anna:
            await anna.hold(linear=[0.05, 0.0, 0.0])
            await until(rover.moves)
            pair.kill(leader)
            await until(lambda: not rover.moves(), why="the replica stops the robot when the leader is gone")
        meter.say(type="telemetry", seq=2, t=time.time(), values={"temperature": 2})
        await until(lambda: pair.metric(follower, "handover_device_gateway_leads") == 1)
        async with driver(Through(pair.cells[follower]), "rover-1") as anna:
            await anna.hold(linear=[0.05, 0.0, 0.0])
            await until(rover.moves)
        await until(lambda: not rover.moves())
        rover.stop()
    await until(lambda: {"type": "ack", "seq": 2} in meter.received("ack"))
    assert await asyncio.to_thread(pair.values, "meter-1") == 2
    await until(lambda: len([one for one in mosquitto.of("handover/gateway") if one["online"]]) >= 2)
    meter.say(type="hello", version=1, boot="b1")  # as the new time in handover/gateway asks
    order = {"name": "beep", "id": "m-1"}
    await asyncio.to_thread(pair.ask, "POST", "/devices/meter-1/commands", json=order)
    await until(lambda: [one["id"] for one in meter.received("command")] == ["m-1"])
    meter.stop()
