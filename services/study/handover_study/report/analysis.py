"""The analysis: what the answers say, and how sure that is.

SUS is compared with the average of 68. Welch's t-test against a constant, which has no variance, is the
one-sample t-test with n - 1 degrees of freedom, so that is what is computed and named. NASA-TLX is compared
between personal and predefined gestures for each scale: Mann-Whitney U as in Machines 2022, 10, 957,
section 6.1, with the rank-biserial correlation as effect size; and, as the same people did both, Wilcoxon's
signed-rank test beside it. Answers of sessions that are not finished count as far as they go.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from handover_study.model.protocol import FINISHED, Condition, Session
from handover_study.model.questionnaires import (
    SUS_AVERAGE,
    TLX_SCALES,
    sus_grade,
    sus_score,
    tlx_raw,
    tlx_weighted,
)
from handover_study.model.views import AnalysisView, StatisticalTest, SummaryView, SusAnalysis, TlxAnalysis

CONFIDENCE = 0.95
ALL_SIGNS_UP_TO = 13
"""Of so many pairs with ties all 8,192 signs are gone through."""

MEASURES = (*TLX_SCALES, "raw", "weighted")


@dataclass(frozen=True, slots=True)
class Scores:
    """What one participant's answers come to; None where there is no answer (yet)."""

    sus: float | None
    tlx: dict[Condition, dict[str, float]]
    """The six ratings and the raw and weighted TLX, by condition."""


def scores_of(session: Session) -> Scores:
    """Return the scores of a session."""
    sus = session.answers.get("sus")
    tlx: dict[Condition, dict[str, float]] = {}
    for step in ("tlx1", "tlx2"):
        answer, condition = session.answers.get(step), session.condition_of(step)
        if answer is None or condition is None:
            continue
        ratings = answer.content["ratings"]
        chosen = [choice["chosen"] for choice in answer.content["choices"]]
        tlx[condition] = {
            **{scale: float(ratings[scale]) for scale in TLX_SCALES},
            "raw": tlx_raw(ratings),
            "weighted": tlx_weighted(ratings, chosen),
        }
    return Scores(sus_score(sus.content["answers"]) if sus else None, tlx)


def analysis_of(sessions: Sequence[Session]) -> AnalysisView:
    """Return the analysis of `sessions`. Loads SciPy and takes some tenths of a second."""
    scores = [scores_of(session) for session in sessions]
    orders = Counter(session.first for session in sessions if session.first is not None)
    answers = [session.answers for session in sessions]
    preferences = Counter(
        answer["preference"].content["preferred"] for answer in answers if "preference" in answer
    )
    ages = [
        float(answer["introduction"].content["age_years"])
        for answer in answers
        if "introduction" in answer and answer["introduction"].content["age_years"] is not None
    ]
    return {
        "participants": len(sessions),
        "finished": sum(session.step == FINISHED for session in sessions),
        "personalFirst": orders[Condition.PERSONAL],
        "predefinedFirst": orders[Condition.PREDEFINED],
        "age_years": summary(ages),
        "preference": {
            "personal": preferences["personal"],
            "predefined": preferences["predefined"],
            "none": preferences["none"],
        },
        "recalibrated": sum(
            bool(answer["preference"].content["recalibrated"]) for answer in answers if "preference" in answer
        ),
        "sus": sus_analysis([score.sus for score in scores if score.sus is not None]),
        "tlx": {measure: _tlx(scores, measure) for measure in MEASURES},
        "confidence": CONFIDENCE,
    }


def sus_analysis(values: Sequence[float]) -> SusAnalysis:
    """Return mean, spread and grade of SUS scores, and how they compare with the average of 68."""
    described = summary(values)
    return {
        **described,
        "grade": None if described["mean"] is None else sus_grade(described["mean"]),
        "scores": list(values),
        "test": against(values, SUS_AVERAGE),
        "normality": normality(values),
    }


def summary(values: Sequence[float]) -> SummaryView:
    """Return n, mean, sample SD and the five numbers of a box plot; None where there are too few values.

    Quartiles lie between neighbours in proportion (type 7 of Hyndman and Fan, Am. Stat. 50, 1996, 361); the
    whiskers end at the last value within 1.5 times the box, what lies beyond are `outliers` (Tukey).
    """
    import numpy as np  # noqa: PLC0415 - heavy, and seldom asked for

    if not values:
        return {"n": 0, "mean": None, "sd": None, "box": None}
    ordered = sorted(values)
    q1, median, q3 = (float(value) for value in np.quantile(ordered, [0.25, 0.5, 0.75]))
    reach = 1.5 * (q3 - q1)
    within = [value for value in ordered if q1 - reach <= value <= q3 + reach]
    return {
        "n": len(ordered),
        "mean": float(np.mean(ordered)),
        "sd": float(np.std(ordered, ddof=1)) if len(ordered) > 1 else None,
        "box": {
            "min": ordered[0],
            "q1": q1,
            "median": median,
            "q3": q3,
            "max": ordered[-1],
            "low": within[0],
            "high": within[-1],
            "outliers": [value for value in ordered if not within[0] <= value <= within[-1]],
        },
    }


