"""The population: prior knowledge of where straight and bent fingers are in all hands.

The position of a finger is a share: 0 is its level in the person's own fist, 1 in their open hand. Fingers
move their neighbours (V. Zatsiorsky, Z. Li, M. Latash: Enslaving effects in multi-finger force production,
Exp. Brain Res. 131, 2000): a bent finger beside a straight one is higher than in the fist, and a thumb or
little finger that is stretched alone does not reach the open hand. `learn` calculates the values from
recordings.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from handover_gloves.recognition.finger_states import BENT, STRAIGHT

Shares = Sequence[float]
"""The positions of the five fingers, thumb first."""

MIN_SHARE, MAX_SHARE = -0.1, 1.08
"""Shares are clipped to this range."""

MAX_OUTLIER_DISTANCE = 0.2
"""The limit of the deviation of a finger from its kind: a larger one means a wrong label."""

_PRIOR_WEIGHT = 4


@dataclass(frozen=True, slots=True)
class Stand:
    """The median share of one kind of finger, and its standard deviation between hands."""

    share: float
    spread: float


@dataclass(frozen=True, slots=True)
class Population:
    """The positions of fingers by kind; see `kind_of`."""

    kinds: Mapping[str, Stand]


BEFOREHAND = Population(
    {
        "straight": Stand(1.0, 0.05),
        "straight little": Stand(1.0, 0.05),
        "straight little alone": Stand(0.85, 0.12),
        "straight thumb": Stand(1.0, 0.16),
        "straight thumb alone": Stand(0.8, 0.2),
        "straight thumb up": Stand(0.95, 0.14),
        "bent": Stand(0.1, 0.12),
        "bent beside": Stand(0.2, 0.12),
        "bent thumb": Stand(0.15, 0.16),
        "bent thumb beside": Stand(0.15, 0.16),
        "half bent": Stand(0.57, 0.12),
        "half bent beside": Stand(0.67, 0.12),
        "half bent thumb": Stand(0.55, 0.17),
        "half bent thumb beside": Stand(0.55, 0.17),
    }
)
"""The assumption without recordings; it has the weight of two to four observed fingers.

A thumb moves about two axes, but its sensor measures only one, so its deviation is larger.
"""


def kind_of(code: str, place: int) -> str:
    """Return the kind of the finger at `place` of a hand that shows `code`; "beside" means beside a straight
    finger."""
    name = {0: " thumb", 4: " little"}.get(place, "")
    beside = [code[neighbour] for neighbour in (place - 1, place + 1) if 0 <= neighbour < len(code)]
    if code[place] == STRAIGHT:
        if place == 0 and STRAIGHT not in code[1:]:
            return "straight thumb up"
        return f"straight{name}" + (" alone" if name and STRAIGHT not in beside else "")
    name = " thumb" if place == 0 else ""
    return ("bent" if code[place] == BENT else "half bent") + name + (" beside" if STRAIGHT in beside else "")


def learn(hands: Iterable[Mapping[str, Sequence[Shares]]], beforehand: Population = BEFOREHAND) -> Population:
    """Return the population of `hands`, each of which has frames by code.

    Each finger of each code counts once per hand, by its median; the limit of the deviation reduces the
    effect of wrong labels.
    """
    seen: dict[str, list[float]] = {kind: [] for kind in beforehand.kinds}
    for hand in hands:
        for code, frames in hand.items():
            if set(code) <= {STRAIGHT, BENT} and frames:
                for place in range(len(code)):
                    stand = median(clipped(frame[place]) for frame in frames)
                    seen[kind_of(code, place)].append(stand)
    return Population({kind: _learnt(seen[kind], stand) for kind, stand in beforehand.kinds.items()})


def clipped(share: float) -> float:
    """Return `share` within `MIN_SHARE` and `MAX_SHARE`."""
    return min(max(share, MIN_SHARE), MAX_SHARE)


def _learnt(seen: Sequence[float], before: Stand) -> Stand:
    if not seen:
        return before
    usual, weight = median(seen), _PRIOR_WEIGHT / 2
    share = (len(seen) * usual + weight * before.share) / (len(seen) + weight)
    away = sum(min(abs(value - usual), MAX_OUTLIER_DISTANCE) ** 2 for value in seen)
    spread = ((_PRIOR_WEIGHT * before.spread**2 + away) / (_PRIOR_WEIGHT + len(seen))) ** 0.5
    return Stand(round(share, 3), round(spread, 3))


HOLDING = (
    ("11111", (Stand(0.5, 0.15), *[Stand(0.5, 0.08)] * 4)),
    ("22222", (Stand(0.5, 0.2), *[Stand(0.35, 0.1)] * 4)),
    ("22222", (Stand(0.6, 0.12), *[Stand(0.22, 0.1)] * 4)),
    ("21222", (Stand(0.5, 0.2), Stand(0.65, 0.12), *[Stand(0.32, 0.1)] * 3)),
)
"""The positions of fingers around an object: something thick, a handle or a key (wider fists), a tool with
the
index finger along it.

These are estimates: an object keeps fingers from closing, and they stay together. So a working hand is not
confused with a gesture whose fingers each deviate a little.
"""

USUAL = Population(
    {
        "straight": Stand(0.991, 0.051),
        "straight little": Stand(1.004, 0.051),
        "straight little alone": Stand(0.832, 0.095),
        "straight thumb": Stand(0.945, 0.12),
        "straight thumb alone": Stand(0.857, 0.17),
        "straight thumb up": Stand(0.95, 0.14),
        "bent": Stand(0.132, 0.102),
        "bent beside": Stand(0.217, 0.133),
        "bent thumb": Stand(0.187, 0.136),
        "bent thumb beside": Stand(0.26, 0.139),
        "half bent": Stand(0.57, 0.12),
        "half bent beside": Stand(0.67, 0.12),
        "half bent thumb": Stand(0.55, 0.17),
        "half bent thumb beside": Stand(0.55, 0.17),
    }
)
"""The result of `learn` for recordings of three people, eight number signs each (J. Cheng, Z. Sun, J. Wang,
J. Zhang, "Chinese Number Gesture Recognition Glove Based on Flex Sensors"). A benchmark with one of the three
must `learn` from the other two."""
