"""The questionnaires: scores, grades and weights, and the same questions in every language."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_study.model.protocol import LANGUAGES
from handover_study.model.questionnaires import (
    TLX_PAIRS,
    TLX_SCALES,
    sus_grade,
    sus_score,
    tlx_raw,
    tlx_weighted,
    tlx_weights,
)
from handover_study.model.wording import consent_version, wording


@pytest.mark.parametrize(
    ("answers", "score"),
    [
        ([5, 1] * 5, 100.0),
        ([1, 5] * 5, 0.0),
        ([3] * 10, 50.0),
        # Brooke's own example (1996, p. 193): 22 points · 2.5 = 55
        ([1, 4, 2, 1, 2, 4, 5, 1, 5, 3], 55.0),
    ],
)
def test_the_sus_score(answers: list[int], score: float) -> None:
    assert sus_score(answers) == score


@pytest.mark.parametrize(
    ("score", "grade"),
    [(100, "A+"), (84.1, "A+"), (84.0, "A"), (80.8, "A"), (79.25, "A-"), (78.9, "A-"), (78.84, "B+"),
     (77.2, "B+"), (77.1, "B"), (74.0, "B-"), (72.5, "C+"), (71.0, "C"), (68, "C"), (64.9, "C-"),
     (62.6, "D"), (51.6, "F"), (0, "F")],
)  # fmt: skip
def test_the_curved_grades(score: float, grade: str) -> None:
    assert sus_grade(score) == grade  # 79.25 is the paper's, graded A- there


def test_raw_and_weighted_tlx() -> None:
    ratings = dict(zip(TLX_SCALES, (60, 10, 40, 20, 50, 30), strict=True))
    assert tlx_raw(ratings) == 35  # 210 / 6
    chosen = [pair[0] for pair in TLX_PAIRS]
    assert list(tlx_weights(chosen).values()) == [5, 4, 3, 2, 1, 0]
    # (5 · 60 + 4 · 10 + 3 · 40 + 2 · 20 + 1 · 50) / 15 = 550 / 15
    assert tlx_weighted(ratings, chosen) == pytest.approx(36.666667, abs=1e-6)


def test_there_are_fifteen_pairs_each_scale_in_five() -> None:
    assert len(TLX_PAIRS) == 15
    assert all(sum(scale in pair for pair in TLX_PAIRS) == 5 for scale in TLX_SCALES)


@given(
    st.fixed_dictionaries({scale: st.integers(0, 20).map(lambda n: 5 * n) for scale in TLX_SCALES}),
    st.tuples(*(st.sampled_from(pair) for pair in TLX_PAIRS)),
)
def test_a_weighted_workload_lies_between_the_ratings(
    ratings: dict[str, int], chosen: tuple[str, ...]
) -> None:
    assert sum(tlx_weights(chosen).values()) == 15
    assert min(ratings.values()) - 1e-9 <= tlx_weighted(ratings, chosen) <= max(ratings.values()) + 1e-9


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_language_asks_the_same(language: str) -> None:
    def keys(node: object, path: str = "") -> set[str]:
        if isinstance(node, dict):
            return {one for name, inner in node.items() for one in keys(inner, f"{path}.{name}")}
        if isinstance(node, list):
            return {f"{path}[{len(node)}]"}
        assert isinstance(node, str)
        assert node.strip()
        return {path}

    assert keys(wording(language)) == keys(wording("en"))  # type: ignore[arg-type]  # parametrized
    assert len(wording(language)["sus"]["items"]) == 10  # type: ignore[arg-type]  # parametrized
    assert set(wording(language)["tlx"]["scales"]) == set(TLX_SCALES)  # type: ignore[arg-type]  # parametrized


def test_every_text_of_consent_has_a_version_of_its_own() -> None:
    assert len({consent_version(language) for language in LANGUAGES}) == len(LANGUAGES)
