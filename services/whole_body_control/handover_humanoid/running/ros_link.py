"""The link of a humanoid to other nodes of a ROS graph: its state on topics, and their wishes.

The topics are below the name of the humanoid, with `_` for what ROS does not permit: `/coman_1/wish`
(`geometry_msgs/TwistStamped`), `joint_states`, `odometry`, `status`. A node that wishes holds a dead-man
control as a therapist does: it publishes zero first, then velocities 8 times a second or more; when it is
silent, the robot stands. While a therapist steers, its wishes do not count.

All stamps are of the robot's clock. A wish has the stamp of the newest state that the node has received; so
its delay, the whole way there and back, is measured by one clock. A wish that is older than `MAX_DELAY_S`, or
from the future, does not count.
"""

import asyncio
import math
import re
from collections.abc import Mapping
from typing import Any, Final

from pydantic import ValidationError
from websockets.asyncio.client import ClientConnection

from handover.control.limit_link import exchange, keep_connected
from handover.security.service_access import ServiceAccess
from handover.telemetry import get_logger
from handover_datamodels.humanoid_link import LINK_REPORTS, LinkSetup, LinkState, LinkWish
from handover_datamodels.robot_messages import StreamRefusal
from handover_humanoid.metrics import INPUTS, LINK_DELAY
from handover_humanoid.running.humanoid_control import HumanoidControl
from handover_humanoid.settings import WholeBodySettings

log = get_logger(__name__)

STATE_HZ: Final = 50.0
MAX_DELAY_S: Final = 0.3
AHEAD_S: Final = 0.05
"""The state that a wish answers may be newer than the one that this process has read."""
_SHOWN: Final = ("mode", "behaviour", "phase")


class RosLink:
    """The link of one humanoid; `run` keeps it."""

    def __init__(self, settings: WholeBodySettings, control: HumanoidControl, access: ServiceAccess) -> None:
        self._url, self._control, self._access = settings.humanoid_link, control, access
        self._ca_files = settings.ca_files
        base = f"/{re.sub('[^A-Za-z0-9_]', '_', control.name)}"
        self.setup = LinkSetup(
            humanoid=control.name,
            joint_names=control.model.joint_names,
            wish=f"{base}/wish",
            joint_states=f"{base}/joint_states",
            odometry=f"{base}/odometry",
            status=f"{base}/status",
        )
        self._delay_s, self._refused, self._problem = math.nan, "", ""

    async def run(self) -> None:
        """Keep the link until cancelled."""
        await keep_connected(
            self._url,
            self._serve,
            headers=self._access.headers,
            ca_files=self._ca_files,
            on_problem=self._say,
            peer="the ROS bridge",
        )

    async def _serve(self, socket: ClientConnection) -> None:
        await socket.send(self.setup.model_dump_json(by_alias=True))
        log.info("linked to the ROS graph", wish=self.setup.wish)
        self._problem = ""
        try:
            await exchange(socket, self._send(socket), self._take)
        finally:
            self._control.steering.leave(self)

    async def _send(self, socket: ClientConnection) -> None:
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            state = self._state()
            if state is not None:
                await socket.send(state.model_dump_json(by_alias=True))
            due_s = max(due_s + 1.0 / STATE_HZ, loop.time())
            await asyncio.sleep(due_s - loop.time())

    def _state(self) -> LinkState | None:
        """Return the newest state; None while the cycle has none that is finite."""
        control = self._control
        document, values = control.document(), control.links.values
        joints = [values.get(f"joint.{name}", math.nan) for name in self.setup.joint_names]
        base = [values.get(f"base.{axis}", math.nan) for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")]
        stamp_s, yaw = values.get("robot_time_s", math.nan), values.get("feet.yaw", math.nan)
        if not all(map(math.isfinite, (*joints, *base, stamp_s, yaw))):
            return None
        x, y = (values.get(f"velocity_reference.{axis}", 0.0) for axis in "xy")
        cosine, sine = math.cos(yaw), math.sin(yaw)
        fault = document["fault"]
        return LinkState(
            stamp=stamp_s,
            positions=tuple(joints),
            place=(base[0], base[1], base[2]),
            rotation=(base[3], base[4], base[5], base[6]),
            velocity=(cosine * x + sine * y, cosine * y - sine * x, 0.0),
            level=2 if fault else 1 if self._refused else 0,
            message=(str(fault.get("message", fault.get("code", ""))) if fault else self._refused)[:500],
            status=self._shown(document),
        )

    def _shown(self, document: Mapping[str, Any]) -> dict[str, str]:
        shown = {name: str(document[name]) for name in _SHOWN}
        shown["speed_share"] = f"{document['limit']['factor']:.3f}"
        shown["needs_release"] = str(bool(document["needsRelease"])).lower()
        shown["walked"] = " ".join(f"{velocity:.3f}" for velocity in self._control.motion.walked)
        shown["wish_delay_s"] = f"{self._delay_s:.3f}"
        return shown

    def _take(self, received: str | bytes) -> None:
        try:
            report = LINK_REPORTS.validate_json(received)
        except ValidationError as error:
            log.warning("report of the ROS bridge not read", error=str(error.errors()[0]["msg"]))
            return
        if isinstance(report, StreamRefusal):
            self._say(f"the ROS bridge: {report.reason}")
            return
        refused = self._refusal(report)
        INPUTS.labels("refused" if refused else "accepted").inc()
        if refused and refused != self._refused:
            log.warning("wish of the ROS graph refused", reason=refused)
        self._refused = refused
        if not refused:
            is_held = any((report.ahead, report.left, report.yaw))
            self._control.motion.walk(report.ahead, report.left, report.yaw, is_held=is_held)

    def _refusal(self, wish: LinkWish) -> str:
        """Measure the delay of a wish; return why it does not count, or nothing."""
        self._control.links.refresh()
        self._delay_s = self._control.links.values.get("robot_time_s", math.nan) - wish.stamp
        LINK_DELAY.set(self._delay_s)
        if not -AHEAD_S <= self._delay_s <= MAX_DELAY_S:
            return (
                f"a wish on {self.setup.wish} has the time {wish.stamp:.3f} s, which is {self._delay_s:.3f} "
                "s ago by the clock of the robot; give it the stamp of the newest state, "
                f"{MAX_DELAY_S} s old at most"
            )
        return "" if self._control.steering.takes(self) else "a therapist steers; wait for their end"

    def _say(self, problem: str) -> None:
        if problem != self._problem:
            log.warning("not linked to the ROS graph", reason=problem)
        self._problem = problem
