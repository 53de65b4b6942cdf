"""The trajectory tool takes real Tasks from a real broker; both are processes."""

import asyncio
import itertools
import json
import random
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from typing import Any

import httpx
import pytest

from handover.broker import BrokerClient, NotFound
from handover.settings import RESTARTED, Settings
from handover.subscriptions.own_subscriptions import OwnSubscriptions
from handover.subscriptions.record import SubscriptionRecord
from handover.tasks.outcomes import is_outcome_unknown
from handover.tasks.task_life import FINISHED
from handover_datamodels.entities import Device, DeviceState, Task, TaskStatus
from handover_robots.physics import is_available
from tests.kit.cell import Cell
from tests.kit.waiting import until

pytestmark = pytest.mark.slow

ROBOT = "urn:ngsi-ld:Device:demo:ur10-1"
AWAY = [1.5, -1.2, 1.4, -1.5, -1.5, 0.0]
HOME = [0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0]


class Shop:
    """A broker and a trajectory tool, and Tasks for its robot."""

    _numbers = itertools.count(1)

    def __init__(self, cell: Cell, broker: BrokerClient) -> None:
        self.cell = cell
        self.broker = broker

    async def ask(self, operation: str, definition: str = "work", **parameters: Any) -> str:
        """Create a Task and return its id; without `operation` its definition says what to do."""
        task_id = f"urn:ngsi-ld:Task:demo:{operation or definition}-{next(self._numbers)}"
        work_parameters = {"operation": operation, **parameters} if operation else parameters
        await self.broker.create(
            Task.from_ngsild(
                {
                    "id": task_id,
                    "type": "Task",
                    "isDefinedBy": f"urn:ngsi-ld:TaskDefinition:demo:{definition}",
                    "status": {"type": "Property", "value": "pending", "observedAt": _now()},
                    "involves": {"type": "Property", "value": [{"type": "Relationship", "object": ROBOT}]},
                    "workParameters": {"type": "Property", "value": work_parameters},
                }
            )
        )
        return task_id

    async def wish(self, task_id: str, wish: str) -> None:
        written = {"type": "Property", "value": wish, "observedAt": _now()}
        await self.broker.append(task_id, {"requestedStatus": written})

    async def comes_to(self, task_id: str, status: TaskStatus, within_s: float = 30.0) -> dict[str, Any]:
        """Wait until a Task is in `status`; return its outputParameters."""

        async def in_status() -> Task | None:
            task = await self.broker.get(task_id, Task)
            return task if task.status.value is status else None

        reached: Task = await until(in_status, within_s, f"{task_id} is not {status}")
        return dict(reached.output_parameters.value) if reached.output_parameters else {}

    async def done(self, operation: str, **parameters: Any) -> dict[str, Any]:
        return await self.comes_to(await self.ask(operation, **parameters), TaskStatus.COMPLETED)

    async def refused(self, operation: str, **parameters: Any) -> str:
        failed = await self.comes_to(await self.ask(operation, **parameters), TaskStatus.FAILED)
        return str(failed["reason"])

    async def device_is(self, state: DeviceState) -> Device:
        async def in_state() -> Device | None:
            try:
                device = await self.broker.get(ROBOT, Device)
            except (NotFound, ValueError):
                return None
            return device if device.device_state is not None and device.device_state.value is state else None

        reached: Device = await until(in_state, why=f"{ROBOT} is not {state}")
        return reached

    def robot(self) -> dict[str, Any]:
        answer = httpx.get(f"{self.cell.url('trajectory_tool')}/robots/ur10-1", timeout=120)
        return dict(answer.raise_for_status().json())

    async def in_motion(self) -> dict[str, Any]:
        def moving() -> dict[str, Any] | None:
            robot = self.robot()
            return robot if max(map(abs, robot["joints"]["velocity"])) > 0.3 else None

        seen: dict[str, Any] = await until(moving, why="the robot does not move")
        return seen


def _now() -> str:
    return datetime.now(UTC).isoformat().replace("+00:00", "Z")


@asynccontextmanager
async def at_work(cell: Cell) -> AsyncIterator[Shop]:
    cell.run("context_broker", "trajectory_tool")
    async with BrokerClient(Settings.load(broker_url=cell.url("context_broker"))) as broker:
        yield Shop(cell, broker)


@pytest.fixture
async def new_shop(cell: Cell) -> AsyncIterator[Shop]:
    """A shop in which nothing has been done yet, for tests of what lies where and what the robot holds."""
    async with at_work(cell) as made:
        yield made


@pytest.fixture
async def shop(shared_cell: Cell) -> AsyncIterator[Shop]:
    """The shop of all tests that only move the robot; it begins where a new one does."""
    async with at_work(shared_cell) as made:
        await made.done("home")
        await made.device_is(DeviceState.IDLE)
        yield made


