"""The packages in `examples/` are installed beside Handover and work in the real services."""

import asyncio
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree as ET

import httpx
import orjson
import pytest

from handover.broker import BrokerClient
from handover_datamodels.entities import Device, ResourceSpecification
from tests.e2e.conftest import EXAMPLES
from tests.kit.cell import Cell
from tests.kit.gloves import BENT, STRAIGHT, TcpGlove
from tests.kit.paths import REPOSITORY
from tests.kit.ports import next_free_port
from tests.kit.waiting import scaled, wait_for

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


def handover(cell: Cell, *words: str) -> subprocess.Popen[bytes]:
    """Start the command line in the environment of a cell."""
    return subprocess.Popen(
        [sys.executable, "-m", "handover_cell", *words],
        env=cell.environment,
        cwd=cell.data_dir,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
    )


async def task_ends_as(cell: Cell, task_id: str) -> str:
    """Wait until a Task has ended, and return its status."""
    async with BrokerClient(cell.settings) as broker, asyncio.timeout(scaled(60)):
        while True:
            task = await broker.retrieve(task_id)
            if task["status"]["value"] in {"completed", "failed"}:
                return str(task["status"]["value"])
            await asyncio.sleep(0.1)


async def create_task(cell: Cell, name: str, device: str, **parameters: Any) -> str:
    """Create a pending Task for a Device and return its id."""
    task_id = f"urn:ngsi-ld:Task:demo:{name}"
    device_id = f"urn:ngsi-ld:Device:demo:{device}"
    async with BrokerClient(cell.settings) as broker:
        await broker.create(
            {
                "id": task_id,
                "type": "Task",
                "isDefinedBy": {"type": "Relationship", "object": f"urn:ngsi-ld:TaskDefinition:demo:{name}"},
                "status": {"type": "Property", "value": "pending", "observedAt": "2026-01-01T12:00:00Z"},
                "involves": {"type": "Property", "value": [{"type": "Relationship", "object": device_id}]},
                "workParameters": {"type": "Property", "value": parameters},
            }
        )
    return task_id


def test_every_example_has_a_readme_that_the_index_links() -> None:
    index = (REPOSITORY / "examples" / "README.md").read_text()
    assert [path.name for path in EXAMPLES if f"({path.name}/README.md)" not in index] == []


@pytest.mark.nightly
def test_recognizer_reads_a_glove(extended_cell: Cell) -> None:
    cell = extended_cell
    cell.start("context_broker", "gesture_controller")
    with (
        httpx.Client(base_url=cell.url("gesture_controller"), timeout=120, trust_env=False) as controller,
        TcpGlove(cell.ports["glove"]) as glove,
    ):
        assert "nearest" in controller.get("/recognizers").json()
        hands = {"fist": [[BENT] * 5] * 20, "open": [[STRAIGHT] * 5] * 20}
        controller.post("/gloves/glove-1/calibration", json=hands).raise_for_status()
        controller.put("/gloves/glove-1/recognizer", json={"name": "nearest"}).raise_for_status()
        glove.show("02222", 0.5)

        def recognition() -> Any:
            return controller.get("/gloves/glove-1/recognition").json()

        wait_for(lambda: recognition()["gesture"] == "Thumbs up", why=lambda: str(recognition()))
        assert "no finger differs by more than" in recognition()["why"]


@pytest.mark.nightly
def test_glove_source_sends_datagrams_as_frames(extended_cell: Cell) -> None:
    cell = extended_cell
    cell.start("context_broker", "gesture_controller")
    port = next_free_port()
    bridge = handover(cell, "glove", "udp", "--listen", str(port), "--glove", "glove-1")
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def frames() -> int:
        sender.sendto(b"1700,400,400,400,400", ("127.0.0.1", port))
        glove = httpx.get(f"{cell.url('gesture_controller')}/gloves/glove-1", timeout=120)
        return int(glove.json()["frames"]) if glove.is_success else 0

    try:
        wait_for(lambda: frames() >= 10, 30)
    finally:
        sender.close()
        bridge.terminate()
        bridge.communicate(timeout=scaled(20))


