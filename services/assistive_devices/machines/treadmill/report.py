"""The figures of the trainer beside those of ROS4HC (sections 4.2.2 and 5.2, figure 4c).

The paper gives no numbers beyond its settings: the share of the time in the zone is "most of the session",
and figure 4c shows curves only. So a line without a number of the paper says so, and nothing is invented.
Where the belt is at its highest speed for most of the time, the zone is not reached, as in the paper: its
"speed limit (1.3 m/s) restricted higher heart rates".
"""

from typing import Final, Protocol

from services.assistive_devices.machines.treadmill.belt import PAPER_MAX_SPEED_MPS, StopReason
from services.assistive_devices.machines.treadmill.coach import ADVICE_EVERY_S
from services.assistive_devices.machines.treadmill.figures import Figures
from services.assistive_devices.machines.treadmill.training import Plan

MOST: Final = 0.5
"""Most of the session: more than half of it."""
MIN_JUDGED_S: Final = 300.0
"""A shorter session has too little time to reach the zone, so its share decides nothing."""


class Comparison(Protocol):
    """Takes a figure: a `Trial`, or a list of the study."""

    def compare(self, name: str, paper: str, ours: str, passed: bool | None = None) -> None:
        """Add a figure of the paper with ours."""
        ...


def compare(
    to: Comparison, figures: Figures, plan: Plan, ended_by: StopReason | None, name: str = ""
) -> None:
    """Add all figures of one session; `name` is that of the walker, in a study of several."""
    of = f"{name}: " if name else ""
    zone = plan.zone
    faster, keep, slower = figures.advice
    expected = int((plan.duration_s - 1e-6) // ADVICE_EVERY_S)
    to.compare(
        f"{of}session",
        "10 min, 3 people walked",
        f"{figures.duration_s / 60:.1f} min, {figures.distance_m:.0f} m, simulated",
        ended_by is StopReason.TIME,
    )
    to.compare(
        f"{of}interventions",
        "one every 30 s",
        f"{figures.interventions}: {faster} faster, {keep} keep, {slower} slower",
        figures.interventions == expected,
    )
    is_limited = figures.at_limit > MOST
    is_judged = plan.duration_s >= MIN_JUDGED_S and not is_limited
    why = "; the belt was at its limit" if is_limited else ""
    to.compare(
        f"{of}time within {zone.low_bpm:.0f} to {zone.high_bpm:.0f} bpm",
        '"most of the session"',
        f"{figures.in_zone:.0%}, {figures.in_zone_after_first:.0%} once reached ({_reached(figures)}){why}",
        figures.in_zone > MOST if is_judged else None,
    )
    to.compare(
        f"{of}mean heart rate", "(curves only)", f"{figures.mean_bpm:.1f} bpm, valid {figures.valid:.0%}"
    )
    to.compare(
        f"{of}highest speed",
        f"{PAPER_MAX_SPEED_MPS} m/s (limit)",
        f"{figures.highest_mps:.2f} m/s, at its limit {figures.at_limit:.0%} of the time",
        figures.highest_mps <= PAPER_MAX_SPEED_MPS + 1e-9,
    )
    profile = " ".join(f"{speed:.2f}" for speed in figures.profile_mps)
    to.compare(f"{of}speed of each minute", "(curves only)", f"{profile} m/s")
    to.compare(
        f"{of}walker off the middle; acceleration",
        "(not in the paper)",
        f"at most {figures.furthest_m:.2f} m; {figures.highest_change:.2f} m/s²",
    )


def _reached(figures: Figures) -> str:
    return "never" if figures.first_in_zone_s is None else f"after {figures.first_in_zone_s:.0f} s"