@pytest.mark.nightly
async def test_the_robots_part_of_the_process_is_done(new_shop: Shop) -> None:
    assert (await new_shop.done("", definition="home"))["joints"] == HOME
    missed = await new_shop.done("scan", bin="bin-1")
    assert missed["found"] is False
    assert missed["reason"] == "no part lies free in bin-1"
    seen = await new_shop.done("scan", bin="bin-1")
    assert seen["found"] is True
    picked = await new_shop.done("pick", part=seen["part"], pose=seen["pose"])
    assert picked["part"] == seen["part"]
    assert picked["gripped"] is True
    assert 1 < picked["durationS"] < 10
    device = await new_shop.device_is(DeviceState.IDLE)
    assert device.value is not None
    assert device.value.value["holds"] == seen["part"]
    placed = await new_shop.done("place", location="fixture-1")
    assert placed["location"] == "fixture-1"
    assert placed["progress"] == 1.0
    metrics = httpx.get(f"{new_shop.cell.url('trajectory_tool')}/metrics", timeout=120).text
    assert 'handover_trajectory_tool_tasks_total{operation="scan",outcome="completed"} 2.0' in metrics


@pytest.mark.nightly
async def test_a_task_reports_its_progress_while_the_robot_moves(shop: Shop) -> None:
    task = await shop.ask("moveTo", joints=AWAY, speed=0.3)
    fractions = []
    async with asyncio.timeout(120):
        while (now := await shop.broker.get(task, Task)).status.value is not TaskStatus.COMPLETED:
            if now.status.value is TaskStatus.IN_PROGRESS and now.output_parameters is not None:
                fractions.append(now.output_parameters.value["progress"])
            await asyncio.sleep(0.05)
    assert fractions == sorted(fractions)
    assert len(set(fractions)) >= 3
    assert any(0.1 < fraction < 0.9 for fraction in fractions)


@pytest.mark.nightly
async def test_the_device_shows_the_state_of_the_robot(shop: Shop) -> None:
    device = await shop.device_is(DeviceState.IDLE)
    assert device.category is not None
    assert device.category.value == ("robot",)
    assert device.controlled_property.value == ("pose",)
    task = await shop.ask("moveTo", joints=AWAY, speed=0.3)
    await shop.device_is(DeviceState.BUSY)
    await shop.wish(task, "paused")
    await shop.device_is(DeviceState.PAUSED)
    await shop.wish(task, "inProgress")
    await shop.device_is(DeviceState.BUSY)
    await shop.comes_to(task, TaskStatus.COMPLETED)
    idle = await shop.device_is(DeviceState.IDLE)
    assert idle.value is not None
    assert idle.value.value["joints"] == AWAY


@pytest.mark.nightly
async def test_a_paused_task_stands_still_and_reaches_its_target_afterwards(shop: Shop) -> None:
    task = await shop.ask("moveTo", joints=AWAY, speed=0.4)
    seen = await shop.in_motion()
    assert seen["task"] == task
    assert seen["operation"] == "moveTo"
    assert seen["remainingS"] > 0
    await shop.wish(task, "paused")
    await shop.comes_to(task, TaskStatus.PAUSED)
    rest = shop.robot()
    assert rest["deviceState"] == "paused"
    assert rest["joints"]["velocity"] == [0.0] * 6
    assert 0 < rest["joints"]["position"][0] < AWAY[0]
    assert 0 < rest["progress"] < 1
    assert shop.robot()["joints"]["position"] == rest["joints"]["position"]
    await shop.wish(task, "inProgress")
    assert (await shop.comes_to(task, TaskStatus.COMPLETED))["joints"] == AWAY
    assert shop.robot()["task"] is None


@pytest.mark.nightly
async def test_a_cancelled_task_stops_the_robot_and_the_next_one_is_done(shop: Shop) -> None:
    task = await shop.ask("moveTo", joints=AWAY, speed=0.4)
    following = await shop.ask("home")
    await shop.in_motion()
    await shop.wish(task, "cancelled")
    assert (await shop.comes_to(task, TaskStatus.FAILED))["reason"] == "cancelled"
    assert (await shop.comes_to(following, TaskStatus.COMPLETED))["joints"] == HOME


async def test_a_paused_task_can_be_cancelled(shop: Shop) -> None:
    task = await shop.ask("moveTo", joints=AWAY, speed=0.4)
    await shop.in_motion()
    await shop.wish(task, "paused")
    await shop.comes_to(task, TaskStatus.PAUSED)
    await shop.wish(task, "cancelled")
    assert (await shop.comes_to(task, TaskStatus.FAILED))["reason"] == "cancelled"
    await shop.device_is(DeviceState.IDLE)


