"""Keeps running what the persons allow, and nothing else.

`apply` compares a person with what runs: without a valid consent nothing runs and nothing is known. The
limits of all persons are computed `TICK_S` apart; one that a heart rate lowers is sent at once. The end of a
consent is looked for every second.
"""

import asyncio
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import orjson

from handover.errors import HandoverError
from handover.runtime.background_tasks import BackgroundTasks
from handover.security.service_access import ServiceAccess
from handover.telemetry import get_logger
from handover_body.drivers.base import SENSOR_DRIVERS, SensorDriver
from handover_body.drivers.runner import SensorRunner
from handover_body.limits.robot_stream import RobotStream
from handover_body.limits.strain import Strain
from handover_body.metrics import SENSORS
from handover_body.model.signals import LinkState
from handover_body.monitoring.person_monitor import ClassifierOf, PersonMonitor, PipelineOf, SensorView
from handover_body.people.consent import Purpose
from handover_body.people.people import People, Person
from handover_body.settings import HumanStateSettings
from handover_body.storage.store import SensorRow
from handover_datamodels.streams import SpeedLimitReport

log = get_logger(__name__)

TICK_S: Final = 0.05
REPORT_EVERY_S: Final = 0.25
"""An unchanged limit is sent this often; a changed one at once."""
MIN_CHANGE: Final = 0.002
CHECK_EVERY_S: Final = 1.0


@dataclass(slots=True)
class _RunningSensor:
    row: SensorRow
    task: asyncio.Task[None] | None
    driver: SensorDriver | None = None


@dataclass(slots=True)
class RobotLink:
    """The stream of the limit of a person to a robot."""

    stream: RobotStream
    task: asyncio.Task[None]
    fraction: float = -1.0
    sent_s: float = 0.0


