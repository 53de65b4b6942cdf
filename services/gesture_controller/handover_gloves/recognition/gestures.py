"""Gestures: hand shapes with names, and their commands.

The code of a gesture is the states of five fingers, thumb first: 0 straight, 2 bent. A composite gesture has
two parts with codes: one for each hand, or one after the other. The 21 built-in gestures are those of M2O2P
(Machines 2022, 10, 957, Table 1, with its three misprinted rows corrected).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any, Literal

from handover.messages import message
from handover_datamodels.states import Outcome
from handover_gloves.recognition.finger_states import BENT, STRAIGHT
from handover_gloves.recognition.gesture_views import CompositeGestureView, PartView, PlainGestureView
from handover_gloves.recognition.thresholds import FINGERS

M2O2P_GESTURES: Mapping[str, str] = {
    "Horns": "20220",
    "Index and middle straight": "20022",
    "Index and ring straight": "20202",
    "Index, middle and little straight": "20020",
    "Index, middle and ring straight": "20002",
    "Index, ring and little straight": "20200",
    "Middle and little straight": "22020",
    "Middle and ring straight": "22002",
    "Middle straight": "22022",
    "Middle, ring and little straight": "22000",
    "Little straight": "22220",
    "Point with index": "20222",
    "Ring and little straight": "22200",
    "Ring straight": "22202",
    "Thumb and index straight": "00222",
    "Thumb and little straight": "02220",
    "Thumb, index and middle straight": "00022",
    "Thumb, index and little straight": "00220",
    "Thumb, index, middle and little straight": "00020",
    "Thumb, middle and little straight": "02020",
    "Thumbs up": "02222",
}

DEFAULT_COMMANDS: Mapping[int, str] = {
    1: "Point with index",
    2: "Index and middle straight",
    3: "Thumbs up",
    4: "Thumb and index straight",
    5: "Thumb and little straight",
    6: "Middle, ring and little straight",
    7: "Little straight",
    8: "Horns",
    9: "Thumb, index and middle straight",
    10: "Index, middle and ring straight",
    11: "Thumb, index and little straight",
    12: "Ring and little straight",
    13: "Middle straight",
    14: "Index, middle and little straight",
    15: "Middle and ring straight",
    16: "Ring straight",
    17: "Index and ring straight",
    18: "Index, ring and little straight",
    19: "Middle and little straight",
    20: "Thumb, index, middle and little straight",
    21: "Thumb, middle and little straight",
}


RESTING = {"00000": "the open hand", "22222": "the fist"}
"""Shapes in which a hand rests or carries; people make them unintentionally."""


class WrongGesture(ValueError):
    """A gesture is invalid; the message names it, the rule and the remedy."""


@dataclass(frozen=True, slots=True)
class Shape:
    """The definition of a gesture: a `code`, or a part for each hand, or two parts in `sequence`.

    A part is a code or the name of a gesture that has one.
    """

    code: str | None = None
    left: str | None = None
    right: str | None = None
    sequence: tuple[str, str] | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return it as in files and REST responses."""
        if self.sequence is not None:
            return {"sequence": list(self.sequence)}
        return {"code": self.code} if self.code is not None else {"left": self.left, "right": self.right}


@dataclass(frozen=True, slots=True)
class TwoHandGesture:
    """A gesture of both hands: the name of the gesture of each."""

    left: str
    right: str

    def names(self) -> tuple[str, str]:
        """Return the names of both parts."""
        return (self.left, self.right)


@dataclass(frozen=True, slots=True)
class SequenceGesture:
    """Two gestures of one hand: the names of the first and the second."""

    first: str
    second: str

    def names(self) -> tuple[str, str]:
        """Return the names of both parts."""
        return (self.first, self.second)


CompositeGesture = TwoHandGesture | SequenceGesture


@dataclass(frozen=True, slots=True)
class Part:
    """The gesture of one hand at one moment; `hand` is None if either hand may show it."""

    gesture: str
    code: str
    hand: Literal["left", "right"] | None = None


