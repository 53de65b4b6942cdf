"""The gestures file: the YAML file with the gestures, commands, persons and gloves of a site.

    gestures:                       # all of them; without this section the 21 of M2O2P
      Thumbs up: 02222
      Both thumbs up: {left: 02222, right: 02222}           # a part for each hand, a code or a name
      Wave off: {sequence: [Point with index, Horns]}       # one after the other
    commands:                       # a number and its gesture
      3: Thumbs up
    persons:                        # their own gestures for commands
      anna: {3: Horns}
    answers:                        # without this section, on the screen only
      notGood: Horns
      problem: Little straight
    gloves:                         # without this section one, glove-1
      glove-1: {hand: right, person: anna, thresholds: {thumb: {upper: 1000, lower: 800}}}

Each error message is one line that names the file, the line, the rule and the remedy.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from handover_datamodels.states import Outcome
from handover_gloves.configuration.lined_yaml import Entry, LinedYaml, WrongFile, is_empty
from handover_gloves.recognition.frames import is_glove_name
from handover_gloves.recognition.gestures import (
    M2O2P_GESTURES,
    RESTING,
    Answers,
    Commands,
    Gestures,
    Shape,
    WrongGesture,
    checked_code,
    default_commands,
)
from handover_gloves.recognition.thresholds import M2O2P_THRESHOLDS, Thresholds, WrongThreshold

_SECTIONS = ("gestures", "commands", "persons", "answers", "gloves")


class WrongConfiguration(WrongFile):
    """The gestures file is invalid; the message names the line, the rule and the remedy."""


@dataclass(frozen=True, slots=True)
class GloveConfiguration:
    """A glove of the site: its hand, its wearer (None: nobody by name) and its thresholds."""

    name: str
    hand: str = "right"
    person: str | None = None
    thresholds: Thresholds = M2O2P_THRESHOLDS


@dataclass(frozen=True, slots=True)
class Configuration:
    """The content of the gestures file."""

    gestures: Gestures
    commands: Commands
    persons: Mapping[str, Commands]
    """The commands of each person with own gestures."""
    gloves: tuple[GloveConfiguration, ...]
    answers: Answers = field(default_factory=dict)
    """The gestures that answer a Task with another outcome than `ok`."""

    def restricted_answers(self) -> list[str]:
        """Return a sentence for each answer that some Tasks do not offer by gesture."""
        faults = []
        for whose, commands in {"": self.commands, **self.persons}.items():
            of_person = f" of {whose}" if whose else ""
            for outcome, gesture in self.answers.items():
                if (command := commands.ids.get(gesture)) is not None and (
                    not whose or self.commands.ids.get(gesture) != command
                ):
                    faults.append(
                        f'"{gesture}" is the gesture of the answer {outcome} and of the command {command}'
                        f"{of_person}: a Task that asks for it can be answered {outcome} on the screen only"
                    )
        return faults

    def commands_of(self, person: str | None) -> Commands:
        """Return the commands with the gestures of `person`."""
        return self.persons.get(person, self.commands) if person else self.commands


def built_in() -> Configuration:
    """Return the configuration used without a file: M2O2P's gestures, and glove-1 worn by operator-1."""
    gestures = Gestures(M2O2P_GESTURES)
    glove = GloveConfiguration("glove-1", person="operator-1")
    return Configuration(gestures, default_commands(gestures), {}, (glove,))


def load(path: Path | None) -> Configuration:
    """Return the configuration in the file `path`, or the built-in one; raise `WrongConfiguration`."""
    if path is None:
        return built_in()
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise WrongConfiguration(
            f"the gestures file {path} cannot be read ({error}); correct HANDOVER_GESTURES_FILE"
        ) from None
    return parse(text, path.name)


def parse(text: str, name: str = "gestures.yaml") -> Configuration:
    """Return the configuration in `text`; errors call the file `name`."""
    reader = Reader(name)
    return reader.configuration(reader.compose(text))


