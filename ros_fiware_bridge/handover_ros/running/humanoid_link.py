"""The state of a humanoid on topics of the graph, and the wishes of its nodes back to whole-body control.

The messages are those of `handover_datamodels.humanoid_link`.
"""

import time
from collections.abc import Callable
from typing import Final, Self

from pydantic import BaseModel

from handover.telemetry import get_logger
from handover_datamodels.humanoid_link import LinkSetup, LinkState, LinkWish
from handover_ros.graph.port import Message, Publisher, Received, RosGraph, Subscription
from handover_ros.graph.qos import DEFAULT, SENSOR_DATA

log = get_logger(__name__)

WISH: Final = "geometry_msgs/msg/TwistStamped"
JOINT_STATE: Final = "sensor_msgs/msg/JointState"
ODOMETRY: Final = "nav_msgs/msg/Odometry"
DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"
STATUS_EVERY_S: Final = 0.1

Send = Callable[[BaseModel], None]


class HumanoidLink:
    """One humanoid; an asynchronous context manager. `send` is called on the event loop with each wish.

    Raises `GraphError` on entry for names that ROS does not permit.
    """

    def __init__(self, graph: RosGraph, setup: LinkSetup, send: Send) -> None:
        self.setup = setup
        self._graph, self._send = graph, send
        self._wishes: Subscription | None = None
        self._publishers: list[Publisher] = []
        self._status_s = float("-inf")

    async def __aenter__(self) -> Self:
        setup = self.setup
        topics = ((setup.joint_states, JOINT_STATE), (setup.odometry, ODOMETRY), (setup.status, DIAGNOSTICS))
        try:
            for topic, kind in topics:
                qos = DEFAULT if kind == DIAGNOSTICS else SENSOR_DATA
                self._publishers.append(await self._graph.publisher(topic, kind, qos))
            self._wishes = await self._graph.subscribe(setup.wish, WISH, self._receive)
        except BaseException:
            await self._close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._close()

    async def _close(self) -> None:
        for endpoint in (*self._publishers, self._wishes):
            if endpoint is not None:
                await endpoint.close()

    def take(self, state: LinkState) -> None:
        """Publish a state. Raises `ValueError` for one that does not fit the setup."""
        count = len(self.setup.joint_names)
        if len(state.positions) != count:
            raise ValueError(f"{len(state.positions)} positions for {count} joints")
        header = {"stamp": _stamp(state.stamp), "frame_id": "odom"}
        joints, odometry, status = self._publishers
        joints.publish(
            {"header": header, "name": list(self.setup.joint_names), "position": list(state.positions)}
        )
        x, y, z, w = state.rotation
        pose = {"position": _vector(state.place), "orientation": {"x": x, "y": y, "z": z, "w": w}}
        odometry.publish(
            {
                "header": header,
                "child_frame_id": "base",
                "pose": {"pose": pose},
                "twist": {"twist": {"linear": _vector(state.velocity)}},
            }
        )
        now_s = time.monotonic()
        if now_s - self._status_s >= STATUS_EVERY_S:
            self._status_s = now_s
            values = [{"key": key, "value": value} for key, value in state.status.items()]
            status.publish(
                {
                    "header": header,
                    "status": [
                        {
                            "level": state.level,
                            "name": self.setup.humanoid,
                            "message": state.message,
                            "hardware_id": self.setup.humanoid,
                            "values": values,
                        }
                    ],
                }
            )

    def _receive(self, received: Received) -> None:
        stamp, twist = received.message["header"]["stamp"], received.message["twist"]
        try:
            wish = LinkWish(
                stamp=stamp["sec"] + stamp["nanosec"] / 1e9,
                ahead=float(twist["linear"]["x"]),
                left=float(twist["linear"]["y"]),
                yaw=float(twist["angular"]["z"]),
                age_s=max(time.time() - received.received_at_s, 0.0),
            )
        except ValueError as error:  # not finite
            log.warning("wish not read", topic=self.setup.wish, error=str(error).splitlines()[0])
            return
        self._send(wish)


def _stamp(seconds: float) -> Message:
    whole = int(seconds // 1)
    return {"sec": whole, "nanosec": min(round((seconds - whole) * 1e9), 10**9 - 1)}


def _vector(values: tuple[float, float, float]) -> Message:
    return dict(zip("xyz", values, strict=True))