def against(values: Sequence[float], average: float) -> StatisticalTest:
    """Return the two-sided one-sample t-test of `values` against `average`, with the mean's interval.

    `effect` is Cohen's d, the distance in standard deviations.
    """
    import numpy as np  # noqa: PLC0415 - heavy, and seldom asked for
    from scipy import stats  # noqa: PLC0415 - heavy, and seldom asked for

    name = "one-sample t-test (Welch's t-test against a constant), two-sided"
    if len(values) < 2 or min(values) == max(values):
        return {"name": name, "average": average, "why": "needs two different scores at least"}
    result = stats.ttest_1samp(values, average)
    interval = result.confidence_interval(CONFIDENCE)
    return {
        "name": name,
        "average": average,
        "t": float(result.statistic),
        "df": int(result.df),
        "p": float(result.pvalue),
        "interval": [float(interval.low), float(interval.high)],
        "effect": (float(np.mean(values)) - average) / float(np.std(values, ddof=1)),
    }


def normality(values: Sequence[float]) -> StatisticalTest:
    """Return the Shapiro-Wilk test: the t-test presumes that nothing speaks against a normal distribution."""
    from scipy import stats  # noqa: PLC0415 - heavy, and seldom asked for

    if len(values) < 3 or min(values) == max(values):
        return {"name": "Shapiro-Wilk", "why": "needs three scores, not all alike"}
    result = stats.shapiro(values)
    return {"name": "Shapiro-Wilk", "w": float(result.statistic), "p": float(result.pvalue)}


def mann_whitney(some: Sequence[float], others: Sequence[float]) -> StatisticalTest:
    """Return the two-sided Mann-Whitney U test of two samples.

    `u` counts the pairs in which the first is larger, ties as half; `effect` is the rank-biserial correlation
    2 u / (n1 n2) - 1, -1 when all of the first lie below all of the others and 0 when they are alike
    (Kerby, Compr. Psychol. 3, 2014). p is exact for small samples without ties, else the normal
    approximation corrected for ties and continuity.
    """
    from scipy import stats  # noqa: PLC0415 - heavy, and seldom asked for

    name = "Mann-Whitney U test, two-sided"
    if not some or not others:
        return {"name": name, "why": "needs answers in both conditions"}
    result = stats.mannwhitneyu(some, others, alternative="two-sided")
    u, p = float(result.statistic), float(result.pvalue)
    return {
        "name": name,
        "u": u,
        "p": 1.0 if math.isnan(p) else p,  # nothing but ties: the two are the same
        "effect": 2 * u / (len(some) * len(others)) - 1,
    }


def wilcoxon(pairs: Sequence[tuple[float, float]]) -> StatisticalTest:
    """Return the two-sided Wilcoxon signed-rank test of pairs; those without a difference are left out.

    p is exact for up to 13 pairs, with ties too, and for up to 50 without; else the normal approximation.
    """
    from scipy import stats  # noqa: PLC0415 - heavy, and seldom asked for

    name = "Wilcoxon signed-rank test, two-sided"
    differences = [first - other for first, other in pairs if first != other]
    if not differences:
        return {"name": name, "n": 0, "why": "needs pairs that differ"}
    is_tied = len({abs(difference) for difference in differences}) < len(differences)
    if is_tied and len(differences) <= ALL_SIGNS_UP_TO:
        w, p = _of_all_signs(differences)
        return {"name": name, "n": len(differences), "w": w, "p": p}
    result = stats.wilcoxon(differences)
    return {"name": name, "n": len(differences), "w": float(result.statistic), "p": float(result.pvalue)}


def _of_all_signs(differences: Sequence[float]) -> tuple[float, float]:
    """Return the same test by going through all signs at once; SciPy's own would take seconds over them."""
    import numpy as np  # noqa: PLC0415 - heavy, and seldom asked for
    from scipy import stats  # noqa: PLC0415 - heavy, and seldom asked for

    signed = np.asarray(differences)
    ranks = stats.rankdata(np.abs(signed))

    def above(some: Any, axis: int) -> Any:
        return np.sum(np.where(some > 0, ranks, 0.0), axis=axis)

    result = stats.permutation_test(
        (signed,), above, permutation_type="samples", vectorized=True, n_resamples=math.inf
    )
    return float(min(result.statistic, ranks.sum() - result.statistic)), float(result.pvalue)


def _tlx(scores: Sequence[Scores], measure: str) -> TlxAnalysis:
    personal, predefined = (
        [score.tlx[condition][measure] for score in scores if condition in score.tlx]
        for condition in (Condition.PERSONAL, Condition.PREDEFINED)
    )
    pairs = [
        (score.tlx[Condition.PERSONAL][measure], score.tlx[Condition.PREDEFINED][measure])
        for score in scores
        if len(score.tlx) == 2
    ]
    return {
        "personal": summary(personal),
        "predefined": summary(predefined),
        "test": mann_whitney(personal, predefined),
        "paired": wilcoxon(pairs),
    }
