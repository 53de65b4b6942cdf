"""A humanoid as a node of a ROS graph: joints that follow commands, an inertial sensor, force-torque sensors.

It reports its joints in another order than the model, with one more, and by a clock of its own.
"""

import asyncio
from typing import Any

import numpy as np

from handover_ros.graph.port import Message
from handover_ros.graph.qos import SENSOR_DATA

PERIOD_S, FIRST_STAMP_S = 0.005, 1000.0
JOINT_STATES, IMU, COMMANDS, GAINS = "/joint_states", "/imu", "/joint_commands", "/joint_gains"


class RosHumanoid:
    """The joints `names` at `home`, and a topic of each of the `wrenches`."""

    def __init__(self, names: tuple[str, ...], home: Any, wrenches: tuple[str, ...]) -> None:
        self.names = names
        self.reported = ["neck", *reversed(names)]
        self.positions = dict(zip(names, np.asarray(home).tolist(), strict=True))
        self.wrenches = wrenches
        self.commands: list[Message] = []
        self.gains: list[list[float]] = []
        self.is_silent = False
        self.has_imu = True
        self._cycles = 0
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def time_s(self) -> float:
        """Return the time of its clock."""
        return FIRST_STAMP_S + self._cycles * PERIOD_S

    async def join(self, graph: Any) -> None:
        """Publish and subscribe in a graph."""
        await graph.subscribe(COMMANDS, "sensor_msgs/msg/JointState", self._follow)
        await graph.subscribe(
            GAINS,
            "std_msgs/msg/Float64MultiArray",
            lambda got: self.gains.append(got.message["data"].tolist()),
        )
        joints = await graph.publisher(JOINT_STATES, "sensor_msgs/msg/JointState", SENSOR_DATA)
        imu = await graph.publisher(IMU, "sensor_msgs/msg/Imu", SENSOR_DATA)
        wrenches = [
            await graph.publisher(topic, "geometry_msgs/msg/WrenchStamped", SENSOR_DATA)
            for topic in self.wrenches
        ]
        self._tasks = [asyncio.create_task(self._report(joints, imu, wrenches))]

    async def leave(self) -> None:
        """Stop reporting."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _follow(self, received: Any) -> None:
        command = received.message
        self.commands.append(command)
        self.positions.update(zip(command["name"], np.asarray(command["position"]).tolist(), strict=False))

    async def _report(self, joints: Any, imu: Any, wrenches: list[Any]) -> None:
        while True:
            await asyncio.sleep(PERIOD_S)
            self._cycles += 1
            if self.is_silent:
                continue
            seconds = int(self.time_s)
            header = {"stamp": {"sec": seconds, "nanosec": round((self.time_s - seconds) * 1e9)}}
            if self.has_imu:
                imu.publish(
                    {
                        "header": header,
                        "angular_velocity": {"x": 0.1, "y": 0.2, "z": 0.3},
                        "linear_acceleration": {"x": 0.0, "y": 0.0, "z": 9.81},
                    }
                )
            for number, topic in enumerate(wrenches):
                force = {"x": 0.0, "y": 0.0, "z": 100.0 + number}
                topic.publish({"header": header, "wrench": {"force": force, "torque": {"y": 1.0}}})
            at = {"neck": 0.7, **self.positions}
            joints.publish(
                {
                    "header": header,
                    "name": self.reported,
                    "position": [at[name] for name in self.reported],
                    "velocity": [0.0] * len(self.reported),
                    "effort": [float(number) for number in range(len(self.reported))],
                }
            )
