"""A simulated assembly: a hand reaches, grasps, holds tools and parts and rests, without intended gestures.

The grasps are the frequent ones of T. Feix, J. Romero, H. Schmiedmayer, A. Dollar, D. Kragic: The GRASP
Taxonomy of Human Grasp Types (IEEE Trans. Human-Machine Systems 46, 2016). The finger positions of each grasp
are estimates: an object keeps fingers from closing to a fist and from stretching fully.
"""

import random
from collections.abc import Iterator
from dataclasses import dataclass

from glove_sdk_bridge.frames import Five
from glove_sdk_bridge.simulation.hand import AT_REST, Posture, SimulatedHand

Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Grasp:
    """A way to hold an object: the range of each finger position, and of the duration."""

    name: str
    fingers: tuple[Span, Span, Span, Span, Span]
    kept_s: Span


GRASPS = (
    Grasp("cylinder", ((0.35, 0.6), (0.45, 0.65), (0.45, 0.65), (0.45, 0.65), (0.45, 0.65)), (1.0, 5.0)),
    Grasp("handle", ((0.2, 0.5), (0.2, 0.4), (0.15, 0.35), (0.15, 0.35), (0.15, 0.35)), (1.5, 6.0)),
    Grasp("index on it", ((0.2, 0.5), (0.5, 0.72), (0.2, 0.35), (0.15, 0.35), (0.15, 0.35)), (1.0, 4.0)),
    Grasp("pinch", ((0.45, 0.65), (0.4, 0.65), (0.35, 0.6), (0.3, 0.6), (0.3, 0.6)), (0.5, 3.0)),
    Grasp("tripod", ((0.4, 0.6), (0.4, 0.6), (0.4, 0.6), (0.15, 0.4), (0.15, 0.4)), (0.5, 3.0)),
    Grasp("key", ((0.3, 0.6), (0.1, 0.35), (0.1, 0.3), (0.1, 0.3), (0.1, 0.3)), (0.5, 2.5)),
    Grasp("plate", ((0.4, 0.65), (0.55, 0.72), (0.55, 0.72), (0.55, 0.72), (0.5, 0.7)), (1.0, 4.0)),
)
OPENED: Span = (0.7, 0.95)
"""The finger positions on the way to an object."""

REACH_S, CLOSE_S, FUMBLE_S = (0.4, 0.8), (0.2, 0.5), (0.15, 0.4)
FUMBLES = 0.08
"""The standard deviation of finger movements while an object is turned or pressed in."""

RESTS = 0.2
"""The share of grasps that are followed by a rest."""


def assembly(hand: SimulatedHand, seed: int, seconds: float) -> Iterator[Five]:
    """Yield the values of `hand`, thumb first, during `seconds` of work; `seed` makes it reproducible."""
    chance = random.Random(seed)  # noqa: S311 - a simulation, no secret
    left = round(seconds * hand.rate_hz)
    while left > 0:
        for posture, duration_s in _one_part(chance):
            hand.move(posture, duration_s)
            for _ in range(min(left, max(1, round(duration_s * hand.rate_hz)))):
                left -= 1
                yield hand.read()


def _one_part(chance: random.Random) -> Iterator[tuple[Posture, float]]:
    """Yield the movements for one part or tool, with their durations."""
    yield _five([chance.uniform(*OPENED) for _ in range(5)]), chance.uniform(*REACH_S)
    grasp = chance.choice(GRASPS)
    held = [chance.uniform(*span) for span in grasp.fingers]
    yield _five(held), chance.uniform(*CLOSE_S)
    left_s = chance.uniform(*grasp.kept_s)
    while left_s > 0:
        shifted = [
            min(max(share + chance.gauss(0, FUMBLES), span[0]), span[1])
            for share, span in zip(held, grasp.fingers, strict=True)
        ]
        duration_s = chance.uniform(*FUMBLE_S) if chance.random() < 0.5 else chance.uniform(0.5, 2.0)
        yield _five(shifted), duration_s
        left_s -= duration_s
    if chance.random() < RESTS:
        yield AT_REST, chance.uniform(0.5, 3.0)


def _five(shares: list[float]) -> Posture:
    thumb, index, middle, ring, little = shares
    return thumb, index, middle, ring, little
