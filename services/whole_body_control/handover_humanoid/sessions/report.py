"""What a therapist reads: the figures of a session, and how they change over the weeks."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from handover_humanoid.patterns.regions import SIDES, Side
from handover_humanoid.sessions.exercise import Exercise, SessionThrow


@dataclass(frozen=True, slots=True)
class SideFigures:
    """The throws that were nearest to one hand; medians are None where there is no value."""

    throws: int
    caught: int
    median_closest_m: float | None


@dataclass(frozen=True, slots=True)
class JugglingReport:
    """The figures of a session; `level` is the difficulty of the last throw."""

    throws: int
    caught: int
    score: int
    exercised_s: float
    level: float
    longest_run: int
    median_reaction_s: float | None
    median_closest_m: float | None
    left: SideFigures
    right: SideFigures

    @property
    def share_caught(self) -> float | None:
        """Return the share of balls that were caught, None without a throw."""
        return self.caught / self.throws if self.throws else None


def juggling_report(session: Exercise, now_s: float) -> JugglingReport:
    """Return the figures of a session, which may still run."""
    throws = session.throws
    left, right = (_of_side(throws, side) for side in SIDES)
    return JugglingReport(
        throws=len(throws),
        caught=session.caught,
        score=session.score,
        exercised_s=session.exercised_s(now_s),
        level=throws[-1].level if throws else 0.0,
        longest_run=_longest_run(throws),
        median_reaction_s=_median(throw.outcome.reaction_s for throw in throws),
        median_closest_m=_median(throw.outcome.closest_m for throw in throws),
        left=left,
        right=right,
    )


@dataclass(frozen=True, slots=True)
class SessionFigures:
    """What is kept of a session that has ended, for the progress of a person."""

    started_at: datetime
    throws: int
    caught: int
    score: int
    exercised_s: float
    level: float
    distance_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Week:
    """The sessions of a week, named as ISO 8601 does (2026-W48); `best_level` is the highest difficulty."""

    week: str
    sessions: int
    throws: int
    caught: int
    score: int
    exercised_s: float
    best_level: float
    distance_m: float


def progress(sessions: Iterable[SessionFigures]) -> list[Week]:
    """Return the weeks in which a person exercised, the oldest first."""
    by_week: dict[tuple[int, int], list[SessionFigures]] = defaultdict(list)
    for session in sessions:
        year, week, _ = session.started_at.isocalendar()
        by_week[year, week].append(session)
    return [
        Week(
            week=f"{year}-W{week:02d}",
            sessions=len(week_sessions),
            throws=sum(session.throws for session in week_sessions),
            caught=sum(session.caught for session in week_sessions),
            score=sum(session.score for session in week_sessions),
            exercised_s=sum(session.exercised_s for session in week_sessions),
            best_level=max(session.level for session in week_sessions),
            distance_m=sum(session.distance_m for session in week_sessions),
        )
        for (year, week), week_sessions in sorted(by_week.items())
    ]


def _of_side(throws: Sequence[SessionThrow], side: Side) -> SideFigures:
    outcomes = [throw.outcome for throw in throws if throw.outcome.side == side]
    caught = sum(outcome.result == "caught" for outcome in outcomes)
    return SideFigures(len(outcomes), caught, _median(outcome.closest_m for outcome in outcomes))


def _longest_run(throws: Sequence[SessionThrow]) -> int:
    """Return the most balls that were caught one after the other."""
    longest = run = 0
    for throw in throws:
        run = run + 1 if throw.outcome.result == "caught" else 0
        longest = max(longest, run)
    return longest


def _median(values: Iterable[float]) -> float | None:
    finite = [value for value in values if np.isfinite(value)]
    return float(np.median(finite)) if finite else None
