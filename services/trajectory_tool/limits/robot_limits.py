"""The limits of one robot: the rules, what they allow together, and the record of what people decided.

The control thread reads `pace`; everything else runs on the event loop. Body limits are computed from the
clock when they are read. Distances are computed on the event loop, `EVALUATE_EVERY_S` apart and at each
report; when that is overdue, the robot stops. The effective limit is the lowest of all rules.
"""

import asyncio
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import replace

from datamodels.streams import PeopleReport, SpeedLimitReport
from services.trajectory_tool.limits.separation import (
    RULE,
    Distance,
    Separation,
    SeparationRule,
    SeparationState,
    Stopping,
    distance_from,
)
from services.trajectory_tool.limits.speed_limits import Allowed, SpeedLimits
from services.trajectory_tool.limits.store import LimitStore, MeasuredStop, Mode, RobotRecord, SafeSpeed
from services.trajectory_tool.metrics import ALLOWED_PACE, LIMIT_STOPS
from services.trajectory_tool.robot import Joints
from services.trajectory_tool.robot_model import RobotModel
from services.trajectory_tool.scene import Zone

EVALUATE_EVERY_S = 0.04
OVERDUE_S = 0.5
REDUCED_MPS = 0.25
"""The speed of the tool in reduced mode (ISO 10218-1)."""
LINK_RADIUS_M = 0.12
ZONE_MARGIN_M = 0.05


