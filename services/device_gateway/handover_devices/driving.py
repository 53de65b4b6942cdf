"""Driving a registered robot: a person's velocities over its connection, within its registered limits.

A person who drives has the lease of the robot (`handover.control.leasing`). The newest input counts; 50 times
a second the gateway sends the robot a `drive` message with velocities, and one with `held` false once the
dead-man control does not permit motion. Each velocity is valid for `VALID_S`: the program of the robot stops
when no newer one arrives, so that a broken connection or a dead gateway stops it too. A message that would
have to wait is not sent. Motion is neither stored, queued nor repeated.

A robot that walks or rolls takes the velocity of its base (x, y in m/s, rz in rad/s); one with joints takes
velocities of these. How a robot comes to rest is its own: a walking one goes to its stand, and sends the
event `rest` when it stands.
"""

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from handover.control.dead_man import TIMEOUT_S, DeadMan
from handover.errors import TranslatedError
from handover_datamodels.streams import HumanInput
from handover_devices.metrics import DRIVE_STOP_BEGIN
from handover_devices.model.description import DeviceKind, Joint
from handover_devices.registry.device import Device

EVERY_S: Final = 0.02
VALID_S: Final = 0.1
"""How long a velocity is valid at the robot."""
MAX_JOINT_FRACTION: Final = 0.3
"""The fraction of the speed of a joint that a person commands at most."""
DEFAULT_JOINT_RPS: Final = 0.3
"""Of a joint without a registered speed, in rad/s or m/s."""
MAX_BASE: Final = {DeviceKind.HUMANOID: (0.1, 0.5), DeviceKind.MOBILE_ROBOT: (0.5, 1.0)}
"""The speed of a base that a person commands at most, in m/s and rad/s."""
MAX_POSITION_AGE_S: Final = 2.0
LOOK_AHEAD_S: Final = 0.3
"""A joint does not move where it would be beyond its limit after this time and the age of its position."""
REST_EVENT: Final = "rest"


class NotDrivable(TranslatedError):
    """This robot cannot be driven now; the message names the way out."""


@dataclass(frozen=True, slots=True)
class DriveLimits:
    """What a person may command: velocities of the base (m/s, rad/s), and of the joints by name."""

    base: tuple[float, float] | None
    joints: Mapping[str, float]

    @classmethod
    def of(cls, device: Device) -> "DriveLimits":
        """Return the limits of a device."""
        description = device.stored.description
        return cls(
            MAX_BASE.get(description.kind), {joint.name: _fastest(joint) for joint in description.joints}
        )


def _fastest(joint: Joint) -> float:
    return DEFAULT_JOINT_RPS if joint.max_velocity is None else MAX_JOINT_FRACTION * joint.max_velocity


def require_drivable(device: Device) -> None:
    """Raise `NotDrivable` for a device that is no robot, is away, or whose program takes no velocities."""
    limits = DriveLimits.of(device)
    if limits.base is None and not limits.joints:
        raise NotDrivable.translated(
            "device.not_a_robot",
            "{device} has neither joints nor a base that moves; register it as a robot with its joints",
            device=device.name,
        )
    if device.link is None:
        raise NotDrivable.translated(
            "device.not_connected", "{device} is not connected; start its program", device=device.name
        )
    if not device.drives:
        raise NotDrivable.translated(
            "device.takes_no_motion",
            "the program of {device} follows no velocities; let it register a function with "
            "DeviceClient.drive",
            device=device.name,
        )


