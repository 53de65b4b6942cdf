"""The commands of the machines on ROS 2, at the rate of their controllers.

A control loop never waits for the broker: each cycle writes its commands to DDS by itself, and the bridge has
no part in it. A machine that is stopped gets velocities of 0 for `STOP_S`, then nothing, so that others may
command it. Without the lease of its Device nothing is published for a machine; when the lease ends soon, it
is stopped. A real machine must stop by itself when no command comes: DDS does not promise that one arrives.
"""

import asyncio
import time
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, Final

from handover.formats.ros_dds import TopicEndpoints, require_extra, struct_of
from handover.tasks.device_lease import DeviceLease
from handover.telemetry import get_logger
from handover_cases.metrics import COMMANDS
from handover_cases.model.command import Command, NumberCommand, VelocityCommand
from handover_cases.running.machine_runner import MachineRunner

log = get_logger(__name__)

STOP_S: Final = 1.0
MAX_BLOCKING_NS: Final = 1_000_000
"""A slow subscriber loses messages; it does not delay a cycle."""
RETRY_S: Final = 10.0


class RosCommands:
    """Publishes what the machines command, from the moment when the ROS domain could be joined."""

    def __init__(
        self,
        domain: int,
        runners: Sequence[MachineRunner],
        lease_of: Callable[[MachineRunner], DeviceLease | None] = lambda _: None,
    ) -> None:
        require_extra()
        self._domain = domain
        self._runners = runners
        self._lease_of = lease_of
        self._endpoints: TopicEndpoints | None = None
        self._writers: dict[str, tuple[Any, Any]] = {}
        """By topic, the writer and the DDS type."""
        self._moving: dict[tuple[str, str], float] = {}
        """Case and topic of velocities that were commanded, and until when they are followed by 0."""

    async def run(self) -> None:
        """Join the domain, publish in each cycle until cancelled, and then stop what moves."""
        while self._endpoints is None:
            try:
                self._endpoints = await asyncio.to_thread(TopicEndpoints, self._domain)
            except OSError as error:
                log.warning("ROS domain not joined", domain=self._domain, error=str(error))
                await asyncio.sleep(RETRY_S)
        for runner in self._runners:
            runner.on_cycle = self.publish
        try:
            await asyncio.Event().wait()
        finally:
            for runner in self._runners:
                runner.on_cycle = lambda _: None
            for _, topic in self._moving:
                self._write(self._endpoints, VelocityCommand(topic, 0.0))

    def publish(self, runner: MachineRunner) -> None:
        """Publish the commands of one cycle of one machine, and stop what it no longer commands."""
        if self._endpoints is None:
            return
        lease = self._lease_of(runner)
        if lease is not None and not lease.is_held():
            return
        case, now_s = runner.case.name, time.monotonic()
        commands = runner.machine.commands() if lease is None or lease.may_begin() else ()
        for command in commands:
            if isinstance(command, VelocityCommand):
                self._moving[case, command.topic] = now_s + STOP_S
            self._write(self._endpoints, command)
        commanded = {command.topic for command in commands}
        ended = [key for key in self._moving if key[0] == case and key[1] not in commanded]
        for key in ended:
            self._write(self._endpoints, VelocityCommand(key[1], 0.0))
            if now_s >= self._moving[key]:
                del self._moving[key]

    def _write(self, endpoints: TopicEndpoints, command: Command) -> None:
        try:
            if command.topic not in self._writers:
                struct = twist() if isinstance(command, VelocityCommand) else number()
                writer = endpoints.writer(command.topic, struct, max_blocking_ns=MAX_BLOCKING_NS)
                self._writers[command.topic] = writer, struct
            writer, struct = self._writers[command.topic]
            writer.write(_message_of(struct, command))
        except endpoints.failure as error:
            COMMANDS.labels("failed").inc()
            log.debug("command not published", topic=command.topic, error=str(error))
        else:
            COMMANDS.labels("published").inc()


@cache
def twist() -> Any:
    """Return the DDS type of `geometry_msgs/msg/Twist`."""
    vector = struct_of("geometry_msgs/msg/Vector3", [(axis, "float64") for axis in "xyz"])
    return struct_of("geometry_msgs/msg/Twist", (("linear", vector), ("angular", vector)))


@cache
def number() -> Any:
    """Return the DDS type of `std_msgs/msg/Float64`."""
    return struct_of("std_msgs/msg/Float64", (("data", "float64"),))


def _message_of(struct: Any, command: Command) -> Any:
    if isinstance(command, NumberCommand):
        return struct(data=command.value)
    vector = struct.__annotations__["linear"]
    linear = vector(x=command.linear_mps, y=0.0, z=0.0)
    return struct(linear=linear, angular=vector(x=0.0, y=0.0, z=command.angular_radps))
