"""A machine commands ROS 2 in each cycle of its controller, without broker and bridge."""

import asyncio
import time
from collections import defaultdict
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="the extra [ros] is not installed")

from handover.control.speed_limits import Allowed
from handover.runtime.background_tasks import BackgroundTasks
from handover_cases.body_link import BodyLink
from handover_cases.machine import CASES, Seen
from handover_cases.machines.wheelchair.case import WheelchairMachine
from handover_cases.model.body import Body, Reading
from handover_cases.running.machine_runner import MachineRunner
from handover_cases.running.ros_commands import RosCommands
from handover_ros.graph.joining import Adapter, JoinSettings, join
from handover_ros.types.type_store import TypeStore
from tests.kit.ros_domains import ros_domain
from tests.kit.waiting import until

CYCLE_S = 0.05


async def no_headers() -> Mapping[str, str]:
    return {}


def runner_of(case: str) -> MachineRunner:
    link = BodyLink("http://127.0.0.1:9", person="p", robot="r", sensors=(), headers=no_headers)
    return MachineRunner(CASES.load(case), link, BackgroundTasks("test"))


def drive(runner: MachineRunner, forwards_mm: float, seconds: float) -> list[tuple[float, float]]:
    """Step the wheelchair, publish in each cycle, and return what was commanded."""
    machine, commanded = runner.machine, []
    assert isinstance(machine, WheelchairMachine)
    for _ in range(round(seconds / CYCLE_S)):
        now_s = time.monotonic()
        readings = {"copX": 0.0, "copY": forwards_mm, "heartRate": 70.0}
        body = Body({name: Reading(value, now_s) for name, value in readings.items()})
        machine.step(Seen(now_s, CYCLE_S, body, Allowed("body", 1.0)))
        runner.on_cycle(runner)
        commanded.append((machine.controller.linear, machine.controller.angular))
    return commanded


async def test_each_cycle_of_a_machine_is_a_message_on_ros() -> None:
    domain = ros_domain()
    chair, bed = runner_of("wheelchair"), runner_of("bed")
    graph = await join(TypeStore([]), JoinSettings(domain_id=domain), Adapter.CYCLONE)
    received: defaultdict[str, list[Any]] = defaultdict(list)
    subscriptions = [
        await graph.subscribe(topic, of, lambda one, topic=topic: received[topic].append(one.message))
        for topic, of in (("/cmd_vel", "geometry_msgs/msg/Twist"), ("/bed/backrest", "std_msgs/msg/Float64"))
    ]
    commands = asyncio.create_task(RosCommands(domain, [chair, bed]).run())
    try:
        chair.machine.start()

        def both_are_received() -> bool:
            drive(chair, 0.0, CYCLE_S)
            bed.on_cycle(bed)
            return bool(received["/cmd_vel"] and received["/bed/backrest"])

        await until(both_are_received)
        drive(chair, 0.0, 2.0)
        given = drive(chair, 60.0, 1.0)
        assert given[-1][0] > 0.3
        await until(lambda: any(one["linear"]["x"] == given[-1][0] for one in received["/cmd_vel"]))
        commands.cancel()
        with suppress(asyncio.CancelledError):
            await commands
        await until(lambda: received["/cmd_vel"][-1]["linear"]["x"] == 0.0)
        drive(chair, 60.0, 1.0)
        assert received["/bed/backrest"][0] == {"data": 0.0}
    finally:
        commands.cancel()
        for one in subscriptions:
            await one.close()
        await graph.close()


async def test_a_machine_at_rest_leaves_its_topic_to_others() -> None:
    chair = runner_of("wheelchair")
    assert chair.machine.commands() == ()
    chair.machine.start()
    drive(chair, 0.0, 2.0)
    assert [command.topic for command in chair.machine.commands()] == ["/cmd_vel"]
    drive(chair, 60.0, 1.0)
    chair.machine.stop()
    assert chair.machine.commands(), "it still moves"
    drive(chair, 60.0, 3.0)
    assert chair.machine.commands() == ()