@pytest.mark.nightly
@pytest.mark.parametrize("driver", ["simulated", "steady"])
async def test_robot_moves_for_a_task(extended_cell: Cell, driver: str) -> None:
    cell = extended_cell
    cell.extra["HANDOVER_ROBOT_MODEL"] = "rail"
    cell.extra["HANDOVER_ROBOT"] = driver
    cell.start("context_broker", "trajectory_tool")
    target = [1.1, 0.3, -0.5, 1.2, 0.4, 0.5, 4.0]
    task = await create_task(cell, "move", "rail-1", operation="moveTo", joints=target)
    assert await task_ends_as(cell, task) == "completed"
    robot = httpx.get(f"{cell.url('trajectory_tool')}/robots/rail-1", timeout=120).json()
    assert robot["joints"]["position"] == pytest.approx(target)
    assert robot["joints"]["name"][0] == "rail"

    beyond = await create_task(cell, "beyond", "rail-1", operation="moveTo", joints=[1.7, *target[1:]])
    assert await task_ends_as(cell, beyond) == "failed"
    async with BrokerClient(cell.settings) as broker:
        failed = await broker.retrieve(beyond)
        device = await broker.get("urn:ngsi-ld:Device:demo:rail-1", Device)
        assert device.is_specified_by is not None
        [specified_by] = device.is_specified_by
        specification = await broker.get(specified_by.object, ResourceSpecification)
    assert "rail cannot be at 1.700 m: it moves from 0.000 to 1.600 m" in str(failed["outputParameters"])
    assert specification.name.value == "Rail arm"
    assert specification.parameters is not None
    parameters = specification.parameters.value
    assert parameters["degreesOfFreedom"] == 7
    assert parameters["joints"][0] == {
        "name": "rail",
        "type": "prismatic",
        "unit": "m",
        "lower": 0.0,
        "upper": 1.6,
        "maxVelocity": 1.2,
        "maxAcceleration": 1.5,
        "maxJerk": 60.0,
    }
    urdf = httpx.get(parameters["urdf"], timeout=120)
    assert urdf.headers["content-type"].startswith("application/xml")
    assert ET.fromstring(urdf.text).get("name") == "rail"


@pytest.mark.nightly
def test_the_driver_does_what_every_driver_does(extended_cell: Cell) -> None:
    """As its author runs the tests: in a project of its own, with the contract that Handover has."""
    tests = REPOSITORY / "examples" / "rail_robot" / "tests"
    options = ["-q", "-c", os.devnull, "-o", "asyncio_mode=auto", "-p", "no:cacheprovider"]
    run = subprocess.run(
        [sys.executable, "-m", "pytest", *options, str(tests)],
        env=extended_cell.environment,
        cwd=extended_cell.data_dir,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=scaled(120),
    )
    assert run.returncode == 0, run.stdout
    assert " passed" in run.stdout


DATAGRAM_RULES = """
ros_to_ngsild:
  level: {topic: /level, type: std_msgs/Float64, entity: Device:tank-1, attributes: {level: data}}
ngsild_to_ros:
  valve: {entity: Device:tank-1, topic: /valve, type: std_msgs/Float64, fields: {data: opening}}
"""


