"""The protocol: which steps a participant goes through, and what each answer must hold.

Consent comes first, and nothing is kept of who declines. Then introduction, sample task and SUS, as in
Machines 2022, 10, 957, figure 11; two interactions, one with personal and one with predefined gestures, each
followed by NASA-TLX; and which of the two was preferred.
"""

import random
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from handover.errors import Problem
from handover.formats.strict_json import RequestBody
from handover.formats.validation import fault_lines
from handover_study.model.questionnaires import SUS_ITEMS, TLX_PAIRS, TLX_SCALES, TLX_STEP

Language = Literal["en", "de", "fi"]
LANGUAGES: tuple[Language, ...] = ("en", "de", "fi")


class Condition(StrEnum):
    """Whose gestures are used."""

    PERSONAL = "personal"
    PREDEFINED = "predefined"

    @property
    def other(self) -> "Condition":
        """Return the other one."""
        return Condition.PREDEFINED if self is Condition.PERSONAL else Condition.PERSONAL


STEPS = (
    "consent", "introduction", "sample", "sus", "interaction1", "tlx1", "interaction2", "tlx2", "preference",
)  # fmt: skip
FINISHED = "finished"


class Consent(RequestBody):
    """Whether the participant agrees; `text` is the version of the text that was shown."""

    agreed: bool
    text: Annotated[str, Field(min_length=1, max_length=40)]


class Introduction(RequestBody):
    """Data about the participant; all of it is optional."""

    age_years: Annotated[int, Field(ge=16, le=120)] | None = None
    experience: Literal["low", "medium", "high"] | None = None


class Done(RequestBody):
    """A task is done, or was given up."""

    completed: bool = True
    notes: Annotated[str, Field(max_length=2000)] = ""


class Sus(RequestBody):
    """Ten answers from 1 (strongly disagree) to 5 (strongly agree), in the order of the statements."""

    answers: Annotated[
        list[Annotated[int, Field(ge=1, le=5)]], Field(min_length=SUS_ITEMS, max_length=SUS_ITEMS)
    ]


class Choice(RequestBody):
    """Which of two scales contributed more to the workload."""

    of: Annotated[list[str], Field(min_length=2, max_length=2)]
    chosen: str


class Tlx(RequestBody):
    """Six ratings from 0 to 100 in steps of 5, and a choice for each of the 15 pairs of scales."""

    ratings: dict[str, Annotated[int, Field(ge=0, le=100, multiple_of=TLX_STEP)]]
    choices: list[Choice]

    @model_validator(mode="after")
    def _complete(self) -> Self:
        missing = [scale for scale in TLX_SCALES if scale not in self.ratings]
        unknown = [scale for scale in self.ratings if scale not in TLX_SCALES]
        if missing or unknown:
            raise ValueError(
                f"rate {', '.join(TLX_SCALES)} once each"
                + (f"; missing: {', '.join(missing)}" if missing else "")
                + (f"; unknown: {', '.join(unknown)}" if unknown else "")
            )
        pairs = [tuple(sorted(choice.of)) for choice in self.choices]
        wanted = sorted(tuple(sorted(pair)) for pair in TLX_PAIRS)
        if sorted(pairs) != wanted:
            lacking = sorted(set(wanted) - set(pairs))
            what = f"; missing: {' or '.join(lacking[0])}" if lacking else ""
            raise ValueError(f"choose one of each of the {len(TLX_PAIRS)} pairs of scales, once{what}")
        for choice in self.choices:
            if choice.chosen not in choice.of:
                raise ValueError(f'"{choice.chosen}" is none of the pair {" or ".join(choice.of)}')
        return self


class Preference(RequestBody):
    """Which interaction was preferred, and whether the glove had to be calibrated again."""

    preferred: Literal["personal", "predefined", "none"]
    recalibrated: bool = False
    comment: Annotated[str, Field(max_length=4000)] = ""


ANSWERS: Mapping[str, type[RequestBody]] = {
    "consent": Consent,
    "introduction": Introduction,
    "sample": Done,
    "sus": Sus,
    "interaction1": Done,
    "tlx1": Tlx,
    "interaction2": Done,
    "tlx2": Tlx,
    "preference": Preference,
}


@dataclass(frozen=True, slots=True)
class StepAnswer:
    """What was answered in a step; `opened_at` is when the step before was over, both ISO 8601 in UTC."""

    content: Mapping[str, Any]
    language: Language
    opened_at: str
    answered_at: str


@dataclass(frozen=True, slots=True)
class Session:
    """One participant's way through the study; `first` is drawn when consent is given."""

    id: str
    study: str
    pseudonym: str
    language: Language
    began_at: str
    glove: str | None = None
    person: str | None = None
    first: Condition | None = None
    step: str = STEPS[0]
    ended_at: str | None = None
    answers: Mapping[str, StepAnswer] = field(default_factory=dict)

    @property
    def condition(self) -> Condition | None:
        """Return whose gestures are used in the present step; None where that is not set."""
        return self.condition_of(self.step)

    def condition_of(self, step: str) -> Condition | None:
        """Return whose gestures `step` is about."""
        if self.first is None or step[-1] not in "12":
            return None
        return self.first if step.endswith("1") else self.first.other

    @property
    def last_at(self) -> str:
        """Return when the present step began."""
        return max((answer.answered_at for answer in self.answers.values()), default=self.began_at)

    def pairs(self) -> list[tuple[str, str]]:
        """Return the 15 pairs of scales, order and sides drawn by lot for this session and step."""
        lot = random.Random(f"{self.id} {self.step}")  # noqa: S311 - to be fair, not secret
        pairs = [pair if lot.random() < 0.5 else (pair[1], pair[0]) for pair in TLX_PAIRS]
        return lot.sample(pairs, len(pairs))


def checked(step: str, content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the answer `given` to `step` as it is kept; raises `Problem` 404 or 422 with what to change."""
    if step not in ANSWERS:
        raise Problem(404, "Unknown step", f'there is no step "{step}"; the steps are {", ".join(STEPS)}')
    try:
        return ANSWERS[step].model_validate(content).model_dump()
    except ValidationError as error:
        raise Problem(422, "Incomplete answer", "; ".join(fault_lines(error, step))) from None


def next_step(step: str) -> str:
    """Return what follows `step`."""
    following = STEPS.index(step) + 1
    return STEPS[following] if following < len(STEPS) else FINISHED


def balanced(personal_first: int, predefined_first: int, lot: float) -> Condition:
    """Return what the next participant begins with: the rarer order; `lot` in [0, 1) breaks ties."""
    if personal_first != predefined_first:
        return Condition.PERSONAL if personal_first < predefined_first else Condition.PREDEFINED
    return Condition.PERSONAL if lot < 0.5 else Condition.PREDEFINED
