"""Accuracy tests as in REST responses. The page's TypeScript types are generated from them."""

from typing import Any

from typing_extensions import TypedDict

from handover_gloves.accuracy_tests.trials import Outcome, Phase


class TestSummary(TypedDict):
    """An accuracy test."""

    id: str
    glove: str
    person: str | None
    phase: Phase
    reason: str
    beganAt: str
    endedAt: str | None
    gestures: list[str]
    rounds: int
    trials: int
    seed: int


class TestState(TestSummary):
    """An accuracy test; `live` is its view while it runs."""

    live: dict[str, Any] | None


class Figures(TypedDict):
    """The results of some trials; `interval` is the 95 % interval of Wilson."""

    trials: int
    right: int
    corrected: int
    missed: int
    accuracy: float | None
    interval: tuple[float, float] | None
    medianMs: float | None
    p95Ms: float | None


class GestureFigures(Figures):
    """The results of a gesture."""

    gesture: str
    code: str


class RoundFigures(Figures):
    """The results of a round."""

    round: int


class ProblematicGesture(TypedDict):
    """A gesture with problematic interactions."""

    gesture: str
    interactions: int


class InteractionTable(TypedDict):
    """Table 3 of the paper."""

    problematic: list[ProblematicGesture]
    successfulInteractions: int
    problematicInteractions: int
    accuracy: float | None


class ConfusionMatrix(TypedDict):
    """Rows are the requested gestures, columns the first recognized ones."""

    asked: list[str]
    recognized: list[str]
    counts: list[list[int]]


class Results(TypedDict):
    """The results of a test."""

    table: InteractionTable
    overall: Figures
    gestures: list[GestureFigures]
    rounds: list[RoundFigures]
    confusion: ConfusionMatrix
    holdMs: float
    limitMs: float


class TestReport(Results):
    """A test with its results."""

    test: TestState


class TryView(TypedDict):
    """A shape that was held in a trial."""

    gesture: str | None
    states: str
    atMs: float


class TrialView(TypedDict):
    """A trial."""

    round: int
    trial: int
    asked: str
    first: str
    outcome: Outcome
    recognizedMs: float | None
    tries: list[TryView]
    repeats: int
    endedAt: str
