"""At an edge a motion is passed on at once or never, and a driven robot stops without the centre."""

import asyncio
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from handover.database import connect
from handover_devices.edge.commands import EdgeCommands, EdgeDispatcher
from handover_devices.edge.edge_app import NoReports
from handover_devices.gateway import DeviceGateway
from handover_devices.protocol.messages import AnswerState, CommandAnswer, parse_message
from handover_devices.protocol.times import TimeRule
from handover_devices.storage import schema
from handover_devices.storage.device_store import StoredDevice
from handover_devices.storage.history_writer import HistoryWriter
from handover_devices.storage.outbox import Outbox
from tests.kit.device_gateways import SENSOR, background
from tests.kit.waiting import until


class Robot:
    """The connection of a device."""

    def __init__(self) -> None:
        self.boot = ""
        self.received: list[Mapping[str, Any]] = []

    def send(self, message: Mapping[str, Any]) -> None:
        self.received.append(message)

    def send_latest(self, message: Mapping[str, Any]) -> bool:
        self.received.append(message)
        return True

    def end(self, code: str, reason: str, *, retry: bool) -> None:
        self.received.append({"type": "error", "code": code, "reason": reason, "retry": retry})


class Edge:
    """The commands of an edge with one device, `arm-1`."""

    def __init__(self, gateway: DeviceGateway, outbox: Outbox) -> None:
        self.gateway, self.outbox, self.robot = gateway, outbox, Robot()
        self.commands = EdgeCommands(gateway, max_motion_delay_s=2.0)

    def order(self, name: str, identifier: str, age_s: float | None, remaining_s: float = 60.0) -> None:
        command = {"type": "command", "id": identifier, "name": name, "parameters": {}}
        self.commands.deliver("arm-1", {**command, "remaining": remaining_s}, age_s)

    def drive(
        self, seq: int, age_s: float | None = 0.01, valid_s: float = 60.0, *, held: bool = True
    ) -> None:
        message = {"type": "drive", "seq": seq, "held": held, "validS": valid_s, "base": [0.1, 0, 0]}
        self.commands.deliver("arm-1", message, age_s)

    def held(self) -> list[tuple[int, bool]]:
        """Return the number and `held` of each velocity that the robot got."""
        return [(one["seq"], one["held"]) for one in self.robot.received if one["type"] == "drive"]

    async def answers(self, count: int) -> list[str]:
        """Return what waits for the centre, once there are so many messages."""

        async def written() -> list[str] | None:
            rows = await asyncio.to_thread(self.outbox.read, 0, 100)
            return [row.body for row in rows] if len(rows) >= count else None

        found: list[str] = await until(written)
        return found


@pytest.fixture
async def edge(tmp_path: Path) -> AsyncIterator[Edge]:
    engine = connect(f"sqlite:///{tmp_path / 'edge.db'}")
    schema.prepare(engine)
    outbox = Outbox(engine, 1024 * 1024)
    outbox.load()
    writer = HistoryWriter(engine, outbox=outbox)
    times = TimeRule(3600, 60)
    gateway = DeviceGateway(engine, writer, EdgeDispatcher(engine, writer), NoReports(), times)
    async with background(writer.run):
        await gateway.mirror(StoredDevice("arm-1", SENSOR, None, 1, 1))
        made = Edge(gateway, outbox)
        gateway.attach("arm-1", made.robot, boot="b1")
        yield made
    engine.dispose()


async def test_a_motion_is_fresh_or_fails_with_the_reason(edge: Edge) -> None:
    edge.order("turn", "fresh", age_s=0.1)
    edge.order("turn", "old", age_s=2.5)
    edge.order("turn", "unknown", age_s=None)
    edge.order("turn", "late", age_s=1.0, remaining_s=0.9)
    edge.order("nothing", "unregistered", age_s=3.0)  # counts as a motion
    assert [one["id"] for one in edge.robot.received] == ["fresh"]
    edge.gateway.end("arm-1", "away", "away", retry=True)
    edge.order("turn", "away", age_s=0.1)
    found = "\n".join(await edge.answers(5))
    for identifier, reason in (
        ("old", "reached the edge up to 2.5 s after"),
        ("unknown", "up to ? s after"),
        ("late", "after its deadline"),
        ("away", "not connected to the edge"),
    ):
        assert f'"id":"{identifier}","reason":"' in found
        assert reason in found
    assert "fresh" not in found


async def test_a_replica_is_not_called_an_edge(edge: Edge) -> None:
    edge.commands = EdgeCommands(edge.gateway, max_motion_delay_s=2.0, is_replica=True)
    edge.order("turn", "old", age_s=2.5)
    edge.order("turn", "late", age_s=1.0, remaining_s=0.9)
    edge.gateway.end("arm-1", "away", "away", retry=True)
    edge.order("turn", "away", age_s=0.1)
    found = [parse_message(body.encode(), 64 * 1024) for body in await edge.answers(3)]
    assert [answer.reason.code for answer in found] == [
        "device.replica_motion_late",
        "device.replica_too_late",
        "device.replica_device_away",
    ]
    assert not any("edge" in answer.reason.partition("(HANDOVER")[0] for answer in found)


async def test_an_action_may_be_late_and_is_left_to_the_centre_when_the_device_is_away(edge: Edge) -> None:
    edge.order("beep", "slow", age_s=30.0)
    edge.order("beep", "over", age_s=61.0)
    assert [one["id"] for one in edge.robot.received] == ["slow"]
    edge.gateway.end("arm-1", "away", "away", retry=True)
    edge.order("beep", "away", age_s=0.1)
    edge.order("turn", "marker", age_s=0.1)
    (only,) = await edge.answers(1)
    assert '"marker"' in only  # nothing is answered for actions: the centre repeats or ends them


async def test_a_driven_robot_stops_when_the_link_ends_or_velocities_stop_coming(edge: Edge) -> None:
    edge.drive(1)
    edge.drive(2, age_s=0.5)  # too old
    edge.drive(3)
    edge.commands.stop_driven()
    assert edge.held() == [(1, True), (3, True), (3, False)]
    edge.drive(4, valid_s=0.001)
    await until(lambda: (4, False) in edge.held())
    edge.drive(5)
    edge.drive(6, held=False, age_s=9.0)  # a stop is never too old
    edge.commands.stop_driven()
    assert edge.held()[-2:] == [(5, True), (6, False)]


async def test_motions_that_run_are_cancelled_and_ended_ones_are_not(edge: Edge) -> None:
    for identifier in ("one", "two", "three"):
        edge.order("turn", identifier, age_s=0.1)
    edge.commands.note_answer("arm-1", CommandAnswer("one", AnswerState.DONE))
    edge.commands.note_answer("arm-1", CommandAnswer("two", AnswerState.RUNNING, progress=0.5))
    edge.commands.note_answer("arm-1", CommandAnswer("three", None, reason="blocked"))
    assert edge.commands.cancel_motions() == 1
    last = edge.robot.received[-1]
    assert (last["name"], last["parameters"]) == ("cancel", {"id": "two"})
    assert edge.commands.cancel_motions() == 0
