"""A person: which gesture they like for which command, and the gestures that are their own."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from services.gesture_controller.gestures import Commands, Gestures, Shape, WrongGesture

MAX_OWN_GESTURES = 100
"""Nobody tells so many apart, and screens list them all."""
PERSON_RULE = 'a name is 1 to 64 letters, digits, ".", "_" or "-"; what people call them is the title'


@dataclass(frozen=True, slots=True)
class Sample:
    """A gesture as it was made with a glove: median and noise (1 sigma) of each finger, thumb first, raw."""

    glove: str
    levels: tuple[float, ...]
    noise: tuple[float, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return it as it stands in files and in the database."""
        return {"glove": self.glove, "levels": list(self.levels), "noise": list(self.noise)}


@dataclass(frozen=True, slots=True)
class OwnGesture:
    """A gesture of a person's own; `sample` is there if it was recorded by making it."""

    shape: Shape
    sample: Sample | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return it as it stands in the database and on the wire."""
        return {**self.shape.as_dict(), **({"sample": self.sample.as_dict()} if self.sample else {})}


@dataclass(frozen=True, slots=True)
class Person:
    """What a person has of their own; all else is the site's.

    `commands` names the gesture of a command, None where the person gives it with no gesture at all.
    """

    name: str
    title: str | None = None
    commands: Mapping[int, str | None] = field(default_factory=dict)
    gestures: Mapping[str, OwnGesture] = field(default_factory=dict)


class WrongCommand(ValueError):
    """The `command` cannot be given so; the message names it, the rule and the way out."""

    def __init__(self, command: int, why: str) -> None:
        super().__init__(why)
        self.command = command


def gestures_of(person: Person, site: Gestures) -> Gestures:
    """Return the gestures of `site` and those of `person`; raise `WrongGesture` for one that cannot be."""
    return site.with_shapes({name: own.shape for name, own in person.gestures.items()})


def commands_of(person: Person, site: Commands, gestures: Gestures) -> Commands:
    """Return the commands of `site` as `person` gives them; raise `WrongCommand` for one that cannot be.

    `gestures` are all that the person has.
    """
    given: dict[int, str] = dict(site.gestures)
    for command, gesture in person.commands.items():
        if gesture is None:
            given.pop(command, None)
            continue
        known = gestures.find(gesture)
        if known is None:
            raise WrongCommand(
                command, f'command {command} has the unknown gesture "{gesture}"; {gestures.like(gesture)}'
            )
        given[command] = known
    seen: dict[str, int] = {}
    for command, gesture in sorted(given.items()):
        if seen.setdefault(gesture, command) != command:
            raise WrongCommand(
                command if command in person.commands else seen[gesture],
                f'"{gesture}" stands for the commands {seen[gesture]} and {command} for {person.name}; give '
                "one of them another gesture, or null for none",
            )
    return Commands(given)


def what_works(
    person: Person, gestures: Gestures, commands: Commands
) -> tuple[Gestures, Commands, list[str]]:
    """Return as much of what is `person`'s own as the site's `gestures` and `commands` leave room for.

    The third is what does not fit, one sentence each: a site may have changed its file since.
    """
    faults: list[str] = []
    known = gestures
    for name, own in sorted(person.gestures.items(), key=lambda item: item[1].shape.code is None):
        try:
            known = known.with_shapes({name: own.shape})
        except WrongGesture as error:
            faults.append(str(error))
    left = dict(person.commands)
    while True:
        try:
            return known, commands_of(Person(person.name, commands=left), commands, known), faults
        except WrongCommand as error:
            faults.append(str(error))
            del left[error.command]