@dataclass(frozen=True)
class Gestures:
    """The known gestures: unique names and codes, and composite gestures of two of them."""

    codes: Mapping[str, str]
    composites: Mapping[str, CompositeGesture] = field(default_factory=dict)
    names: Mapping[str, str] = field(init=False)
    """Names by code."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", {code: name for name, code in self.codes.items()})

    def __iter__(self) -> Iterator[tuple[str, str]]:
        """Yield name and code of each single gesture."""
        return iter(self.codes.items())

    def find(self, name: str) -> str | None:
        """Return the known name that equals `name` without regard to case; None if there is none."""
        if name in self.codes or name in self.composites:
            return name
        searched = name.strip().casefold()
        return next((candidate for candidate in self._all() if candidate.casefold() == searched), None)

    def like(self, name: str) -> str:
        """Return a suggestion for the unknown gesture `name`, as half a sentence."""
        close = get_close_matches(name, self._all(), n=1)
        if close:
            return message("gesture.did_you_mean", 'did you mean "{gesture}"', gesture=close[0])
        return message("gesture.known", "the gestures are {known}", known=", ".join(self._all()))

    def parts_of(self, name: str) -> tuple[Part, ...]:
        """Return the parts of the gesture called `name`: itself, or two parts (left hand first)."""
        composed = self.composites.get(name)
        if composed is None:
            return (Part(name, self.codes[name]),)
        if isinstance(composed, SequenceGesture):
            return tuple(Part(part, self.codes[part]) for part in (composed.first, composed.second))
        return (
            Part(composed.left, self.codes[composed.left], "left"),
            Part(composed.right, self.codes[composed.right], "right"),
        )

    def with_shapes(self, shapes: Mapping[str, Shape]) -> "Gestures":
        """Return these gestures and those of `shapes`; raise `WrongGesture` for an invalid one.

        A part that is a code without a name gets a name that lists its straight fingers.
        """
        codes, composed = dict(self.codes), dict(self.composites)
        names = {code: name for name, code in codes.items()}
        for name, shape in shapes.items():
            if self.find(name) is not None:
                raise WrongGesture(
                    message(
                        "gesture.name_taken",
                        'there is a gesture "{name}" already; call one of them otherwise',
                        name=name,
                    )
                )
            if shape.code is not None:
                code = checked_code(name, shape.code)
                if code in names:
                    raise WrongGesture(
                        message(
                            "gesture.code_taken",
                            'gesture "{name}" has the code {code}, which "{other}" already has; give one of '
                            "them another code",
                            name=name,
                            code=code,
                            other=names[code],
                        )
                    )
                codes[name], names[code] = code, name
        for name, shape in shapes.items():
            if shape.code is None:
                gesture = _composed(name, shape, codes, names, composed)
                twin = next((other for other, composite in composed.items() if composite == gesture), None)
                if twin is not None:
                    raise WrongGesture(
                        message(
                            "gesture.same_parts",
                            'gesture "{name}" is made like "{twin}"; change one of them',
                            name=name,
                            twin=twin,
                        )
                    )
                composed[name] = gesture
        return Gestures(codes, composed)

    def with_parts(self, parts: Sequence[Part]) -> "Gestures":
        """Return these gestures with `parts`, which replace gestures of the same name or code."""
        names = {part.gesture for part in parts}
        codes = {part.code for part in parts}
        left = {name: code for name, code in self.codes.items() if name not in names and code not in codes}
        plain = {**left, **{part.gesture: part.code for part in parts}}
        whole = {
            name: composite
            for name, composite in self.composites.items()
            if all(part in plain for part in composite.names())
        }
        return Gestures(plain, whole)

    def _all(self) -> list[str]:
        return [*self.codes, *self.composites]


def is_code(text: str) -> bool:
    """Return True if `text` is five states, thumb first, each 0 (straight) or 2 (bent)."""
    return len(text) == len(FINGERS) and set(text) <= {STRAIGHT, BENT}


def checked_code(name: str, code: str) -> str:
    """Return `code`; raise `WrongGesture` if it is no code for the gesture called `name`."""
    if not is_code(code):
        raise WrongGesture(
            message(
                "gesture.invalid_code",
                'gesture "{name}" has the code "{code}"; a code is five states, thumb first, '
                "each {straight} (straight) or {bent} (bent), such as 02222",
                name=name,
                code=code,
                straight=STRAIGHT,
                bent=BENT,
            )
        )
    return code


def described(code: str) -> str:
    """Return a name for a code that has none, such as "Thumb and index straight"."""
    straight = [finger for finger, state in zip(FINGERS, code, strict=True) if state == STRAIGHT]
    if not straight:
        return "Fist"
    if len(straight) == len(FINGERS):
        return "Open hand"
    words = f"{', '.join(straight[:-1])} and {straight[-1]}" if straight[1:] else straight[0]
    return f"{words[0].upper()}{words[1:]} straight"


def _composed(
    name: str,
    shape: Shape,
    codes: dict[str, str],
    names: dict[str, str],
    composed: Mapping[str, CompositeGesture],
) -> CompositeGesture:
    def part(written: str) -> str:
        if is_code(written):
            if written not in names:
                codes[described(written)], names[written] = written, described(written)
            return names[written]
        gesture = Gestures(codes).find(written)
        if gesture is None:
            hint = (
                f'"{written}" itself is composed; a part is a gesture of one hand'
                if written in composed
                else Gestures(codes).like(written)
            )
            raise WrongGesture(
                message(
                    "gesture.unknown_part",
                    'gesture "{name}" has the unknown part "{given}"; {hint}',
                    name=name,
                    given=written,
                    hint=hint,
                )
            )
        return gesture

    if shape.sequence is not None:
        return SequenceGesture(*(part(gesture) for gesture in shape.sequence))
    if shape.left is None or shape.right is None:
        raise WrongGesture(
            message(
                "gesture.one_hand",
                'gesture "{name}" names one hand; give a part for left and one for right',
                name=name,
            )
        )
    return TwoHandGesture(part(shape.left), part(shape.right))


@dataclass(frozen=True)
class Commands:
    """The gesture of each command; a gesture has at most one command."""

    gestures: Mapping[int, str]
    ids: Mapping[str, int] = field(init=False)
    """Command ids by gesture."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "ids", {gesture: command for command, gesture in self.gestures.items()})

    def with_own(self, own: Mapping[int, str]) -> "Commands":
        """Return these commands with the `own` gestures of a person."""
        return Commands({**self.gestures, **own})


