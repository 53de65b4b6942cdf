"""How well a led robot followed the intentions of the simulated person, beside the criteria.

The velocity that the robot wants is to be within `TOLERANCE` of the intention `REACTION_S` after it begins,
and its motion after two steps. Both are directions in the frame of the heading, so that a drift of the
odometry does not count.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from handover_humanoid.behaviours.simulated_person import Lead, LedRecord
from handover_humanoid.model.kinematics import Array
from handover_humanoid.patterns.footsteps import StepLimits
from handover_humanoid.patterns.zmp_control import PERIOD_S

Flags = NDArray[np.bool_]
TOLERANCE: Final = float(np.radians(15))
REACTION_S: Final = 0.5
MIN_MPS: Final = 0.01
"""Below this speed the wanted velocity has no direction."""


@dataclass(frozen=True, slots=True)
class Followed:
    """One intention with a direction: what the robot made of it; angles in rad.

    `reaction_s` is when the velocity was within the tolerance for the first time, None if never; `share` the
    share of the time from `REACTION_S` on in which it was, `error` (median) and `error_95` its error then.
    `motion_error` is that of the way from the end of the second step to that of the fourth, and `speed_mps`
    the speed of it; NaN for an intention too short for it.
    """

    lead: Lead
    reaction_s: float | None
    share: float
    error: float
    error_95: float
    motion_error: float
    speed_mps: float


@dataclass(frozen=True, slots=True)
class StopResponse:
    """A time without intention: how long until the robot wanted no velocity and stood; None if never."""

    lead: Lead
    reaction_s: float | None
    standing_s: float | None


def followed(record: LedRecord, limits: StepLimits) -> list[Followed | StopResponse]:
    """Return what the robot made of each part of the script that it lived through, but for turns on the
    spot."""
    responses: list[Followed | StopResponse] = []
    begun_s = float(record.time_s[0])
    for lead in record.script:
        part = (record.time_s >= begun_s - 1e-9) & (record.time_s < begun_s + lead.seconds - 1e-9)
        since_s = record.time_s[part] - begun_s
        begun_s += lead.seconds
        if not len(since_s) or since_s[-1] < lead.seconds / 2:
            break
        if lead.direction is not None:
            responses.append(_followed(lead, record, part, since_s, limits))
        elif not lead.apart_m:
            responses.append(_stopped(lead, record, part, since_s))
    return responses


def _followed(lead: Lead, record: LedRecord, part: Flags, since_s: Array, limits: StepLimits) -> Followed:
    velocity, intention = record.velocity[part], record.intention[part]
    error = np.abs(_wrapped(np.arctan2(velocity[:, 1], velocity[:, 0]) - intention))
    error[np.hypot(*velocity.T) < MIN_MPS] = np.pi
    within = np.flatnonzero(error <= TOLERANCE)
    later = error[since_s >= REACTION_S]
    two_steps_s = 2 * (limits.single + limits.double) * PERIOD_S
    first, last = np.searchsorted(since_s, [two_steps_s, 2 * two_steps_s])
    motion_error = speed = np.nan
    if last < len(since_s):
        place = record.place[part]
        way = place[last, :2] - place[first, :2]
        heading = np.arctan2(way[1], way[0]) - place[first, 2]
        motion_error = abs(float(_wrapped(heading - intention[first])))
        speed = float(np.hypot(*way)) / two_steps_s
    return Followed(
        lead=lead,
        reaction_s=float(since_s[within[0]]) if len(within) else None,
        share=float((later <= TOLERANCE).mean()),
        error=float(np.median(later)),
        error_95=float(np.quantile(later, 0.95)),
        motion_error=motion_error,
        speed_mps=speed,
    )


def _stopped(lead: Lead, record: LedRecord, part: Flags, since_s: Array) -> StopResponse:
    """Return when the velocity became 0 and the robot stood, for good."""
    moving = np.hypot(*record.velocity[part].T) > 0
    states = [state for state, is_part in zip(record.states, part, strict=True) if is_part]
    stepping = np.array([state.stance.phase != "standing" for state in states])
    return StopResponse(lead, _end_of(moving, since_s), _end_of(stepping, since_s))


def _end_of(flags: Flags, since_s: Array) -> float | None:
    """Return when flags became False for good, None if they did not."""
    last = np.flatnonzero(flags)
    if not len(last):
        return 0.0
    return None if last[-1] == len(flags) - 1 else float(since_s[last[-1] + 1])


def _wrapped(angle: Array) -> Array:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
