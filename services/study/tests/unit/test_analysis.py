"""The analysis, against values worked out by hand; the arithmetic stands beside each."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_study.report.analysis import against, analysis_of, mann_whitney, normality, summary, wilcoxon


def upper_tail_of_t(t: float, df: int) -> float:
    """P(T > t): Simpson's rule over Student's density, with t = tan to have finite ends."""
    factor = math.gamma((df + 1) / 2) / (math.sqrt(df * math.pi) * math.gamma(df / 2))
    start, end, steps = math.atan(t), math.pi / 2, 20_000

    def density(angle: float) -> float:
        if angle >= end:
            return 0.0
        x = math.tan(angle)
        return factor * (1 + x * x / df) ** (-(df + 1) / 2) / math.cos(angle) ** 2

    width = (end - start) / steps
    inner = sum((4 if nth % 2 else 2) * density(start + nth * width) for nth in range(1, steps))
    return width / 3 * (density(start) + inner + density(end))


def two_sided_normal(z: float) -> float:
    return math.erfc(abs(z) / math.sqrt(2))


def test_the_participants_are_counted(analysis: dict[str, Any]) -> None:
    assert (analysis["participants"], analysis["finished"]) == (20, 20)
    assert (analysis["personalFirst"], analysis["predefinedFirst"]) == (10, 10)
    assert analysis["preference"] == {"personal": 14, "predefined": 4, "none": 2}
    assert analysis["recalibrated"] == 1
    # ages 21 … 40: mean 30.5; the variance of 1 … n is n (n + 1) / 12 = 20 · 21 / 12 = 35
    assert analysis["age_years"]["mean"] == 30.5
    assert analysis["age_years"]["sd"] == pytest.approx(math.sqrt(35))


def test_sus_mean_and_sd(analysis: dict[str, Any]) -> None:
    # (65 + 70 + 72.5 + 75 + 77.5 + 80 + 82.5 + 85 + 87.5 + 90) / 10 = 785 / 10 = 78.5
    assert analysis["sus"]["mean"] == pytest.approx(78.5)
    # 13.5² + 8.5² + 6² + 3.5² + 1² + 1.5² + 4² + 6.5² + 9² + 11.5²
    #   = 182.25 + 72.25 + 36 + 12.25 + 1 + 2.25 + 16 + 42.25 + 81 + 132.25 = 577.5
    # twice 577.5 = 1155; 1155 / 19 = 60.789474; its root is 7.796760
    assert analysis["sus"]["sd"] == pytest.approx(7.796760, abs=1e-6)


def test_sus_quartiles(analysis: dict[str, Any]) -> None:
    # in order, places counted from 0:
    # 65 65 70 70 72.5 72.5 75 75 77.5 77.5 80 80 82.5 82.5 85 85 87.5 87.5 90 90
    # q1 at 0.25 · 19 = 4.75, between 72.5 and 72.5; median at 9.5, between 77.5 and 80; q3 at 14.25: 85
    box = analysis["sus"]["box"]
    assert (box["q1"], box["median"], box["q3"]) == (72.5, 78.75, 85.0)
    # whiskers reach to 72.5 - 1.5 · 12.5 = 53.75 and 85 + 18.75 = 103.75 at most, so to the last scores
    assert (box["low"], box["high"], box["outliers"]) == (65, 90, [])


def test_sus_grade(analysis: dict[str, Any]) -> None:
    assert analysis["sus"]["grade"] == "B+"  # 77.2 to 78.8


def test_sus_against_the_average_of_68(analysis: dict[str, Any]) -> None:
    test = analysis["sus"]["test"]
    # standard error 7.796760 / √20 = 1.743409; t = (78.5 - 68) / 1.743409 = 6.022684
    assert (test["average"], test["df"]) == (68, 19)
    assert test["t"] == pytest.approx(6.022684, abs=2e-6)
    assert test["p"] == pytest.approx(2 * upper_tail_of_t(6.022684, 19), rel=1e-4)
    # the 97.5 % quantile of t with 19 degrees of freedom is 2.093024; 2.093024 · 1.743409 = 3.648997
    assert test["interval"] == pytest.approx([78.5 - 3.648997, 78.5 + 3.648997], abs=5e-6)
    assert test["effect"] == pytest.approx(10.5 / 7.796760, abs=1e-6)


def test_welchs_t_test_against_a_constant_is_the_same(analysis: dict[str, Any]) -> None:
    # Welch: t = (m1 - m2) / √(s1²/n1 + s2²/n2)
    # and df = (s1²/n1 + s2²/n2)² / ((s1²/n1)²/(n1 - 1) + (s2²/n2)²/(n2 - 1));
    # for a constant s2 = 0, so t = 10.5 / √(60.789474 / 20) and df = (n1 - 1) = 19
    assert analysis["sus"]["test"]["t"] == pytest.approx(10.5 / math.sqrt(60.789474 / 20), abs=1e-6)


def test_mental_demand_which_is_5_more_with_predefined_gestures(analysis: dict[str, Any]) -> None:
    mental = analysis["tlx"]["mental"]
    # 0, 5 … 95: mean 47.5; variance 25 · 20 · 21 / 12 = 875
    assert mental["personal"]["mean"] == 47.5
    assert mental["personal"]["sd"] == pytest.approx(math.sqrt(875))
    assert mental["predefined"]["box"]["median"] == 52.5
    # personal 5 i lies above predefined 5 (j + 1) where i - j is 2 at least: 18 + 17 + … + 1 = 171 pairs;
    # 19 pairs tie: 9.5
    assert mental["test"]["u"] == 180.5
    assert mental["test"]["effect"] == pytest.approx(2 * 180.5 / 400 - 1)  # -0.0975
    # 19 values are there twice: Σ(t³ - t) = 19 · 6 = 114
    # σ² = 20 · 20 / 12 · (41 - 114 / (40 · 39)) = 33.333333 · 40.926923 = 1364.230769, σ = 36.935494
    # z = (|180.5 - 200| - 0.5) / 36.935494 = 0.514410
    assert mental["test"]["p"] == pytest.approx(two_sided_normal(0.514410), abs=1e-5)
    assert mental["test"]["p"] > 0.05
    # paired, all twenty differences are -5: no positive rank at all
    assert (mental["paired"]["n"], mental["paired"]["w"]) == (20, 0)
    # all tie: ranks 10.5 each; mean 105; σ² = 20 · 21 · 41 / 24 - (20³ - 20) / 48 = 717.5 - 166.25 = 551.25
    # z = 105 / √551.25 = 4.472136
    assert mental["paired"]["p"] == pytest.approx(two_sided_normal(4.472136), rel=1e-4)


def test_physical_demand_which_is_always_lower_with_personal_gestures(analysis: dict[str, Any]) -> None:
    physical = analysis["tlx"]["physical"]
    assert physical["test"]["u"] == 0
    assert physical["test"]["effect"] == -1
    # 20 values are there twice: 120; σ² = 33.333333 · (41 - 120 / 1560) = 1364.102564, σ = 36.933759
    # z = (200 - 0.5) / 36.933759 = 5.401562
    assert physical["test"]["p"] == pytest.approx(two_sided_normal(5.401562), rel=1e-4)
    # personal: 0 0 5 5 … 45 45: q1 at place 4.75, 10; median at 9.5, between 20 and 25; q3 at 14.25, 35
    box = physical["personal"]["box"]
    assert (box["q1"], box["median"], box["q3"]) == (10, 22.5, 35)


def test_temporal_demand_which_never_differs(analysis: dict[str, Any]) -> None:
    temporal = analysis["tlx"]["temporal"]
    assert (temporal["test"]["u"], temporal["test"]["effect"], temporal["test"]["p"]) == (200, 0, 1)
    assert temporal["paired"]["n"] == 0
    assert "p" not in temporal["paired"]


def test_frustration_which_is_always_higher_with_personal_gestures(analysis: dict[str, Any]) -> None:
    assert analysis["tlx"]["frustration"]["test"]["u"] == 400
    assert analysis["tlx"]["frustration"]["test"]["effect"] == 1


def test_raw_workload(analysis: dict[str, Any]) -> None:
    # personal gestures: the six means are 47.5, 22.5, 30, 10, 20 and 60, together 190; a sixth of that
    # predefined gestures: 52.5, 72.5, 30, 20, 20 and 40, together 235
    assert analysis["tlx"]["raw"]["personal"]["mean"] == pytest.approx(31.666667, abs=1e-6)
    assert analysis["tlx"]["raw"]["predefined"]["mean"] == pytest.approx(39.166667, abs=1e-6)


def test_weighted_workload(analysis: dict[str, Any]) -> None:
    # weights 5, 4, 3, 2, 1, 0 of 15; personal: (5 · 47.5 + 4 · 22.5 + 3 · 30 + 2 · 10 + 20) / 15 = 457.5 / 15
    assert analysis["tlx"]["weighted"]["personal"]["mean"] == pytest.approx(30.5)
    # predefined: (5 · 52.5 + 4 · 72.5 + 3 · 30 + 2 · 20 + 20) / 15 = 702.5 / 15
    assert analysis["tlx"]["weighted"]["predefined"]["mean"] == pytest.approx(46.833333, abs=1e-6)


def test_a_small_sample_without_ties_is_tested_exactly() -> None:
    # 1, 2, 3 against 4, 5, 6: of 20 ways to deal six ranks, one has U = 0 and one U = 9, so p = 2 / 20
    assert mann_whitney([1, 2, 3], [4, 5, 6])["p"] == pytest.approx(0.1)


def test_an_outlier_stands_alone() -> None:
    # 0 … 9 and 100: q1 2.5, q3 7.5, whiskers to 7.5 + 7.5 = 15 at most
    box = summary([*range(10), 100])["box"]
    assert (box["low"], box["high"], box["outliers"]) == (0, 9, [100])


def test_too_little_is_said_to_be_too_little(twenty: list[Any]) -> None:
    assert analysis_of([])["sus"]["grade"] is None
    assert "p" not in analysis_of(twenty[:1])["sus"]["test"]
    assert "why" in against([70, 70], 68)
    assert "why" in normality([70, 70, 70])
    assert "why" in mann_whitney([], [1])
    assert "why" in wilcoxon([(1, 1)])


@pytest.mark.parametrize(
    "differences", [(5, 5), (5, -5, 10), (10, 5, -5, 20, 15, 10), (5, 5, 5, -5, 10, 10, 25, 30)]
)
def test_tied_pairs_are_tested_exactly_as_by_scipy(differences: tuple[float, ...]) -> None:
    from scipy import stats

    ours = wilcoxon([(one, 0) for one in differences])
    theirs = stats.wilcoxon(differences, method=stats.PermutationMethod())
    assert (ours["w"], ours["p"]) == pytest.approx((theirs.statistic, theirs.pvalue))


def test_a_session_that_is_not_finished_counts_as_far_as_it_goes(twenty: list[Any]) -> None:
    from dataclasses import replace

    half = replace(twenty[0], step="interaction1", answers={"sus": twenty[0].answers["sus"]})
    analysis = analysis_of([half, *twenty[1:]])
    assert (analysis["finished"], analysis["sus"]["n"], analysis["tlx"]["mental"]["personal"]["n"]) == (
        19,
        20,
        19,
    )
    assert analysis["tlx"]["raw"]["paired"]["n"] == 19


samples = st.lists(st.sampled_from([float(value) for value in range(0, 101, 5)]), min_size=1, max_size=12)


@given(samples, samples)
def test_to_exchange_the_conditions_turns_the_effect_round(some: list[float], others: list[float]) -> None:
    one, other = mann_whitney(some, others), mann_whitney(others, some)
    assert one["effect"] == pytest.approx(-other["effect"])
    assert one["p"] == pytest.approx(other["p"])
    assert -1 <= one["effect"] <= 1
    assert 0 <= one["p"] <= 1


@given(samples)
def test_the_numbers_of_a_box_stand_in_order(values: list[float]) -> None:
    box = summary(values)["box"]
    assert box["min"] <= box["low"] <= box["high"] <= box["max"]
    assert box["q1"] <= box["median"] <= box["q3"]
    assert len(box["outliers"]) + sum(box["low"] <= value <= box["high"] for value in values) == len(values)
