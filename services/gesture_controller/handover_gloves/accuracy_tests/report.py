"""The report of an accuracy test: Table 3 of the paper, confusion matrix, times and intervals.

A trial is successful if the first shape that was held is the gesture asked for; otherwise it is problematic
(Machines 2022, 10, 957, section 6.1: recognized only after readjusting a finger). Proportions have the 95 %
interval of Wilson (J. Am. Stat. Assoc. 22, 1927, 209), which is valid for few trials and near 100 %.
"""

import math
from collections import Counter
from collections.abc import Iterable, Sequence

from handover_gloves.accuracy_tests.trials import Outcome, Plan, Trial
from handover_gloves.accuracy_tests.views import (
    ConfusionMatrix,
    Figures,
    InteractionTable,
    Results,
)

Z_95 = 1.959963984540054
NO_GESTURE = "no gesture"
NOTHING = "nothing kept"


def wilson(successes: int, of: int, z: float = Z_95) -> tuple[float, float] | None:
    """Return the Wilson score interval of a proportion, both ends from 0 to 1; None without trials."""
    if of == 0:
        return None
    share, square = successes / of, z * z
    centre = share + square / (2 * of)
    half = z * math.sqrt(share * (1 - share) / of + square / (4 * of * of))
    below = 0.0 if successes == 0 else (centre - half) / (1 + square / of)
    above = 1.0 if successes == of else (centre + half) / (1 + square / of)
    return below, above


def quantile(values: Iterable[float], part: float) -> float | None:
    """Return the quantile `part` of `values` with linear interpolation (type 7)."""
    ordered = sorted(values)
    if not ordered:
        return None
    place = part * (len(ordered) - 1)
    below = math.floor(place)
    above = min(below + 1, len(ordered) - 1)
    return ordered[below] + (ordered[above] - ordered[below]) * (place - below)


def report_of(plan: Plan, trials: Sequence[Trial]) -> Results:
    """Return the report; times in ms from the request to the end of the hold, shares from 0 to 1."""
    by_gesture = {gesture: [trial for trial in trials if trial.asked == gesture] for gesture in plan.codes}
    return {
        "table": _table(trials),
        "overall": _figures(trials),
        "gestures": [
            {"gesture": gesture, "code": plan.codes[gesture], **_figures(trials_of)}
            for gesture, trials_of in by_gesture.items()
        ],
        "rounds": [
            {"round": number + 1, **_figures([trial for trial in trials if trial.round == number])}
            for number in range(len(plan.order))
        ],
        "confusion": confusion(plan, trials),
        "holdMs": plan.hold_ms,
        "limitMs": plan.limit_ms,
    }


def confusion(plan: Plan, trials: Sequence[Trial]) -> ConfusionMatrix:
    """Return the confusion matrix: gestures asked for (rows) and first recognized (columns)."""
    counts = {gesture: Counter[str]() for gesture in plan.codes}
    for trial in trials:
        counts[trial.asked][first_recognized(trial)] += 1
    others = {name for row in counts.values() for name in row} - set(plan.codes) - {NO_GESTURE, NOTHING}
    columns = [*plan.codes, *sorted(others), NO_GESTURE, NOTHING]
    return {
        "asked": list(plan.codes),
        "recognized": columns,
        "counts": [[counts[gesture][column] for column in columns] for gesture in plan.codes],
    }


def first_recognized(trial: Trial) -> str:
    """Return the gesture that was first recognized."""
    if trial.first is None:
        return NOTHING
    return trial.first.gesture or NO_GESTURE


def _table(trials: Sequence[Trial]) -> InteractionTable:
    problems = Counter(trial.asked for trial in trials if trial.outcome is not Outcome.RIGHT)
    successful = len(trials) - problems.total()
    return {
        "problematic": [{"gesture": gesture, "interactions": n} for gesture, n in problems.most_common()],
        "successfulInteractions": successful,
        "problematicInteractions": problems.total(),
        "accuracy": successful / len(trials) if trials else None,
    }


def _figures(trials: Sequence[Trial]) -> Figures:
    outcomes = Counter(trial.outcome for trial in trials)
    right = outcomes[Outcome.RIGHT]
    times = [trial.recognized_ms for trial in trials if trial.recognized_ms is not None]
    return {
        "trials": len(trials),
        "right": right,
        "corrected": outcomes[Outcome.CORRECTED],
        "missed": outcomes[Outcome.MISSED],
        "accuracy": right / len(trials) if trials else None,
        "interval": wilson(right, len(trials)),
        "medianMs": quantile(times, 0.5),
        "p95Ms": quantile(times, 0.95),
    }
