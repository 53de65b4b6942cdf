"""The report: against the paper's Table 3 and against values worked out by hand."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_gloves.accuracy_tests.report import (
    NO_GESTURE,
    NOTHING,
    quantile,
    report_of,
    wilson,
)
from handover_gloves.accuracy_tests.trials import Attempt, Outcome, Plan, Trial, draw_order
from handover_gloves.recognition.gestures import M2O2P_GESTURES


def trial(number: int, asked: str, *tries: tuple[str | None, float]) -> Trial:
    kept = tuple(
        Attempt(gesture, M2O2P_GESTURES.get(gesture or "", "22212"), at_ms) for gesture, at_ms in tries
    )
    right = bool(kept) and kept[-1].gesture == asked
    outcome = Outcome.MISSED if not right else Outcome.RIGHT if len(kept) == 1 else Outcome.CORRECTED
    return Trial(number, number // 21, asked, outcome, kept)


@pytest.fixture
def paper() -> tuple[Plan, list[Trial]]:
    """The test of the paper: 21 gestures ten times, two of which needed readjustment."""
    plan = Plan(M2O2P_GESTURES, draw_order(M2O2P_GESTURES, 10, 3), 3)
    trials = [trial(number, asked, (asked, 1200.0)) for number, asked in enumerate(plan.asked)]
    for asked in ("Middle and ring straight", "Index and ring straight"):
        number = plan.asked.index(asked)
        trials[number] = trial(number, asked, (None, 1500.0), (asked, 3000.0))
    return plan, trials


def test_the_papers_table_3_comes_out(paper: tuple[Plan, list[Trial]]) -> None:
    table = report_of(*paper)["table"]
    assert {row["gesture"]: row["interactions"] for row in table["problematic"]} == {
        "Middle and ring straight": 1,
        "Index and ring straight": 1,
    }
    assert (table["successfulInteractions"], table["problematicInteractions"]) == (208, 2)
    assert round(table["accuracy"] * 100, 2) == 99.05


def test_the_papers_208_of_210_have_the_wilson_interval_worked_out_by_hand() -> None:
    # p = 208/210 = 0.9904762, z² = 3.8414588, z²/n = 0.01829266
    # centre = (0.9904762 + 0.00914633) / 1.01829266 = 0.9996225 / 1.01829266 = 0.9816652
    # half = 1.9599640 · sqrt(0.9904762 · 0.0095238 / 210 + 3.8414588 / (4 · 210²)) / 1.01829266
    #      = 1.9599640 · sqrt(0.00004491955 + 0.00002177698) / 1.01829266
    #      = 1.9599640 · 0.008166794 / 1.01829266 = 0.01571905
    assert wilson(208, 210) == pytest.approx((0.9659462, 0.9973843), abs=2e-6)


def test_all_or_none_right_reach_the_ends_and_no_further() -> None:
    # for 10 of 10: lower = 1 / (1 + z²/10) = 1 / 1.38414588 = 0.7224672
    assert wilson(10, 10) == pytest.approx((0.7224672, 1.0), abs=1e-6)
    assert wilson(0, 10) == pytest.approx((0.0, 0.2775328), abs=1e-6)
    assert wilson(0, 0) is None


@given(st.integers(1, 500).flatmap(lambda of: st.tuples(st.integers(0, of), st.just(of))))
def test_an_interval_holds_its_proportion_and_lies_between_0_and_1(counts: tuple[int, int]) -> None:
    successes, of = counts
    interval = wilson(successes, of)
    assert interval is not None
    assert 0 <= interval[0] <= successes / of <= interval[1] <= 1


def test_median_and_95th_percentile_lie_between_neighbours() -> None:
    # 1, 2, 3, 4: the median lies half way between 2 and 3; 0.95 · 3 = 2.85, so 3 + 0.85 · (4 - 3)
    assert quantile([4, 1, 3, 2], 0.5) == 2.5
    assert quantile([4, 1, 3, 2], 0.95) == pytest.approx(3.85)
    assert quantile([7], 0.95) == 7
    assert quantile([], 0.5) is None


def test_the_confusion_matrix_says_what_each_gesture_was_first_first_recognized() -> None:
    codes = {name: M2O2P_GESTURES[name] for name in ("Horns", "Thumbs up")}
    plan = Plan(codes, draw_order(codes, 2, 1), 1)
    trials = [
        trial(0, "Horns", ("Horns", 900.0)),
        trial(1, "Thumbs up", ("Horns", 800.0), ("Thumbs up", 2000.0)),
        trial(2, "Horns", (None, 900.0), ("Ring straight", 1500.0)),
        trial(3, "Thumbs up"),
    ]
    matrix = report_of(plan, trials)["confusion"]
    assert matrix["asked"] == ["Horns", "Thumbs up"]
    assert matrix["recognized"] == ["Horns", "Thumbs up", NO_GESTURE, NOTHING]
    assert matrix["counts"] == [[1, 0, 1, 0], [1, 0, 0, 1]]
    assert sum(map(sum, matrix["counts"])) == len(trials)


def test_each_gesture_has_its_share_and_its_times(paper: tuple[Plan, list[Trial]]) -> None:
    report = report_of(*paper)
    ring = next(row for row in report["gestures"] if row["gesture"] == "Index and ring straight")
    assert (ring["trials"], ring["right"], ring["corrected"], ring["missed"]) == (10, 9, 1, 0)
    assert ring["accuracy"] == 0.9
    assert ring["medianMs"] == 1200
    # nine times 1200 and once 3000: 0.95 · 9 = 8.55, so 1200 + 0.55 · 1800
    assert ring["p95Ms"] == pytest.approx(2190)
    assert [row["trials"] for row in report["rounds"]] == [21] * 10


def test_a_report_on_nothing_claims_nothing() -> None:
    plan = Plan(M2O2P_GESTURES, draw_order(M2O2P_GESTURES, 1, 1), 1)
    report = report_of(plan, [])
    assert report["table"]["accuracy"] is None
    assert report["overall"]["interval"] is None
    assert report["overall"]["medianMs"] is None