Answers = Mapping[Outcome, str]
"""The gesture of an answer other than `ok`, where the site configures one."""


def answer_parts(answers: Answers, gestures: Gestures, prompted: Sequence[Part] = ()) -> dict[Outcome, Part]:
    """Return the answers that a person can give by gesture to a Task that prompts for `prompted`.

    An answer is left out if its gesture is prompted for, which means `ok`, or if an own gesture of the person
    has its name or code.
    """
    prompted_codes = {part.code for part in prompted}
    return {
        outcome: Part(gesture, gestures.codes[gesture])
        for outcome, gesture in answers.items()
        if gesture in gestures.codes and gestures.codes[gesture] not in prompted_codes
    }


def default_commands(gestures: Gestures) -> Commands:
    """Return the default commands whose gestures are in `gestures`."""
    return Commands({command: name for command, name in DEFAULT_COMMANDS.items() if gestures.find(name)})


def codes_in_use(gestures: Gestures, commands: Commands, prompted: Sequence[Part] = ()) -> frozenset[str]:
    """Return the codes of all parts of `commands` and of `prompted`."""
    commanded = (
        part.code
        for name in commands.ids
        if name in gestures.codes or name in gestures.composites
        for part in gestures.parts_of(name)
    )
    return frozenset({*commanded, *(part.code for part in prompted)})


def listed(gestures: Gestures, commands: Commands) -> list[PlainGestureView | CompositeGestureView]:
    """Return the gestures as in REST responses: name, code or parts, and command."""
    plain: list[PlainGestureView | CompositeGestureView] = [
        {"name": name, "code": code, "commandId": commands.ids.get(name)} for name, code in gestures
    ]
    return plain + [_composite_view(name, gestures, commands) for name in gestures.composites]


def _composite_view(name: str, gestures: Gestures, commands: Commands) -> CompositeGestureView:
    first, second = (PartView(gesture=part.gesture, code=part.code) for part in gestures.parts_of(name))
    command = commands.ids.get(name)
    if isinstance(gestures.composites[name], SequenceGesture):
        return {"name": name, "sequence": [first, second], "commandId": command}
    return {"name": name, "left": first, "right": second, "commandId": command}
