"""The limits of a robot as the REST interface returns them. The types of the page are generated from it."""

import math
from datetime import datetime
from typing import Any

from pydantic import BaseModel, ConfigDict
from pydantic.alias_generators import to_camel

from handover.control.speed_limits import Allowed
from handover.messages import with_code
from handover_robots.driver_base.robot import Robot, SafetyStatus
from handover_robots.limits.contact_table import ContactSpeed
from handover_robots.limits.robot_limits import RobotLimits
from handover_robots.limits.store import Mode

NOTICE = "These limits are not a safety-rated function. They are advisory and only lower the speed."
SHOWN_DECISIONS = 20


class _View(BaseModel):
    model_config = ConfigDict(alias_generator=to_camel, populate_by_name=True, from_attributes=True)


class RuleView(_View):
    """What a rule allows: a fraction of the speed, and a speed of the tool in m/s; null for no limit."""

    rule: str
    fraction: float
    max_speed: float | None
    reason: str
    needs_reset: bool


class SeparationView(_View):
    """The distance of the nearest person in m, null without sensors, and the people who vanished."""

    distance: float | None
    required: float | None
    lost: list[str]
    fields: list["FieldView"]
    hold: float


class FieldView(_View):
    """The fields of a safety scanner, true while they are infringed."""

    source: str
    warning: bool
    protective: bool


class ContactSpeedView(_View):
    """The speed of contacts in m/s that the table of the cell permits, and who confirmed the table."""

    speed: float
    region: str
    source: str
    confirmed_by: str
    confirmed_at: datetime


class ContactView(_View):
    """The force at the wrist, and the change of it that stops a motion, in N; null for none."""

    force: float | None
    limit: float | None
    permitted: ContactSpeedView | None


class SafeSpeedView(_View):
    """The speed of the tool that was validated for the end effector, in m/s."""

    end_effector: str
    speed_mps: float
    validated_at: datetime


class StoppingView(_View):
    """How the robot stops: a delay in s, then a deceleration in m/s²; null for values that are assumed."""

    delay: float
    deceleration: float
    measured_at: str | None


class SafetyStatusView(_View):
    """The safety functions of a real robot as its controller reports them; `speed` is a fraction.

    `detail` says why the arm cannot move, with the code and the parameters of the message.
    """

    emergency_stop: bool
    protective_stop: bool
    safeguard_stop: bool
    mode: str
    speed: float | None
    detail: str
    detail_code: str | None
    detail_parameters: dict[str, Any] | None


class DecisionView(_View):
    """What a person decided, and why."""

    what: str
    name: str
    reason: str
    at: datetime


class RobotLimitsView(_View):
    """What limits the speed of a robot now; `rule`, `reason` and `max_speed` are of the lowest limit."""

    notice: str
    pace: float
    rule: str | None
    reason: str | None
    reason_code: str | None
    reason_parameters: dict[str, Any] | None
    max_speed: float | None
    needs_reset: bool
    rules: list[RuleView]
    separation: SeparationView
    limit_sources: list[str]
    people_sensors: list[str]
    mode: Mode
    end_effector: str | None
    safe_speeds: list[SafeSpeedView]
    contact: ContactView
    stopping: StoppingView
    safety_status: SafetyStatusView | None
    decisions: list[DecisionView]


def view_of(limits: RobotLimits, driver: Robot) -> RobotLimitsView:
    """Return the present limits."""
    lowest, record, state = limits.lowest(), limits.record, limits.state
    rule, allowed, status = limits.separation.rule, limits.allowed(), driver.safety_status()
    force_n = driver.wrist_force_n()
    said = {} if lowest is None else with_code("reason", lowest.reason)
    return RobotLimitsView(
        notice=NOTICE,
        pace=round(limits.pace(), 3),
        rule=None if lowest is None else lowest.rule,
        reason=said.get("reason"),
        reason_code=said.get("reasonCode"),
        reason_parameters=said.get("reasonParameters"),
        max_speed=_speed(lowest),
        needs_reset=any(limit.needs_reset for limit in allowed),
        rules=[
            RuleView(
                rule=limit.rule,
                fraction=round(limit.fraction, 3),
                max_speed=_speed(limit),
                reason=limit.reason,
                needs_reset=limit.needs_reset,
            )
            for limit in allowed
        ],
        separation=SeparationView(
            distance=None if state.distance_m is None else round(state.distance_m, 3),
            required=None if state.required_m is None else round(state.required_m, 3),
            lost=list(state.lost),
            fields=[FieldView.model_validate(field) for field in state.fields],
            hold=rule.hold_s,
        ),
        limit_sources=list(limits.body.sources),
        people_sensors=list(limits.separation.sources),
        mode=record.mode,
        end_effector=limits.end_effector,
        safe_speeds=[SafeSpeedView.model_validate(speed) for speed in record.safe_speeds.values()],
        contact=ContactView(
            force=None if force_n is None else round(force_n, 1),
            limit=limits.contact.max_n,
            permitted=_permitted(limits.contact_speed),
        ),
        stopping=StoppingView(
            delay=rule.stopping.delay_s,
            deceleration=rule.stopping.deceleration_mps2,
            measured_at=rule.stopping.measured_at,
        ),
        safety_status=None if status is None else _safety_status(status),
        decisions=[DecisionView.model_validate(decision) for decision in record.decisions[-SHOWN_DECISIONS:]],
    )


def _safety_status(status: SafetyStatus) -> SafetyStatusView:
    said = with_code("detail", status.detail)
    return SafetyStatusView(
        emergency_stop=status.emergency_stop,
        protective_stop=status.protective_stop,
        safeguard_stop=status.safeguard_stop,
        mode=status.mode,
        speed=status.speed,
        detail=said["detail"],
        detail_code=said.get("detailCode"),
        detail_parameters=said.get("detailParameters"),
    )


def _speed(allowed: Allowed | None) -> float | None:
    """Return the speed of the tool that a rule allows; None for no limit."""
    return None if allowed is None or allowed.max_speed_mps == math.inf else allowed.max_speed_mps


def _permitted(contact_speed: ContactSpeed | None) -> ContactSpeedView | None:
    if contact_speed is None:
        return None
    return ContactSpeedView(
        speed=round(contact_speed.speed_mps, 3),
        region=contact_speed.region,
        source=contact_speed.table.source,
        confirmed_by=contact_speed.table.confirmed_by,
        confirmed_at=contact_speed.table.confirmed_at,
    )
