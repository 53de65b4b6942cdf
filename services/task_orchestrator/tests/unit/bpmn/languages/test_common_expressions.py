"""The expressions that all languages share have the same value in each of them."""

from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_bpmn.languages.base import ExpressionError, quote_names
from handover_bpmn.languages.feel import read_feel
from handover_bpmn.languages.juel import read_juel
from handover_bpmn.languages.native import read

VARIABLES = {"a": 3, "b": -2, "c": 0.5, "s": "gear", "t": "shaft", "yes": True, "no": False}


@dataclass(frozen=True)
class Written:
    """One expression in the three languages."""

    native: str
    juel: str
    feel: str


def _same(text: str) -> Written:
    return Written(text, text, text)


NUMBERS = st.recursive(
    st.sampled_from(["a", "b", "c", "1", "7", "2.5", "0"]).map(_same),
    lambda parts: (
        st.builds(
            lambda left, sign, right: Written(
                *(f"({x} {sign} {y})" for x, y in zip(_texts(left), _texts(right), strict=True))
            ),
            parts,
            st.sampled_from(["+", "-", "*", "/"]),
            parts,
        )
        | parts.map(lambda part: Written(*(f"(-{text})" for text in _texts(part))))
    ),
    max_leaves=8,
)
TEXTS = st.sampled_from([_same("s"), _same("t"), Written("'gear'", "'gear'", '"gear"')])
SIGNS = {"==": "=", "!=": "!=", "<": "<", "<=": "<=", ">": ">", ">=": ">="}


def _texts(written: Written) -> tuple[str, str, str]:
    return written.native, written.juel, written.feel


def _compared(left: Written, sign: str, right: Written) -> Written:
    return Written(
        f"({left.native} {sign} {right.native})",
        f"({left.juel} {sign} {right.juel})",
        f"({left.feel} {SIGNS[sign]} {right.feel})",
    )


def _joined(left: Written, word: str, right: Written) -> Written:
    sign = {"and": "&&", "or": "||"}[word]
    return Written(
        f"({left.native} {word} {right.native})",
        f"({left.juel} {sign} {right.juel})",
        f"({left.feel} {word} {right.feel})",
    )


CONDITIONS = st.recursive(
    st.sampled_from(["yes", "no", "true", "false"]).map(_same)
    | st.builds(_compared, NUMBERS, st.sampled_from(list(SIGNS)), NUMBERS)
    | st.builds(_compared, TEXTS, st.sampled_from(list(SIGNS)), TEXTS),
    lambda parts: (
        st.builds(_joined, parts, st.sampled_from(["and", "or"]), parts)
        | parts.map(lambda part: Written(f"(not {part.native})", f"(!{part.juel})", f"not({part.feel})"))
    ),
    max_leaves=6,
)
CHOICES = st.builds(
    lambda condition, yes, no: Written(
        f"{yes.native} if {condition.native} else {no.native}",
        f"{condition.juel} ? {yes.juel} : {no.juel}",
        f"if {condition.feel} then {yes.feel} else {no.feel}",
    ),
    CONDITIONS,
    NUMBERS,
    NUMBERS,
)


@settings(max_examples=4 * settings.default.max_examples)
@given(NUMBERS | CONDITIONS | CHOICES)
def test_the_languages_agree_on_arithmetic_comparisons_and_conditions(written: Written) -> None:
    try:
        values = [
            read(written.native).value(VARIABLES),
            read_juel("${" + written.juel + "}").value(VARIABLES),
        ]
    except ExpressionError as error:
        # A division by zero is null in FEEL, and decides nothing that is compared with it.
        if "division by zero" in str(error):
            return
        raise
    values.append(read_feel("=" + written.feel).value(VARIABLES))
    assert values[0] == values[1] == values[2]
    assert len({isinstance(value, bool) for value in values}) == 1


class Failing(dict[str, object]):
    """Variables of which each read fails as a defect of a function or operator would."""

    def __init__(self, error: Exception) -> None:
        super().__init__(a=1)
        self.error = error

    def __getitem__(self, name: str) -> object:
        raise self.error


ERRORS = [ValueError("empty"), TypeError("naive"), UnicodeError("half"), RecursionError(), AssertionError()]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_whatever_python_raises_is_an_error_of_the_expression(error: Exception) -> None:
    for expression in (read("a + 1"), read_juel("${a + 1}"), read_feel("a + 1")):
        with pytest.raises(ExpressionError, match=r"`.*a \+ 1.*`: "):
            expression.value(Failing(error))


def test_an_error_lists_few_names_and_the_nearest_first() -> None:
    names = [f"process-{number:03}" for number in range(300)] + ["weld-frame"]
    listed = quote_names(names, near="weld-frames")
    assert listed.startswith("weld-frame, process-000, ")
    assert listed.endswith(" and 296 more")
    assert quote_names(names).endswith(" and 281 more")
    variables: dict[str, object] = dict.fromkeys(names, 1)
    with pytest.raises(ExpressionError) as refusal:
        read("missing").value(variables)
    assert len(str(refusal.value)) < 400
