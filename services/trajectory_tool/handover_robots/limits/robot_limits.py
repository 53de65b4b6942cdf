"""The limits of one robot: the rules, what they allow together, and the record of what people decided.

The control thread reads `pace`; everything else runs on the event loop. Body limits are computed from the
clock when they are read. Distances are computed on the event loop, `EVALUATE_EVERY_S` apart and at each
report; when that is overdue, the robot stops. The effective limit is the lowest of all rules.
"""

import asyncio
import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from handover.control.speed_limits import Allowed, SpeedLimits
from handover.messages import Message, message
from handover_datamodels.streams import PeopleReport, SpeedLimitReport
from handover_robots.limits.contact_force import ContactForce
from handover_robots.limits.contact_table import ContactSpeed
from handover_robots.limits.guards import ZONE_MARGIN_M, PeakSpeeds
from handover_robots.limits.separation import (
    RULE,
    Distance,
    Separation,
    SeparationRule,
    SeparationState,
    Stopping,
    distance_from,
)
from handover_robots.limits.store import LimitStore, MeasuredStop, Mode, RobotRecord, SafeSpeed
from handover_robots.metrics import ALLOWED_PACE, LIMIT_STOPS
from handover_robots.model.joints import Joints
from handover_robots.model.robot_model import RobotModel
from handover_robots.model.trajectory import Setpoint, rounded_pace
from handover_robots.scene.scene import REDUCED_SPEED_MPS, Zone

