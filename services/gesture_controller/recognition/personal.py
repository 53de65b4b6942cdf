"""The personal recognizer: calibrated for a hand, it weighs every shape that fingers can make.

Each finger may be straight, bent or half bent; where it then stands is known from the person's fist, open
hand and samples, and for the rest from people at large. What speaks for each of the 243 shapes is weighed
by Bayes' rule over time: hands keep a shape for a while, and half-bent fingers make no gesture.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from services.gesture_controller.calibration.levels import Calibration
from services.gesture_controller.finger_states import BENT, BETWEEN, STRAIGHT
from services.gesture_controller.frames import Frame
from services.gesture_controller.gestures import Gestures
from services.gesture_controller.recognition.population import (
    HIGHEST,
    HOLDING,
    LOWEST,
    USUAL,
    Population,
    Stand,
    kind_of,
)
from services.gesture_controller.recognition.recognizer import CannotRecognize, Given, Recognition
from services.gesture_controller.thresholds import FINGERS

Numbers = NDArray[np.float64]

LOOK_S = 0.25
"""What a finger shows hardly changes within this time: so long a look counts as one piece of evidence."""

KEPT_S = 1.0
"""How long a hand keeps a shape at least, as a rule: the chance to change is one in this time."""

GAP_S = 0.25
"""After longer without a frame, nobody knows what the hand did: it is looked at anew."""

SURE = 0.5
"""A gesture that is less probable than this is not answered."""

UNUSED = 0.2
"""How much rarer a shape is that stands for nothing, than one that this person uses."""

HALF, HALF_THUMB = 0.5, 0.125
"""How much rarer still a shape is for each finger that is half bent."""

AT_REST = frozenset({STRAIGHT * len(FINGERS), BENT * len(FINGERS)})
"""The open hand and the closed one are as frequent as any gesture, though they may stand for nothing."""

RAW_UNREST = (14.0, 10.0, 10.0, 10.0, 10.0)
"""How far a flex sensor wanders and drifts within a pose, in raw units; it weighs more in a small span."""

AT_WORK = 1.0
"""How frequent each way to hold something is, beside a gesture that this person uses."""

SAMPLE_SPREAD = 0.06
"""How far, as a share of the span, a finger will stand from where it stood in a sample of the gesture."""

SAMPLE_TAILS, TAILS = 6.0, 4.0
"""Degrees of freedom of Student's t, for samples and for the population: hands surprise."""

NEAR = 2.5
OVERRULED = 3.0
"""A shape of hands at large that is within `NEAR` deviations of a sample of another loses so much (in nats):
this person has shown that they mean the other by it."""


@dataclass(frozen=True, slots=True)
class _Looking:
    """How probable each shape is by now, and the shares that were measured last."""

    odds: Numbers
    shares: Numbers


@dataclass(frozen=True, slots=True, eq=False)
class _Shapes:
    """All shapes and samples, one a row; `terms` are the few different ways in which a finger may stand."""

    codes: tuple[str, ...]
    """The codes that are told apart."""
    row_code: NDArray[np.intp]
    row_terms: NDArray[np.intp]
    """Fingers by rows: which of the terms it is."""
    row_weight: Numbers
    finger: NDArray[np.intp]
    share: Numbers
    narrowness: Numbers
    """One over the deviation and over the root of the degrees of freedom."""
    steepness: Numbers
    height: Numbers


class PersonalRecognizer:
    """Reads the hand of one person."""

    def __init__(
        self,
        calibration: Calibration,
        gestures: Gestures,
        in_use: frozenset[str] = frozenset(),
        population: Population = USUAL,
    ) -> None:
        self._gestures = gestures
        self._fist = np.array([level.fist for level in calibration.levels])
        self._span = np.array([level.span for level in calibration.levels])
        self._shapes = _shapes_of(calibration, in_use or frozenset(gestures.names), population)

    @classmethod
    def made_from(cls, given: Given) -> "PersonalRecognizer":
        """Return the recognizer for the hand that `given` tells of; raise `CannotRecognize`."""
        if given.calibration is None:
            raise CannotRecognize(
                "the personal recognizer knows a hand by its fist and open hand; calibrate the glove first"
            )
        return cls(given.calibration, given.gestures, given.in_use)

    def see(self, before: Recognition | None, frame: Frame) -> Recognition:
        """Return what `frame` shows."""
        shapes = self._shapes
        shares = (np.array(frame.bend, float) - self._fist) / self._span
        evidence = self._evidence(shares)
        passed_s = -1.0 if before is None else frame.t_s - before.at_s
        if before is not None and 0 <= passed_s <= GAP_S:
            changed = passed_s / (KEPT_S + passed_s)
            evidence *= min(passed_s / LOOK_S, 1.0)
            expected = before.memory.odds * (1 - changed)
            expected += changed / len(expected)
        else:
            expected = np.ones(len(evidence))
        evidence -= evidence.max()
        odds = np.exp(evidence, out=evidence)
        odds *= expected
        odds /= odds.sum()
        by_code = np.bincount(shapes.row_code, odds, len(shapes.codes))
        best = int(by_code.argmax())
        states, certainty = shapes.codes[best], float(by_code[best])
        gesture = self._gestures.names.get(states) if certainty >= SURE else None
        return Recognition(states, gesture, certainty, frame.t_s, _Looking(odds, shares))

    def odds(self, seen: Recognition) -> Mapping[str, float]:
        """Return the probability of each gesture; what is missing to 1 is that there is none."""
        by_code = dict(zip(self._shapes.codes, self._by_code(seen), strict=True))
        return {name: round(float(by_code[code]), 4) for name, code in self._gestures}

    def why(self, seen: Recognition) -> str:
        """Return where each finger stands, what that is taken for, and what else it might be."""
        stands = ", ".join(
            f"{finger} {share:.0%} {_WORDS[state]}"
            for finger, share, state in zip(FINGERS, seen.memory.shares, seen.states, strict=True)
        )
        if seen.gesture is not None:
            return f"{stands}: {seen.gesture}, {seen.certainty:.0%} probable"
        if seen.certainty < SURE:
            return f"{stands}: in doubt, at most {seen.certainty:.0%} probable"
        reason = "a finger is half bent" if BETWEEN in seen.states else "no gesture has these states"
        return f"{stands}: {reason}"

    def _by_code(self, seen: Recognition) -> Numbers:
        return np.bincount(self._shapes.row_code, seen.memory.odds, len(self._shapes.codes)).astype(float)

    def _evidence(self, shares: Numbers) -> Numbers:
        shapes = self._shapes
        away = np.minimum(np.maximum(shares, LOWEST), HIGHEST).take(shapes.finger)
        away -= shapes.share
        away *= shapes.narrowness
        away *= away
        terms = shapes.height - shapes.steepness * np.log1p(away, out=away)
        weighed: Numbers = shapes.row_weight.copy()
        for fingers in shapes.row_terms:
            weighed += terms.take(fingers)
        return weighed


