"""The personal recognizer: calculates the probability of every hand shape for one calibrated hand.

Each finger may be straight, bent or half bent. Its expected position comes from the person's fist, open hand
and samples, and otherwise from the population. Bayes' rule over time gives the probability of each of the 243
shapes: hands keep a shape for a while, and half-bent fingers make no gesture.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from handover_gloves.recognition.finger_states import BENT, BETWEEN, STRAIGHT
from handover_gloves.recognition.frames import Frame
from handover_gloves.recognition.gestures import Gestures
from handover_gloves.recognition.levels import Calibration
from handover_gloves.recognition.population import (
    HOLDING,
    MAX_SHARE,
    MIN_SHARE,
    USUAL,
    Population,
    Stand,
    kind_of,
)
from handover_gloves.recognition.recognizer import CannotRecognize, HandContext, Recognition
from handover_gloves.recognition.thresholds import FINGERS

Numbers = NDArray[np.float64]

EVIDENCE_S = 0.25
"""Values within this time are correlated, so they count as one piece of evidence."""

SHAPE_DURATION_S = 1.0
"""The mean duration of a shape; the probability of a change is one in this time."""

GAP_S = 0.25
"""A longer gap between frames resets the probabilities."""

MIN_CERTAINTY = 0.5
"""A gesture with a lower probability is not reported."""

UNUSED = 0.2
"""The prior of a shape without meaning, relative to one that this person uses."""

HALF, HALF_THUMB = 0.5, 0.125
"""The factor of the prior for each half-bent finger."""

AT_REST = frozenset({STRAIGHT * len(FINGERS), BENT * len(FINGERS)})
"""The open hand and the fist are as frequent as gestures, though they may have no meaning."""

RAW_UNREST = (14.0, 10.0, 10.0, 10.0, 10.0)
"""The wander and drift of a flex sensor within a pose, in raw units; more relevant for small spans."""

AT_WORK = 1.0
"""The prior of each way to hold an object, relative to a gesture that this person uses."""

SAMPLE_SPREAD = 0.06
"""The standard deviation of a finger from its position in a sample, as a share of the span."""

SAMPLE_TAILS, TAILS = 6.0, 4.0
"""Degrees of freedom of Student's t for samples and for the population: outliers are frequent."""

NEAR = 2.5
OVERRULED = 3.0
"""The penalty in nats for a shape of the population within `NEAR` deviations of a sample of another gesture:
this person uses it for that gesture."""


@dataclass(frozen=True, slots=True)
class _Evidence:
    """The probability of each shape, and the shares measured last."""

    odds: Numbers
    shares: Numbers


@dataclass(frozen=True, slots=True, eq=False)
class _Shapes:
    """All shapes and samples, one in each row; `terms` are the distinct positions of fingers."""

    codes: tuple[str, ...]
    """The distinct codes."""
    row_code: NDArray[np.intp]
    row_terms: NDArray[np.intp]
    """The index of the term, by finger and row."""
    row_weight: Numbers
    finger: NDArray[np.intp]
    share: Numbers
    least: Numbers
    most: Numbers
    """Limits of the deviation: no finger is too bent to be bent, or too straight to be straight."""
    narrowness: Numbers
    """1 / (deviation · √degrees of freedom)."""
    steepness: Numbers
    height: Numbers


class PersonalRecognizer:
    """Recognizes the gestures of one person."""

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
    def from_context(cls, context: HandContext) -> "PersonalRecognizer":
        """Return the recognizer for the hand of `context`; raises `CannotRecognize`."""
        if context.calibration is None:
            raise CannotRecognize(
                "the personal recognizer needs the person's fist and open hand; calibrate the glove first"
            )
        return cls(context.calibration, context.gestures, context.in_use)

    def see(self, before: Recognition | None, frame: Frame) -> Recognition:
        """Return the result for `frame`."""
        shapes = self._shapes
        shares = (np.array(frame.bend, float) - self._fist) / self._span
        evidence = self._evidence(shares)
        passed_s = -1.0 if before is None else frame.t_s - before.at_s
        if before is not None and 0 <= passed_s <= GAP_S:
            changed = passed_s / (SHAPE_DURATION_S + passed_s)
            evidence *= min(passed_s / EVIDENCE_S, 1.0)
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
        gesture = self._gestures.names.get(states) if certainty >= MIN_CERTAINTY else None
        return Recognition(states, gesture, certainty, frame.t_s, _Evidence(odds, shares))

    def odds(self, seen: Recognition) -> Mapping[str, float]:
        """Return the probability of each gesture; the rest is the probability of no gesture."""
        by_code = dict(zip(self._shapes.codes, self._by_code(seen), strict=True))
        return {name: round(float(by_code[code]), 4) for name, code in self._gestures}

    def why(self, seen: Recognition) -> str:
        """Return the position and state of each finger, and the resulting gesture."""
        positions = ", ".join(
            f"{finger} {share:.0%} {_WORDS[state]}"
            for finger, share, state in zip(FINGERS, seen.memory.shares, seen.states, strict=True)
        )
        if seen.gesture is not None:
            return f"{positions}: {seen.gesture}, {seen.certainty:.0%} probable"
        if seen.certainty < MIN_CERTAINTY:
            return f"{positions}: in doubt, at most {seen.certainty:.0%} probable"
        reason = "a finger is half bent" if BETWEEN in seen.states else "no gesture has these states"
        return f"{positions}: {reason}"

    def _by_code(self, seen: Recognition) -> Numbers:
        return np.bincount(self._shapes.row_code, seen.memory.odds, len(self._shapes.codes)).astype(float)

    def _evidence(self, shares: Numbers) -> Numbers:
        shapes = self._shapes
        away = np.minimum(np.maximum(shares, MIN_SHARE), MAX_SHARE).take(shapes.finger)
        away -= shapes.share
        np.maximum(away, shapes.least, out=away)
        np.minimum(away, shapes.most, out=away)
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
"""Student's t with this many degrees of freedom is the normal distribution, used for half-bent fingers."""

