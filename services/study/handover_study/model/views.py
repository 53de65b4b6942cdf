"""The responses of the REST interface of studies. The page's TypeScript types are generated from them."""

from typing import Any, Literal, NotRequired

from typing_extensions import TypedDict

from handover_study.model.protocol import Condition, Language


class SessionView(TypedDict):
    """A session without its answers; `pairs` are the scales to weight, in the order of this session."""

    id: str
    study: str
    pseudonym: str
    language: Language
    glove: str | None
    person: str | None
    step: str
    stepNumber: int
    steps: int
    first: Condition | None
    condition: Condition | None
    pairs: list[tuple[str, str]] | None
    consentVersion: str
    beganAt: str
    endedAt: str | None


class SessionWithAnswers(SessionView):
    """A session with its answers by step."""

    answers: dict[str, dict[str, Any]]


class DeclinedSession(TypedDict):
    """A session that was deleted because the participant declined."""

    id: str
    step: Literal["declined"]


class ConsentWording(TypedDict):
    """The texts of the consent."""

    title: str
    text: list[str]
    agree: str
    decline: str


class StepWording(TypedDict):
    """The texts of a step."""

    title: str
    text: str


class StepsWording(TypedDict):
    """The texts of the steps without a questionnaire."""

    introduction: StepWording
    sample: StepWording
    interaction: dict[Condition, StepWording]
    preference: StepWording


class PreferenceWording(TypedDict):
    """The texts of the question for the preferred gestures."""

    personal: str
    predefined: str
    none: str
    recalibrated: str
    comment: str


class IntroductionWording(TypedDict):
    """The texts of the questions about the participant."""

    age: str
    experience: str
    low: str
    medium: str
    high: str


class SusWording(TypedDict):
    """The texts of SUS; `source` names the origin of the wording and whether it is validated."""

    title: str
    source: str
    ask: str
    disagree: str
    agree: str
    items: list[str]


class ScaleWording(TypedDict):
    """The texts of a scale of NASA-TLX."""

    title: str
    ask: str
    low: str
    high: str


class TlxWording(TypedDict):
    """The texts of NASA-TLX; `source` as in `SusWording`."""

    title: str
    source: str
    ask: str
    choose: str
    scales: dict[str, ScaleWording]


class WordingView(TypedDict):
    """The texts for participants, and the steps, scales and pairs of the questionnaires."""

    consent: ConsentWording
    steps: StepsWording
    preference: PreferenceWording
    introduction: IntroductionWording
    sus: SusWording
    tlx: TlxWording
    report: dict[str, str | list[str]]
    consentVersion: str
    order: list[str]
    scales: list[str]
    scaleStep: int
    pairs: list[tuple[str, str]]


class BoxView(TypedDict):
    """The values of a box plot; the whiskers end at `low` and `high`."""

    min: float
    q1: float
    median: float
    q3: float
    max: float
    low: float
    high: float
    outliers: list[float]


class SummaryView(TypedDict):
    """Number, mean, sample standard deviation and box plot of some values."""

    n: int
    mean: float | None
    sd: float | None
    box: BoxView | None


class StatisticalTest(TypedDict):
    """A statistical test; `why` is the reason if there is no result."""

    name: str
    why: NotRequired[str]
    p: NotRequired[float]
    u: NotRequired[float]
    t: NotRequired[float]
    w: NotRequired[float]
    n: NotRequired[int]
    df: NotRequired[int]
    average: NotRequired[float]
    interval: NotRequired[list[float]]
    effect: NotRequired[float]


class SusAnalysis(SummaryView):
    """The SUS scores, their grade, and the comparison with the average of 68."""

    grade: str | None
    scores: list[float]
    test: StatisticalTest
    normality: StatisticalTest


class TlxAnalysis(TypedDict):
    """A measure of NASA-TLX by condition."""

    personal: SummaryView
    predefined: SummaryView
    test: StatisticalTest
    paired: StatisticalTest


class PreferenceCounts(TypedDict):
    """The number of participants by preference."""

    personal: int
    predefined: int
    none: int


class AnalysisView(TypedDict):
    """The analysis of a study."""

    participants: int
    finished: int
    personalFirst: int
    predefinedFirst: int
    age_years: SummaryView
    preference: PreferenceCounts
    recalibrated: int
    sus: SusAnalysis
    tlx: dict[str, TlxAnalysis]
    confidence: float


class StudyAnalysis(AnalysisView):
    """The analysis with the name of the study."""

    study: str