_WORDS = {STRAIGHT: "straight", BETWEEN: "half bent", BENT: "bent"}
_CODES = tuple("".join(states) for states in product(STRAIGHT + BETWEEN + BENT, repeat=len(FINGERS)))
_NORMAL = 1e6
"""Student's t with so many degrees of freedom is the normal distribution: a half-bent finger is near half."""

Term = tuple[int, float, float, float]
"""A way in which a finger may stand: its place, the share, the standard deviation, degrees of freedom."""


@dataclass(frozen=True, slots=True)
class _Row:
    code: str
    weight: float
    terms: tuple[Term, ...]


def _shapes_of(calibration: Calibration, in_use: frozenset[str], population: Population) -> _Shapes:
    unrest = _unrest(calibration)
    shown = list(_samples(calibration))
    rows = [*_hands_at_large(population, unrest, in_use, shown), *_hands_at_work(unrest), *shown]
    terms = list(dict.fromkeys(term for row in rows for term in row.terms))
    place = {term: number for number, term in enumerate(terms)}
    finger, share, scale, tails = (np.array(column) for column in zip(*terms, strict=True))
    codes = tuple(dict.fromkeys(row.code for row in rows))
    number = {code: place for place, code in enumerate(codes)}
    return _Shapes(
        codes,
        np.array([number[row.code] for row in rows]),
        np.array([[place[row.terms[finger]] for row in rows] for finger in range(len(FINGERS))]),
        np.array([row.weight for row in rows]),
        finger.astype(np.intp),
        share,
        1 / (scale * np.sqrt(tails)),
        (tails + 1) / 2,
        -np.log(scale),
    )


def _unrest(calibration: Calibration) -> list[float]:
    """Return how far each finger is to be expected from its place by its sensor alone, as a share."""
    return [
        float(np.hypot(raw, level.noise) / level.span)
        for raw, level in zip(RAW_UNREST, calibration.levels, strict=True)
    ]


def _samples(calibration: Calibration) -> Iterator[_Row]:
    for sample in calibration.samples:
        terms = (
            (
                place,
                float(np.clip(stand, LOWEST, HIGHEST)),
                float(np.hypot(np.hypot(SAMPLE_SPREAD, noise), RAW_UNREST[place] / 2 / level.span)),
                SAMPLE_TAILS,
            )
            for place, (stand, noise, level) in enumerate(
                zip(sample.shares, sample.noise, calibration.levels, strict=True)
            )
        )
        yield _Row(sample.code, 0.0, tuple(terms))


def _hands_at_large(
    population: Population, unrest: Sequence[float], in_use: frozenset[str], shown: Sequence[_Row]
) -> Iterator[_Row]:
    used = in_use | AT_REST | {row.code for row in shown}
    for code, stands in _stands(population):
        weight = 0.0 if code in used else float(np.log(UNUSED))
        weight += code[0].count(BETWEEN) * float(np.log(HALF_THUMB))
        weight += code[1:].count(BETWEEN) * float(np.log(HALF))
        terms = tuple(
            (place, stand.share, float(np.hypot(stand.spread, unrest[place])), _NORMAL if half else TAILS)
            for place, (stand, half) in enumerate(stands)
        )
        if BETWEEN not in code and any(row.code != code and _is_near(row, terms) for row in shown):
            weight -= OVERRULED
        yield _Row(code, weight, terms)


def _hands_at_work(unrest: Sequence[float]) -> Iterator[_Row]:
    for code, stands in HOLDING:
        terms = tuple(
            (place, stand.share, float(np.hypot(stand.spread, unrest[place])), _NORMAL)
            for place, stand in enumerate(stands)
        )
        yield _Row(code, float(np.log(AT_WORK)), terms)


def _stands(population: Population) -> Iterator[tuple[str, Sequence[tuple[Stand, bool]]]]:
    for code in _CODES:
        yield (
            code,
            [(population.kinds[kind_of(code, place)], state == BETWEEN) for place, state in enumerate(code)],
        )


def _is_near(sample: _Row, terms: Sequence[Term]) -> bool:
    return all(
        abs(shown[1] - usual[1]) < NEAR * usual[2] for shown, usual in zip(sample.terms, terms, strict=True)
    )
