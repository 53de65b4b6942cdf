"""Twenty synthetic participants, made so that everything about them can be worked out by hand.

SUS: two of each of 65, 70, 72.5, 75, 77.5, 80, 82.5, 85, 87.5 and 90.
Mental demand: 0, 5, … 95 with personal gestures, each 5 more with predefined ones.
Physical demand: two of each of 0, 5, … 45 with personal, of 50, 55, … 95 with predefined gestures.
Temporal demand: 30 for everybody, both times. Performance, effort and frustration: 10, 20 and 60 with
personal, 20, 20 and 40 with predefined gestures. Of each pair the scale that stands first on the form is
chosen, so that the weights are 5, 4, 3, 2, 1 and 0. Ten begin with personal gestures. Fourteen prefer their
own, four the given ones. Ages: 21 to 40.
"""

import pytest

from handover_study.model.protocol import FINISHED, Condition, Session, StepAnswer
from handover_study.model.questionnaires import TLX_PAIRS
from handover_study.report.analysis import analysis_of

SUS_SCORES = [65, 70, 72.5, 75, 77.5, 80, 82.5, 85, 87.5, 90] * 2
SUS_ANSWERS = {
    # points (score / 2.5): praise agreed to and complaints disagreed with give up to four each
    65.0: [5, 1, 5, 1, 5, 1, 3, 5, 1, 5],  # 6 · 4 + 2 = 26
    70.0: [5, 1, 5, 1, 5, 1, 5, 5, 1, 5],  # 7 · 4 = 28
    72.5: [5, 1, 5, 1, 5, 1, 5, 4, 1, 5],  # 29
    75.0: [5, 1, 5, 1, 5, 1, 5, 3, 1, 5],  # 30
    77.5: [5, 1, 5, 1, 5, 1, 5, 2, 1, 5],  # 31
    80.0: [5, 1, 5, 1, 5, 1, 5, 1, 1, 5],  # 8 · 4 = 32
    82.5: [5, 1, 5, 1, 5, 1, 5, 1, 2, 5],  # 33
    85.0: [5, 1, 5, 1, 5, 1, 5, 1, 3, 5],  # 34
    87.5: [5, 1, 5, 1, 5, 1, 5, 1, 4, 5],  # 35
    90.0: [5, 1, 5, 1, 5, 1, 5, 1, 5, 5],  # 9 · 4 = 36
}
CHOICES = [{"of": list(pair), "chosen": pair[0]} for pair in TLX_PAIRS]


def ratings(nth: int, condition: Condition) -> dict[str, int]:
    personal = condition is Condition.PERSONAL
    return {
        "mental": 5 * nth + (0 if personal else 5),
        "physical": 5 * (nth // 2) + (0 if personal else 50),
        "temporal": 30,
        "performance": 10 if personal else 20,
        "effort": 20,
        "frustration": 60 if personal else 40,
    }


def participant(nth: int) -> Session:
    first = Condition.PERSONAL if nth % 2 == 0 else Condition.PREDEFINED
    contents = {
        "consent": {"agreed": True, "text": "en-1"},
        "introduction": {"age_years": 21 + nth, "experience": "low"},
        "sample": {"completed": True, "notes": ""},
        "sus": {"answers": SUS_ANSWERS[SUS_SCORES[nth]]},
        "interaction1": {"completed": True, "notes": ""},
        "tlx1": {"ratings": ratings(nth, first), "choices": CHOICES},
        "interaction2": {"completed": True, "notes": ""},
        "tlx2": {"ratings": ratings(nth, first.other), "choices": CHOICES},
        "preference": {
            "preferred": "personal" if nth < 14 else "predefined" if nth < 18 else "none",
            "recalibrated": nth == 3,
            "comment": "",
        },
    }
    at = "2026-03-02T09:00:00.000000Z"
    answers = {step: StepAnswer(content, "en", at, at) for step, content in contents.items()}
    return Session(
        f"s{nth}",
        "gestures",
        f"P{nth + 1:02}",
        "en",
        at,
        first=first,
        step=FINISHED,
        ended_at=at,
        answers=answers,
    )


@pytest.fixture(scope="session")
def twenty():
    """Twenty sessions that are finished."""
    return [participant(nth) for nth in range(20)]


@pytest.fixture(scope="session")
def analysis(twenty):
    """What the analysis makes of them."""
    return analysis_of(twenty)