async def test_a_task_that_cannot_be_done_fails_with_the_reason(shop: Shop) -> None:
    assert "moveTo, moveLinear, scan, pick, place, home" in await shop.refused("dance")
    assert 'no operation "work"' in await shop.refused("")
    assert "UR10 has 6 joints" in await shop.refused("moveTo", joints=[0, 0])
    assert "reaches 1.30 m" in await shop.refused("moveTo", pose={"position": [3, 0, 0]})
    assert "the gripper is empty" in await shop.refused("place", location="fixture-1")
    assert (await shop.done("home"))["joints"] == HOME


@pytest.mark.nightly
async def test_a_motion_is_repeated_after_a_power_cut(shop: Shop) -> None:
    task = await shop.ask("moveTo", joints=AWAY, speed=0.4)
    await shop.in_motion()
    shop.cell.restart("trajectory_tool")
    assert (await shop.comes_to(task, TaskStatus.COMPLETED))["joints"] == AWAY


@pytest.mark.nightly
async def test_the_subscription_of_a_robot_that_was_removed_is_deleted_and_no_other(shop: Shop) -> None:
    def subscription(robot: str, address: str = shop.cell.url("trajectory_tool")) -> dict[str, Any]:
        return {
            "id": f"urn:ngsi-ld:Subscription:demo:trajectory-tool-{robot}-tasks",
            "type": "Subscription",
            "entities": [{"type": "Task"}],
            "notification": {"endpoint": {"uri": f"{address}/notifications/{robot}"}},
        }

    record = SubscriptionRecord(shop.cell.data_dir / "trajectory_tool" / "subscriptions.json")
    settings = Settings.load(_env_file=None)
    written = OwnSubscriptions("trajectory-tool", settings, shop.broker, record)
    for robot in ("gone", "moved"):
        await written.keep(subscription(robot))
    for robot in ("moved", "theirs"):  # another cell of the factory has these robots now
        await shop.broker.ensure_subscription(subscription(robot, "http://127.0.0.1:9"))
    shop.cell.restart("trajectory_tool")

    async def ids() -> set[str]:
        listed = await shop.broker.subscriptions()
        return {str(entity["id"]).removeprefix("urn:ngsi-ld:Subscription:demo:") for entity in listed}

    async def is_gone() -> bool:
        return "trajectory-tool-gone-tasks" not in await ids()

    await until(is_gone, why="the subscription of the removed robot stays")
    kept = {f"trajectory-tool-{robot}-tasks" for robot in ("ur10-1", "moved", "theirs")}
    assert kept <= await ids()

    def is_forgotten() -> bool:
        names = json.loads((shop.cell.data_dir / "trajectory_tool" / "subscriptions.json").read_text())
        return [name.rpartition(":")[2] for name in names] == ["trajectory-tool-ur10-1-tasks"]

    await until(is_forgotten, why="the record is not as the cell")


@pytest.mark.nightly
async def test_a_motion_continues_where_the_robot_was_when_the_tool_was_killed(new_shop: Shop) -> None:
    task = await new_shop.ask("moveTo", joints=AWAY, speed=0.2)

    def on_the_way() -> float:
        position = new_shop.robot()["joints"]["position"][0]
        return float(position) if position > 0.4 else 0.0

    before = await until(on_the_way, why="the robot does not move")
    new_shop.cell.restart("trajectory_tool")
    assert new_shop.robot()["joints"]["position"][0] >= before
    assert (await new_shop.comes_to(task, TaskStatus.COMPLETED))["joints"] == AWAY


@pytest.mark.nightly
async def test_a_tool_that_the_watchdog_has_restarted_continues_no_motion(new_shop: Shop) -> None:
    task = await new_shop.ask("moveTo", joints=AWAY, speed=0.4)
    await new_shop.in_motion()
    new_shop.cell.kill("trajectory_tool")
    new_shop.cell.extra[RESTARTED] = "1"
    new_shop.cell.start("trajectory_tool")
    here = new_shop.robot()["joints"]["position"]

    async def ended() -> Task | None:
        seen = await new_shop.broker.get(task, Task)
        return seen if seen.status.value in FINISHED else None

    seen: Task = await until(ended, 60, "the Task does not end")
    assert seen.status.value is TaskStatus.FAILED
    assert seen.output_parameters is not None
    assert is_outcome_unknown(seen.output_parameters.value), seen.output_parameters.value
    assert new_shop.robot()["joints"]["position"] == here, "it has not moved"
    assert (await new_shop.done("home"))["joints"] == HOME, "what is asked afterwards is done"


