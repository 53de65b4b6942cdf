"""Guards of the limiter: what depends on the place of the arm, not on a joint alone.

`CollisionGuard` uses the collision model of motion planning, `ToolSpeedGuard` the speed of the tool,
`TorqueGuard` the inverse dynamics. Each is used by one thread, and sees the configurations that the joints
pass on their way to rest.
"""

import logging
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

import numpy as np

from handover_robots.model.joints import Joints
from handover_robots.model.obstacles import World
from handover_robots.model.robot_model import RobotModel
from handover_robots.model.trajectory import Setpoint
from handover_robots.planning import is_available
from handover_robots.scene.scene import Zone

MARGIN_M = 0.002
LADDER_M = tuple(0.004 * 2.0**step for step in range(9))
"""The travels that one query certifies; each has its own set of requests."""
SAME_DISTANCE_M = 1e-7
FORWARD_S = 1e-4
PEAK_EVERY_S, MIN_PEAK_SAMPLES, MAX_PEAK_SAMPLES = 0.01, 30, 1000
SLOW_EVERY_S, MAX_SLOW_SAMPLES = 0.04, 100
"""Without the extra `motion`, a speed takes twenty times as long to compute."""
PEAK_RESERVE = 1.02
ZONE_MARGIN_M = 0.05
SLOW_MPS = 1e-6
RESERVE = 0.95
"""The fraction of a limit that is used, since a way to rest is checked at samples."""
TORQUE_TOLERANCE = 1.05
"""Of the limit of a joint, for setpoints of planned motions."""
TORQUE_RESERVE = 0.85
"""The same for commanded velocities; the torque on a way to rest may peak between its samples."""

log = logging.getLogger(__name__)


class Guard(Protocol):
    """A rule for setpoints."""

    def needs_preparation(self) -> bool:
        """Return whether `start` would take long."""

    def prepare(self) -> None:
        """Build what `start` needs."""

    def start(self, joints: Joints) -> None:
        """Begin a motion at rest at `joints`."""

    def violation(self, setpoint: Setpoint) -> str | None:
        """Return why a setpoint of a planned motion is refused; None if it is permitted."""

    def permits_stop(self, stop: Sequence[Setpoint]) -> bool:
        """Return whether a way to rest is permitted; the first setpoint is the next to be commanded."""

    def note(self, setpoint: Setpoint) -> None:
        """Note a commanded setpoint whose way to rest `permits_stop` has permitted."""


class CollisionGuard:
    """The robot touches neither itself nor its surroundings.

    A motion that begins in contact may leave it, and one that ended near to something may lead away from it.
    `world` is read at the start of each motion. Needs the extra `motion`.
    """

    def __init__(self, model: RobotModel, world: Callable[[], World]) -> None:
        self._model = model
        self._world = world
        self._collisions: Any = None
        self._is_leaving = False
        self._last: Any = None

    def needs_preparation(self) -> bool:
        """Return whether the surroundings differ from those of the model."""
        return self._collisions is None or self._collisions.world != self._world()

    def prepare(self) -> None:
        """Build the model of the present surroundings."""
        from handover_robots.planning.arm import Arm  # noqa: PLC0415 - needs the extra
        from handover_robots.planning.collision import Collisions  # noqa: PLC0415

        collisions = Collisions(Arm(self._model), self._world())
        for travel_m in (0.0, *LADDER_M[:4]):  # those of a slow motion
            collisions.is_free_within(
                np.zeros(len(self._model.joints)), travel_m, MARGIN_M if travel_m else 0.0
            )
        self._collisions = collisions

    def start(self, joints: Joints) -> None:
        """Begin a motion; take the present surroundings."""
        if self.needs_preparation():
            self.prepare()
        self._last = np.array(joints)
        self._is_leaving = not self._collisions.is_free(self._last)

    def violation(self, setpoint: Setpoint) -> str | None:
        """Return what touches."""
        joints = np.array(setpoint.positions)
        is_free = self._collisions.is_free(joints)
        if is_free or self._is_leaving:
            self._is_leaving = not is_free
            self._last = joints
            return None
        nearest = self._collisions.closest(joints)
        return f"{nearest.first} would touch {nearest.second}"

    def permits_stop(self, stop: Sequence[Setpoint]) -> bool:
        """Return whether the way to rest is free, with what lies between its setpoints."""
        if self._is_leaving:
            self._is_leaving = not self._collisions.is_free(np.array(stop[0].positions))
            return True
        box = getattr(stop, "box", None)
        if box is not None and self._is_free_between(*map(np.array, box)):
            return True
        path = np.array([setpoint.positions for setpoint in stop])
        return (
            self._is_free(path)
            or all(self._is_free(path[number : number + 2]) for number in range(len(path) - 1))
            or self._leads_away(path)
        )

    def note(self, setpoint: Setpoint) -> None:
        """Remember where the robot is commanded to be."""
        self._last = setpoint.positions

    def _leads_away(self, path: Any) -> bool:
        """Return whether nothing comes nearer on a short way to rest: one that cannot be certified."""
        if float(self._collisions.reach @ np.ptp(path, axis=0)) > LADDER_M[0]:
            return False
        here_m = self._collisions.closest(np.asarray(self._last)).distance_m
        return bool(
            self._collisions.closest(path[-1]).distance_m > here_m
            and self._collisions.closest(path[0]).distance_m >= here_m - SAME_DISTANCE_M
        )

    def _is_free(self, path: Any) -> bool:
        """Return whether every configuration between the extremes of `path` is free, by one query."""
        return self._is_free_between(path.min(axis=0), path.max(axis=0))

    def _is_free_between(self, lower: Any, upper: Any) -> bool:
        travel_m = float(self._collisions.reach @ (upper - lower)) / 2
        covering = next((step for step in LADDER_M if step >= travel_m), None)
        if covering is None:
            return False
        return bool(self._collisions.is_free_within((lower + upper) / 2, covering, MARGIN_M))


