"""A person: their gestures for commands, and their own gestures."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from handover_gloves.recognition.gestures import Commands, Gestures, Shape, WrongGesture

MAX_OWN_GESTURES = 100
"""More than anybody can distinguish; screens list all of them."""
PERSON_RULE = 'a name is 1 to 64 letters, digits, ".", "_" or "-"; what people call them is the title'


@dataclass(frozen=True, slots=True)
class Sample:
    """A recorded gesture: median and noise (1 sigma) of each finger, thumb first, in raw units."""

    glove: str
    levels: tuple[float, ...]
    noise: tuple[float, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return it as in files and in the database."""
        return {"glove": self.glove, "levels": list(self.levels), "noise": list(self.noise)}


@dataclass(frozen=True, slots=True)
class OwnGesture:
    """A person's own gesture; `sample` is None unless it was recorded."""

    shape: Shape
    sample: Sample | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return it as in the database and in REST responses."""
        return {**self.shape.as_dict(), **({"sample": self.sample.as_dict()} if self.sample else {})}


@dataclass(frozen=True, slots=True)
class Person:
    """A person's own commands and gestures; everything else comes from the site.

    `commands` has the gesture of each command; None means that the person has no gesture for it.
    """

    name: str
    title: str | None = None
    commands: Mapping[int, str | None] = field(default_factory=dict)
    gestures: Mapping[str, OwnGesture] = field(default_factory=dict)


class WrongCommand(ValueError):
    """The gesture of `command` is invalid; the message names it, the rule and the remedy."""

    def __init__(self, command: int, why: str) -> None:
        super().__init__(why)
        self.command = command


def gestures_of(person: Person, site: Gestures) -> Gestures:
    """Return the gestures of `site` and of `person`; raise `WrongGesture` for an invalid one."""
    return site.with_shapes({name: own.shape for name, own in person.gestures.items()})


def commands_of(person: Person, site: Commands, gestures: Gestures) -> Commands:
    """Return the commands of `site` with the gestures of `person`; raise `WrongCommand` for an invalid one.

    `gestures` holds all gestures of the person.
    """
    by_command: dict[int, str] = dict(site.gestures)
    for command, gesture in person.commands.items():
        if gesture is None:
            by_command.pop(command, None)
            continue
        name = gestures.find(gesture)
        if name is None:
            raise WrongCommand(
                command, f'command {command} has the unknown gesture "{gesture}"; {gestures.like(gesture)}'
            )
        by_command[command] = name
    seen: dict[str, int] = {}
    for command, gesture in sorted(by_command.items()):
        if seen.setdefault(gesture, command) != command:
            raise WrongCommand(
                command if command in person.commands else seen[gesture],
                f'"{gesture}" stands for the commands {seen[gesture]} and {command} for {person.name}; give '
                "one of them another gesture, or null for none",
            )
    return Commands(by_command)


def without_conflicts(
    person: Person, gestures: Gestures, commands: Commands
) -> tuple[Gestures, Commands, list[str]]:
    """Return the gestures and commands of `person` without those that conflict with the site.

    The third result describes each conflict in a sentence: the site may have changed its file.
    """
    faults: list[str] = []
    usable = gestures
    for name, own in sorted(person.gestures.items(), key=lambda item: item[1].shape.code is None):
        try:
            usable = usable.with_shapes({name: own.shape})
        except WrongGesture as error:
            faults.append(str(error))
    left = dict(person.commands)
    while True:
        try:
            return usable, commands_of(Person(person.name, commands=left), commands, usable), faults
        except WrongCommand as error:
            faults.append(str(error))
            del left[error.command]