class RobotLimits:
    """The limits of the robot `name`; `joints` returns its present joints.

    Raises `UsageError` when the stored limits are damaged.
    """

    def __init__(
        self,
        name: str,
        model: RobotModel,
        joints: Callable[[], Joints],
        store: LimitStore,
        *,
        limit_sources: Iterable[str] = (),
        people_sensors: Iterable[str] = (),
        hold_s: float = 2.0,
        zones: Iterable[Zone] = (),
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name = name
        self.peak_mps = 0.0
        """The highest speed of the tool in the present motion, at full speed."""
        self._model = model
        self._joints = joints
        self._store = store
        self._now = now
        self._zones = tuple(zone for zone in zones if zone.kind == "reducedSpeed")
        record = store.of(name)
        self.body = SpeedLimits({*limit_sources, *record.limit_sources}, now())
        rule = SeparationRule(stopping=_stopping(record), hold_s=hold_s)
        self.separation = Separation({*people_sensors, *record.people_sensors}, rule, now())
        self.state = SeparationState(Allowed(RULE))
        self._zone = Allowed("zone")
        self._evaluated_s = -math.inf
        self._was_stopped = False

    @property
    def record(self) -> RobotRecord:
        """Return what is stored."""
        return self._store.of(self.name)

    def pace(self) -> float:
        """Return the allowed fraction of the speed of the present motion; thread-safe."""
        return min((each.pace(self.peak_mps) for each in self.allowed()), default=1.0)

    def allowed(self) -> tuple[Allowed, ...]:
        """Return what each rule allows now; thread-safe."""
        now_s, record = self._now(), self.record
        found = [*self.body.allowed(now_s)]
        if self.separation.sources or self._zones:
            is_overdue = now_s - self._evaluated_s > OVERDUE_S
            found += (
                [Allowed(RULE, 0.0, reason="the distance was not evaluated in time")]
                if is_overdue
                else [self.state.allowed, self._zone]
            )
        if record.mode == "reduced":
            found.append(Allowed("mode", max_speed_mps=REDUCED_MPS, reason="reduced mode"))
        if record.safe_speed is not None:
            speed = record.safe_speed
            found.append(
                Allowed(
                    "endEffector",
                    max_speed_mps=speed.speed_mps,
                    reason=f"{speed.end_effector}, validated on {speed.validated_at:%Y-%m-%d}",
                )
            )
        return tuple(found)

    def lowest(self) -> Allowed | None:
        """Return the rule that holds; None if none lowers the speed."""
        peak_mps = self.peak_mps or math.inf
        limiting = [each for each in self.allowed() if each.fraction < 1 or each.max_speed_mps < peak_mps]
        return min(limiting, key=lambda each: (each.fraction, each.max_speed_mps), default=None)

    def tool_limit_mps(self) -> float:
        """Return the speed of the tool that the rules allow, for commanded velocities; thread-safe."""
        return min((each.max_speed_mps for each in self.allowed()), default=math.inf)

    def begin_motion(self, peak_mps: float) -> None:
        """Note the highest speed of the tool in the motion that begins."""
        self.peak_mps = peak_mps
        self.evaluate()

    async def run(self) -> None:
        """Evaluate distances until cancelled."""
        while True:
            self.evaluate()
            await asyncio.sleep(EVALUATE_EVERY_S)

    def evaluate(self) -> None:
        """Compute what the distances of people and zones allow."""
        now_s = self._now()
        if self.separation.sources:
            self.state = self.separation.state(now_s, self._distance(), self.peak_mps)
        else:
            self.state = SeparationState(Allowed(RULE))
        if self._zones:
            self._zone = self._in_zone()
        self._evaluated_s = now_s
        pace = self.pace()
        ALLOWED_PACE.labels(self.name).set(pace)
        if pace == 0.0 and not self._was_stopped and (lowest := self.lowest()) is not None:
            is_body = lowest.rule in self.body.sources
            LIMIT_STOPS.labels("body" if is_body else lowest.rule).inc()
        self._was_stopped = pace == 0.0

    async def receive_limit(self, report: SpeedLimitReport) -> None:
        """Take a speed limit; a new source is stored. Raises `RefusedReport`, `OSError`."""
        if self.body.receive(report, self._now(), time.time()):
            sources = tuple(sorted({*self.record.limit_sources, report.source}))
            await self._put(self.record.model_copy(update={"limit_sources": sources}))
        self.evaluate()

    async def receive_people(self, report: PeopleReport) -> None:
        """Take the places of people; a new sensor is stored. Raises `RefusedReport`, `OSError`."""
        is_new = self.separation.receive(report, self._now(), time.time(), self._distance(), self.peak_mps)
        if is_new:
            sensors = tuple(sorted({*self.record.people_sensors, report.source}))
            await self._put(self.record.model_copy(update={"people_sensors": sensors}))
        self.evaluate()

    async def remove(self, source: str, name: str, reason: str) -> bool:
        """Stop requiring a source or a sensor; return whether it was required. Raises `OSError`."""
        if source not in {*self.body.sources, *self.separation.sources}:
            return False
        record = self.record
        await self._put(
            record.decided(
                f"removed {source}",
                name,
                reason,
                limit_sources=tuple(each for each in record.limit_sources if each != source),
                people_sensors=tuple(each for each in record.people_sensors if each != source),
            )
        )
        self.body.remove(source)
        self.separation.remove(source)
        self.evaluate()
        return True

    async def reset(self, name: str) -> list[str]:
        """Release stops of body signals; return the sources that still stop the robot. Raises `OSError`."""
        await self._put(self.record.decided("reset", name))
        still = self.body.reset(self._now())
        self.evaluate()
        return still

    async def confirm_clear(self, name: str) -> list[str]:
        """Forget people who vanished, since `name` has seen that nobody is there. Raises `OSError`."""
        await self._put(self.record.decided("confirmed that nobody is near", name))
        found = self.separation.confirm_clear()
        self.evaluate()
        return found

    async def set_mode(self, mode: Mode, name: str) -> None:
        """Set the mode. Raises `OSError`."""
        await self._put(self.record.decided(f"mode {mode}", name, mode=mode))
        self.evaluate()

    async def set_safe_speed(self, speed: SafeSpeed, name: str) -> None:
        """Set the validated speed of the end effector. Raises `OSError`."""
        what = f"{speed.end_effector}: {speed.speed_mps:g} m/s"
        await self._put(self.record.decided(what, name, safe_speed=speed))
        self.evaluate()

    async def set_stop(self, stop: MeasuredStop, name: str) -> None:
        """Set the measured stop. Raises `OSError`."""
        await self._put(self.record.decided("measured the stop", name, stop=stop))
        self.separation.rule = replace(self.separation.rule, stopping=_stopping(self.record))
        self.evaluate()

    async def _put(self, record: RobotRecord) -> None:
        # On the event loop: a file of some kB, seldom, and two writes never overlap.
        self._store.put(self.name, record)

    def _distance(self) -> Distance:
        return distance_from([(x, y) for x, y, _ in self._model.chain(self._joints())], LINK_RADIUS_M)

    def _in_zone(self) -> Allowed:
        tool = self._model.tool_pose(self._joints()).position
        margin_m = ZONE_MARGIN_M + self.separation.rule.stopping.distance_m(self.peak_mps)
        near = [zone for zone in self._zones if zone.distance_m(tool) <= margin_m]
        slowest = min(near, key=lambda zone: zone.max_tool_speed_mps, default=None)
        if slowest is None:
            return Allowed("zone")
        return Allowed("zone", max_speed_mps=slowest.max_tool_speed_mps, reason=slowest.name)


def _stopping(record: RobotRecord) -> Stopping:
    stop = record.stop
    if stop is None:
        return Stopping()
    return Stopping(stop.delay_s, stop.deceleration_mps2, stop.measured_at.date().isoformat())
