"""An arm as a node of a ROS graph: a joint trajectory controller, a velocity controller and a gripper.

It behaves like ros2_control: a goal takes the place of the one before from the present joints, with quintic
interpolation to its first point; a cancelled goal holds the position at once.
"""

import asyncio
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handover_ros.graph.port import GoalEnded, GoalStatus, Message, ServedGoal
from handover_ros.graph.qos import SENSOR_DATA

CYCLE_S = 0.005
FOLLOW = "/joint_trajectory_controller/follow_joint_trajectory"
VELOCITIES = "/forward_velocity_controller/commands"
TWISTS = "/servo_node/delta_twist_cmds"

Array = NDArray[np.float64]


class RosArm:
    """The joints `names` at rest at `home`, and one finger; `reported` is the order of its joint states."""

    def __init__(self, names: list[str], home: list[float]) -> None:
        self.names = names
        self.reported = ["finger_joint", *reversed(names)]
        self.position: Array = np.array(home, dtype=float)
        self.velocity: Array = np.zeros(len(home))
        self.goals: list[Message] = []
        self.grips: list[float] = []
        self.velocities: list[list[float]] = []
        self.twists: list[Message] = []
        self.part_between_fingers = False
        self.fault = ""
        self.dead = False
        self.stuck = False
        self.path: list[tuple[float, Array]] = []
        """The joint positions in each cycle."""
        self._commanded: Array = np.zeros(len(home))
        self._goal: ServedGoal | None = None
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def is_at_rest(self) -> bool:
        """Return whether no joint moves."""
        return not self.velocity.any()

    async def join(self, graph: Any) -> None:
        """Serve the interfaces in a graph."""
        await graph.serve_action(FOLLOW, "control_msgs/action/FollowJointTrajectory", self.follow)
        await graph.serve_action(
            "/gripper_controller/gripper_cmd", "control_msgs/action/GripperCommand", self.grip
        )
        await graph.subscribe(VELOCITIES, "std_msgs/msg/Float64MultiArray", self._on_velocity)
        await graph.subscribe(TWISTS, "geometry_msgs/msg/TwistStamped", self._on_twist)
        states = await graph.publisher("/joint_states", "sensor_msgs/msg/JointState", SENSOR_DATA)
        self._tasks = [asyncio.create_task(self._report(states)), asyncio.create_task(self._run())]

    async def leave(self) -> None:
        """Stop reporting."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def follow(self, goal: ServedGoal) -> Message:
        """Follow the points of a goal."""
        self.goals.append(goal.request)
        if self.fault:
            raise GoalEnded(GoalStatus.ABORTED, {"error_code": -4, "error_string": self.fault})
        asked = goal.request["trajectory"]
        assert list(asked["joint_names"]) == self.names
        knots = [(0.0, self.position.copy(), self.velocity.copy(), np.zeros(len(self.names)))]
        for one in asked["points"]:
            at_s = one["time_from_start"]["sec"] + one["time_from_start"]["nanosec"] / 1e9
            knots.append(
                (at_s, *(np.array(one[key]) for key in ("positions", "velocities", "accelerations")))
            )
        self._goal = goal
        began_s = time.monotonic()
        while self._goal is goal:
            await asyncio.sleep(CYCLE_S)
            if self.dead:
                await asyncio.Event().wait()
            if goal.cancel_requested:
                self.velocity[:] = 0.0
                self._goal = None
                raise GoalEnded(GoalStatus.CANCELED)
            now_s = time.monotonic() - began_s
            if self._goal is goal and not self.stuck:
                self.position, self.velocity = interpolated(knots, now_s)
            if self._goal is goal and now_s >= knots[-1][0]:
                self._goal = None
                if self.stuck:
                    raise GoalEnded(GoalStatus.ABORTED, {"error_string": "goal tolerance violated"})
                return {"error_code": 0}
        raise GoalEnded(GoalStatus.ABORTED, {"error_string": "a new goal came"})

    async def grip(self, goal: ServedGoal) -> Message:
        """Move the fingers."""
        wanted_m = goal.request["command"]["position"]
        self.grips.append(wanted_m)
        if wanted_m == 0.0 and self.part_between_fingers:
            raise GoalEnded(GoalStatus.ABORTED, {"position": 0.03, "stalled": True})
        return {"position": wanted_m, "reached_goal": True}

    def _on_velocity(self, received: Any) -> None:
        self.velocities.append(list(map(float, received.message["data"])))
        self._commanded = np.array(self.velocities[-1])

    def _on_twist(self, received: Any) -> None:
        self.twists.append(received.message)

    async def _run(self) -> None:
        before_s = time.monotonic()
        while True:
            await asyncio.sleep(CYCLE_S)
            now_s = time.monotonic()
            if self._goal is None and not self.dead:
                self.velocity = self._commanded.copy()
                self.position = self.position + self.velocity * (now_s - before_s)
            before_s = now_s
            self.path.append((now_s, self.position.copy()))

    async def _report(self, states: Any) -> None:
        while not self.dead:
            now_ns = time.time_ns()
            at = {"finger_joint": 0.0, **dict(zip(self.names, self.position.tolist(), strict=True))}
            turning = {"finger_joint": 0.0, **dict(zip(self.names, self.velocity.tolist(), strict=True))}
            states.publish(
                {
                    "header": {"stamp": {"sec": now_ns // 10**9, "nanosec": now_ns % 10**9}},
                    "name": self.reported,
                    "position": [at[name] for name in self.reported],
                    "velocity": [turning[name] for name in self.reported],
                }
            )
            await asyncio.sleep(0.01)


def interpolated(knots: list[tuple[float, Array, Array, Array]], now_s: float) -> tuple[Array, Array]:
    """Return position and velocity on quintics between knots: time, position, velocity, acceleration."""
    if now_s >= knots[-1][0]:
        return knots[-1][1].copy(), knots[-1][2].copy()
    number = next(index for index, knot in enumerate(knots) if knot[0] > now_s)
    (t0, p0, v0, a0), (t1, p1, v1, a1) = knots[number - 1], knots[number]
    t = t1 - t0
    x = (now_s - t0) / t
    h = p1 - p0
    c3 = 10 * h - (6 * v0 + 4 * v1) * t - (3 * a0 - a1) * t * t / 2
    c4 = -15 * h + (8 * v0 + 7 * v1) * t + (3 * a0 - 2 * a1) * t * t / 2
    c5 = 6 * h - 3 * (v0 + v1) * t - (a0 - a1) * t * t / 2
    position = p0 + x * (v0 * t + x * (a0 * t * t / 2 + x * (c3 + x * (c4 + x * c5))))
    velocity = (v0 * t + x * (a0 * t * t + x * (3 * c3 + x * (4 * c4 + x * 5 * c5)))) / t
    return position, velocity
