"""The protocol: the order of the steps, what an answer must hold, and a fair lot."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem
from handover_study.model.protocol import FINISHED, STEPS, Condition, Session, balanced, checked, next_step
from handover_study.model.questionnaires import TLX_PAIRS, TLX_SCALES

RATINGS = dict.fromkeys(TLX_SCALES, 50)
CHOICES = [{"of": list(pair), "chosen": pair[1]} for pair in TLX_PAIRS]


def session(**values: Any) -> Session:
    return Session("s1", "gestures", "P01", "en", "2026-03-02T09:00:00.000000Z", **values)


def test_consent_comes_first_and_the_questions_after_what_they_are_about() -> None:
    way = [STEPS[0]]
    while way[-1] != FINISHED:
        way.append(next_step(way[-1]))
    assert way[0] == "consent"
    assert way.index("sample") < way.index("sus") < way.index("interaction1")
    for nth in "12":
        assert way.index(f"tlx{nth}") == way.index(f"interaction{nth}") + 1


@pytest.mark.parametrize("first", Condition)
def test_each_condition_is_met_once_with_its_questions(first: Condition) -> None:
    met = {step: session(first=first, step=step).condition for step in STEPS}
    assert met["interaction1"] is met["tlx1"] is first
    assert met["interaction2"] is met["tlx2"] is first.other
    assert {met[step] for step in STEPS if step[-1] not in "12"} == {None}


@given(st.lists(st.floats(0, 1, exclude_max=True), max_size=60))
def test_whatever_the_lot_the_orders_stay_balanced(lots: list[float]) -> None:
    counts = {Condition.PERSONAL: 0, Condition.PREDEFINED: 0}
    for lot in lots:
        counts[balanced(counts[Condition.PERSONAL], counts[Condition.PREDEFINED], lot)] += 1
        assert abs(counts[Condition.PERSONAL] - counts[Condition.PREDEFINED]) <= 1


def test_the_pairs_are_in_another_order_for_everyone_but_stay_for_one() -> None:
    here = session(step="tlx1")
    assert here.pairs() == here.pairs()
    assert here.pairs() != session(step="tlx2").pairs()
    assert sorted(tuple(sorted(pair)) for pair in here.pairs()) == sorted(
        tuple(sorted(pair)) for pair in TLX_PAIRS
    )


def without(pair: int) -> list[dict[str, Any]]:
    return [choice for nth, choice in enumerate(CHOICES) if nth != pair]


@pytest.mark.parametrize(
    ("step", "given", "says"),
    [
        ("consent", {"text": "en-1"}, "agreed"),
        ("consent", {"agreed": "yes", "text": "en-1"}, "agreed"),
        ("sus", {"answers": [3] * 9}, "at least 10 items"),
        ("sus", {"answers": [3] * 9 + [6]}, "less than or equal to 5"),
        ("sus", {"answers": [3] * 9 + [True]}, "valid integer"),
        ("sus", {"answers": [3] * 9 + ["3"]}, "valid integer"),
        ("tlx1", {"ratings": RATINGS, "choices": without(0)}, "missing: mental or physical"),
        (
            "tlx1",
            {"ratings": RATINGS, "choices": [*without(1), CHOICES[0]]},
            "once; missing: mental or temporal",
        ),
        ("tlx1", {"ratings": {**RATINGS, "mental": 52}, "choices": CHOICES}, "multiple of 5"),
        ("tlx1", {"ratings": {"mental": 50}, "choices": CHOICES}, "missing: physical"),
        (
            "tlx2",
            {
                "ratings": RATINGS,
                "choices": [{"of": ["mental", "physical"], "chosen": "effort"}, *without(0)],
            },
            '"effort" is none of the pair mental or physical',
        ),
        ("preference", {"preferred": "both"}, "preferred"),
        ("introduction", {"age_years": 12}, "age_years"),
        ("introduction", {"name": "Maija"}, "name"),
    ],
)
def test_an_incomplete_answer_is_refused_with_what_is_missing(
    step: str, given: dict[str, Any], says: str
) -> None:
    with pytest.raises(Problem) as refused:
        checked(step, given)
    assert refused.value.status == 422
    assert says in refused.value.detail


def test_a_whole_number_may_have_decimals() -> None:
    assert checked("sus", {"answers": [3.0] * 10}) == {"answers": [3] * 10}


def test_the_error_for_an_unknown_step_lists_the_steps() -> None:
    with pytest.raises(Problem, match="the steps are consent, introduction"):
        checked("lunch", {})