Term = tuple[int, float, float, float, str]
"""A position of a finger: index, share, standard deviation, degrees of freedom and state. A bent finger may
be
more bent than that, and a straight one straighter."""


@dataclass(frozen=True, slots=True)
class _Row:
    code: str
    weight: float
    terms: tuple[Term, ...]


def _shapes_of(calibration: Calibration, in_use: frozenset[str], population: Population) -> _Shapes:
    unrest = _unrest(calibration)
    shown = list(_samples(calibration))
    rows = [*_population_rows(population, unrest, in_use, shown), *_holding_rows(unrest), *shown]
    terms = list(dict.fromkeys(term for row in rows for term in row.terms))
    place = {term: number for number, term in enumerate(terms)}
    finger, share, scale, tails, state = (np.array(column) for column in zip(*terms, strict=True))
    codes = tuple(dict.fromkeys(row.code for row in rows))
    number = {code: place for place, code in enumerate(codes)}
    return _Shapes(
        codes,
        np.array([number[row.code] for row in rows]),
        np.array([[place[row.terms[finger]] for row in rows] for finger in range(len(FINGERS))]),
        np.array([row.weight for row in rows]),
        finger.astype(np.intp),
        share,
        np.where(state == BENT, 0.0, -np.inf),
        np.where(state == STRAIGHT, 0.0, np.inf),
        1 / (scale * np.sqrt(tails)),
        (tails + 1) / 2,
        -np.log(scale),
    )


def _unrest(calibration: Calibration) -> list[float]:
    """Return the standard deviation of each finger that its sensor causes, as a share."""
    return [
        float(np.hypot(raw, level.noise) / abs(level.span))
        for raw, level in zip(RAW_UNREST, calibration.levels, strict=True)
    ]


def _samples(calibration: Calibration) -> Iterator[_Row]:
    for sample in calibration.samples:
        terms = (
            (
                place,
                float(np.clip(stand, MIN_SHARE, MAX_SHARE)),
                float(np.hypot(np.hypot(SAMPLE_SPREAD, noise), RAW_UNREST[place] / 2 / abs(level.span))),
                SAMPLE_TAILS,
                BETWEEN,
            )
            for place, (stand, noise, level) in enumerate(
                zip(sample.shares, sample.noise, calibration.levels, strict=True)
            )
        )
        yield _Row(sample.code, 0.0, tuple(terms))


def _population_rows(
    population: Population, unrest: Sequence[float], in_use: frozenset[str], shown: Sequence[_Row]
) -> Iterator[_Row]:
    used = in_use | AT_REST | {row.code for row in shown}
    for code, positions in _stands(population):
        weight = 0.0 if code in used else float(np.log(UNUSED))
        weight += code[0].count(BETWEEN) * float(np.log(HALF_THUMB))
        weight += code[1:].count(BETWEEN) * float(np.log(HALF))
        terms = tuple(
            (
                place,
                stand.share,
                float(np.hypot(stand.spread, unrest[place])),
                _NORMAL if state == BETWEEN else TAILS,
                state,
            )
            for place, (stand, state) in enumerate(zip(positions, code, strict=True))
        )
        if BETWEEN not in code and any(row.code != code and _is_near(row, terms) for row in shown):
            weight -= OVERRULED
        yield _Row(code, weight, terms)


def _holding_rows(unrest: Sequence[float]) -> Iterator[_Row]:
    for code, stands in HOLDING:
        terms = tuple(
            (place, stand.share, float(np.hypot(stand.spread, unrest[place])), _NORMAL, BETWEEN)
            for place, stand in enumerate(stands)
        )
        yield _Row(code, float(np.log(AT_WORK)), terms)


def _stands(population: Population) -> Iterator[tuple[str, Sequence[Stand]]]:
    for code in _CODES:
        yield code, [population.kinds[kind_of(code, place)] for place in range(len(code))]


def _is_near(sample: _Row, terms: Sequence[Term]) -> bool:
    return all(
        abs(shown[1] - usual[1]) < NEAR * usual[2] for shown, usual in zip(sample.terms, terms, strict=True)
    )
