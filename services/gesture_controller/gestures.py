"""Gestures: hand shapes with names, and the commands that they stand for.

A gesture is the states of five fingers, thumb first: 0 straight, 2 bent. The 21 are those of M2O2P
(Machines 2022, 10, 957, Table 1, with its three misprinted rows put right).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches

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


@dataclass(frozen=True)
class Gestures:
    """The gestures that are known: a name and a code each, both unique."""

    codes: Mapping[str, str]
    names: Mapping[str, str] = field(init=False)
    """Names by code."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", {code: name for name, code in self.codes.items()})

    def __iter__(self) -> Iterator[tuple[str, str]]:
        """Yield name and code of each."""
        return iter(self.codes.items())

    def find(self, name: str) -> str | None:
        """Return the name of a gesture as it is known here, whatever its capitals; None if it is not."""
        if name in self.codes:
            return name
        return next((known for known in self.codes if known.casefold() == name.strip().casefold()), None)

    def like(self, name: str) -> str:
        """Return what a person may have meant by `name`, as half a sentence."""
        close = get_close_matches(name, self.codes, n=1)
        return f'did you mean "{close[0]}"' if close else f"the gestures are {', '.join(self.codes)}"


@dataclass(frozen=True)
class Commands:
    """Which gesture stands for which command; each command has one gesture, each gesture at most one."""

    gestures: Mapping[int, str]
    ids: Mapping[str, int] = field(init=False)
    """Command ids by gesture."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "ids", {gesture: command for command, gesture in self.gestures.items()})

    def with_own(self, own: Mapping[int, str]) -> "Commands":
        """Return the commands of a person who shows some of them with gestures of their own."""
        return Commands({**self.gestures, **own})


def default_commands(gestures: Gestures) -> Commands:
    """Return the command map used when the configuration names none, as far as `gestures` has them."""
    return Commands({command: name for command, name in DEFAULT_COMMANDS.items() if name in gestures.codes})
