"""The stream of joints, to readers who are quick, slow or gone."""

import asyncio
import json
from typing import Any

from prometheus_client import REGISTRY
from starlette.websockets import WebSocket

from handover_robots.model.joints import JointState
from handover_robots.robots.ur10 import ROBOT
from handover_robots.routes.joint_states import stream

TARGET = (1.0, -1.2, 1.1, -1.4, -1.5, 0.3)


class Reader:
    """The far end of a WebSocket: takes each message in `takes_s`, and disconnects on request."""

    def __init__(self, takes_s: float = 0.0) -> None:
        self.takes_s = takes_s
        self.got: list[dict[str, Any]] = []
        self.says: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        self.says.put_nowait({"type": "websocket.connect"})

    @property
    def socket(self) -> WebSocket:
        return WebSocket({"type": "websocket", "path": "/", "headers": []}, self.says.get, self._take)

    async def _take(self, message: Any) -> None:
        if message["type"] == "websocket.send":
            await asyncio.sleep(self.takes_s)
            self.got.append(json.loads(message["text"]))

    def leave(self) -> None:
        self.says.put_nowait({"type": "websocket.disconnect", "code": 1000})


def dropped() -> float:
    return REGISTRY.get_sample_value("handover_trajectory_tool_joint_states_dropped_total") or 0.0


def test_joints_are_written_as_ros_names_them() -> None:
    message = JointState(1700000000.5, TARGET, (0.0,) * 6, (1.5,) * 6).written(ROBOT.joint_names)
    assert message["stamp"] == 1700000000.5
    assert message["name"] == ROBOT.joint_names
    assert message["position"] == list(TARGET)
    assert message["velocity"] == [0.0] * 6
    assert message["effort"] == (1.5,) * 6


async def test_the_stream_ends_when_its_reader_leaves(worker: Any, eventually_true: Any) -> None:
    reader = Reader()
    streaming = asyncio.create_task(stream(worker.unit.robot, ROBOT.joint_names, reader.socket, 125.0))
    reader.says.put_nowait({"type": "websocket.receive", "bytes": b"\xff"})
    await eventually_true(lambda: len(reader.got) >= 3)
    reader.leave()
    async with asyncio.timeout(120):
        await streaming


async def test_a_slow_reader_gets_fewer_joints_and_the_newest(worker: Any, eventually_true: Any) -> None:
    reader = Reader(takes_s=0.1)
    before = dropped()
    streaming = asyncio.create_task(stream(worker.unit.robot, ROBOT.joint_names, reader.socket, 125.0))
    await eventually_true(lambda: reader.got)
    await worker.do("moveTo", joints=list(TARGET))
    after = len(reader.got)
    await eventually_true(lambda: len(reader.got) >= after + 2)
    assert reader.got[after + 1]["position"] == list(TARGET)
    assert dropped() - before >= 10
    reader.leave()
    async with asyncio.timeout(120):
        await streaming
