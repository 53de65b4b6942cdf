"""The figures of the trainer beside those of ROS4HC (sections 4.2.2 and 5.2, figure 4c).

The paper gives no numbers beyond its settings: the share of the time in the zone is "most of the session",
and figure 4c shows curves only. So a line without a number of the paper says so, and nothing is invented.
Where the belt is at its highest speed for most of the time, the line says so: in the paper, too, the "speed
limit (1.3 m/s) restricted higher heart rates". A person who was not in the zone has missed it all the same.
"""

from collections.abc import Callable
from functools import partial
from typing import Final, Protocol

from handover.messages import message
from handover_cases.machines.treadmill.belt import PAPER_MAX_SPEED_MPS, StopReason
from handover_cases.machines.treadmill.coach import ADVICE_EVERY_S
from handover_cases.machines.treadmill.figures import Figures
from handover_cases.machines.treadmill.training import Plan
from handover_cases.trial import NOT_IN_PAPER

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
    of = partial(_named, name)
    zone = plan.zone
    faster, keep, slower = figures.advice
    expected = int((plan.duration_s - 1e-6) // ADVICE_EVERY_S)
    curves = message("case.treadmill.paper.curves", "(curves only)")
    to.compare(
        of(message("case.treadmill.figure.session", "session")),
        message("case.treadmill.paper.session", "10 min, 3 people walked"),
        message(
            "case.treadmill.ours.session",
            "{minutes} min, {metres} m, simulated",
            minutes=round(figures.duration_s / 60, 1),
            metres=round(figures.distance_m),
        ),
        ended_by is StopReason.TIME,
    )
    to.compare(
        of(message("case.treadmill.figure.advice", "interventions")),
        message("case.treadmill.paper.advice", "one every 30 s"),
        message(
            "case.treadmill.ours.advice",
            "{count}: {faster} faster, {keep} keep, {slower} slower",
            count=figures.interventions,
            faster=faster,
            keep=keep,
            slower=slower,
        ),
        figures.interventions == expected,
    )
    is_limited = figures.at_limit > MOST
    is_judged = plan.duration_s >= MIN_JUDGED_S
    in_zone = message(
        "case.treadmill.figure.zone",
        "time within {low} to {high} bpm",
        low=round(zone.low_bpm),
        high=round(zone.high_bpm),
    )
    to.compare(
        of(in_zone),
        message("case.treadmill.paper.zone", '"most of the session"'),
        _in_zone(figures, is_limited=is_limited, is_judged=is_judged),
        figures.in_zone > MOST if is_judged else None,
    )
    to.compare(
        of(message("case.treadmill.figure.heart", "mean heart rate")),
        curves,
        message(
            "case.treadmill.ours.heart",
            "{bpm} bpm, valid {percent} %",
            bpm=round(figures.mean_bpm, 1),
            percent=round(100 * figures.valid),
        ),
    )
    _compare_belt(to, figures, of)


def _compare_belt(to: Comparison, figures: Figures, of: Callable[[str], str]) -> None:
    to.compare(
        of(message("case.treadmill.figure.highest", "highest speed")),
        message("case.treadmill.paper.highest", "{speed} m/s (limit)", speed=PAPER_MAX_SPEED_MPS),
        message(
            "case.treadmill.ours.highest",
            "{speed} m/s, at its limit {percent} % of the time",
            speed=round(figures.highest_mps, 2),
            percent=round(100 * figures.at_limit),
        ),
        figures.highest_mps <= PAPER_MAX_SPEED_MPS + 1e-9,
    )
    profile = " ".join(f"{speed:.2f}" for speed in figures.profile_mps)
    to.compare(
        of(message("case.treadmill.figure.minutes", "speed of each minute")),
        message("case.treadmill.paper.curves", "(curves only)"),
        f"{profile} m/s",
    )
    to.compare(
        of(message("case.treadmill.figure.place", "walker off the middle; acceleration")),
        NOT_IN_PAPER,
        message(
            "case.treadmill.ours.place",
            "at most {metres} m; {change} m/s²",
            metres=round(figures.furthest_m, 2),
            change=round(figures.highest_change, 2),
        ),
    )


def _named(walker: str, figure: str) -> str:
    return (
        message("case.treadmill.of", "{walker}: {figure}", walker=walker, figure=figure) if walker else figure
    )


def _in_zone(figures: Figures, *, is_limited: bool, is_judged: bool) -> str:
    share = message(
        "case.treadmill.ours.zone",
        "{percent} %, {after} % once reached ({reached})",
        percent=round(100 * figures.in_zone),
        after=round(100 * figures.in_zone_after_first),
        reached=_reached(figures),
    )
    if not is_judged:
        return message(
            "case.treadmill.ours.short",
            "{share}; not judged below {minutes} min",
            share=share,
            minutes=round(MIN_JUDGED_S / 60),
        )
    if not is_limited:
        return share
    return message("case.treadmill.ours.limited", "{share}; the belt was at its limit", share=share)


def _reached(figures: Figures) -> str:
    if figures.first_in_zone_s is None:
        return message("case.treadmill.never", "never")
    return message("case.treadmill.after", "after {seconds} s", seconds=round(figures.first_in_zone_s))
