"""Speed and separation monitoring after ISO/TS 15066, 5.5.4: slower when people are near, or stopped.

The protective separation distance is S_p = S_h + S_r + S_s + C + Z_d + Z_r: the way of a person until the
robot is at rest, the ways of the robot during its reaction and its stop, the intrusion distance, and the
position uncertainties of person and robot. A place that is older than the reaction time counts as nearer by
the way of a person since. With a reaction time T, and a stop from the speed v that takes
d + v/a and v d + v^2/(2 a), it is a quadratic function of v. The robot may move at the speed whose S_p is the
distance of the nearest person. Example: with the default values, a person at 2 m allows 0.75 m/s, and at
0.87 m nothing.

A sensor counts only while it positively reports. A silent one, or one that is required and was never
received, counts as a person at the robot. So does, in time, a person who vanished near the robot or jumped:
they may have moved from their last place at the speed of a person. After a stop, the distance must be
reported for the hold.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from handover.control.speed_limits import (
    MAX_SOURCES,
    Allowed,
    RefusedReport,
    require_new,
)
from handover.messages import message
from handover_datamodels.streams import PeopleReport
from handover_robots.scene.scene import REDUCED_SPEED_MPS

Point = tuple[float, float]
Distance = Callable[[Point], float]
"""Returns the horizontal distance of a point from the nearest part of the robot, in m."""

RULE = "separation"
MIN_PACE = 0.05
"""A lower pace is a stop."""
MAX_PERSON_MPS, JUMP_M = 5.0, 0.3
"""A person who moves faster than this, and farther than the noise of a sensor, has jumped."""


@dataclass(frozen=True, slots=True)
class Stopping:
    """How the robot stops: it moves on for `delay_s`, then slows down by `deceleration_mps2`."""

    delay_s: float = 0.1
    deceleration_mps2: float = 1.5
    measured_at: str | None = None
    """The date of the measurement; None for assumed values."""

    def time_s(self, speed_mps: float) -> float:
        """Return the duration of a stop."""
        return self.delay_s + speed_mps / self.deceleration_mps2

    def distance_m(self, speed_mps: float) -> float:
        """Return the way of a stop."""
        return speed_mps * self.delay_s + speed_mps**2 / (2 * self.deceleration_mps2)


@dataclass(frozen=True, slots=True)
class SeparationRule:
    """The values of the protective separation distance, and the hold after a stop."""

    stopping: Stopping = Stopping()
    reaction_s: float = 0.1
    person_mps: float = 1.6
    intrusion_m: float = 0.3
    person_uncertainty_m: float = 0.2
    robot_uncertainty_m: float = 0.05
    hold_s: float = 2.0

    def parts_m(self, speed_mps: float) -> dict[str, float]:
        """Return the parts of the protective separation distance at a speed of the robot."""
        stopping = self.stopping
        return {
            "Sh": self.person_mps * (self.reaction_s + stopping.time_s(speed_mps)),
            "Sr": speed_mps * self.reaction_s,
            "Ss": stopping.distance_m(speed_mps),
            "C": self.intrusion_m,
            "Zd": self.person_uncertainty_m,
            "Zr": self.robot_uncertainty_m,
        }

    def distance_m(self, speed_mps: float) -> float:
        """Return the protective separation distance."""
        return sum(self.parts_m(speed_mps).values())

    def speed_mps(self, distance_m: float) -> float:
        """Return the highest speed whose protective separation distance is not more than `distance_m`."""
        stopping = self.stopping
        a = 1 / (2 * stopping.deceleration_mps2)
        b = self.person_mps / stopping.deceleration_mps2 + self.reaction_s + stopping.delay_s
        c = self.distance_m(0.0) - distance_m
        return 0.0 if c >= 0 else (-b + math.sqrt(b * b - 4 * a * c)) / (2 * a)


@dataclass(slots=True)
class _Sensor:
    """The last report of a sensor and when it arrived, and the last places of people who vanished."""

    since_s: float
    report: PeopleReport | None = None
    lost: dict[str, tuple[Point, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Field:
    """The fields of a safety scanner that are infringed; both are while it is silent."""

    source: str
    warning: bool
    protective: bool


@dataclass(frozen=True, slots=True)
class SeparationState:
    """What monitoring found at a time; `distance_m` is None without sensors."""

    allowed: Allowed
    distance_m: float | None = None
    required_m: float | None = None
    lost: tuple[str, ...] = ()
    fields: tuple[Field, ...] = ()


class Separation:
    """Monitors the distance of people from one robot; used by one thread.

    `required` are the names of the sensors without which the robot does not move.
    """

    def __init__(self, required: Iterable[str], rule: SeparationRule, now_s: float) -> None:
        self.rule = rule
        self._sensors = {name: _Sensor(now_s) for name in required}
        self._is_stopped = False
        self._clear_since_s: float | None = None

    @property
    def sources(self) -> tuple[str, ...]:
        """Return the names of the required sensors."""
        return tuple(self._sensors)

    def receive(
        self, report: PeopleReport, now_s: float, wall_s: float, distance: Distance, peak_mps: float
    ) -> bool:
        """Take a report; return whether its sensor is new. Raises `RefusedReport`, as for speed limits."""
        sensor = self._sensors.get(report.source)
        if sensor is None and len(self._sensors) >= MAX_SOURCES:
            raise RefusedReport(f"there are {MAX_SOURCES} sensors; remove one before another reports")
        last = None if sensor is None else sensor.report
        require_new(report.stamp, None if last is None else last.stamp, wall_s)
        if len({person.id for person in report.people}) < len(report.people):
            raise RefusedReport("two people have the same id")
        is_new = sensor is None
        if sensor is None:
            sensor = self._sensors[report.source] = _Sensor(now_s)
        if sensor.report is not None:
            self._find_lost(
                sensor, sensor.report, report, now_s, lambda at: distance(at) < self._zone_m(peak_mps)
            )
        sensor.report, sensor.since_s = report, now_s
        return is_new

    def remove(self, source: str) -> bool:
        """Stop requiring a sensor; return whether it was required."""
        return self._sensors.pop(source, None) is not None

    def confirm_clear(self) -> list[str]:
        """Forget vanished people, since a person has seen that nobody is there; return their ids."""
        people = [name for sensor in self._sensors.values() for name in sensor.lost]
        for sensor in self._sensors.values():
            sensor.lost.clear()
        return people

    def state(self, now_s: float, distance: Distance, peak_mps: float) -> SeparationState:
        """Return what is allowed for a motion whose tool reaches `peak_mps` at full speed."""
        if not self._sensors:
            return SeparationState(Allowed(RULE))
        nearest_m, reason = self._nearest(now_s, distance)
        speed_mps = self.rule.speed_mps(nearest_m)
        pace = min(speed_mps / peak_mps, 1.0) if peak_mps > 0 else float(speed_mps > 0)
        reports = [sensor.report for sensor in self._sensors.values() if sensor.report is not None]
        if any(report.protective_field for report in reports):
            pace, reason = 0.0, message("limit.protective_field", "the protective field is infringed")
        is_warned = any(report.warning_field for report in reports)
        holds_warning = is_warned and speed_mps > REDUCED_SPEED_MPS
        if pace < MIN_PACE:
            self._is_stopped, self._clear_since_s = True, None
        elif self._is_stopped:
            self._clear_since_s = now_s if self._clear_since_s is None else self._clear_since_s
            self._is_stopped = now_s - self._clear_since_s < self.rule.hold_s
            reason = message(
                "limit.distance_held",
                "the distance is kept for {hold_s} s before the robot continues",
                hold_s=f"{self.rule.hold_s:g}",
            )
        if holds_warning and not self._is_stopped:
            reason = message("limit.warning_field", "the warning field is infringed")
        allowed = Allowed(
            RULE,
            0.0 if self._is_stopped else pace,
            REDUCED_SPEED_MPS if is_warned else math.inf,
            reason,
        )
        moving_mps = peak_mps * allowed.pace(peak_mps)
        lost = tuple(name for sensor in self._sensors.values() for name in sensor.lost)
        shown_m = nearest_m if math.isfinite(nearest_m) else None
        return SeparationState(allowed, shown_m, self.rule.distance_m(moving_mps), lost, self._fields(now_s))

    def _fields(self, now_s: float) -> tuple[Field, ...]:
        """Return the fields of the scanners: sensors that have reported an infringed field or say so."""
        fields = []
        for name, sensor in self._sensors.items():
            report = sensor.report
            if report is None or (report.warning_field is None and report.protective_field is None):
                continue
            silent = now_s - sensor.since_s > report.stale_s
            fields.append(
                Field(name, silent or bool(report.warning_field), silent or bool(report.protective_field))
            )
        return tuple(fields)

    def _zone_m(self, peak_mps: float) -> float:
        """Return the distance within which a person who vanishes still counts."""
        return self.rule.distance_m(max(peak_mps, 1.0)) + 1.0

    def _nearest(self, now_s: float, distance: Distance) -> tuple[float, str]:
        nearest_m, reason = math.inf, ""
        for name, sensor in self._sensors.items():
            report = sensor.report
            if report is None:
                return 0.0, message(
                    "limit.sensor_not_received", "{sensor} is required, and not received yet", sensor=name
                )
            if now_s - sensor.since_s > report.stale_s:
                return 0.0, message(
                    "limit.sensor_silent",
                    "{sensor} has been silent for {silent_s} s",
                    sensor=name,
                    silent_s=f"{now_s - sensor.since_s:.1f}",
                )
            aged_s = max(now_s - sensor.since_s - self.rule.reaction_s, 0.0)
            distances = []
            for person in report.people:
                moved_m = person.radius + self.rule.person_mps * (person.age + aged_s)
                near = message("limit.person_near", "{person} is near", person=person.id)
                distances.append((max(distance(person.point) - moved_m, 0.0), near))
            for lost, (point, since_s) in sensor.lost.items():
                moved_m = self.rule.person_mps * (now_s - since_s)
                gone = message("limit.person_vanished", "{person} vanished near the robot", person=lost)
                distances.append((max(distance(point) - moved_m, 0.0), gone))
            nearest_m, reason = min([(nearest_m, reason), *distances])
        return nearest_m, reason

    @staticmethod
    def _find_lost(
        sensor: _Sensor,
        before: PeopleReport,
        report: PeopleReport,
        now_s: float,
        is_near: Callable[[Point], bool],
    ) -> None:
        """Keep the last places of people near the robot who are gone or have jumped."""
        present = {person.id: person.point for person in report.people}
        reach_m = MAX_PERSON_MPS * (now_s - sensor.since_s) + JUMP_M
        for person in before.people:
            point = present.get(person.id)
            has_jumped = point is not None and math.dist(point, person.point) > reach_m
            if (point is None or has_jumped) and is_near(person.point):
                sensor.lost[person.id] = (person.point, sensor.since_s)
        for name, (place, since_s) in tuple(sensor.lost.items()):
            point = present.get(name)
            if point is not None and math.dist(point, place) <= MAX_PERSON_MPS * (now_s - since_s) + JUMP_M:
                del sensor.lost[name]


def distance_from(parts: Sequence[Point], radius_m: float) -> Distance:
    """Return the horizontal distance from a chain of `parts` whose links have a radius."""

    links = list(zip(parts, [*parts[1:], parts[-1]], strict=True))

    def distance(point: Point) -> float:
        nearest = min((_to_segment(point, start, end) for start, end in links), default=0.0)
        return max(nearest - radius_m, 0.0)

    return distance


def _to_segment(point: Point, start: Point, end: Point) -> float:
    dx, dy = end[0] - start[0], end[1] - start[1]
    length2 = dx * dx + dy * dy
    share = ((point[0] - start[0]) * dx + (point[1] - start[1]) * dy) / length2 if length2 > 0 else 0.0
    share = min(max(share, 0.0), 1.0)
    return math.dist(point, (start[0] + share * dx, start[1] + share * dy))