class DriveSession:
    """One person drives one device, until `end`, or until its connection ends."""

    def __init__(self, device: Device, gamma: float = 1.0, now: Callable[[], float] = time.monotonic) -> None:
        self._device = device
        self._link = device.link
        self._limits = DriveLimits.of(device)
        self._gamma = gamma
        self._now = now
        self._dead_man = DeadMan()
        self._input = HumanInput(seq=0, held=False)
        self._begun_s = self._received_s = now()
        self._released_s = 0.0
        self._sent = 0
        self._moves = False
        self._is_ended = False
        self._latency_s: float | None = None
        self._measured_seq = -1
        self._stopped_s: float | None = None
        self._stop_ms: dict[str, float | None] | None = None
        self._limit: str | None = None
        self._posture: str | None = None
        """How the robot says that it rests."""

    def receive(self, human_input: HumanInput) -> None:
        """Take an input. Raises `NotDrivable` for a gripper, and for joints that the robot does not have."""
        if human_input.gripper is not None:
            raise NotDrivable("the gripper of this robot acts by its commands, on the page Devices")
        count = len(self._limits.joints)
        if human_input.joints is not None and len(human_input.joints) != count:
            raise NotDrivable(
                f"joints has {len(human_input.joints)} values, and {self._device.name} has {count}"
            )
        now_s = self._now()
        if self._input.held and not human_input.held:
            self._released_s = now_s
        self._input, self._received_s = human_input, now_s
        self._dead_man.receive(now_s, is_held=human_input.held)
        if human_input.gamma is not None:
            self._gamma = human_input.gamma
        self.step()  # an input, and above all a release, does not wait for the next cycle

    def silence_s(self) -> float:
        """Return the time since the last input."""
        return self._now() - self._received_s

    def end(self) -> None:
        """Stop the robot; `run` returns then."""
        self._is_ended = True
        self.step()

    async def run(self) -> None:
        """Send velocities until the end, or until the robot is away."""
        try:
            while not self._is_ended and self._device.link is self._link:
                self.step()
                await asyncio.sleep(EVERY_S)
        finally:
            self.end()

    def step(self) -> None:
        """Send the present velocities, or the stop."""
        now_s = self._now()
        self._note_rest(now_s)
        link = self._device.link
        if link is None or link is not self._link:
            self._moves = False
            return
        permitted = not self._is_ended and self._dead_man.permits(now_s)
        wanted = self._velocities() if permitted else {}
        if not wanted:
            if self._moves:
                self._stop(link, now_s)
            return
        self._sent += 1
        moving = {"type": "drive", "seq": self._sent, "held": True, "validS": VALID_S, **wanted}
        if link.send_latest(moving):
            self._moves = True
            self._stopped_s = None
            if self._measured_seq != self._input.seq:
                self._measured_seq, self._latency_s = self._input.seq, now_s - self._received_s

    def _stop(self, link: Any, now_s: float) -> None:
        """Send the stop: it may wait, as a robot that reads nothing stops by itself."""
        self._moves = False
        self._sent += 1
        link.send({"type": "drive", "seq": self._sent, "held": False, "validS": VALID_S})
        cause_s = self._received_s + TIMEOUT_S if self._input.held else self._released_s
        begin_s = max(0.0, now_s - cause_s) if not self._is_ended else 0.0
        DRIVE_STOP_BEGIN.observe(begin_s)
        self._stopped_s = now_s
        self._stop_ms = {"beginMs": round(1000 * begin_s, 1), "restMs": None}

    def _note_rest(self, now_s: float) -> None:
        event = self._device.event
        if self._stopped_s is not None and self._stop_ms is not None and event is not None:
            data = event[1]
            if event[0] == REST_EVENT and isinstance(data, dict) and data.get("seq") == self._sent:
                self._stop_ms["restMs"] = round(1000 * (now_s - self._stopped_s), 1)
                self._stopped_s = None
                self._posture = str(data.get("posture", ""))[:64] or None

    def _velocities(self) -> dict[str, Any]:
        """Return what the robot should do; empty for nothing."""
        self._limit = None
        human_input = self._input
        if human_input.joints is not None:
            speeds = {
                name: self._joint(name, value * self._gamma)
                for name, value in zip(self._limits.joints, human_input.joints, strict=True)
            }
            moved = {name: speed for name, speed in speeds.items() if speed}
            return {"joints": moved} if moved else {}
        if self._limits.base is None:
            if any((*human_input.linear, *human_input.angular)):
                self._limit = "this robot takes velocities of its joints only"
            return {}
        fastest, turning = self._limits.base
        x, y = (_limited(self._gamma * speed, fastest) for speed in human_input.linear[:2])
        rz = _limited(self._gamma * human_input.angular[2], turning)
        return {"base": [x, y, rz]} if x or y or rz else {}

    def _joint(self, name: str, speed: float) -> float:
        """Return the speed of a joint within its limits; 0 towards an end that is near, or unknown."""
        speed = _limited(speed, self._limits.joints[name])
        if not speed:
            return 0.0
        sensor, latest = self._device.values[name], self._device.latest.get(name)
        if sensor.minimum is None or sensor.maximum is None:
            return speed  # continuous
        age_s = None if latest is None else time.time() - latest.t
        if latest is None or age_s is None or age_s > MAX_POSITION_AGE_S:
            self._limit = (
                f"the position of {name} is not known; it has to be sent every {MAX_POSITION_AGE_S:g} s"
            )
            return 0.0
        ahead = latest.value + speed * (max(age_s, 0.0) + LOOK_AHEAD_S)
        if not sensor.minimum <= ahead <= sensor.maximum and (ahead > sensor.maximum) == (speed > 0):
            self._limit = f"{name} is at its limit"
            return 0.0
        return speed

    def view(self) -> dict[str, Any]:
        """Return the present state, in the form of the trajectory tool."""
        now_s = self._now()
        latest, names = self._device.latest, list(self._limits.joints)
        values = [latest[name].value if name in latest else None for name in names]
        state = self._device.state
        return {
            "type": "state",
            "seq": self._input.seq,
            "joints": {
                "name": names,
                "position": [] if None in values else values,
                "velocity": [],
            },
            "moves": self._moves,
            "needsRelease": self._dead_man.needs_release(now_s),
            "limit": self._limit,
            "fault": None,
            "holds": None,
            "mix": 0.0,
            "goal": None,
            "goalDistanceM": None,
            "goals": {},
            "confidence": 0.0,
            "deviceState": None if state is None else state.value,
            "posture": None if self._moves else self._posture,
            "inputAgeMs": round((now_s - self._received_s) * 1000, 2),
            "stop": self._stop_ms,
            "isRecorded": False,
            "latencyMs": None if self._latency_s is None else round(self._latency_s * 1000, 2),
        }


def _limited(value: float, most: float) -> float:
    return max(-most, min(most, value))
