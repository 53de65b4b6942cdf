"""People as in REST responses. The page's TypeScript types are generated from them."""

from typing import Literal, NotRequired

from typing_extensions import TypedDict

from handover_gloves.recognition.gesture_views import CompositeGestureView, PlainGestureView

Side = Literal["left", "right"]
Finger = Literal["thumb", "index", "middle", "ring", "little"]


class WornGlove(TypedDict):
    """A glove that a person wears."""

    glove: str
    hand: Side
    connected: bool


class FitView(TypedDict):
    """What is adapted to a person for one glove."""

    thresholds: dict[Finger, dict[Literal["upper", "lower", "inverted"], float]] | None
    recognizer: str | None
    changedAt: str | None


class SampleView(TypedDict):
    """The recording of an own gesture."""

    glove: str
    levels: list[float]
    noise: list[float]


class OwnGestureView(TypedDict):
    """An own gesture: a code, or a part for each hand, or two parts in sequence."""

    code: NotRequired[str]
    left: NotRequired[str | None]
    right: NotRequired[str | None]
    sequence: NotRequired[list[str]]
    sample: NotRequired[SampleView]


class PersonView(TypedDict):
    """A person; `commands` has the gesture of each command, `ownCommands` those that differ from the site.

    A null in `ownCommands` means that the person has no gesture for the command. `faults` are own gestures
    and commands that the gestures of the site no longer allow.
    """

    name: str
    title: str | None
    gloves: list[WornGlove]
    fits: dict[str, FitView]
    commands: dict[str, str]
    ownCommands: dict[str, str | None]
    ownGestures: dict[str, OwnGestureView]
    faults: list[str]


class PersonWithGestures(PersonView):
    """A person with all gestures that they can use."""

    gestures: list[PlainGestureView | CompositeGestureView]


class PersonWithFreedCommands(PersonView):
    """A person whose own gesture was deleted; `givenAsBefore` are the commands that it was used for."""

    givenAsBefore: list[int]


class NeighbourView(TypedDict):
    """The nearest other gesture; `timesNoise` is the distance in standard deviations of the recording."""

    gesture: str
    code: str
    distance: float
    fingers: list[Finger]
    timesNoise: float | None


class DefinedGesture(OwnGestureView):
    """An own gesture that was defined."""

    person: str
    name: str
    nearest: NeighbourView | None


class WearerView(TypedDict):
    """The wearer of a glove."""

    glove: str
    hand: Side
    person: str | None