class TorqueGuard:
    """The drives of the joints exceed no limit of torque, with the payload of `world`.

    A setpoint of a planned motion is refused only where a drive pushes its joint on: a brake motion would not
    lower the torque of a joint that brakes. A motion that begins above a limit may continue, but not higher.
    Needs the extra `motion`. A robot without inertia in its URDF is not checked, which is logged.
    """

    def __init__(self, model: RobotModel, world: Callable[[], World]) -> None:
        self._model = model
        self._world = world
        self._torques: Any = None
        self._inverse: Any = None
        self._at_start = 0.0

    def needs_preparation(self) -> bool:
        """Return whether the payload differs from that of the model."""
        return self._torques is None or self._torques.payload_kg != self._world().payload_kg

    def prepare(self) -> None:
        """Build the model with the present payload."""
        from handover_robots.planning.arm import Arm  # noqa: PLC0415 - needs the extra
        from handover_robots.planning.torques import Torques  # noqa: PLC0415

        self._torques = Torques(Arm(self._model), self._world().payload_kg)
        self._inverse = 1.0 / self._torques.limits
        if self._torques.unchecked is not None:
            log.warning(
                "torque not checked", extra={"robot": self._model.name, "reason": self._torques.unchecked}
            )

    def start(self, joints: Joints) -> None:
        """Begin a motion; take the present payload."""
        if self.needs_preparation():
            self.prepare()
        self._at_start = self._highest(Setpoint.at_rest(joints))

    def violation(self, setpoint: Setpoint) -> str | None:
        """Return which joint needs too much torque."""
        allowed = max(1.0, self._at_start) * TORQUE_TOLERANCE
        if self._torques.unchecked is not None or self._highest(setpoint) <= allowed:
            return None
        shares = self._shares(setpoint)
        pushing = shares * np.sign(setpoint.velocities)
        number = int(pushing.argmax())
        if pushing[number] <= allowed:
            return None
        torques = self._torques
        limit = float(torques.limits[number])
        needed = torques.text(number, shares[number] * limit)
        return (
            f"{torques.names[number]} would need {needed}, above its limit of {torques.text(number, limit)}"
        )

    def permits_stop(self, stop: Sequence[Setpoint]) -> bool:
        """Return whether the torques are within the limits on the way to rest."""
        if self._torques.unchecked is not None:
            return True
        allowed = max(TORQUE_RESERVE, self._at_start)
        return all(self._highest(setpoint) <= allowed for setpoint in stop[::2])

    def note(self, setpoint: Setpoint) -> None:
        """Do nothing."""

    def _highest(self, setpoint: Setpoint) -> float:
        shares = self._shares(setpoint)
        return max(float(shares.max()), -float(shares.min()))

    def _shares(self, setpoint: Setpoint) -> Any:
        """Return the torque of each joint as a fraction of its limit."""
        joints, velocities, accelerations = map(np.array, setpoint.derivatives)
        return self._torques.of(joints, velocities, accelerations) * self._inverse