class Monitoring:
    """The monitors of all persons who consent, their sensors, and the streams to robots."""

    def __init__(
        self,
        settings: HumanStateSettings,
        people: People,
        access: ServiceAccess,
        tasks: BackgroundTasks,
        *,
        pipeline_of: PipelineOf,
        classifier_of: ClassifierOf,
    ) -> None:
        self.monitors: dict[str, PersonMonitor] = {}
        self.links: dict[tuple[str, str], RobotLink] = {}
        """By robot and person."""
        self.followers: Counter[str] = Counter()
        """How many controllers follow the stream of limits of each robot by themselves."""
        self.sequence = 0
        self.on_stopped: Callable[[PersonMonitor], None] = lambda _: None
        """Called after a person's monitoring has ended."""
        self.on_strain: Callable[[PersonMonitor], object] = lambda _: None
        self._settings = settings
        self._people = people
        self._access = access
        self._tasks = tasks
        self._pipeline_of = pipeline_of
        self._classifier_of = classifier_of
        self._running: dict[str, _RunningSensor] = {}
        self._is_publishing = False
        """Whether the readers get the limits in this turn of the event loop."""
        self._ticked = asyncio.Event()
        self._limits: dict[str, Any] = {"sequence": 0, "stamp": 0.0, "limits": []}

    def apply(self, name: str) -> None:
        """Start and stop what the person called `name` needs now."""
        person = self._people.find(name)
        purposes = frozenset() if person is None else person.purposes()
        if person is None or Purpose.LIVE not in purposes:
            self._stop(name)
            return
        monitor = self.monitors.get(name)
        if monitor is None:
            monitor = self.monitors[name] = PersonMonitor(person, self._pipeline_of, self._classifier_of)
            monitor.strain = Strain(window_s=self._settings.health_strain_window_s)
            monitor.on_lowered = self._lowered
        for gone in monitor.person.sensors.keys() - person.sensors.keys():
            self._stop_sensor(gone, name)
        monitor.change(person)
        for row in person.sensors.values():
            running = self._running.get(row.name)
            if running is None or running.row != row:
                self._stop_sensor(row.name, None)
                monitor.forget(row.name)
                self._running[row.name] = self._start_sensor(row, monitor)
        wanted = person.robots if Purpose.SPEED_LIMITS in purposes else frozenset()
        for robot, of in list(self.links):
            if of == name and robot not in wanted:
                self.links.pop((robot, of)).task.cancel()
        for robot in wanted:
            if (robot, name) not in self.links:
                self._link(robot, name)
        SENSORS.set(sum(sensor.task is not None for sensor in self._running.values()))

    def _stop(self, name: str) -> None:
        for sensor, running in list(self._running.items()):
            if running.row.person == name:
                self._stop_sensor(sensor, name)
        for key in [key for key in self.links if key[1] == name]:
            self.links.pop(key).task.cancel()
        monitor = self.monitors.pop(name, None)
        if monitor is not None:
            self.on_stopped(monitor)
        SENSORS.set(sum(sensor.task is not None for sensor in self._running.values()))

    def _stop_sensor(self, sensor: str, person: str | None) -> None:
        running = self._running.get(sensor)
        if running is None or person not in (None, running.row.person):
            return
        del self._running[sensor]
        if running.task is not None:
            running.task.cancel()

    def driver_of(self, sensor: str) -> SensorDriver | None:
        """Return the driver of a sensor that runs."""
        running = self._running.get(sensor)
        return None if running is None else running.driver

    def _start_sensor(self, row: SensorRow, monitor: PersonMonitor) -> _RunningSensor:
        try:
            kind: type[SensorDriver] = SENSOR_DRIVERS.load(row.driver)
            driver = kind(row.name, kind.settings_model.model_validate(row.settings))
            runner = SensorRunner(driver, monitor.take)
        except (HandoverError, ValueError) as error:
            log.warning("sensor cannot start", sensor=row.name, driver=row.driver, error=str(error))
            monitor.sensors[row.name] = SensorView(LinkState.FAULT, text=str(error)[:300])
            return _RunningSensor(row, None)
        kinds = frozenset(info.kind for info in driver.signals)
        monitor.sensors[row.name] = SensorView(kinds=kinds, left_out=dict(driver.left_out))
        return _RunningSensor(row, self._tasks.start(runner.run), driver)

    def _link(self, robot: str, person: str) -> None:
        url = f"{self._settings.trajectory_tool.replace('http', 'ws', 1)}/robots/{robot}/speed_limits"
        stream = RobotStream(url, self._access.headers, self._settings.ca_files)
        self.links[robot, person] = RobotLink(stream, self._tasks.start_restarting(stream.run))

    async def run(self) -> None:
        """Compute and send limits until cancelled."""
        clock = asyncio.get_running_loop().time
        due_s = checked_s = clock()
        while True:
            if clock() - checked_s >= CHECK_EVERY_S:
                checked_s = clock()
                await self._check()
            self._tick()
            due_s = max(due_s + TICK_S, clock())
            await asyncio.sleep(due_s - clock())

    async def _check(self) -> None:
        """End what a consent no longer allows; store stops; notice lasting strain."""
        for person in self._people.all():
            purposes = person.purposes()
            is_running = person.name in self.monitors
            has_links = any(of == person.name for _, of in self.links)
            if (Purpose.LIVE in purposes) != is_running or (
                has_links and Purpose.SPEED_LIMITS not in purposes
            ):
                self.apply(person.name)
        for name, monitor in list(self.monitors.items()):
            was_lasting, monitor.was_lasting = monitor.was_lasting, monitor.strain.is_lasting
            if monitor.was_lasting and not was_lasting:
                self.on_strain(monitor)
            if Purpose.SPEED_LIMITS in monitor.person.purposes() and monitor.person.robots:
                await self._people.keep_stop(name, is_stopped=monitor.limit.is_stopped)

    def _tick(self) -> None:
        now_s, wall_s = time.monotonic(), time.time()
        for monitor in self.monitors.values():
            monitor.step(now_s)
            if Purpose.SPEED_LIMITS in monitor.person.purposes():
                self._send_to_robots(monitor, now_s, wall_s)
        self._publish()

    def _lowered(self, monitor: PersonMonitor) -> None:
        """Send a limit that fell; readers get the falls of one turn of the event loop together."""
        if Purpose.SPEED_LIMITS not in monitor.person.purposes():
            return
        self._send_to_robots(monitor, time.monotonic(), time.time())
        if not self._is_publishing:
            self._is_publishing = True
            asyncio.get_running_loop().call_soon(self._publish)

    def _send_to_robots(self, monitor: PersonMonitor, now_s: float, wall_s: float) -> None:
        for robot in monitor.person.robots:
            link = self.links.get((robot, monitor.person.name))
            if link is not None:
                self._send(link, monitor, now_s, wall_s)

    def _publish(self) -> None:
        """Give the readers the limits of all persons as they are now."""
        now_s, wall_s = time.monotonic(), time.time()
        self._is_publishing = False
        self.sequence += 1
        limits = [
            _limit_view(monitor, now_s, wall_s)
            for monitor in self.monitors.values()
            if Purpose.SPEED_LIMITS in monitor.person.purposes()
        ]
        self._limits = {"sequence": self.sequence, "stamp": wall_s, "limits": limits}
        self._ticked.set()
        self._ticked = asyncio.Event()

    def _send(self, link: RobotLink, monitor: PersonMonitor, now_s: float, wall_s: float) -> None:
        fraction = monitor.limit.fraction
        is_other_stop = (fraction == 0.0) != (link.fraction == 0.0)
        is_changed = is_other_stop or abs(fraction - link.fraction) >= MIN_CHANGE
        if not is_changed and now_s - link.sent_s < REPORT_EVERY_S:
            return
        link.fraction, link.sent_s = fraction, now_s
        person = monitor.person
        is_public = Purpose.BROKER in person.purposes()
        link.stream.put(
            SpeedLimitReport(
                source=source_of(person),
                stamp=wall_s,
                fraction=fraction,
                reason=monitor.limit.reason(now_s),
                person=self._settings.entity_id("Person", person.name) if is_public else None,
                period=REPORT_EVERY_S,
            )
        )

    async def next_limits(self, after: int, robot: str | None = None) -> bytes:
        """Wait for limits after the sequence `after`, of all persons or of one robot.

        They are JSON with sequence, stamp and limits: the newest, so that a slow reader is never behind.
        """
        while self.sequence <= after:
            await self._ticked.wait()
        if robot is None:
            return orjson.dumps(self._limits)
        limits = [limit for limit in self._limits["limits"] if robot in limit["robots"]]
        return orjson.dumps({**self._limits, "limits": limits})


def source_of(person: Person) -> str:
    """Return the name of the source of speed limits at a robot."""
    return f"body-{person.pseudonym}"


def _limit_view(monitor: PersonMonitor, now_s: float, wall_s: float) -> dict[str, Any]:
    limit = monitor.limit
    newest = limit.newest
    return {
        "source": source_of(monitor.person),
        "robots": sorted(monitor.person.robots),
        "fraction": round(limit.fraction, 4),
        "isStopped": limit.is_stopped,
        "reason": limit.reason(now_s),
        "ageS": None if newest is None else round(now_s - newest.at_s, 3),
        "validUntil": wall_s + 1.0,
    }
