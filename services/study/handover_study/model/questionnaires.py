"""Questionnaires: how usable the system is (SUS) and how much work the task was (NASA-TLX), and their scores.

SUS: ten statements, 1 (strongly disagree) to 5 (strongly agree), odd ones praise and even ones complain
(Brooke, in Usability Evaluation in Industry, 1996, 189). NASA-TLX: six scales from 0 to 100 in steps of 5,
and which of each two mattered more (Hart and Staveland, Adv. Psychol. 52, 1988, 139).
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import combinations

SUS_ITEMS = 10
SUS_AVERAGE = 68.0
"""What systems score on average (Sauro and Lewis, Quantifying the User Experience, 2016, chapter 8)."""

TLX_SCALES = ("mental", "physical", "temporal", "performance", "effort", "frustration")
TLX_STEP = 5
TLX_PAIRS = tuple(combinations(TLX_SCALES, 2))

_GRADES = (
    (84.1, "A+"), (80.8, "A"), (78.9, "A-"), (77.2, "B+"), (74.1, "B"), (72.6, "B-"),
    (71.1, "C+"), (65.0, "C"), (62.7, "C-"), (51.7, "D"),
)  # fmt: skip
"""The curved grades of Sauro and Lewis, with the least score of each (as above, table 8.5)."""


def sus_score(answers: Sequence[int]) -> float:
    """Return the SUS score, 0 to 100 in steps of 2.5, of ten answers from 1 to 5."""
    praise, complaints = answers[0::2], answers[1::2]
    return 2.5 * (sum(answer - 1 for answer in praise) + sum(5 - answer for answer in complaints))


def sus_grade(score: float) -> str:
    """Return the curved grade, A+ to F, of a SUS score; the score is rounded to a tenth, as the table is."""
    return next((grade for least, grade in _GRADES if round(score, 1) >= least), "F")


def tlx_raw(ratings: Mapping[str, float]) -> float:
    """Return the raw TLX, 0 to 100: the mean of the six ratings."""
    return sum(ratings[scale] for scale in TLX_SCALES) / len(TLX_SCALES)


def tlx_weights(chosen: Sequence[str]) -> dict[str, int]:
    """Return how often each scale was chosen of the 15 pairs: 0 to 5, 15 in all."""
    counts = Counter(chosen)
    return {scale: counts[scale] for scale in TLX_SCALES}


def tlx_weighted(ratings: Mapping[str, float], chosen: Sequence[str]) -> float:
    """Return the weighted TLX, 0 to 100; `chosen` names the one chosen of each of the 15 pairs."""
    weights = tlx_weights(chosen)
    return sum(ratings[scale] * weights[scale] for scale in TLX_SCALES) / len(TLX_PAIRS)