class ToolSpeedGuard:
    """The tool moves at `max_mps()` at most, and in each of `zones()` at the speed of the zone.

    It governs commanded velocities: a way to rest that leads into a zone is slow enough there, so the tool
    slows down before the zone. When a limit falls below the present speed, the tool brakes until it is slow
    enough. A planned motion is slowed down as a whole, by its pace.
    """

    def __init__(
        self,
        model: RobotModel,
        max_mps: Callable[[], float],
        zones: Callable[[], Sequence[Zone]] = lambda: (),
    ) -> None:
        self._model = model
        self._max_mps = max_mps
        self._zones = zones
        self._last: Setpoint | None = None
        self._arm: Any = None

    def needs_preparation(self) -> bool:
        """Return whether a model is needed, and missing."""
        return self._arm is None and is_available() and bool(self._zones() or self._max_mps() < math.inf)

    def prepare(self) -> None:
        """Build the model."""
        if self.needs_preparation():
            from handover_robots.planning.arm import Arm  # noqa: PLC0415 - needs the extra

            self._arm = Arm(self._model)

    def start(self, joints: Joints) -> None:
        """Begin a motion at rest."""
        self._last = Setpoint.at_rest(joints)
        self.prepare()

    def violation(self, setpoint: Setpoint) -> None:
        """Permit every setpoint of a planned motion."""
        self.note(setpoint)

    def note(self, setpoint: Setpoint) -> None:
        """Remember the speed."""
        self._last = setpoint

    def permits_stop(self, stop: Sequence[Setpoint]) -> bool:
        """Return whether the tool is slow enough on its way to rest."""
        max_mps, zones = self._max_mps(), self._zones()
        if max_mps == math.inf and not zones:
            return True
        if self._last is not None and not self._is_slow(self._last, max_mps, zones):
            return False
        return all(self._is_slow(setpoint, max_mps * RESERVE, zones, RESERVE) for setpoint in stop)

    def _is_slow(
        self, setpoint: Setpoint, max_mps: float, zones: Sequence[Zone], reserve: float = 1.0
    ) -> bool:
        speed_mps = self._tool_speed_mps(setpoint)
        if speed_mps > max_mps + SLOW_MPS:
            return False
        faster = [zone for zone in zones if zone.max_tool_speed_mps * reserve + SLOW_MPS < speed_mps]
        if not faster:
            return True
        tool = (self._arm or self._model).tool_pose(setpoint.positions).position
        return all(zone.distance_m(tool) > ZONE_MARGIN_M for zone in faster)

    def _tool_speed_mps(self, setpoint: Setpoint) -> float:
        if self._arm is None:
            return tool_speed_mps(self._model, setpoint)
        return float(self._arm.tool_speed_mps(np.array(setpoint.positions), np.array(setpoint.velocities)))


class PeakSpeeds:
    """The highest speeds in motions of a robot; used by one thread."""

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        self._arm: Any = None

    def of_tool(self, at: Callable[[float], Setpoint], duration_s: float) -> float:
        """Return the highest speed of the tool; a little more, for what lies between the samples."""
        if self._arm is None and is_available():
            from handover_robots.planning.arm import Arm  # noqa: PLC0415 - needs the extra

            self._arm = Arm(self._model)
        return PEAK_RESERVE * max(map(self._tool_speed_mps, self._samples(at, duration_s)))

    def of_links(
        self, at: Callable[[float], Setpoint], duration_s: float, counts: Callable[[Joints], bool]
    ) -> float:
        """Return the highest speed of any end of a link where it `counts`; call `of_tool` before."""
        speeds = (
            self._fastest_mps(setpoint)
            for setpoint in self._samples(at, duration_s)
            if counts(setpoint.positions)
        )
        return PEAK_RESERVE * max(speeds, default=0.0)

    def _samples(self, at: Callable[[float], Setpoint], duration_s: float) -> Iterator[Setpoint]:
        every_s, most = (PEAK_EVERY_S, MAX_PEAK_SAMPLES) if self._arm else (SLOW_EVERY_S, MAX_SLOW_SAMPLES)
        count = min(max(math.ceil(duration_s / every_s), MIN_PEAK_SAMPLES), most)
        return (at(duration_s * number / count) for number in range(1, count))

    def _fastest_mps(self, setpoint: Setpoint) -> float:
        if self._arm is not None:
            return float(self._arm.fastest_mps(np.array(setpoint.positions), np.array(setpoint.velocities)))
        here, there = (self._model.chain(positions) for positions in (setpoint.positions, _soon(setpoint)))
        ways_m = (math.dist(before, after) for before, after in zip(here, there, strict=True))
        return max(*ways_m, 0.0) / FORWARD_S

    def _tool_speed_mps(self, setpoint: Setpoint) -> float:
        if self._arm is None:
            return tool_speed_mps(self._model, setpoint)
        return float(self._arm.tool_speed_mps(np.array(setpoint.positions), np.array(setpoint.velocities)))


def tool_speed_mps(model: RobotModel, setpoint: Setpoint) -> float:
    """Return the speed of the tip of the tool."""
    if not any(setpoint.velocities):
        return 0.0
    here, there = model.tool_pose(setpoint.positions), model.tool_pose(_soon(setpoint))
    return here.distance_m(there) / FORWARD_S


def _soon(setpoint: Setpoint) -> Joints:
    return tuple(
        position + FORWARD_S * velocity
        for position, velocity in zip(setpoint.positions, setpoint.velocities, strict=True)
    )
