"""Persons, states and limits as views."""

import time
from datetime import UTC, datetime
from typing import Any

from handover.errors import UsageError
from handover.messages import with_code
from handover_body.drivers.base import SENSOR_DRIVERS, SensorDriver
from handover_body.fusion.person_state import FusedValue
from handover_body.model.features import UNITS, FeatureName
from handover_body.monitoring.monitoring import Monitoring, RobotLink
from handover_body.monitoring.person_monitor import PersonMonitor, SensorView
from handover_body.people.consent import Purpose
from handover_body.people.people import Person
from handover_body.routes.bodies import (
    ConsentView,
    LeftOutView,
    LimitView,
    PersonView,
    RobotLinkView,
    SensorStateView,
    SensorValueView,
    StateView,
    ValueView,
)
from handover_body.storage.store import SensorRow


def moment(us: int) -> datetime:
    """Return a time of microseconds since 1970."""
    return datetime.fromtimestamp(us / 1e6, UTC)


def person_view(person: Person, monitoring: Monitoring) -> PersonView:
    """Return a person without values."""
    monitor = monitoring.monitors.get(person.name)
    row = person.consent.row
    return PersonView(
        person=person.name,
        pseudonym=person.pseudonym,
        rest_bpm=person.row.rest_bpm,
        maximum_bpm=person.row.maximum_bpm,
        baseline_method=person.row.baseline_method,
        consent=None
        if row is None
        else ConsentView(
            purposes=sorted(person.purposes()),
            given=moment(row.given_us),
            ends=moment(row.ends_us),
            given_by=row.given_by,
            withdrawn=None if row.withdrawn_us is None else moment(row.withdrawn_us),
        ),
        purposes=sorted(person.purposes()),
        is_monitored=monitor is not None,
        recording=None if monitor is None else monitor.recording,
        sensors=[_sensor_view(person, name, monitor) for name in sorted(person.sensors)],
        limit=None if monitor is None else limit_view(monitor, monitoring),
    )


def _sensor_view(person: Person, name: str, monitor: PersonMonitor | None) -> SensorStateView:
    row = person.sensors[name]
    view = SensorView() if monitor is None else monitor.sensors.get(name, SensorView())
    fault = view.present_fault(time.monotonic())
    problem = view.text if fault is None or not fault.text else fault.text
    coded = with_code("problem", problem)
    return SensorStateView(
        name=name,
        driver=row.driver,
        settings=_shown_settings(row),
        link=view.link,
        battery=view.battery,
        has_contact=view.has_contact,
        fault=None if fault is None else fault.fault,
        problem=str(problem),
        problem_code=coded.get("problemCode"),
        problem_parameters=coded.get("problemParameters"),
        signals=sorted(view.signals),
        left_out=[_left_out_view(name, reason) for name, reason in sorted(view.left_out.items())],
    )


def _left_out_view(name: str, reason: str) -> LeftOutView:
    coded = with_code("reason", reason)
    return LeftOutView(
        name=name,
        reason=str(reason),
        reason_code=coded.get("reasonCode"),
        reason_parameters=coded.get("reasonParameters"),
    )


def _shown_settings(row: SensorRow) -> dict[str, Any]:
    try:
        driver: type[SensorDriver] = SENSOR_DRIVERS.load(row.driver)
    except UsageError:  # nothing says which of its settings are secrets
        return {}
    return driver.settings_model.shown(row.settings)


def limit_view(monitor: PersonMonitor, monitoring: Monitoring) -> LimitView | None:
    """Return the limit of a person; None without consent to it."""
    person, limit = monitor.person, monitor.limit
    if Purpose.SPEED_LIMITS not in person.purposes():
        return None
    links = {robot: monitoring.links.get((robot, person.name)) for robot in sorted(person.robots)}
    return LimitView(
        fraction=limit.fraction,
        is_stopped=limit.is_stopped,
        reason=limit.reason(time.monotonic()),
        held_by=monitor.state.faulty_sensors(FeatureName.HEART_RATE, time.monotonic()),
        free_bpm=limit.curve.free_bpm,
        strained_bpm=limit.curve.strained_bpm,
        least_fraction=limit.curve.least,
        robots=[
            RobotLinkView(robot=robot, problem=_problem_of(link, is_followed=monitoring.followers[robot] > 0))
            for robot, link in links.items()
        ],
    )


def _problem_of(link: RobotLink | None, *, is_followed: bool) -> str:
    if is_followed:
        return ""
    return "not connected yet" if link is None else link.stream.problem


def state_view(monitor: PersonMonitor, monitoring: Monitoring) -> StateView:
    """Return the state of a person now."""
    now_s = time.monotonic()
    heart_rate = monitor.heart_rate(now_s)
    return StateView(
        person=monitor.person.name,
        pseudonym=monitor.person.pseudonym,
        values=[_value_view(value, now_s) for value in monitor.values(now_s)],
        exertion=None if heart_rate is None else monitor.person.baseline.exertion(heart_rate.bpm),
        strain=monitor.strain.mean,
        is_strained=monitor.strain.is_lasting,
        limit=limit_view(monitor, monitoring),
    )


def _value_view(value: FusedValue, now_s: float) -> ValueView:
    return ValueView(
        name=value.name,
        value=value.value,
        unit=UNITS.get(value.name),
        quality=value.quality,
        status=value.status,
        age_s=max(now_s - value.at_s, 0.0),
        method=value.method,
        is_calibrated=value.is_calibrated,
        disagree=value.disagree,
        sensors=[
            SensorValueView(
                sensor=sensor.source,
                value=sensor.value,
                quality=sensor.quality,
                status=sensor.status,
                age_s=max(now_s - sensor.at_s, 0.0),
                method=sensor.method,
            )
            for sensor in value.sensors
            if not isinstance(sensor.value, float) or sensor.value == sensor.value
        ],
    )