@pytest.mark.nightly
async def test_a_tool_that_is_killed_at_random_moments_repeats_no_act(cell: Cell) -> None:
    """Each pick and place is done once, or fails with an unknown outcome; no part is in two places."""
    chance = random.Random(7)
    cell.extra["HANDOVER_DETECTION_RATE"] = "1.0"
    async with at_work(cell) as shop:
        free = f"{cell.url('trajectory_tool')}/robots/ur10-1/gripper/free"
        for number in range(1, 6):
            holds = shop.robot()["gripper"]["holds"]
            asked = {"location": "fixture-1"} if holds else {"bin": "bin-1"}
            task = await shop.ask("place" if holds else "pick", **asked)
            await shop.in_motion()
            await asyncio.sleep(chance.uniform(0.0, 3.0))
            cell.restart("trajectory_tool")

            async def ended(task: str = task) -> Task | None:
                seen = await shop.broker.get(task, Task)
                return seen if seen.status.value in FINISHED else None

            seen: Task = await until(ended, 60, f"the Task {number} does not end")
            if seen.status.value is TaskStatus.FAILED:
                assert seen.output_parameters is not None
                assert is_outcome_unknown(seen.output_parameters.value), seen.output_parameters.value
                assert shop.robot()["gripper"]["interrupted"] is not None
                httpx.post(free, timeout=120).raise_for_status()
            robot = shop.robot()
            parts = [part["part"] for part in httpx.get(f"{free[:-13]}/scene", timeout=120).json()["parts"]]
            assert len(set(parts)) == len(parts)
            assert robot["gripper"]["holds"] not in parts


@pytest.mark.nightly
async def test_a_pick_cut_short_after_the_grip_takes_no_second_part(new_shop: Shop) -> None:
    task = await new_shop.ask("pick", bin="bin-1", speed=0.5)
    await until(lambda: new_shop.robot()["gripper"]["holds"] is not None)
    memory = new_shop.cell.data_dir / "trajectory_tool" / "cell.json"
    await until(lambda: '"held":"part-1"' in memory.read_text())
    new_shop.cell.kill("trajectory_tool")
    assert (await new_shop.broker.get(task, Task)).status.value is TaskStatus.IN_PROGRESS
    new_shop.cell.start("trajectory_tool")
    picked = await new_shop.comes_to(task, TaskStatus.COMPLETED)
    assert picked["part"] == "part-1"
    placed = await new_shop.done("place", location="fixture-1")
    assert placed["part"] == "part-1"
    assert (await new_shop.done("pick", bin="bin-1"))["part"] == "part-2"


@pytest.mark.nightly
async def test_the_device_is_written_again_after_the_broker_was_unavailable(shop: Shop) -> None:
    await shop.device_is(DeviceState.IDLE)
    shop.cell.restart("context_broker")
    shop.cell.wait_ready("trajectory_tool")
    task = await shop.ask("moveTo", joints=AWAY)
    await shop.comes_to(task, TaskStatus.COMPLETED)
    idle = await shop.device_is(DeviceState.IDLE)
    assert idle.value is not None
    assert idle.value.value["joints"] == AWAY


@pytest.mark.nightly
async def test_a_person_frees_the_gripper_but_not_while_the_robot_works(new_shop: Shop) -> None:
    url = f"{new_shop.cell.url('trajectory_tool')}/robots/ur10-1/gripper/free"
    await new_shop.done("pick", bin="bin-1")
    task = await new_shop.ask("home")
    await new_shop.in_motion()
    refused = httpx.post(url, timeout=120)
    assert refused.status_code == 409
    assert task in refused.json()["detail"]
    await new_shop.comes_to(task, TaskStatus.COMPLETED)

    def free() -> httpx.Response | None:
        freed = httpx.post(url, timeout=120)
        return freed if freed.status_code == 200 else None

    freed = await until(free, why="the gripper is not freed")
    assert freed.json()["gripper"] == {"closed": False, "holds": None, "interrupted": None}


@pytest.mark.nightly
async def test_a_part_is_found_picked_and_placed_in_simulated_physics(cell: Cell) -> None:
    if not is_available():
        pytest.skip("the extra physics is not installed")
    cell.extra |= {"HANDOVER_ROBOT": "physics", "HANDOVER_ROBOT_SPEED": "1"}
    async with at_work(cell) as shop:
        seen = await shop.done("scan", bin="bin-1")
        assert seen["found"] is True
        assert (await shop.done("pick", part=seen["part"], pose=seen["pose"]))["gripped"] is True
        assert shop.robot()["gripper"]["holds"] == seen["part"]
        placed = await shop.done("place", location="fixture-1")
        assert placed["part"] == seen["part"]
        refused = await shop.refused("calibrateCamera", target="divider")
        assert 'no sphere "divider"' in refused
