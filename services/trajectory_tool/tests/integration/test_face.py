"""The trajectory tool as a screen sees it, without a broker: robots over REST, joints over WebSocket."""

import itertools
import json
import subprocess
import sys

import httpx
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from tests.kit.cell import Cell
from tests.kit.waiting import wait_for

NAMES = [
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
]


@pytest.fixture(scope="module")
def tool(shared_cell: Cell) -> Cell:
    """A trajectory tool for all tests that only look."""
    cell = shared_cell
    with (cell.data_dir / "trajectory_tool.log").open("ab") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "handover_robots"],
            env=cell.environment,
            cwd=cell.data_dir,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
        )
    cell.processes["trajectory_tool"] = process

    def answers() -> bool:
        assert process.poll() is None, cell.log("trajectory_tool")
        try:
            return httpx.get(f"{cell.url('trajectory_tool')}/healthz", timeout=120).is_success
        except httpx.TransportError:
            return False

    wait_for(answers, 30)
    return cell


def joint_states(cell: Cell, query: str = "", robot: str = "ur10-1") -> ClientConnection:
    url = cell.url("trajectory_tool").replace("http", "ws")
    return connect(f"{url}/robots/{robot}/joint_states{query}", proxy=None)


@pytest.mark.nightly
@pytest.mark.slow
def test_the_robot_is_shown_and_its_joints_are_streamed(tool: Cell) -> None:
    robots = httpx.get(f"{tool.url('trajectory_tool')}/robots", timeout=120).json()
    assert [robot["id"] for robot in robots] == ["ur10-1"]
    robot = httpx.get(f"{tool.url('trajectory_tool')}/robots/ur10-1", timeout=120).json()
    assert robot["device"] == "urn:ngsi-ld:Device:demo:ur10-1"
    assert robot["deviceState"] == "idle"
    assert robot["gripper"] == {"closed": False, "holds": None, "interrupted": None}
    assert robot["task"] is None
    assert len(robot["toolPose"]["position"]) == 3
    by_urn = httpx.get(f"{tool.url('trajectory_tool')}/robots/{robot['device']}", timeout=120)
    assert by_urn.json()["id"] == "ur10-1"

    described = httpx.get(f"{tool.url('trajectory_tool')}/robots/ur10-1/description", timeout=120).json()
    assert [joint["name"] for joint in described["joints"]] == NAMES
    assert described["revision"] == robot["revision"]
    assert described["model"] == robot["model"] == "UR10"
    assert described["home"] == robot["joints"]["position"]
    urdf = httpx.get(f"{tool.url('trajectory_tool')}/robots/ur10-1/urdf", timeout=120)
    assert urdf.text == described["urdf"]
    assert urdf.headers["content-type"].startswith("application/xml")

    scene = httpx.get(f"{tool.url('trajectory_tool')}/robots/ur10-1/scene", timeout=120).json()
    assert [len(fixture["nests"]) for fixture in scene["fixtures"].values()] == [4]
    assert {part["place"] for part in scene["parts"]} == set(scene["bins"])

    with joint_states(tool) as stream:
        frames = [json.loads(stream.recv(timeout=120)) for _ in range(20)]
    assert frames[0]["name"] == NAMES
    assert frames[0]["position"] == robot["joints"]["position"]
    assert len(frames[0]["velocity"]) == 6
    stamps = [frame["stamp"] for frame in frames]
    assert all(later > earlier for earlier, later in itertools.pairwise(stamps))

    with joint_states(tool, "?hz=125") as fast, joint_states(tool, "?hz=5") as slow:
        assert json.loads(fast.recv(timeout=120))["name"] == NAMES
        first, second = (json.loads(slow.recv(timeout=120))["stamp"] for _ in range(2))
        assert second - first > 0.1

    unready = httpx.get(f"{tool.url('trajectory_tool')}/readyz", timeout=120)
    assert unready.status_code == 503
    assert "broker" in unready.json()


@pytest.mark.slow
def test_the_scene_is_changed_by_rest(cell: Cell) -> None:
    cell.run("context_broker", "trajectory_tool")
    url = f"{cell.url('trajectory_tool')}/cell"
    answer = httpx.get(f"{url}/scene", timeout=120)
    scene = answer.json()
    assert scene["revision"] == 0
    scene["zones"] = {"walkway": {"kind": "reducedSpeed", "box": [1, 1, 2], "position": [1, 1, 1]}}
    headers = {"If-Match": answer.headers["ETag"]}
    changed = httpx.put(f"{url}/scene", json=scene, headers=headers, timeout=120)
    assert changed.status_code == 200, changed.text
    assert changed.json()["revision"] == 1
    late = httpx.put(f"{url}/scene", json=scene, headers=headers, timeout=120)
    assert late.status_code == 412
    faulty = httpx.put(f"{url}/scene", json={"name": "x", "walls": 3}, timeout=120)
    assert faulty.status_code == 400
    assert "walls" in faulty.json()["detail"]
    cell_view = httpx.get(url, timeout=120).json()
    assert cell_view["scene"] == {"digest": changed.json()["digest"], "revision": 1}
    assert [robot["id"] for robot in cell_view["robots"]] == ["ur10-1"]
    shapes = httpx.get(f"{url}/scene", timeout=120).json()["shapes"]
    assert [(shape["name"], shape["kind"]) for shape in shapes] == [("walkway", "reducedSpeed")]
    entities = f"{cell.url('context_broker')}/ngsi-ld/v1/entities"

    def is_in_the_broker() -> bool:
        asset = httpx.get(f"{entities}/urn:ngsi-ld:Asset:demo:walkway", timeout=120)
        location = httpx.get(f"{entities}/urn:ngsi-ld:Location:demo:walkway", timeout=120)
        return asset.is_success and location.is_success

    wait_for(is_in_the_broker)


@pytest.mark.slow
def test_an_invalid_request_is_refused_with_the_reason(tool: Cell) -> None:
    assert httpx.get(f"{tool.url('trajectory_tool')}/robots/ur10-9/scene", timeout=120).status_code == 404
    unknown = httpx.get(f"{tool.url('trajectory_tool')}/robots/ur10-9", timeout=120)
    assert unknown.status_code == 404
    assert unknown.headers["content-type"] == "application/problem+json"
    assert "there is ur10-1" in unknown.json()["detail"]
    for query, robot, code in (("", "ur10-9", 4404), ("?hz=0", "ur10-1", 4400), ("?hz=nan", "ur10-1", 4400)):
        with joint_states(tool, query, robot) as stream, pytest.raises(ConnectionClosed) as closed:
            stream.recv(timeout=120)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == code
    garbage = httpx.post(
        f"{tool.url('trajectory_tool')}/notifications/ur10-1", json={"data": []}, timeout=120
    )
    assert garbage.status_code == 403


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize(
    ("setting", "value", "complaint"),
    [
        ("HANDOVER_SCENE_FILE", "nowhere.yaml", "nowhere.yaml cannot be read"),
        ("HANDOVER_ROBOT_SPEED", "7", "HANDOVER_ROBOT_SPEED"),
        ("HANDOVER_CELL_FILE", "nowhere.yaml", "nowhere.yaml cannot be read"),
    ],
)
def test_a_wrong_setting_is_one_readable_line(cell: Cell, setting: str, value: str, complaint: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "handover_robots"],
        env={**cell.environment, setting: value},
        cwd=cell.data_dir,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 2
    assert complaint in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