EVALUATE_EVERY_S = 0.04
OVERDUE_S = 0.5
SAVE_EVERY_S = 1.0
LINK_RADIUS_M = 0.12


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
        end_effector: str | None = None,
        contact: ContactForce | None = None,
        contact_speed: ContactSpeed | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name = name
        self.peak_mps = 0.0
        """The highest speed of the tool in the present motion, at full speed."""
        self._model = model
        self._joints = joints
        self._store = store
        self._now = now
        self.end_effector = end_effector
        """The mounted one; None where the cell file does not name it."""
        self.contact = contact or ContactForce(None, lambda: None)
        self.contact_speed = contact_speed
        self._peaks = PeakSpeeds(model)
        self._links_peak_mps = 0.0
        self._zones: tuple[Zone, ...] = ()
        self._people_zones: tuple[Zone, ...] = ()
        """Where people may be touched; without any, it is the whole cell."""
        record = store.of(name)
        self.body = SpeedLimits({*limit_sources, *record.limit_sources}, now())
        rule = SeparationRule(stopping=_stopping(record), hold_s=hold_s)
        self.separation = Separation({*people_sensors, *record.people_sensors}, rule, now())
        self.state = SeparationState(Allowed(RULE))
        self._zone = Allowed("zone")
        self.set_zones(zones)
        self._evaluated_s = -math.inf
        self._was_stopped = False
        self._is_moving = False

    def set_zones(self, zones: Iterable[Zone]) -> None:
        """Change the zones."""
        all_zones = tuple(zones)
        self._zones = tuple(zone for zone in all_zones if zone.kind == "reducedSpeed")
        self._people_zones = tuple(zone for zone in all_zones if zone.kind == "people")
        self._zone = Allowed("zone")

    @property
    def record(self) -> RobotRecord:
        """Return what is stored."""
        return self._store.of(self.name)

    def pace(self) -> float:
        """Return the allowed fraction of the speed of the present motion; thread-safe."""
        return min((rule.pace(self.peak_mps) for rule in self.allowed()), default=1.0)

    def allowed(self) -> tuple[Allowed, ...]:
        """Return what each rule allows now; thread-safe."""
        now_s, record = self._now(), self.record
        limits = [*self.body.allowed(now_s)]
        if self.separation.sources or self._zones:
            is_overdue = now_s - self._evaluated_s > OVERDUE_S
            overdue = message("limit.distance_overdue", "the distance was not evaluated in time")
            limits += [Allowed(RULE, 0.0, reason=overdue)] if is_overdue else [self.state.allowed, self._zone]
        if record.mode == "reduced":
            reduced = message("limit.reduced_mode", "reduced mode")
            limits.append(Allowed("mode", max_speed_mps=REDUCED_SPEED_MPS, reason=reduced))
        limits += self._of_end_effector(record)
        limits += self.contact.allowed()
        if self.contact_speed is not None:
            max_mps, peak_mps = self.contact_speed.speed_mps, self._links_peak_mps
            fraction = max_mps / peak_mps if peak_mps > max_mps else 1.0
            everywhere_mps = math.inf if self._people_zones else max_mps
            limits.append(Allowed("contact", fraction, everywhere_mps, self.contact_speed.reason))
        return tuple(limits)

    def _of_end_effector(self, record: RobotRecord) -> Iterator[Allowed]:
        """Yield the validated speed: of the mounted end effector, or the lowest of all."""
        safe_speeds, mounted = record.safe_speeds, self.end_effector
        if mounted is not None and mounted not in safe_speeds:
            reason = message(
                "limit.no_validated_speed", "{effector} has no validated speed", effector=mounted
            )
            yield Allowed("endEffector", max_speed_mps=REDUCED_SPEED_MPS, reason=reason)
            return
        speeds = safe_speeds.values() if mounted is None else [safe_speeds[mounted]]
        for speed in sorted(speeds, key=lambda safe_speed: safe_speed.speed_mps)[:1]:
            yield Allowed(
                "endEffector",
                max_speed_mps=speed.speed_mps,
                reason=message(
                    "limit.validated_speed",
                    "{effector}, validated on {date}",
                    effector=speed.end_effector,
                    date=f"{speed.validated_at:%Y-%m-%d}",
                ),
            )

    def lowest(self) -> Allowed | None:
        """Return the rule that holds; None if none lowers the speed."""
        peak_mps = self.peak_mps if self._is_moving else math.inf
        limiting = [rule for rule in self.allowed() if rule.fraction < 1 or rule.max_speed_mps < peak_mps]
        return min(limiting, key=lambda rule: (rule.fraction, rule.max_speed_mps), default=None)

    @property
    def zones(self) -> tuple[Zone, ...]:
        """Return the zones in which commanded velocities are limited, each with its speed; thread-safe."""
        if self.contact_speed is None:
            return self._zones
        speed_mps = self.contact_speed.speed_mps
        return (*self._zones, *(replace(zone, max_tool_speed_mps=speed_mps) for zone in self._people_zones))

    def tool_limit_mps(self) -> float:
        """Return the speed of the tool that the rules allow, for commanded velocities; thread-safe."""
        return min((rule.max_speed_mps for rule in self.allowed()), default=math.inf)

    def begin_motion(self, at: Callable[[float], Setpoint], duration_s: float) -> None:
        """Note the highest speed of the tool in the motion that begins, and the force at its start."""
        links_mps = 0.0
        tool_mps = self._peaks.of_tool(at, duration_s)
        if self.contact_speed is not None:
            links_mps = self._peaks.of_links(at, duration_s, self._may_touch_people)
        self._begin(tool_mps, links_mps)

    def begin_velocities(self, peak_mps: float) -> None:
        """Note the highest speed of the tool in a motion by velocities, and the force at its start."""
        self._begin(peak_mps, 0.0)

    def _begin(self, tool_mps: float, links_mps: float) -> None:
        self.peak_mps, self._links_peak_mps = tool_mps, links_mps
        self._is_moving = tool_mps > 0
        self.contact.begin_motion()
        self.evaluate()

    def _may_touch_people(self, joints: Joints) -> bool:
        """Return whether a link is where people may be touched."""
        if not self._people_zones:
            return True
        chain, margin_m = self._model.chain(joints), LINK_RADIUS_M + ZONE_MARGIN_M
        return any(zone.is_near(chain, margin_m) for zone in self._people_zones)

    def contact_refusal(self, operation: str) -> Message | None:
        """Return why the motion that begins cannot be slow enough for contacts; None if it can."""
        permitted = self.contact_speed
        if permitted is None or rounded_pace(permitted.speed_mps / max(self._links_peak_mps, 1e-9)) > 0:
            return None
        return message(
            "robot.contact_too_fast",
            "{operation}: a link would move at {speed} m/s, and contacts with {region}, confirmed on {date}, "
            "may have {limit} m/s; choose a slower motion, or another contact table",
            operation=operation,
            speed=f"{self._links_peak_mps:.2f}",
            region=permitted.region,
            date=f"{permitted.table.confirmed_at:%Y-%m-%d}",
            limit=f"{permitted.speed_mps:.4f}",
        )

    def end_motion(self) -> None:
        """Note that the motion has ended."""
        self._is_moving = False
        self.contact.end_motion()

    async def run(self) -> None:
        """Evaluate distances until cancelled."""
        saved_s = self._now()
        while True:
            self.evaluate()
            if (now_s := self._now()) - saved_s > SAVE_EVERY_S:
                saved_s = now_s
                self._store.save()
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
                limit_sources=tuple(required for required in record.limit_sources if required != source),
                people_sensors=tuple(required for required in record.people_sensors if required != source),
            )
        )
        self.body.remove(source)
        self.separation.remove(source)
        self.evaluate()
        return True

    async def reset(self, name: str) -> list[str]:
        """Release stops of body signals and contacts; return the sources that still stop the robot.

        Raises `OSError`.
        """
        await self._put(self.record.decided("reset", name))
        still = self.body.reset(self._now())
        self.contact.reset()
        self.evaluate()
        return still

    async def confirm_clear(self, name: str) -> list[str]:
        """Forget people who vanished, since `name` has seen that nobody is there. Raises `OSError`."""
        await self._put(self.record.decided("confirmed that nobody is near", name))
        people = self.separation.confirm_clear()
        self.evaluate()
        return people

    async def set_mode(self, mode: Mode, name: str) -> None:
        """Set the mode. Raises `OSError` unless it lowers the speed."""
        record = self.record.decided(f"mode {mode}", name, mode=mode)
        await self._put(record, is_lower=mode == "reduced")
        self.evaluate()

    async def set_safe_speed(self, speed: SafeSpeed, name: str) -> None:
        """Set the validated speed of the end effector. Raises `OSError` unless it lowers the speed."""
        what = f"{speed.end_effector}: {speed.speed_mps:g} m/s"
        speeds = {**self.record.safe_speeds, speed.end_effector: speed}
        is_lower = self.is_lower_speed(speed)
        await self._put(self.record.decided(what, name, safe_speeds=speeds), is_lower=is_lower)
        self.evaluate()

    def is_lower_speed(self, speed: SafeSpeed) -> bool:
        """Return whether a validated speed is below the one that is in force for its end effector."""
        in_force = self.record.safe_speeds.get(speed.end_effector)
        return in_force is not None and speed.speed_mps <= in_force.speed_mps

    def is_longer_stop(self, stop: MeasuredStop) -> bool:
        """Return whether a measured stop lowers the speed near people."""
        in_force = self.record.stop
        return in_force is not None and (
            stop.delay_s >= in_force.delay_s and stop.deceleration_mps2 <= in_force.deceleration_mps2
        )

    async def set_stop(self, stop: MeasuredStop, name: str) -> None:
        """Set the measured stop. Raises `OSError` unless it lowers the speed."""
        is_lower = self.is_longer_stop(stop)
        await self._put(self.record.decided("measured the stop", name, stop=stop), is_lower=is_lower)
        self.separation.rule = replace(self.separation.rule, stopping=_stopping(self.record))
        self.evaluate()

    async def _put(self, record: RobotRecord, *, is_lower: bool = False) -> None:
        # On the event loop: a file of some kB, seldom, and two writes never overlap.
        if is_lower:
            self._store.put_lower(self.name, record)
        else:
            self._store.put(self.name, record)

    def _distance(self) -> Distance:
        return distance_from([(x, y) for x, y, _ in self._model.chain(self._joints())], LINK_RADIUS_M)

    def _in_zone(self) -> Allowed:
        tool = self._model.tool_pose(self._joints()).position
        rule = self.separation.rule
        way_m = self.peak_mps * rule.reaction_s + rule.stopping.distance_m(self.peak_mps)
        margin_m = ZONE_MARGIN_M + way_m
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