class Reader(LinedYaml):
    """Reads the gestures file."""

    mistake: type[WrongFile] = WrongConfiguration

    def configuration(self, root: yaml.Node | None) -> Configuration:
        """Return the configuration under `root`."""
        sections = {} if root is None else {entry.key: entry for entry in self.entries(root, "the file")}
        for entry in sections.values():
            if entry.key not in _SECTIONS:
                allowed = f"{', '.join(_SECTIONS[:-1])} and {_SECTIONS[-1]}"
                raise self.wrong(entry.line, f'unknown section "{entry.key}"; the sections are {allowed}')
        gestures = self._gestures(sections.get("gestures"))
        commands = self._command_map(sections.get("commands"), gestures)
        persons = self._persons(sections.get("persons"), gestures, commands)
        answers = self._answers(sections.get("answers"), gestures)
        return Configuration(gestures, commands, persons, self._gloves(sections.get("gloves")), answers)

    def _gestures(self, section: Entry | None) -> Gestures:
        if section is None:
            return Gestures(M2O2P_GESTURES)
        by_code: dict[str, str] = {}
        composites: dict[str, Shape] = {}
        entries = self.entries(section.value, "gestures")
        for entry in entries:
            if isinstance(entry.value, yaml.MappingNode):
                composites[entry.key] = self.shape(entry)
                continue
            code = self.text(entry.value, f'the code of gesture "{entry.key}"')
            try:
                checked_code(entry.key, code)
            except WrongGesture as error:
                raise self.wrong(entry.line, str(error)) from None
            if code in by_code:
                raise self.wrong(
                    entry.line,
                    f'gesture "{entry.key}" has the code {code}, which "{by_code[code]}" already has; '
                    f"give one of them another code in {self.name}",
                )
            by_code[code] = entry.key
        gestures = Gestures({name: code for code, name in by_code.items()})
        for entry in entries:
            if entry.key in composites:
                try:
                    gestures = gestures.with_shapes({entry.key: composites[entry.key]})
                except WrongGesture as error:
                    raise self.wrong(entry.line, str(error)) from None
        return gestures

    def shape(self, entry: Entry) -> Shape:
        """Return the shape of the gesture that `entry` defines."""
        what = f'gesture "{entry.key}"'
        if not isinstance(entry.value, yaml.MappingNode):
            return Shape(self.text(entry.value, f"the code of {what}"))
        parts = {part.key: part for part in self.entries(entry.value, what)}
        if set(parts) == {"left", "right"}:
            left, right = (
                self.text(parts[hand].value, f"the {hand} hand of {what}") for hand in ("left", "right")
            )
            return Shape(left=left, right=right)
        if set(parts) == {"code"}:
            return Shape(self.text(parts["code"].value, f"the code of {what}"))
        if set(parts) != {"sequence"}:
            raise self.wrong(
                entry.line,
                f"{what} has {', '.join(parts) or 'nothing'}; it is a code such as 02222, or "
                "{left: 02222, right: 02222}, or {sequence: [Horns, Thumbs up]}",
            )
        node = parts["sequence"].value
        if not isinstance(node, yaml.SequenceNode) or len(node.value) != 2:
            raise self.wrong(
                parts["sequence"].line, f"the sequence of {what} is a list of two: [first, second]"
            )
        first, second = (self.text(part, f"a part of {what}") for part in node.value)
        return Shape(sequence=(first, second))

    def _command_map(self, section: Entry | None, gestures: Gestures) -> Commands:
        if section is None:
            return default_commands(gestures)
        by_command = self.gestures_by_command(self.entries(section.value, "commands"), gestures)
        self._refuse_two_meanings(by_command, section.line, "")
        return Commands(by_command)

    def _answers(self, section: Entry | None, gestures: Gestures) -> dict[Outcome, str]:
        if section is None:
            return {}
        answers: dict[Outcome, str] = {}
        for entry in self.entries(section.value, "answers"):
            if entry.key not in {Outcome.NOT_GOOD, Outcome.PROBLEM}:
                raise self.wrong(
                    entry.line,
                    f'unknown answer "{entry.key}"; a gesture can stand for notGood and for problem; ok is '
                    "answered with the gesture that the Task asks for",
                )
            answers[Outcome(entry.key)] = self._answer(entry, gestures, answers.values())
        return answers

    def _answer(self, entry: Entry, gestures: Gestures, taken: Collection[str]) -> str:
        name = self.text(entry.value, f"the gesture of the answer {entry.key}")
        gesture = gestures.find(name)
        if gesture is None:
            raise self.wrong(
                entry.line,
                f'the answer {entry.key} has the unknown gesture "{name}"; {gestures.like(name)}',
            )
        if gesture in gestures.composites:
            raise self.wrong(
                entry.line,
                f'the answer {entry.key} has the gesture "{gesture}", which takes two hands or two steps; '
                "choose a gesture of one hand, so that it can be given at any moment",
            )
        if gestures.codes[gesture] in RESTING:
            raise self.wrong(
                entry.line,
                f'the answer {entry.key} has the gesture "{gesture}", which is how a hand rests or carries; '
                "choose another, or it would be answered by accident",
            )
        if gesture in taken:
            raise self.wrong(
                entry.line, f'"{gesture}" stands for both notGood and problem; choose two different gestures'
            )
        return gesture

    def _persons(
        self, section: Entry | None, gestures: Gestures, commands: Commands
    ) -> Mapping[str, Commands]:
        if section is None:
            return {}
        persons: dict[str, Commands] = {}
        for person in self.entries(section.value, "persons"):
            entries = self.entries(person.value, f'person "{person.key}"')
            own = commands.with_own(self.gestures_by_command(entries, gestures))
            self._refuse_two_meanings(own.gestures, person.line, f' for "{person.key}"')
            persons[person.key] = own
        return persons

    def gestures_by_command(self, entries: Sequence[Entry], gestures: Gestures) -> dict[int, str]:
        """Return the gesture of each command in `entries`."""
        by_command: dict[int, str] = {}
        for entry in entries:
            if not entry.key.isdecimal():
                raise self.wrong(entry.line, f'command "{entry.key}" is not a whole number such as 3')
            name = self.text(entry.value, f"the gesture of command {entry.key}")
            gesture = gestures.find(name)
            if gesture is None:
                raise self.wrong(
                    entry.line, f'command {entry.key} has the unknown gesture "{name}"; {gestures.like(name)}'
                )
            by_command[int(entry.key)] = gesture
        return by_command

    def _refuse_two_meanings(self, by_command: Mapping[int, str], line: int, whose: str) -> None:
        seen: dict[str, int] = {}
        for command, gesture in by_command.items():
            if gesture in seen:
                raise self.wrong(
                    line,
                    f'"{gesture}" stands for the commands {seen[gesture]} and {command}{whose}; '
                    "give one of them another gesture",
                )
            seen[gesture] = command

    def _gloves(self, section: Entry | None) -> tuple[GloveConfiguration, ...]:
        if section is None:
            return built_in().gloves
        gloves: list[GloveConfiguration] = []
        wearers: dict[str, str] = {}
        for entry in self.entries(section.value, "gloves"):
            glove = self._glove(entry)
            if glove.person and wearers.setdefault(glove.person, glove.name) != glove.name:
                raise self.wrong(
                    entry.line,
                    f'person "{glove.person}" wears both {wearers[glove.person]} and {glove.name}; '
                    "a Task for a person needs one glove, so name another person or none",
                )
            gloves.append(glove)
        return tuple(gloves)

    def _glove(self, entry: Entry) -> GloveConfiguration:
        if not is_glove_name(entry.key):
            raise self.wrong(
                entry.line, f'glove "{entry.key}": a name is 1 to 64 letters, digits, ".", "_" or "-"'
            )
        hand, person, thresholds = "right", None, M2O2P_THRESHOLDS
        fields = self.entries(entry.value, f'glove "{entry.key}"') if not is_empty(entry.value) else []
        for member in fields:
            if member.key == "hand":
                hand = self.text(member.value, f'the hand of glove "{entry.key}"')
                if hand not in {"left", "right"}:
                    raise self.wrong(member.line, f'glove "{entry.key}": hand is left or right, not "{hand}"')
            elif member.key == "person":
                person = self.text(member.value, f'the person of glove "{entry.key}"')
            elif member.key == "thresholds":
                thresholds = self.thresholds(entry.key, member)
            else:
                raise self.wrong(
                    member.line,
                    f'glove "{entry.key}" has an unknown field "{member.key}"; '
                    "there are hand, person and thresholds",
                )
        return GloveConfiguration(entry.key, hand, person, thresholds)

    def thresholds(self, glove: str, section: Entry) -> Thresholds:
        """Return the thresholds of `glove`; missing fingers have those of M2O2P."""
        thresholds = M2O2P_THRESHOLDS
        for finger in self.entries(section.value, f'the thresholds of glove "{glove}"'):
            bounds = {
                bound.key: self._bound(bound, f"{finger.key} {bound.key}")
                for bound in self.entries(finger.value, f'finger "{finger.key}"')
            }
            try:
                thresholds = thresholds.with_changes({finger.key: bounds})
            except WrongThreshold as error:
                raise self.wrong(finger.line, f'glove "{glove}": {error}') from None
        return thresholds

    def _bound(self, entry: Entry, what: str) -> float:
        if entry.key != "inverted":
            return self.number(entry, what)
        word = self.text(entry.value, what)
        if word not in {"true", "false"}:
            raise self.wrong(entry.line, f'{what} must be true or false, not "{word}"')
        return word == "true"
