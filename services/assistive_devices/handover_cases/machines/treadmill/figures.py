"""The figures of a recorded session, beside those of ROS4HC (section 5.2 and figure 4c)."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from handover_cases.machines.treadmill.coach import Advice, Decision, Zone


@dataclass(frozen=True, slots=True)
class Moment:
    """One line of the record of a session; speeds in m/s. `bpm` is None while no heart rate is valid."""

    at_s: float
    belt_mps: float
    walk_mps: float
    place_m: float
    allowed_mps: float
    bpm: float | None


@dataclass(frozen=True, slots=True)
class Figures:
    """What is computed from a record. Shares are of the time in which a heart rate was valid."""

    duration_s: float
    distance_m: float
    in_zone: float
    in_zone_after_first: float
    """The share since the zone was reached first; 0 if it never was."""
    first_in_zone_s: float | None
    valid: float
    """The share of the session with a valid heart rate."""
    mean_bpm: float
    highest_mps: float
    highest_change: float
    """The highest acceleration or deceleration of the belt, in m/s²."""
    furthest_m: float
    at_limit: float
    profile_mps: tuple[float, ...]
    """The mean speed of each minute."""
    interventions: int
    advice: tuple[int, int, int]
    """Faster, keep, slower."""


def figures_of(record: Sequence[Moment], decisions: Sequence[Decision], zone: Zone) -> Figures:
    """Return the figures of a record in the order of time. Raises `ValueError` for less than two lines."""
    if len(record) < 2:
        raise ValueError("the record has less than two lines; let the session run for longer")
    began_s, ended_s = record[0].at_s, record[-1].at_s
    valid_s = zone_s = after_s = zone_after_s = limit_s = bpm_s = distance_m = 0.0
    first_s: float | None = None
    changes = [0.0]
    minutes: dict[int, tuple[float, float]] = {}
    for before, now in pairwise(record):
        step_s = now.at_s - before.at_s
        if step_s <= 0:
            continue
        changes.append(abs(now.belt_mps - before.belt_mps) / step_s)
        distance_m += step_s * (before.belt_mps + now.belt_mps) / 2
        run_s, run_m = minutes.get(int((before.at_s - began_s) // 60), (0.0, 0.0))
        minutes[int((before.at_s - began_s) // 60)] = run_s + step_s, run_m + step_s * now.belt_mps
        limit_s += step_s if now.belt_mps >= 0.97 * now.allowed_mps else 0.0
        if now.bpm is None:
            continue
        valid_s += step_s
        bpm_s += now.bpm * step_s
        is_inside = now.bpm in zone
        zone_s += step_s if is_inside else 0.0
        if is_inside and first_s is None:
            first_s = now.at_s - began_s
        if first_s is not None:
            after_s += step_s
            zone_after_s += step_s if is_inside else 0.0
    counts = [sum(decision.advice is advice for decision in decisions) for advice in Advice]
    return Figures(
        duration_s=ended_s - began_s,
        distance_m=distance_m,
        in_zone=zone_s / valid_s if valid_s else 0.0,
        in_zone_after_first=zone_after_s / after_s if after_s else 0.0,
        first_in_zone_s=first_s,
        valid=valid_s / (ended_s - began_s),
        mean_bpm=bpm_s / valid_s if valid_s else 0.0,
        highest_mps=max(sample.belt_mps for sample in record),
        highest_change=max(changes),
        furthest_m=max(abs(sample.place_m) for sample in record),
        at_limit=limit_s / (ended_s - began_s),
        profile_mps=tuple(run_m / run_s for _, (run_s, run_m) in sorted(minutes.items())),
        interventions=len(decisions),
        advice=(counts[0], counts[1], counts[2]),
    )