@pytest.mark.nightly
async def test_ros_adapter_carries_topics_both_ways(extended_cell: Cell) -> None:
    cell = extended_cell
    mapping = cell.data_dir / "datagrams.yaml"
    mapping.write_text(DATAGRAM_RULES)
    port = next_free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as node:
        node.bind(("127.0.0.1", 0))
        node.setblocking(False)
        cell.extra["HANDOVER_ROS_ADAPTER"] = "datagram"
        cell.extra["HANDOVER_ROS_MAPPING"] = str(mapping)
        cell.extra["HANDOVER_DATAGRAM_PORT"] = str(port)
        cell.extra["HANDOVER_DATAGRAM_PEER"] = f"127.0.0.1:{node.getsockname()[1]}"
        cell.start("context_broker", "ros_fiware_bridge")
        tank = "urn:ngsi-ld:Device:demo:tank-1"

        async with BrokerClient(cell.settings) as broker, asyncio.timeout(scaled(60)):
            while not (found := await broker.query(type="Device", id_pattern=f"^{tank}$")):
                node.sendto(b"not a message", ("127.0.0.1", port))
                node.sendto(b'{"topic": "/level", "message": {"data": 1.5}}', ("127.0.0.1", port))
                await asyncio.sleep(0.1)
            assert found[0]["level"]["value"] == 1.5
            await broker.append(tank, {"opening": {"type": "Property", "value": 0.25}})
            sent = await asyncio.get_running_loop().sock_recv(node, 1000)
    assert orjson.loads(sent) == {"topic": "/valve", "message": {"data": 0.25}}


@pytest.mark.nightly
def test_exporter_writes_the_history_of_a_process(extended_cell: Cell) -> None:
    cell = extended_cell
    cell.start("context_broker", "task_orchestrator")
    orchestrator = httpx.Client(base_url=cell.url("task_orchestrator"), trust_env=False, timeout=120)
    process = orchestrator.post("/processes", json={"definition": "bin-picking"}).json()["id"]
    wait_for(lambda: orchestrator.get(f"/processes/{process}").json()["tasks"])
    file = cell.data_dir / "log.xes"
    export = handover(cell, "process", "export", process, "--format", "xes", "--output", str(file))
    export.communicate(timeout=scaled(60))
    assert export.returncode == 0
    log = ET.parse(file).getroot()
    namespace = {"xes": "http://www.xes-standard.org/"}
    names = [one.get("value") for one in log.findall("xes:trace/xes:event/xes:string", namespace)]
    assert "Confirm that the cell is clear" in names
    csv = handover(cell, "process", "export", process)
    assert b"confirm_clear" in csv.communicate(timeout=scaled(60))[0]
    orchestrator.close()


@pytest.fixture
def lamp(extended_cell: Cell) -> Iterator[Cell]:
    """A cell in which `handover run lamp` runs."""
    cell = extended_cell
    cell.start("context_broker")
    cell.ports["lamp"] = next_free_port()
    service = handover(cell, "run", "lamp", "--port", str(cell.ports["lamp"]))
    try:
        cell.wait_ready("lamp")
        yield cell
    finally:
        service.terminate()
        service.communicate(timeout=scaled(20))


@pytest.mark.nightly
async def test_service_performs_a_task(lamp: Cell) -> None:
    task = await create_task(lamp, "light", "lamp-1", steps=2)
    assert await task_ends_as(lamp, task) == "completed"


@pytest.mark.nightly
def test_settings_of_an_installed_service_are_listed(extended_cell: Cell) -> None:
    printed, _ = handover(extended_cell, "settings").communicate(timeout=scaled(60))
    assert "HANDOVER_LAMP_PORT" in printed.decode()
    assert os.fspath(extended_cell.data_dir) in printed.decode()


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("setting", "complaint"),
    [
        ("HANDOVER_ROBOT_MODEL", 'there is no robot "stedy"; there are: panda, ur10, ur5e, rail'),
        (
            "HANDOVER_ROBOT",
            'there is no robot driver "stedy"; there are: simulated, physics, ros, steady, ur',
        ),
    ],
)
def test_unknown_robot_is_refused_with_the_names_there_are(
    extended_cell: Cell, setting: str, complaint: str
) -> None:
    extended_cell.extra[setting] = "stedy"
    tool = subprocess.run(
        [sys.executable, "-m", "handover_robots"],
        env=extended_cell.environment,
        cwd=extended_cell.data_dir,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert tool.returncode != 0
    assert complaint in tool.stderr
